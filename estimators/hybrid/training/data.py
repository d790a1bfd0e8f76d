"""Training data of a hybrid: inputs and torques of recordings, normalised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import check_every_joint, check_recordings
from estimators.hybrid.fitted_network import InputScaling, Scaling
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
LEFT_OUT, TRAINING, HELD_OUT = 0, 1, 2
_LONGEST_BLOCK: Final = 10.0  # [s] of held-out motion at a stretch: about a LIMO pose
_BLOCKS: Final = 20  # at least, into which a recording is cut
_FEWEST_RECORDINGS: Final = 2


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
    # Say for each row of each recording who sees it
    if settings.split == "sequences":
        length = settings.sequence_length * stride
        uses = split_sequences(recordings, settings.held_out, random, length, settings.bandwidth)
    elif settings.split == "recordings":
        uses = split_recordings(recordings, settings.held_out, random)
    else:
        uses = split_blocks(recordings, settings.held_out, random)
    for use, recording in zip(uses, recordings, strict=True):
        use[recording.edges(settings.bandwidth)] = LEFT_OUT
    use = np.concatenate(uses)
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


def split_blocks(
    recordings: Sequence[Recording], held_out: float, random: np.random.Generator
) -> list[NDArray[np.int8]]:
    """Hold out whole blocks of up to 10 s of each recording.

    Neighbouring samples are too alike for a split by sample to say anything.
    """
    uses: list[NDArray[np.int8]] = []
    for recording in recordings:
        use = np.full(len(recording), TRAINING, np.int8)
        seconds = min(_LONGEST_BLOCK, recording.duration / _BLOCKS)
        block = max(1, int(seconds * recording.rate))
        blocks = -(-len(recording) // block)
        for i in random.permutation(blocks)[: round(held_out * blocks)]:
            use[i * block : (i + 1) * block] = HELD_OUT
        uses.append(use)
    return uses


def split_sequences(
    recordings: Sequence[Recording],
    held_out: float,
    random: np.random.Generator,
    length: int,
    bandwidth: float,
) -> list[NDArray[np.int8]]:
    """Hold out sub-sequences of `length` rows, drawn from those of all recordings, as the paper.

    They follow each other from the first sure row of a stretch on; rows after the last whole one
    are left out.
    """
    uses = [np.full(len(recording), LEFT_OUT, np.int8) for recording in recordings]
    pieces = [
        use[start : start + length]  # a view, which is written to below
        for use, recording in zip(uses, recordings, strict=True)
        for start in _starts(recording, length, bandwidth)
    ]
    drawn = random.permutation(len(pieces))
    first = round(held_out * len(pieces))
    for i, piece in enumerate(drawn):
        pieces[piece][:] = HELD_OUT if i < first else TRAINING
    return uses


def _starts(recording: Recording, length: int, bandwidth: float) -> list[int]:
    sure = ~recording.edges(bandwidth)
    starts: list[int] = []
    for rows in recording.segments:
        inside = np.flatnonzero(sure[rows]) + rows.start
        if inside.size:
            starts += range(int(inside[0]), int(inside[-1]) + 2 - length, length)
    return starts


def split_recordings(
    recordings: Sequence[Recording], held_out: float, random: np.random.Generator
) -> list[NDArray[np.int8]]:
    """Hold out whole recordings, at least one.

    Raises:
        RecordingError: There is only one.
    """
    count = len(recordings)
    if count < _FEWEST_RECORDINGS:
        raise RecordingError(
            "is the only recording, but some are to be held out whole; give more, or hold out "
            "blocks",
            path=recordings[0].source or None,
        )
    drawn = random.permutation(count)[: min(max(1, round(held_out * count)), count - 1)]
    return [
        np.full(len(recording), HELD_OUT if i in drawn else TRAINING, np.int8)
        for i, recording in enumerate(recordings)
    ]
