"""Models on a simulation, which learn its residual or add nothing, and how they are found by name.

Names are limo's own and those of other distributions, through entry points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from inspect import isabstract
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, Self, TypeVar

from estimators.base import Estimate, State
from limo_driver.errors import ConfigError, NotFittedError, ShapeError
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.runtime.plugins import ESTIMATORS, OWN, names, plug_in

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

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

    def going_on_from(self, other: ResidualModel[Any]) -> Self:  # noqa: ARG002  # a subclass's own
        """Learn anew, or only what another on the same simulation does not know, where that can be.

        Args:
            other: Fitted; not changed.
        """
        return self

    @classmethod
    @abstractmethod
    def load(cls, folder: Path | str) -> Self:
        """Read a model folder; runs no code from it.

        Raises:
            ModelStoreError: The folder is incomplete or does not fit together, by name.
        """

    @abstractmethod
    def save(self, folder: Path | str) -> None:
        """Write the model folder: weights, manifest and the simulation.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ModelStoreError: The folder cannot be written.
        """

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


# limo's own that are not trained by their name, and what is given instead
_OTHERWISE: Final = {
    "hybrid": "by the name of its network",
    "rigid-body": "by `limo identify`",
}


def known_estimators() -> tuple[str, ...]:
    """Return all names that are registered, in order; those of plug-ins may prove unusable."""
    return names(ESTIMATORS)


def trained_by_name() -> tuple[str, ...]:
    """Return the names of those that are trained by their own name."""
    return tuple(name for name in names(ESTIMATORS) if name not in _OTHERWISE)


def estimator_called(name: str, own: Collection[str] = ()) -> type[ResidualModel[Any]]:
    """Return an estimator that keeps its models in folders.

    Args:
        name: As it stands in manifests and after `--model`.
        own: Names that limo gives to something else.

    Raises:
        ConfigError: There is none of that name, or it keeps no models in folders.
        PlugInError: It is of another distribution and cannot be used.
    """
    found = plug_in(ESTIMATORS, name, own)
    if found is None:
        raise ConfigError(f"no estimator is called {name!r}; known: {', '.join(names(ESTIMATORS))}")
    estimator: Any = found.load()
    if not (isinstance(estimator, type) and issubclass(estimator, ResidualModel)):
        if found.distribution == OWN:
            raise ConfigError(f"estimator {name!r} keeps no model folder")
        raise found.unusable("is no subclass of estimators.residual_model.ResidualModel")
    if isabstract(estimator):
        lacking = ", ".join(sorted(estimator.__abstractmethods__))
        raise found.unusable(f"{estimator.__name__} does not define {lacking}")
    if getattr(estimator, "name", None) != name:
        given = getattr(estimator, "name", None)
        raise found.unusable(f"{estimator.__name__} calls itself {given!r}, not {name!r}")
    return estimator


def to_train(name: str, own: Collection[str] = ()) -> type[ResidualModel[Any]]:
    """Return an estimator that is trained by its own name.

    Args:
        name: As it stands after `--model`.
        own: Names that limo gives to something else.

    Raises:
        ConfigError: There is none of that name, or it is trained in another way.
        PlugInError: It is of another distribution and cannot be used.
    """
    if name in _OTHERWISE:
        raise ConfigError(f"estimator {name!r} is trained {_OTHERWISE[name]}")
    return estimator_called(name, own)
