"""Which motion is held out, and what a finding has to remove of its errors."""

from __future__ import annotations

import numpy as np
from servo_arms import commands, recorded

from estimators.drives.judgement.held_out import removes, split


def moved(pace):
    """Return a recording of an arm that is where it is commanded."""
    time, command = commands(5.0, 100.0, pace)
    return recorded(time, command, command)


def test_the_fastest_motion_is_fitted_to():
    fast, slow = (moved(pace) for pace in (1.0, 0.6))

    assert split([slow, fast]) == ([fast], [slow])
    assert split([fast, slow]) == ([fast], [slow])


def test_confidence_is_how_often_a_finding_removes_a_tenth():
    rng = np.random.default_rng(0)
    without = rng.normal(size=4000) ** 2
    once = without.copy()
    once[:200] *= 0.1  # one of the blocks

    assert removes(0.5 * without, without) == 0.99
    assert removes(0.95 * without, without) == 0.0
    assert removes(without, without) == 0.0
    assert removes(once, without) < 0.3
