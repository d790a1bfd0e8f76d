"""Training data of a hybrid: inputs and residual torques of recordings, and who sees which rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.hybrid import InputScaling, Scaling
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.features import Features
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray

LEFT_OUT, TRAINING, HELD_OUT = 0, 1, 2
_LONGEST_BLOCK: Final = 10.0  # [s] of held-out motion at a stretch: about a LIMO pose
_BLOCKS: Final = 20  # at least, into which a recording is cut
_ROWS: Final = 50_000  # whose inputs are computed at once, to bound memory
_SAME_RATE: Final = 0.05


@dataclass(frozen=True)
class TrainingData:
    """Rows of all recordings, one below the other; a stretch has no gap."""

    inputs: NDArray[np.float32]  # (T, d), normalised
    targets: NDArray[np.float32]  # (T, n), normalised residual torque
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
    features: Features,
    *,
    bandwidth: float,
    rate: float,
    held_out: float,
    random: np.random.Generator,
) -> TrainingData:
    """Compute inputs and targets and set blocks of motion aside.

    Motion and torque go through the same zero-phase filter. Inputs are computed at the recorded
    rate, so that the rotational history misses no reversal. Whole blocks of up to 10 s are held
    out: neighbouring samples are too alike for a split by sample to say anything. Rows near the
    ends of a stretch, whose derivatives are unsure, are in neither part.

    Args:
        simulation: Gives tau_RBD.
        recordings: Measured motion; all at about one rate.
        features: The inputs.
        bandwidth: Of the filters [Hz].
        rate: Wanted rate of the network's samples [Hz].
        held_out: Part of the blocks that is held out.
        random: Draws the blocks.

    Raises:
        RecordingError: There is none, one is of another robot, or their rates differ.
    """
    _check(recordings, simulation)
    inputs: list[NDArray[np.float32]] = []
    targets: list[FloatArray] = []
    for recording in recordings:
        x, torque = _inputs(simulation, recording, features, bandwidth)
        inputs.append(x)
        targets.append(recording.filtered_torque(bandwidth) - torque)
    uses = [_split(recording, bandwidth, held_out, random) for recording in recordings]
    x, y, use = np.concatenate(inputs), np.concatenate(targets), np.concatenate(uses)
    if not (use == TRAINING).any():
        raise RecordingError("the recordings are too short to train on", path=recordings[0].source)
    scalings = InputScaling.of(x[use == TRAINING]), Scaling.of(y[use == TRAINING])
    stride = max(1, round(recordings[0].rate / rate))
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
    if not recordings:
        raise RecordingError("no recording to train on")
    first = recordings[0]
    for recording in recordings:
        recording.check_robot(simulation.model)
        if abs(recording.rate / first.rate - 1.0) > _SAME_RATE:
            raise RecordingError(
                f"was recorded at {recording.rate:.4g} Hz, but {first.source or 'the first'} at "
                f"{first.rate:.4g} Hz; train on recordings of one rate",
                path=recording.source or None,
            )


def _inputs(
    simulation: Simulation, recording: Recording, features: Features, bandwidth: float
) -> tuple[NDArray[np.float32], FloatArray]:
    """Return the inputs (T, d) and tau_RBD (T, n) [N m]; memory starts anew in each segment."""
    motion = recording.motion(bandwidth)
    inputs = np.empty((len(recording), len(features.inputs)), np.float32)
    torque = np.empty(motion.position.shape)
    for rows in recording.segments:
        bodies, memory = simulation.init(), features.init()
        for start in range(rows.start, rows.stop, _ROWS):
            piece = slice(start, min(start + _ROWS, rows.stop))
            torque[piece], bodies = simulation.advance(bodies, motion[piece])
            inputs[piece], memory = features.advance(
                memory, motion[piece], torque[piece], simulation.body
            )
    return inputs, torque


def _split(
    recording: Recording, bandwidth: float, held_out: float, random: np.random.Generator
) -> NDArray[np.int8]:
    """Assign whole blocks of a recording to training or held-out."""
    use = np.full(len(recording), TRAINING, np.int8)
    block = max(1, int(min(_LONGEST_BLOCK, recording.duration / _BLOCKS) * recording.rate))
    blocks = -(-len(recording) // block)
    for i in random.permutation(blocks)[: round(held_out * blocks)]:
        use[i * block : (i + 1) * block] = HELD_OUT
    use[recording.edges(bandwidth)] = LEFT_OUT
    return use


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
