"""Noise: how the residual would look if the simulation were right.

Errors of a torque sensor are correlated in time. Taken for white, any slow wave in them becomes a
discovery. Each joint's errors are an autoregression on the slow grid, and everything is compared
after whitening with it.

Source: Box, Jenkins and Reinsel, "Time Series Analysis", 1994, ch. 7.

What errors have above the bandwidth, of which a diagnosis says nothing.

Vibration, a hum of the mains or a ripple of a fast motor are filtered away before anything is
compared. Where they are most of what a simulation leaves of the torque, that is said.

Source: Welch, "The use of fast Fourier transform for the estimation of power spectra", 1967.

Columns: everything that could be in the residual, as vectors over rows and joints.

A column is a torque that one unit of some parameter would add, on one joint or on several. All are
collected in one table, so that sets of hypotheses are compared on sums of products alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from estimators.diagnosis.settings import FINE, MAD, TINY
from estimators.diagnosis.settings.residuals import ABOVE, NOISE
from estimators.regression.evidence import NormalEquations
from limo_driver.recordings.bandwidth import bandwidth_at
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Noise:
    """Errors of n joints on K rows; row t of a run of used rows is predicted from those before."""

    weight: FloatArray  # (n, order + 1, order): of the last rows, for each number of them known
    white: FloatArray  # (n, order + 1) standard deviation of the prediction error [N m]
    known: IntArray  # (K, n) rows before, at most the order, in the same run

    @classmethod
    def of(
        cls, residual: FloatArray, use: BoolArray, segment: IntArray, least: float = TINY
    ) -> Noise:
        """Fit an autoregression to each joint.

        Args:
            residual: Errors, (K, n) [N m].
            use: Rows that count, (K, n).
            segment: Of each row, (K,); no error is predicted from those of another.
            least: Deviation of any noise [N m].
        """
        n = residual.shape[1]
        weight, white = np.zeros((n, NOISE.order + 1, NOISE.order)), np.zeros((n, NOISE.order + 1))
        known = _known(use, segment)
        for j in range(n):
            weight[j], white[j] = _levinson(
                _covariance(residual[:, j], use[:, j], known[:, j], least)
            )
        return cls(weight, np.maximum(white, least), known)

    def larger(self, factor: FloatArray) -> Noise:
        """Return errors that are alike in time, and larger by a factor of each joint (n,)."""
        return replace(self, white=self.white * factor[:, None])

    def over(self, use: BoolArray, segment: IntArray) -> Noise:
        """Return errors that look the same on other rows, (K, n), within segments (K,)."""
        return replace(self, known=_known(use, segment))

    @classmethod
    def independent(cls, deviation: FloatArray, use: BoolArray) -> Noise:
        """Return white noise of given deviations (n,) [N m] on rows (K, n)."""
        n = deviation.size
        white = np.repeat(deviation[:, None], NOISE.order + 1, axis=1)
        return cls(
            np.zeros((n, NOISE.order + 1, NOISE.order)), white, np.zeros(use.shape, dtype=np.int64)
        )

    def whiten(self, values: FloatArray, joint: int, use: BoolArray | None = None) -> FloatArray:
        """Whiten one joint's errors or columns, (K, ...), to unit variance.

        Returns:
            All rows, or those in `use` (K,).
        """
        wanted = np.arange(values.shape[0]) if use is None else np.flatnonzero(use)
        columns = np.ascontiguousarray(values.reshape(values.shape[0], -1).T)
        known = self.known[wanted, joint]
        white = _whitened(columns, wanted, known, self.weight[joint], self.white[joint])
        return white.T.reshape(wanted.size, *values.shape[1:])


@compiled(reads=("columns", "weight", "white"), nogil=True, error_model="numpy")
def _whitened(
    columns: FloatArray, wanted: IntArray, known: IntArray, weight: FloatArray, white: FloatArray
) -> FloatArray:
    """Return the prediction errors of columns (p, K) over their deviation on R rows, (p, R).

    Run after run of rows of which equally many before are known.
    """
    result = np.empty((columns.shape[0], wanted.size))
    first = 0
    while first < wanted.size:
        order, row, end = known[first], wanted[first], first + 1
        while end < wanted.size and known[end] == order and wanted[end] - end == row - first:
            end += 1
        size = end - first
        for p in range(columns.shape[0]):
            errors, given = result[p, first:end], columns[p, row : row + size]
            for i in range(size):
                errors[i] = given[i]
            for lag in range(1, order + 1):
                before = columns[p, row - lag : row - lag + size]
                for i in range(size):
                    errors[i] -= weight[order, lag - 1] * before[i]
            for i in range(size):
                errors[i] /= white[order]
        first = end
    return result


def _known(use: BoolArray, segment: IntArray) -> IntArray:
    """Count the used rows right before each row in its segment, up to the order; (K, n)."""
    known = np.zeros(use.shape, dtype=np.int64)
    unbroken = np.ones(use.shape, dtype=bool)
    for lag in range(1, NOISE.order + 1):
        before = np.zeros(use.shape, dtype=bool)
        before[lag:] = use[:-lag] & (segment[lag:] == segment[:-lag])[:, None]
        unbroken &= before
        known += unbroken
    return known


def _covariance(residual: FloatArray, use: BoolArray, known: IntArray, least: float) -> FloatArray:
    """Return the covariance of errors 0 to `order` rows apart, (order + 1,) [N² m²]."""
    result = np.zeros(NOISE.order + 1)
    for lag in range(NOISE.order + 1):
        rows = np.flatnonzero(use & (known >= lag))
        if rows.size:
            result[lag] = float(np.mean(residual[rows] * residual[rows - lag]))
    result[0] = result[0] * (1.0 + FINE) + least**2
    return result


def _levinson(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve for the best linear prediction from 0 to `order` rows, one order after the other."""
    weight, white = np.zeros((NOISE.order + 1, NOISE.order)), np.zeros(NOISE.order + 1)
    variance = float(covariance[0])
    white[0] = np.sqrt(variance)
    for order in range(1, NOISE.order + 1):
        last = weight[order - 1, : order - 1]
        reflection = (covariance[order] - last @ covariance[order - 1 : 0 : -1]) / variance
        reflection = float(np.clip(reflection, -NOISE.strongest, NOISE.strongest))
        weight[order, : order - 1] = last - reflection * last[::-1]
        weight[order, order - 1] = reflection
        variance *= 1.0 - reflection**2
        white[order] = np.sqrt(variance)
    return weight, white


def roughness(residual: FloatArray, use: BoolArray, least: float = TINY) -> FloatArray:
    """Return what changes from row to row in residuals (K, n), as a white deviation; (n,) [N m].

    Third differences leave nothing of what changes slowly; a lower bound of the noise, which is
    `least` [N m] at least.
    """
    rough = np.diff(residual, n=3, axis=0)
    rows = use[3:] & use[2:-1] & use[1:-2] & use[:-3]
    energy = np.sum(np.where(rows, rough, 0.0) ** 2, axis=0) / np.maximum(rows.sum(axis=0), 1)
    return np.maximum(np.sqrt(energy / _THIRD), least)


_THIRD = 20.0  # variance of a third difference of white noise


def usual_error(errors: FloatArray) -> float:
    """Return the deviation of most errors [N m], whatever a few of them are."""
    usual = MAD * float(np.median(np.abs(errors))) if errors.size else 0.0
    return max(usual, np.finfo(float).tiny)


def usual_errors(errors: FloatArray, use: BoolArray) -> FloatArray:
    """Return the same of each joint (n,), by the rows (K, n) of its errors (K, n) that count."""
    return np.array([usual_error(errors[rows, j]) for j, rows in enumerate(use.T)])


@dataclass(frozen=True)
class _Band:
    """Frequencies above the bandwidth that stand out of a joint's noise."""

    joint: int  # 1-based
    share: float  # of the squared errors at all frequencies
    low: float  # [Hz]
    high: float  # [Hz]
    rate: float  # of the recording [Hz]


def above_note(simulation: Simulation, recordings: Sequence[Recording], bandwidth: float) -> str:
    """Say where most of what a simulation leaves lies above the bandwidth; nothing if it does not.

    Args:
        simulation: The improved one.
        recordings: With torques.
        bandwidth: Up to which they were compared [Hz].
    """
    found = [band for each in recordings for band in _bands(simulation, each, bandwidth)]
    most = max(found, key=lambda band: band.share, default=None)
    if most is None or most.share < ABOVE.share:
        return ""
    wanted = bandwidth
    while wanted < most.high:
        wanted *= 2.0
    wanted = bandwidth_at(most.rate, wanted)
    shown = (
        f"`--bandwidth {wanted:g}` looks at it, too"
        if wanted > most.high
        else f"with {most.rate:.3g} samples a second, no bandwidth shows it"
    )
    return (
        f"Of what the improved simulation leaves of the torque of joint {most.joint}, "
        f"{most.share:.0%} of the squares lie above the {bandwidth:g} Hz up to which it was "
        f"compared, most of it from {most.low:.3g} to {most.high:.3g} Hz: {shown}."
    )


def _bands(simulation: Simulation, recording: Recording, bandwidth: float) -> Iterator[_Band]:
    rate = recording.rate
    errors = recording.torque - simulation.predict(recording, bandwidth)
    for j in np.flatnonzero(recording.measured_joints).tolist():
        error = errors[np.isfinite(errors[:, j]), j]
        frequency, power = welch(error, rate, nperseg=min(len(error), round(ABOVE.window * rate)))
        above = frequency > bandwidth
        if above.any():
            yield _band(j, rate, frequency, np.where(above, power, 0.0), float(power.sum()))


def _band(j: int, rate: float, frequency: FloatArray, power: FloatArray, whole: float) -> _Band:
    """Return what stands out of a density of power (F,), which is zero up to the bandwidth."""
    usual = float(np.median(power[power > 0.0])) if (power > 0.0).any() else 0.0
    outstanding = np.where(power > ABOVE.outstanding * usual, power, 0.0)
    part = np.cumsum(outstanding) / max(float(outstanding.sum()), np.finfo(float).tiny)
    low, high = (frequency[np.argmax(part >= some)] for some in (1.0 - ABOVE.most, ABOVE.most))
    share = float(outstanding.sum()) / max(whole, np.finfo(float).tiny)
    return _Band(j + 1, share, float(low), float(high), rate)


class ColumnTable:
    """A growing table of columns over K rows and n joints.

    Each column lies together in memory, since most sums are of few of all columns.
    """

    def __init__(self, rows: int, joints: int) -> None:
        self.rows, self.joints = rows, joints
        self.count = 0
        self._values: list[list[FloatArray]] = [[] for _ in range(joints)]  # (c, K) each
        self._index: list[list[IntArray]] = [[] for _ in range(joints)]

    def add(self, joints: Sequence[int], values: FloatArray) -> IntArray:
        """Add c columns that act on some joints (0-based), (len(joints), K, c); their indices."""
        index = np.arange(self.count, self.count + values.shape[2])
        for joint, part in zip(joints, values, strict=True):
            self._values[joint].append(np.ascontiguousarray(part.T))
            self._index[joint].append(index)
        self.count += index.size
        return index

    def of_joint(self, joint: int) -> tuple[FloatArray, IntArray]:
        """Return the columns that act on a joint, (K, p), and their indices (p,)."""
        values, index = self._of_joint(joint)
        return values.T, index

    def _of_joint(self, joint: int) -> tuple[FloatArray, IntArray]:
        """Return the same as they lie in memory, (p, K)."""
        if not self._values[joint]:
            return np.zeros((0, self.rows)), np.zeros(0, dtype=np.int64)
        if len(self._values[joint]) > 1:
            self._values[joint] = [np.concatenate(self._values[joint])]
            self._index[joint] = [np.concatenate(self._index[joint])]
        return self._values[joint][0], self._index[joint][0]

    def apply(self, index: IntArray, coefficients: FloatArray) -> FloatArray:
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

    def only(self, index: IntArray) -> ColumnTable:
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


def _runs(marked: BoolArray) -> Iterator[slice]:
    """Yield the stretches of what is marked: those of a fit mostly lie side by side."""
    ends = np.flatnonzero(np.diff(marked, prepend=False, append=False))
    return (slice(a, b) for a, b in ends.reshape(-1, 2).tolist())


def normal_equations(
    columns: ColumnTable,
    residual: FloatArray,
    noise: Noise,
    use: BoolArray,
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
