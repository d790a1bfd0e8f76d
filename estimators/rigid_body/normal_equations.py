"""Normal equations of torque in the full parameters, accumulated joint by joint over chunks.

What a fit needs of any number of samples is, for each joint, the Gram matrix of its regressor,
its product with the torque, and the torque's energy: a few hundred kB. Other weights of the joints
or other priors need no second pass over the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.regressor import PER_LINK, Chain
from limo_driver.differentiation import smooth
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.rigid_body.terms import JointTerms
    from limo_driver.model import RobotModel
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray, Motion

CHUNK = 1024  # samples; its regressor of 7 joints stays in the cache
MOVING = 0.02  # [rad/s], above which a joint counts as moving


@dataclass(frozen=True)
class Rows:
    """Which measured rows a fit uses, and how they are filtered.

    Args:
        bandwidth: Of the zero-phase filter on position and torque [Hz].
        moving_only: Leave out, joint by joint, rows at which the joint rests. At rest, a torque
            measured on the motor side may lie anywhere within the friction band.
    """

    bandwidth: float = 10.0
    moving_only: bool = False


@dataclass(frozen=True)
class NormalEquations:
    """Sums over all rows, for each of n joints and p full parameters."""

    gram: FloatArray  # (n, p, p), Σ y yᵀ
    product: FloatArray  # (n, p), Σ y tau
    energy: FloatArray  # (n,), Σ tau² [N² m²]
    count: FloatArray  # (n,), rows
    independent: float  # share of rows that say something new: 2 bandwidth / sampling rate

    def weighted(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Σ weight gram (p, p) and Σ weight product (p,) for one weight a joint."""
        return np.tensordot(weight, self.gram, 1), weight @ self.product

    def rmse(self, parameters: FloatArray) -> FloatArray:
        """Return the root mean square error of each joint (n,) [N m] of full parameters (p,)."""
        explained = self.gram @ parameters
        error = self.energy - 2 * self.product @ parameters + explained @ parameters
        return np.sqrt(np.maximum(error, 0.0) / np.maximum(self.count, 1))


def accumulate(
    model: RobotModel, terms: JointTerms, recordings: Sequence[Recording], rows: Rows
) -> NormalEquations:
    """Sum up the normal equations of recordings, holding the regressor of one chunk at a time.

    Raises:
        RecordingError: A recording is of another robot, or no row is left.
    """
    sums = _Sums(model, terms)
    samples, new = 0, 0.0
    for recording in recordings:
        recording.check_robot(model)
        sums.add(recording, rows)
        samples += len(recording)
        new += len(recording) * min(1.0, 2 * rows.bandwidth / recording.rate)
    if not sums.count.any():
        raise RecordingError("no row is left to fit to: nothing moves, or the stretches are short")
    gram, product = sums.symmetric()
    return NormalEquations(gram, product, sums.energy, sums.count, new / samples)


class _Sums:
    """The running sums; each joint's columns are its own links' and its own terms'."""

    def __init__(self, model: RobotModel, terms: JointTerms) -> None:
        self.terms = terms
        self.chain = Chain.of(model)
        self.n = model.n
        self.links = PER_LINK * self.n
        self.own = len(terms.all())
        width = self.links + self.own
        self.gram = [np.zeros((width - PER_LINK * j, width - PER_LINK * j)) for j in range(self.n)]
        self.product = [np.zeros(width - PER_LINK * j) for j in range(self.n)]
        self.energy, self.count = np.zeros(self.n), np.zeros(self.n)
        self._Y = np.zeros((self.n, CHUNK, width))

    def add(self, recording: Recording, rows: Rows) -> None:
        """Add one recording."""
        motion = recording.motion(rows.bandwidth)
        own = self._own_columns(recording, motion, rows)
        torque = recording.filtered_torque(rows.bandwidth)
        inside = ~recording.edges(rows.bandwidth)
        use = inside[:, None] & ((np.abs(motion.velocity) > MOVING) | (not rows.moving_only))
        for start in range(0, len(motion), CHUNK):
            chunk = slice(start, start + CHUNK)
            self._add_chunk(motion[chunk], own[chunk], torque[chunk], use[chunk])

    def _own_columns(self, recording: Recording, motion: Motion, rows: Rows) -> FloatArray:
        """Return the joint terms' columns, (T, n, terms), filtered as the torque was.

        A change of sign at a reversal has all frequencies; the measured torque has lost the high
        ones, so the column must lose them too.
        """
        columns = self.terms.columns(motion.velocity, motion.acceleration)
        for k, term in enumerate(self.terms.all()):
            if term.effect == "coulomb_friction":
                columns[:, :, k] = smooth(
                    recording.time,
                    np.ascontiguousarray(columns[:, :, k]),
                    rows.bandwidth,
                    recording.segments,
                )
        return columns

    def _add_chunk(
        self, motion: Motion, own: FloatArray, torque: FloatArray, use: NDArray[np.bool_]
    ) -> None:
        T = len(motion)
        self.chain.fill(motion, self._Y)
        self._Y[:, :T, self.links :] = own.transpose(1, 0, 2)
        for j in range(self.n):
            y, tau = self._Y[j, :T, PER_LINK * j :], torque[:, j]
            if not use[:, j].all():
                y, tau = y[use[:, j]], tau[use[:, j]]
            self.gram[j] += y.T @ y
            self.product[j] += y.T @ tau
            self.energy[j] += tau @ tau
            self.count[j] += tau.size

    def symmetric(self) -> tuple[FloatArray, FloatArray]:
        """Spread each joint's sums over the full parameters, (n, p, p) and (n, p)."""
        p = self.links + self.n * self.own
        gram, product = np.zeros((self.n, p, p)), np.zeros((self.n, p))
        for j in range(self.n):
            at = np.concatenate(
                [
                    np.arange(PER_LINK * j, self.links),
                    self.links + j + self.n * np.arange(self.own),
                ]
            )
            gram[j][np.ix_(at, at)] = self.gram[j]
            product[j][at] = self.product[j]
        return gram, product
