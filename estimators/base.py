"""Interface of all torque estimators: fit, predict a recording, and predict sample by sample."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, runtime_checkable

import numpy as np

from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, JointSample, Motion

DEVIATIONS: Final = 1.959964  # of a normal distribution, that hold 95 %

State: TypeAlias = Any  # each estimator's own; only passed back to its `step`


@dataclass(frozen=True, repr=False)
class Estimate(Displayed):
    """Torque of n joints and how sure it is, for T samples (T, n) or for one (n,).

    95 % of measured torques, filtered as those of training were, are meant to lie within
    `DEVIATIONS` standard deviations. An estimator that does not know its errors says NaN, and flags
    nothing as outside.
    """

    simulation: FloatArray  # [N m], of the physics that was known beforehand
    learned: FloatArray  # [N m], what data add to that
    std: FloatArray  # [N m]
    outside: NDArray[np.bool_]  # the motion is unlike what was learned; `std` is a guess there

    def headline(self) -> str:
        """Say how many samples, and how sure they are."""
        rows, n = (1, *self.torque.shape)[-2:]
        text = f"torque of {rows} samples of {n} joints"
        if np.isnan(self.std).all():
            return text + ", errors unknown"
        return text + f", {np.mean(self.outside):.0%} of it unlike what was learned"

    @property
    def torque(self) -> FloatArray:
        """The whole torque [N m], of the shape of its parts."""
        return self.simulation + self.learned

    def filtered(self, recording: Recording, bandwidth: float) -> Self:
        """Return the estimate of a recording with its torque low-passed as the measured one is.

        Where dry friction changes its sign, a torque as it is differs from one behind a filter by
        as much as that friction, though both are right: errors are judged behind the filter.
        """
        both = np.concatenate([self.simulation, self.learned], axis=1)
        simulation, learned = np.split(recording.filtered(both, bandwidth), 2, axis=1)
        return replace(self, simulation=simulation, learned=learned)

    @classmethod
    def unsure(cls, simulation: FloatArray) -> Estimate:
        """Return torque to which nothing was learned, and whose errors nobody knows."""
        rows, n = simulation.shape
        return cls(simulation, *(_nothing(rows, n) if rows > 1 else _nothing_once(n)))

    @classmethod
    def joined(cls, parts: Sequence[Estimate]) -> Estimate:
        """Return estimates (T, n) that follow each other as one."""
        return cls(
            np.concatenate([part.simulation for part in parts]),
            np.concatenate([part.learned for part in parts]),
            np.concatenate([part.std for part in parts]),
            np.concatenate([part.outside for part in parts]),
        )


def _nothing(rows: int, n: int) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return torque, deviation and flags of who learned nothing, (rows, n) each."""
    return np.zeros((rows, n)), np.full((rows, n), np.nan), np.zeros((rows, n), np.bool_)


@cache
def _nothing_once(n: int) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return these of one row, as a stream needs them a thousand times a second."""
    kept = _nothing(1, n)
    for values in kept:
        values.setflags(write=False)
    return kept


class LiveEstimator(Protocol):
    """Interface of an estimator for a stream of samples."""

    @property
    def n(self) -> int:
        """Number of joints."""
        ...

    @property
    def bandwidth(self) -> float:
        """Of the filters on motion and torque that it was fitted behind [Hz]."""
        ...

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: equal where memory is the same."""
        ...

    def init(self, rate: float | None = None) -> State:
        """Return the memory before the first sample, see `InverseDynamics`."""
        ...

    def advance(self, state: State, motion: Motion) -> tuple[Estimate, State]:
        """Estimate T samples that follow `state`: a whole recording and a `step` in one.

        Args:
            state: Memory after the sample before; not changed.
            motion: T samples of n joints without a gap.

        Returns:
            The torque, (T, n), and the memory after the last sample.

        Raises:
            NotFittedError: `fit` has not been called.
            ShapeError: The motion has another number of joints.
        """
        ...


@runtime_checkable
class InverseDynamics(Protocol):
    """Maps joint motion to joint torque.

    Constructors store; `fit` checks and returns self; fitted attributes end in `_`. Memory goes in
    and out of `step` explicitly, so that one estimator serves several arms.
    """

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit to measured torques.

        Raises:
            RecordingError: The recordings do not suit the robot, or say too little.
        """
        ...

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion.

        Memory is reset at the start of every contiguous segment of the recording.

        Args:
            recording: T samples of n joints; its torque is not looked at.

        Returns:
            Joint torques, (T, n) [N m].

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...

    def init(self, rate: float | None = None) -> State:
        """Return the memory before the first sample.

        Args:
            rate: Rate at which `step` will be called [Hz]; the estimator's own if not given.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...

    def step(self, state: State, sample: JointSample) -> tuple[FloatArray, State]:
        """Predict the torque of the next sample; scanning `step` equals `predict`.

        Args:
            state: Memory after the sample before.
            sample: Motion at the next instant.

        Returns:
            Joint torques (n,) [N m] and the memory after this sample.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...
