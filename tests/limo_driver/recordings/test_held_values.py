"""What steps of time that no clock makes do to judgements of motion: nothing."""

import numpy as np
import pytest

from limo_driver.recordings.gate.held_values import near_jumps, velocity_factor

POSITION = np.sin(np.arange(40.0))


@pytest.mark.parametrize("step", [0.0, 5e-324, 1e-300])
def test_steps_as_good_as_none_say_nothing_of_velocities(step):
    time = step * np.arange(40.0)
    factor = velocity_factor(time, POSITION, np.cos(np.arange(40.0)))
    assert factor is None or np.isfinite(factor)


def test_speeds_beyond_numbers_are_no_warning():
    time = np.cumsum(np.full(40, 1e-300))
    assert near_jumps(time, 1e10 * POSITION).shape == (40,)
