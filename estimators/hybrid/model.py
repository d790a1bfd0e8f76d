"""Hybrid of a rigid-body simulation and a network that learns what it leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import Estimate
from estimators.hybrid.scaling import normalise_inputs
from estimators.residual_model import ResidualModel
from limo_driver.compiled import compiled
from limo_driver.errors import ConfigError, ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any, Self

    from numpy.typing import NDArray

    from estimators.hybrid.features import Features
    from estimators.hybrid.scaling import InputScaling, Scaling
    from estimators.hybrid.training.fit import TrainingSettings
    from estimators.neural import Network
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, Motion

_RATE_TOLERANCE: Final = 0.1  # of the network's rate; beyond it, its memory runs at another speed
_OUTSIDE: Final = 0.1  # standard deviations of an input beyond its range; nearer, noise may be


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
    def columns(self) -> NDArray[np.int64]:
        """Inputs that the network of each joint may use, (n, f)."""
        return self.features.columns

    @cached_property
    def error(self) -> FloatArray:
        """Root mean square error on motion not trained on, (n,) [N m]; NaN if there was none.

        On stretches left out whole if there were any, else on what was held out: blocks, which
        chose the weights that were kept, and whose neighbours are alike and were trained on.
        """
        rmse = self.record.get("rmse", {})
        known = rmse.get("left_out", rmse.get("held_out", {})).get("hybrid")
        return np.full(self.features.n, np.nan) if known is None else np.array(known)

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
            ConfigError: The network has a memory, and the rate is no positive number.
            ModelStoreError: The network has a memory and its rate cannot be reached.
        """
        if not self.network.recurrent:
            return 1
        if not 0 < rate < np.inf:
            raise ConfigError(f"rate = {rate:g} Hz has to be above 0 and finite")
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


class HybridModel(ResidualModel[FittedNetwork]):
    """Predict tau_HYB = tau_RBD + g F_NN(q, dq, ddq, r, tau_RBD).

    tau_RBD is the prediction of a simulation, normally an identified one; the network learns
    tau_meas - tau_RBD. Its inputs are clipped to what training saw, and the gain g of each joint,
    in [0, 1], is what motion held out from training confirms; g = 1 is the paper's. A network that
    was trained to stand alone predicts the whole torque; tau_RBD is then zero. Neither `predict`
    nor `step` needs PyTorch.

    How sure it is follows from its errors on motion not trained on, and from how far it is from all
    of training:

        variance of the error = e² + (d s)²

    e is the root mean square error on stretches that were left out in turn, or on motion held out
    if none was (NaN if neither), s the standard deviation of what the network had to learn, and d
    how far the farthest input that it sees lies beyond the range of training, in standard
    deviations of that input: at d = 1 the network's part is as good as unknown.

    Args:
        simulation: Gives tau_RBD.
        settings: How to train.

    Source: Çallar and Böttger, "Hybrid Learning of Time-Series Inverse Dynamics Models for Locally
    Isotropic Robot Motion", RA-L 2022, eq. (3).
    """

    name = "hybrid"
    folder = "estimators.hybrid.folder"

    def __init__(self, simulation: Simulation, settings: TrainingSettings | None = None) -> None:
        super().__init__(simulation)
        self.settings = settings

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the filters on motion and torque in training [Hz]."""
        return self.fitted.bandwidth

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Train the network on what the simulation leaves of the filtered torque.

        Raises:
            RecordingError: A recording is of another robot, or too short.
            DivergedError: The loss is no longer finite.
        """
        from estimators.hybrid.training.fit import TrainingSettings, train

        self.fitted_ = train(self.simulation, recordings, self.settings or TrainingSettings())
        return self

    def init(self, rate: float | None = None) -> HybridState:
        """Return the memory before the first sample.

        Args:
            rate: Rate at which `step` will be called [Hz]; the network's own if not given.

        Raises:
            NotFittedError: Nothing was trained or loaded.
            ConfigError: The network has a memory, and the rate is no positive number.
            ModelStoreError: The network has a memory whose rate this one is no multiple of.
        """
        fitted = self.fitted
        return HybridState(
            self.simulation.init(),
            fitted.features.init(),
            fitted.network.init(fitted.stride(fitted.rate if rate is None else rate)),
        )

    def _advance(self, state: HybridState, motion: Motion) -> tuple[Estimate, HybridState]:
        fitted = self.fitted
        if fitted.standalone:
            rigid_body, bodies = np.zeros(motion.position.shape), state.rigid_body
        else:
            rigid_body, bodies = self.simulation.advance(state.rigid_body, motion)
        x, history = fitted.features.advance(
            state.features, motion, rigid_body, self.simulation.body
        )
        beyond = normalise_inputs(x, fitted.inputs.table, fitted.columns)
        y, network = fitted.network.advance(state.network, x)
        learned, std, outside = _torque(
            y, fitted.slope, fitted.offset, beyond, fitted.error, fitted.outputs.std
        )
        estimate = Estimate(rigid_body, learned, std, outside)
        return estimate, HybridState(bodies, history, network)


@compiled(reads=("y", "slope", "offset", "beyond", "error", "unknown"), nogil=True)
def _torque(
    y: FloatArray,
    slope: FloatArray,
    offset: FloatArray,
    beyond: FloatArray,
    error: FloatArray,
    unknown: FloatArray,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return torque, its standard deviation, and what is outside, each (T, n).

    Args:
        y: The network's output, (T, n).
        slope: Torque by it, (n,) [N m].
        offset: Torque where it is zero, (n,) [N m].
        beyond: How far the motion is beyond that of training, (T, n).
        error: On motion not trained on, (n,) [N m].
        unknown: What the network had to learn, (n,) [N m].
    """
    std = np.sqrt(error**2 + (beyond * unknown) ** 2)
    return slope * y + offset, std, beyond > _OUTSIDE
