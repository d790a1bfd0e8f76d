"""Split the rows of recordings into training and held-out motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording

LEFT_OUT, TRAINING, HELD_OUT = 0, 1, 2
_LONGEST_BLOCK: Final = 10.0  # [s] of held-out motion at a stretch: about a LIMO pose
_BLOCKS: Final = 20  # at least, into which a recording is cut
_FEWEST_RECORDINGS: Final = 2


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
