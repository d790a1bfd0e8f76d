"""Models on a simulation: ResidualModel, which learns its residual, and the simulation alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, TypeVar

from estimators.base import Estimate
from limo_driver.errors import NotFittedError, ShapeError
from limo_driver.recordings.bandwidth import BANDWIDTH

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Self

    from estimators.base import State
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, JointSample, Motion

_ROWS: Final = 1024  # estimated at a time, to bound memory

Fitted = TypeVar("Fitted")


class ResidualModel(ABC, Generic[Fitted]):
    """Predict tau = tau_S + what was learned, tau_S the prediction of a simulation.

    A subclass fits, and advances; recordings and single samples are all the same. One whose class
    is called with a simulation and a bandwidth can be trained by its name, see `unfitted`. What
    `fit` finds has a `record`: data and errors as JSON values, see `evaluation.trained_on`.

    Args:
        simulation: Gives tau_S, normally an identified one.
    """

    name: ClassVar[str]
    held_out_is: ClassVar[str] = "motion that was not fitted to"  # what its `record` judges it on
    folder: ClassVar[str]  # module of `load` and `save`, where the class has none of its own

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.fitted_: Fitted | None = None

    @classmethod
    def unfitted(cls, simulation: Simulation, bandwidth: float) -> Self:
        """Return a model that can be fitted, as `limo train --model NAME` makes it.

        Args:
            simulation: Gives tau_S.
            bandwidth: Of the zero-phase filters on motion and torque [Hz].
        """
        return cls(simulation, bandwidth)  # pyright: ignore[reportCallIssue]  # a subclass's own

    @classmethod
    def load(cls, folder: Path | str) -> Self:
        """Read a model folder; runs no code from it.

        Raises:
            ModelStoreError: The folder is incomplete or does not fit together, by name.
        """
        return import_module(cls.folder).load(folder)

    def save(self, folder: Path | str) -> None:
        """Write the model folder: weights, manifest and the simulation.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ModelStoreError: The folder cannot be written.
        """
        import_module(self.folder).save(self, folder)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.simulation.model.n

    @property
    @abstractmethod
    def bandwidth(self) -> float:
        """Bandwidth of the zero-phase filters on motion and torque [Hz]."""

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: by default, all of the model."""
        return self

    @property
    def fitted(self) -> Fitted:
        """Result of `fit`.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
        """
        if self.fitted_ is None:
            raise NotFittedError(self.name)
        return self.fitted_

    @abstractmethod
    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit to the simulation's residual of the filtered torque."""

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion, (T, n) [N m]; its torque is not looked at.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The recording has another number of joints.
            ModelStoreError: The recording has another sampling rate than the model can take.
        """
        return self.estimate(recording).torque

    def estimate(self, recording: Recording) -> Estimate:
        """Predict as `predict` does, with the parts, standard deviation and flag.

        Memory is reset at the start of each contiguous segment.
        """
        state = self.init(recording.rate)
        self._check_joints(recording.position.shape)
        motion = recording.motion(self.bandwidth)
        return Estimate.joined(
            [self.advance(state, motion[rows])[0] for rows in recording.segments]
        )

    @abstractmethod
    def init(self, rate: float | None = None) -> State:
        """Return the memory before the first sample.

        Args:
            rate: Rate at which `step` will be called [Hz]; the model's own if not given.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
        """

    def step(self, state: State, sample: JointSample) -> tuple[FloatArray, State]:
        """Predict the torque of the next sample, (n,) [N m], and return the memory after it.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The sample has another number of joints.
        """
        estimate, after = self.advance(state, sample.motion())
        return estimate.torque[0], after

    def advance(self, state: State, motion: Motion) -> tuple[Estimate, State]:
        """Estimate T samples that follow `state`: `estimate` and `step` in one.

        Args:
            state: Memory after the sample before; not changed.
            motion: T samples of as many joints as the model has.

        Returns:
            The torque, (T, n), and the memory after the last sample.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The motion has another number of joints.
        """
        self._check_joints(motion.position.shape)
        if len(motion) <= _ROWS:
            return self._advance(state, motion)
        parts: list[Estimate] = []
        for start in range(0, len(motion), _ROWS):
            part, state = self._advance(state, motion[start : start + _ROWS])
            parts.append(part)
        return Estimate.joined(parts), state

    @abstractmethod
    def _advance(self, state: Any, motion: Motion) -> tuple[Estimate, State]:  # noqa: ANN401
        """Do as `advance` does, for few enough samples of the right shape."""

    def _check_joints(self, shape: tuple[int, ...]) -> None:
        if shape[-1] != self.n:
            raise ShapeError("position", shape, f"(T, {self.n})")


@dataclass(frozen=True)
class SimulationOnly:
    """Predict tau_S and add nothing.

    Args:
        simulation: Gives tau_S.
        bandwidth: Of the filter on live motion [Hz].
    """

    simulation: Simulation
    bandwidth: float = BANDWIDTH

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.simulation.model.n

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: the simulation."""
        return self.simulation

    def init(self, rate: float | None = None) -> State:  # noqa: ARG002  # any will do
        """Return the memory before the first sample."""
        return self.simulation.init()

    def advance(self, state: State, motion: Motion) -> tuple[Estimate, State]:
        """Estimate T samples, see `LiveEstimator`; how sure that is, nobody knows.

        Raises:
            ShapeError: The motion has another number of joints.
        """
        torque, after = self.simulation.advance(state, motion)
        return Estimate.unsure(torque), after
