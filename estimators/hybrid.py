"""Hybrid of a rigid-body simulation and a network that learns what it leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ModelStoreError, NotFittedError, ShapeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any, Self

    from estimators.base import Estimate
    from estimators.features import Features
    from estimators.neural import Network
    from estimators.scaling import InputScaling, Scaling
    from estimators.training import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray, JointSample, Motion

_RATE_TOLERANCE: Final = 0.1  # of the network's rate; beyond it, its memory runs at another speed
_ROWS: Final = 100_000  # evaluated at once, to bound memory


@dataclass(frozen=True)
class FittedNetwork:
    """What training gives: a network and how to feed it."""

    features: Features
    network: Network
    inputs: InputScaling
    outputs: Scaling  # of the residual torque, or of the whole if it stands alone [N m]
    gain: FloatArray  # (n,) in [0, 1], how much of its torque carried over to motion held out
    rate: float  # rate of the samples that follow each other in the network's memory [Hz]
    bandwidth: float  # of the filters on motion and torque in training [Hz]
    record: Mapping[str, Any] = field(default_factory=dict)  # settings, data and metrics, as JSON
    standalone: bool = False  # no rigid-body torque goes into it or is added to it

    @cached_property
    def slope(self) -> FloatArray:
        """Torque by the network's output, (n,) [N m]."""
        return self.gain * self.outputs.std

    @cached_property
    def offset(self) -> FloatArray:
        """Torque where the network's output is zero, (n,) [N m]."""
        return self.gain * self.outputs.mean

    def stride(self, rate: float) -> int:
        """Return how many samples at `rate` [Hz] the network's memory spans at a time.

        Raises:
            ModelStoreError: The network has a memory and its rate cannot be reached.
        """
        if not self.network.recurrent:
            return 1
        stride = max(1, round(rate / self.rate))
        if abs(rate / stride / self.rate - 1.0) > _RATE_TOLERANCE:
            raise ModelStoreError(
                f"the model remembers at {self.rate:.4g} Hz, which samples at {rate:.4g} Hz cannot "
                f"give; train one at {rate / stride:.4g} Hz, or record at a multiple of its rate"
            )
        return stride


@dataclass(frozen=True)
class HybridState:
    """Memory of all three parts after a sample."""

    rigid_body: tuple[FloatArray, ...]
    features: FloatArray
    network: FloatArray


@dataclass(frozen=True)
class TorqueParts:
    """The two parts of a hybrid's torque, each (T, n) [N m]."""

    rigid_body: FloatArray
    network: FloatArray

    @property
    def hybrid(self) -> FloatArray:
        """Their sum, (T, n) [N m]."""
        return self.rigid_body + self.network


class HybridModel:
    """Predict tau_HYB = tau_RBD + g F_NN(q, dq, ddq, r, tau_RBD).

    tau_RBD is the prediction of a simulation, normally an identified one; the network learns
    tau_meas - tau_RBD. Its inputs are clipped to what training saw, and the gain g of each joint,
    in [0, 1], is what motion held out from training confirms; g = 1 is the paper's. A network that
    was trained to stand alone predicts the whole torque; tau_RBD is then zero. Neither `predict`
    nor `step` needs PyTorch.

    Args:
        simulation: Gives tau_RBD.
        settings: How to train.

    Source: Çallar and Böttger, "Hybrid Learning of Time-Series Inverse Dynamics Models for Locally
    Isotropic Robot Motion", RA-L 2022, eq. (3).
    """

    name = "hybrid"

    def __init__(self, simulation: Simulation, settings: TrainingSettings | None = None) -> None:
        self.simulation = simulation
        self.settings = settings
        self.fitted_: FittedNetwork | None = None

    @classmethod
    def load(cls, folder: Path | str) -> HybridModel:
        """Read a model folder; runs no code from it.

        Raises:
            ModelStoreError: The folder is incomplete or does not fit together, by name.
        """
        from estimators.model_store import load

        return load(folder)

    def save(self, folder: Path | str) -> None:
        """Write the model folder: weights, manifest and the simulation."""
        from estimators.model_store import save

        save(self, folder)

    @property
    def fitted(self) -> FittedNetwork:
        """What training gave.

        Raises:
            NotFittedError: Nothing was trained or loaded.
        """
        if self.fitted_ is None:
            raise NotFittedError(self.name)
        return self.fitted_

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Train the network on what the simulation leaves of the filtered torque.

        Raises:
            RecordingError: A recording is of another robot, or too short.
            DivergedError: The loss is no longer finite.
        """
        from estimators.training import TrainingSettings, train

        self.fitted_ = train(self.simulation, recordings, self.settings or TrainingSettings())
        return self

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion, (T, n) [N m]; its torque is not looked at.

        Raises:
            NotFittedError: Nothing was trained or loaded.
            ModelStoreError: The recording has another sampling rate than the model can take.
        """
        return self.parts(recording).hybrid

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the filters on motion and torque in training [Hz]."""
        return self.fitted.bandwidth

    def estimate(self, recording: Recording) -> Estimate:
        """Predict as `predict` does, with standard deviation and flag.

        Raises:
            NotFittedError: Nothing was trained or loaded.
            ModelStoreError: The recording has another sampling rate than the model can take.
        """
        from estimators.hybrid_uncertainty import estimate

        return estimate(self, recording)

    def parts(self, recording: Recording) -> TorqueParts:
        """Predict as `predict` does, and keep the parts; memory starts anew in each segment."""
        fitted = self.fitted
        fitted.stride(recording.rate)
        motion = recording.motion(fitted.bandwidth)
        rigid_body, network = np.empty(motion.position.shape), np.empty(motion.position.shape)
        for rows in recording.segments:
            parts = self.predict_motion(motion[rows], recording.rate)
            rigid_body[rows], network[rows] = parts.rigid_body, parts.network
        return TorqueParts(rigid_body, network)

    def predict_motion(self, motion: Motion, rate: float) -> TorqueParts:
        """Predict one contiguous motion that is sampled at `rate` [Hz], from relaxed memory.

        Raises:
            ShapeError: The motion has another number of joints.
        """
        self._check_joints(motion.position.shape)
        state = self.init(rate)
        chunks: list[TorqueParts] = []
        for start in range(0, len(motion), _ROWS):
            parts, state = self.advance(state, motion[start : start + _ROWS])
            chunks.append(parts)
        return TorqueParts(
            np.concatenate([c.rigid_body for c in chunks]),
            np.concatenate([c.network for c in chunks]),
        )

    def init(self, rate: float | None = None) -> HybridState:
        """Return the memory before the first sample.

        Args:
            rate: Rate at which `step` will be called [Hz]; the network's own if not given.
        """
        fitted = self.fitted
        return HybridState(
            self.simulation.init(),
            fitted.features.init(),
            fitted.network.init(fitted.stride(rate or fitted.rate)),
        )

    def step(self, state: HybridState, sample: JointSample) -> tuple[FloatArray, HybridState]:
        """Predict the torque of the next sample, (n,) [N m], and return the memory after it.

        Raises:
            NotFittedError: Nothing was trained or loaded.
            ShapeError: The sample has another number of joints.
        """
        self._check_joints(sample.position.shape)
        motion = sample.motion()
        parts, after = self.advance(state, motion)
        return parts.hybrid[0], after

    def advance(self, state: HybridState, motion: Motion) -> tuple[TorqueParts, HybridState]:
        """Predict T samples that follow `state`: `predict` and `step` in one.

        Args:
            state: Memory after the sample before; not changed.
            motion: T samples of as many joints as the model has.

        Returns:
            The parts of the torque, and the memory after the last sample.
        """
        fitted = self.fitted
        rigid_body, bodies = np.zeros(motion.position.shape), state.rigid_body
        if not fitted.standalone:
            rigid_body, bodies = self.simulation.advance(state.rigid_body, motion)
        x, history = fitted.features.advance(
            state.features, motion, rigid_body, self.simulation.body, fitted.inputs.table
        )
        y, network = fitted.network.advance(state.network, x)
        parts = TorqueParts(rigid_body, fitted.slope * y + fitted.offset)
        return parts, HybridState(bodies, history, network)

    def _check_joints(self, shape: tuple[int, ...]) -> None:
        n = self.fitted.features.n
        if shape[-1] != n:
            raise ShapeError("position", shape, f"({n},)" if len(shape) == 1 else f"(T, {n})")
