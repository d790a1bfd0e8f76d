"""Training data of a hybrid: inputs and torques of recordings, normalised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.hybrid.scaling import InputScaling, Scaling
from estimators.hybrid.training.split import (
    HELD_OUT,
    LEFT_OUT,
    TRAINING,
    split_blocks,
    split_recordings,
    split_sequences,
)
from estimators.recordings import check_every_joint, check_recordings
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.hybrid.features import Features
    from estimators.hybrid.training.settings import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_ROWS: Final = 50_000  # whose inputs are computed at once, to bound memory
_SAME_RATE: Final = 0.05


@dataclass(frozen=True)
class TrainingData:
    """Rows of all recordings, one below the other; a stretch has no gap."""

    inputs: NDArray[np.float32]  # (T, d), normalised
    targets: NDArray[np.float32]  # (T, n), normalised torque that the network is to give
    use: NDArray[np.int8]  # (T,): LEFT_OUT, TRAINING or HELD_OUT
    stretches: tuple[slice, ...]
    recordings: tuple[slice, ...]
    input_scaling: InputScaling
    output_scaling: Scaling
    stride: int  # rows from one network sample to the next
    rate: float  # of the network samples [Hz]


def prepare(
    simulation: Simulation,
    recordings: Sequence[Recording],
    settings: TrainingSettings,
    random: np.random.Generator,
) -> TrainingData:
    """Compute inputs and targets and hold motion out.

    Motion and torque go through the same zero-phase filter. Inputs are computed at the recorded
    rate, so that the rotational history misses no reversal. Rows near the ends of a stretch, whose
    derivatives are unsure, are neither trained on nor held out. The target is tau_meas - tau_RBD,
    or tau_meas for a network that stands alone.

    Args:
        simulation: Gives tau_RBD.
        recordings: Measured motion; all at about one rate.
        settings: Features, bandwidth, rate of the network's samples, and what is held out.
        random: Draws what is held out.

    Raises:
        RecordingError: There is none, one is of another robot or given twice, nothing moves, no
            torque was measured, or that of a joint was not, their rates differ, or nothing is
            left to train on or hold out.
    """
    _check(recordings, simulation)
    features, bandwidth = settings.features_for(simulation.model.n), settings.bandwidth
    inputs: list[NDArray[np.float32]] = []
    targets: list[FloatArray] = []
    for recording in recordings:
        x, torque = inputs_and_torque(simulation, recording, features, settings)
        inputs.append(x)
        targets.append(recording.filtered_torque(bandwidth) - torque)
    stride = max(1, round(recordings[0].rate / settings.rate)) if settings.rate else 1
    use = np.concatenate(_split(recordings, settings, stride, random))
    x, y = np.concatenate(inputs), np.concatenate(targets)
    _check_split(use, settings.held_out, recordings)
    scalings = InputScaling.of(x[use == TRAINING]), Scaling.of(y[use == TRAINING])
    return TrainingData(
        scalings[0].normalise(x).astype(np.float32),
        scalings[1].normalise(y).astype(np.float32),
        use,
        tuple(_stretches(recordings)),
        tuple(_whole(recordings)),
        *scalings,
        stride,
        recordings[0].rate / stride,
    )


def _check(recordings: Sequence[Recording], simulation: Simulation) -> None:
    check_recordings(recordings, simulation.model)
    check_every_joint(recordings)
    first = recordings[0]
    for recording in recordings:
        if abs(recording.rate / first.rate - 1.0) > _SAME_RATE:
            raise RecordingError(
                f"was recorded at {recording.rate:.4g} Hz, but {first.source or 'the first'} at "
                f"{first.rate:.4g} Hz; train on recordings of one rate",
                path=recording.source or None,
            )


def _check_split(use: NDArray[np.int8], held_out: float, recordings: Sequence[Recording]) -> None:
    for wanted, purpose in ((TRAINING, "train on"), (HELD_OUT, "hold out")):
        if not (use == wanted).any():
            seconds = sum(recording.duration for recording in recordings)
            raise RecordingError(
                f"nothing is left to {purpose}: {held_out:g} of {seconds:.3g} s are to be held out "
                "in whole blocks, without the ends of stretches; give more motion, or another part",
                path=recordings[0].source or None,
            )


def inputs_and_torque(
    simulation: Simulation, recording: Recording, features: Features, settings: TrainingSettings
) -> tuple[NDArray[np.float32], FloatArray]:
    """Compute what the network of a hybrid is given, not normalised, and the rigid body's part.

    Memory is reset at each segment. A network that stands alone is given no tau_RBD: it is zero.

    Args:
        simulation: Gives tau_RBD.
        recording: T samples; their torque is not looked at.
        features: The inputs.
        settings: Say the bandwidth, and whether the network stands alone.

    Returns:
        The inputs (T, d) and tau_RBD (T, n) [N m].
    """
    motion = recording.motion(settings.bandwidth)
    inputs = np.empty((len(recording), len(features.inputs)), np.float32)
    torque = np.zeros(motion.position.shape)
    for rows in recording.segments:
        bodies, memory = simulation.init(), features.init()
        for start in range(rows.start, rows.stop, _ROWS):
            piece = slice(start, min(start + _ROWS, rows.stop))
            if not settings.standalone:
                torque[piece], bodies = simulation.advance(bodies, motion[piece])
            inputs[piece], memory = features.advance(
                memory, motion[piece], torque[piece], simulation.body
            )
    return inputs, torque


def _split(
    recordings: Sequence[Recording],
    settings: TrainingSettings,
    stride: int,
    random: np.random.Generator,
) -> list[NDArray[np.int8]]:
    """Say for each row of each recording who sees it."""
    if settings.split == "sequences":
        length = settings.sequence_length * stride
        uses = split_sequences(recordings, settings.held_out, random, length, settings.bandwidth)
    elif settings.split == "recordings":
        uses = split_recordings(recordings, settings.held_out, random)
    else:
        uses = split_blocks(recordings, settings.held_out, random)
    for use, recording in zip(uses, recordings, strict=True):
        use[recording.edges(settings.bandwidth)] = LEFT_OUT
    return uses


def _stretches(recordings: Sequence[Recording]) -> Iterator[slice]:
    before = 0
    for recording in recordings:
        for rows in recording.segments:
            yield slice(before + rows.start, before + rows.stop)
        before += len(recording)


def _whole(recordings: Sequence[Recording]) -> Iterator[slice]:
    before = 0
    for recording in recordings:
        yield slice(before, before + len(recording))
        before += len(recording)
