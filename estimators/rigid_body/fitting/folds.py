"""Folds: parts of the recordings that a fit leaves out, to see how far its parameters hold.

A recording is cut into blocks of time, which are dealt to the folds in turn. Blocks are far longer
than the errors remember, so that those of one fold say little about those of another; in a long
recording each fold has many, so that no fold is all there is of one kind of motion.

What the fits without each fold disagree by is the delete-a-group jackknife,

    V = (F - 1)/F Σ_f (phi_f - mean)(phi_f - mean)ᵀ,

a covariance that asks no model of the errors: what a wrong model pulls the parameters to changes
with the motion, and so shows.

Source: Shao and Tu, "The Jackknife and Bootstrap", 1995, sec. 2.3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FOLDS = 5
_LONGEST = 10.0  # [s] of a block


def fold_of(recording: Recording) -> NDArray[np.int64]:
    """Return which fold each sample of a recording is in, (T,)."""
    time = recording.time - recording.time[0]
    block = min(_LONGEST, recording.duration / FOLDS)
    return np.floor(time / block).astype(np.int64) % FOLDS


def jackknife(fits: Sequence[FloatArray]) -> FloatArray:
    """Return the covariance (p, p) of parameters, from those (p,) fitted without each fold."""
    off = np.array(fits) - np.mean(fits, axis=0)
    return (len(fits) - 1) / len(fits) * off.T @ off
