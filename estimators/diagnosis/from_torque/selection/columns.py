"""Columns: everything that could be in the residual, as vectors over rows and joints.

A column is a torque that one unit of some parameter would add, on one joint or on several. All are
collected in one table, so that sets of hypotheses are compared on sums of products alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.regression.evidence import NormalEquations

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from limo_driver.types import FloatArray


class ColumnTable:
    """A growing table of columns over K rows and n joints.

    Each column lies together in memory, since most sums are of few of all columns.
    """

    def __init__(self, rows: int, joints: int) -> None:
        self.rows, self.joints = rows, joints
        self.count = 0
        self._values: list[list[FloatArray]] = [[] for _ in range(joints)]  # (c, K) each
        self._index: list[list[NDArray[np.int64]]] = [[] for _ in range(joints)]

    def add(self, joints: Sequence[int], values: FloatArray) -> NDArray[np.int64]:
        """Add c columns that act on some joints (0-based), (len(joints), K, c); their indices."""
        index = np.arange(self.count, self.count + values.shape[2])
        for joint, part in zip(joints, values, strict=True):
            self._values[joint].append(np.ascontiguousarray(part.T))
            self._index[joint].append(index)
        self.count += index.size
        return index

    def of_joint(self, joint: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the columns that act on a joint, (K, p), and their indices (p,)."""
        values, index = self._of_joint(joint)
        return values.T, index

    def _of_joint(self, joint: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the same as they lie in memory, (p, K)."""
        if not self._values[joint]:
            return np.zeros((0, self.rows)), np.zeros(0, dtype=np.int64)
        if len(self._values[joint]) > 1:
            self._values[joint] = [np.concatenate(self._values[joint])]
            self._index[joint] = [np.concatenate(self._index[joint])]
        return self._values[joint][0], self._index[joint][0]

    def apply(self, index: NDArray[np.int64], coefficients: FloatArray) -> FloatArray:
        """Return the torque of some columns times coefficients, (K, n) [N m]."""
        full = np.zeros(self.count)
        np.add.at(full, index, coefficients)
        result = np.zeros((self.rows, self.joints))
        for joint in range(self.joints):
            values, at = self._of_joint(joint)
            own = full[at]
            for some in _runs(own != 0.0):
                result[:, joint] += own[some] @ values[some]
        return result

    def only(self, index: NDArray[np.int64]) -> ColumnTable:
        """Return a table of some of the columns (c,), numbered as they are given."""
        place = np.full(self.count, -1)
        place[index] = np.arange(index.size)
        some = ColumnTable(self.rows, self.joints)
        some.count = index.size
        for joint in range(self.joints):
            values, at = self._of_joint(joint)
            own = np.flatnonzero(place[at] >= 0)
            own = own[np.argsort(place[at[own]])]
            some._values[joint], some._index[joint] = [values[own]], [place[at[own]]]
        return some

    def size(self) -> FloatArray:
        """Return each column's RMS on the joint where it is largest, (P,)."""
        size = np.zeros(self.count)
        for joint in range(self.joints):
            values, at = self._of_joint(joint)
            np.maximum.at(size, at, np.sqrt(np.mean(values**2, axis=1)))
        return size


def _runs(marked: NDArray[np.bool_]) -> Iterator[slice]:
    """Yield the stretches of what is marked: those of a fit mostly lie side by side."""
    ends = np.flatnonzero(np.diff(marked, prepend=False, append=False))
    return (slice(a, b) for a, b in ends.reshape(-1, 2).tolist())


def normal_equations(
    columns: ColumnTable,
    residual: FloatArray,
    noise: Noise,
    use: NDArray[np.bool_],
    known: NormalEquations | None = None,
) -> NormalEquations:
    """Sum over the rows in `use`, (K, n), with each joint's errors whitened.

    Args:
        columns: The table.
        residual: (K, n) [N m].
        noise: Of each joint.
        use: Rows that count, (K, n).
        known: The same sums over the columns that the table had before.
    """
    old = 0 if known is None else known.product.size
    if known is not None and old == columns.count:
        return known
    gram, product = np.zeros((columns.count, columns.count)), np.zeros(columns.count)
    if known is not None:
        gram[:old, :old] = known.gram
    for joint in range(columns.joints):
        values, at = columns.of_joint(joint)
        rows = use[:, joint]
        A = noise.whiten(values, joint, rows)
        y = noise.whiten(residual[:, joint], joint, rows)
        first = int(np.searchsorted(at, old))  # column that is new; they are in order
        new = A.T @ A[:, first:]
        gram[np.ix_(at, at[first:])] += new
        gram[np.ix_(at[first:], at[:first])] += new[:first].T
        product[at] += A.T @ y
    return NormalEquations(gram, product)
