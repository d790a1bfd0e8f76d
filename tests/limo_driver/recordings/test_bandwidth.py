"""The bandwidth that recordings are filtered at where nobody tells one."""

from __future__ import annotations

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import RecordingError
from limo_driver.recordings.bandwidth import BANDWIDTH, about_lower_bandwidth, bandwidth_for
from limo_driver.recordings.recording import Recording


def recorded(rate, duration=40.0, torque_of=None):
    """Return smooth motion of a pendulum-like joint, or of an arm's joints, with its torque."""
    time = np.arange(0, duration, 1 / rate)
    n = 2 if torque_of is None else torque_of.n
    pace = 2 * np.pi * (0.07 + 0.03 * np.arange(n))
    angle = np.outer(time, pace) + np.arange(n)
    q, v, a = 0.6 * np.sin(angle), 0.6 * pace * np.cos(angle), -0.6 * pace**2 * np.sin(angle)
    if torque_of is None:
        return Recording.from_arrays(time, q, q)
    torque = torque_of.inverse_dynamics(q, v, a) + 0.8 * np.tanh(v / 0.01)
    torque += np.random.default_rng(1).normal(0, 0.03, q.shape)
    return Recording.from_arrays(time, q, torque)


@pytest.mark.parametrize(("rate", "expected"), [(1000.0, 10.0), (25.0, 10.0), (20.0, 7.2)])
def test_it_is_ten_hertz_or_what_the_slowest_recording_can_bear(rate, expected):
    found = bandwidth_for([recorded(500.0), recorded(rate)])
    assert found == pytest.approx(expected, abs=0.05)
    recorded(rate).motion(found)  # which refuses what it cannot bear


def test_what_a_user_tells_is_kept_and_refused_where_it_does_not_suit():
    slow = recorded(20.0)
    assert bandwidth_for([slow], 9.0) == 9.0
    with pytest.raises(RecordingError, match="at most 8 Hz"):
        limo.Simulation("iiwa14").predict(slow, 9.0)


def test_a_lowered_one_is_told_with_its_reason():
    slow = recorded(20.0)
    said = about_lower_bandwidth([recorded(500.0), slow], bandwidth_for([slow]))
    assert said is not None
    assert "up to 7.2 Hz instead of 10 Hz" in said
    assert "sampled at 20 Hz" in said
    assert about_lower_bandwidth([recorded(500.0)], BANDWIDTH) is None
    assert about_lower_bandwidth([slow], 3.0) is None  # asked for


def test_an_arm_sampled_at_twenty_hertz_is_identified_and_scored():
    arm = limo.RobotModel.load("iiwa14")
    slow = recorded(20.0, torque_of=arm)
    found = limo.identify(arm, slow)
    assert found.rows.bandwidth == pytest.approx(7.2, abs=0.05)
    coulomb = {
        e.joints[0]: e.tau_c for e in found.simulation.effects if e.name == "coulomb_friction"
    }
    assert coulomb == pytest.approx(dict.fromkeys(range(1, 8), 0.8), rel=0.1)
    assert (found.simulation.score(slow).rmse < 0.1).all()
