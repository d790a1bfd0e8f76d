"""Hybrid of a rigid-body simulation and a network that learns its residual."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from estimators.base import Estimate
from estimators.hybrid.fitted_network import (
    PACKAGES,
    FittedNetwork,
    entries_of,
    fitted_in,
    normalise_inputs,
    tensors_in,
)
from estimators.model_folder import ModelFolder, provenance, write_folder
from estimators.residual_model import ResidualModel
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, Motion

_OUTSIDE: Final = 0.1  # standard deviations of an input beyond its range; nearer, noise may be


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

    def __init__(self, simulation: Simulation, settings: TrainingSettings | None = None) -> None:
        super().__init__(simulation)
        self.settings = settings

    @classmethod
    def load(cls, folder: Path | str) -> Self:
        """Read a model folder, see `ResidualModel`."""
        opened = ModelFolder.open(folder, cls.name)
        model = cls(opened.simulation)
        model.fitted_ = fitted_in(opened)
        return model

    def save(self, folder: Path | str) -> None:
        """Write a model folder, see `ResidualModel`."""
        entries = {"estimator": self.name, **entries_of(self.fitted)}
        write_folder(folder, entries, tensors_in(self.fitted), self.simulation, PACKAGES)

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the filters on motion and torque in training [Hz]."""
        return self.fitted.bandwidth

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Train the network on the simulation's residual of the filtered torque.

        Raises:
            RecordingError: A recording is of another robot, or too short.
            DivergedError: The loss is no longer finite.
        """
        from estimators.hybrid.training.settings import TrainingSettings

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
) -> tuple[FloatArray, FloatArray, BoolArray]:
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


def train(
    simulation: Simulation,
    recordings: Sequence[Recording],
    settings: TrainingSettings,
    on_epoch: Callable[[Epoch], None] = lambda _: None,
    unfinished: Path | None = None,
) -> FittedNetwork:
    """Train a network on tau_meas - tau_RBD, or on tau_meas alone.

    After it, networks that do not see a part of the motion show how much of what is learned carries
    over to other motion: the gain of each joint.

    The loss is the MSE of the normalised residual, so that every joint counts the same. AdamW
    starts at `learning_rate`, which falls to zero along a cosine, or is halved when the training
    loss stops falling. A recurrent network answers every sample of a sequence, not only the last,
    so that each sequence gives as many targets as it has samples. Its memory is carried through
    `carried` sequences: it is trained as it is used, scanning long motion.

    Args:
        simulation: Gives tau_RBD.
        recordings: Measured motion and torque, at about one rate.
        settings: How to train.
        on_epoch: Called after each epoch, for a progress bar.
        unfinished: Folder in which each epoch is kept, to go on from after a kill.

    Raises:
        ConfigError: The device is not there, or what was kept cannot be read.
        RecordingError: A recording is of another robot, or too short for a sequence.
        DivergedError: The loss is no longer finite.

    Source: Çallar and Böttger, RA-L 2022, sec. III-D, whose recurrent networks answer only the last
    sample of each sequence.
    """
    from estimators.hybrid.training.data import prepare
    from estimators.hybrid.training.fit import device_for, fit_prepared

    device_for(settings)  # refused before the inputs are computed, which takes a while
    data = prepare(simulation, recordings, settings, np.random.default_rng(settings.seed))
    fitted = fit_prepared(data, settings, on_epoch, unfinished)
    # RMSE per joint [N m] of rigid body and hybrid, as they are used: scanning it all
    from estimators.hybrid.training.data import HELD_OUT, TRAINING

    model = HybridModel(simulation)
    model.fitted_ = fitted
    bandwidth = fitted.bandwidth
    found = [model.estimate(recording).filtered(recording, bandwidth) for recording in recordings]
    torque = np.concatenate([r.filtered_torque(bandwidth) for r in recordings])
    predicted = {
        "rigid_body": np.concatenate([own.simulation for own in found]),
        "hybrid": np.concatenate([own.torque for own in found]),
    }
    rows = {"training": data.use == TRAINING, "held_out": data.use == HELD_OUT}
    record = {
        **fitted.record,
        "recordings": [provenance(recording) for recording in recordings],
        "rmse": {
            where: {
                name: np.sqrt(np.mean((torque - values)[use] ** 2, axis=0)).tolist()
                for name, values in predicted.items()
            }
            for where, use in rows.items()
        }
        | fitted.record.get("rmse", {}),
    }
    return replace(fitted, record=record)
