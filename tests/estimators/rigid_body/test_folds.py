"""Folds of recordings."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.rigid_body.fitting.effective_rows import FOLDS, fold_of
from limo_driver.recordings.recording import Recording


def test_folds_cut_short_recordings_once_and_long_ones_often():
    for duration, blocks in ((20.0, 5), (100.0, 10), (300.0, 30)):
        time = np.arange(0.0, duration, 0.1)
        fold = fold_of(Recording(time, np.zeros((time.size, 7)), np.zeros((time.size, 7))))
        assert set(fold) == set(range(FOLDS))
        assert np.count_nonzero(np.diff(fold)) == pytest.approx(blocks, abs=1)
