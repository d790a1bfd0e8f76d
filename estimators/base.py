"""What every torque estimator can do: fit, predict a recording, and predict sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    import numpy as np
    from numpy.typing import NDArray

    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray, JointSample

DEVIATIONS: Final = 1.959964  # of a normal distribution, that hold 95 %

State: TypeAlias = Any  # each estimator's own; only passed back to its `step`


@dataclass(frozen=True)
class Estimate:
    """Torque of n joints and how sure it is, for T samples (T, n) or for one (n,).

    95 % of measured torques, filtered as those of training were, are meant to lie within
    `DEVIATIONS` standard deviations.
    """

    torque: FloatArray  # [N m]
    std: FloatArray  # [N m]
    outside: NDArray[np.bool_]  # the motion is unlike what was learned; `std` is a guess there


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

        Memory starts anew in every contiguous segment of the recording.

        Args:
            recording: T samples of n joints; its torque is not looked at.

        Returns:
            Joint torques, (T, n) [N m].

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...

    def init(self) -> State:
        """Return the memory before the first sample.

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
