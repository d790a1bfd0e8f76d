"""Folds: parts of the recordings that a fit leaves out, to see how far its parameters hold.

A recording is cut into blocks of time, which are dealt to the folds in turn. Blocks are far longer
than the errors remember, so that those of one fold say little about those of another; in a long
recording each fold has many, so that no fold is all there is of one kind of motion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording

FOLDS = 5
_LONGEST = 10.0  # [s] of a block


def fold_of(recording: Recording) -> NDArray[np.int64]:
    """Return which fold each sample of a recording is in, (T,)."""
    time = recording.time - recording.time[0]
    block = min(_LONGEST, recording.duration / FOLDS)
    return np.floor(time / block).astype(np.int64) % FOLDS
