"""What is believed of measurements, and when."""

from __future__ import annotations

import numpy as np
import pytest
from contracts import LIMITS, PERIOD, POSE, ZERO, moved, only, reason, started, state

from limo_driver.robot.measured import Belief, Measured

REACH = 1.2 * LIMITS.velocity * 2 * PERIOD + 0.01  # [rad] in a cycle, which may begin late


def believing(*states):
    """Return what is believed after some states, and whether each was."""
    measured, belief = Measured(LIMITS, PERIOD), Belief()
    return measured, belief, [measured.take(item, belief) for item in states]


@pytest.mark.parametrize("j", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_pose_within_reach_is_believed_and_no_other(j, sign):
    for factor, fine in ((0.99, True), (1.01, False)):
        there = only(j, POSE[j] + sign * factor * REACH[j], POSE)
        assert believing(state(), state(1, there))[2] == [True, fine]


def test_reach_grows_while_nothing_is_measured():
    there = POSE + 3 * 1.2 * LIMITS.velocity * PERIOD
    lost = [state(0, stale=True)] * 3
    assert believing(state(), *lost, state(4, there))[2][-1]
    assert not believing(state(), state(1, there + 0.02))[2][-1]


def test_a_pose_that_insists_is_believed_in_the_end():
    there = state(1, POSE + 0.5)
    again = [state(k, POSE + 0.5) for k in (1, 2, 3)]
    assert believing(state(), *again)[2] == [True, False, False, True]
    elsewhere = [there, state(2, POSE - 0.5), state(3, POSE + 0.5), state(4, POSE - 0.5)]
    assert believing(state(), *elsewhere)[2] == [True, False, False, False, False]
    between = [there, state(2, POSE), state(3, POSE + 0.5), state(4, POSE + 0.5)]
    assert believing(state(), *between)[2] == [True, False, True, False, False]


def test_an_arm_that_is_commanded_holds_where_its_pose_jumped():
    contract = started(moved(valid_for=1.0))
    for cycle in (1, 2):
        assert contract.observe(state(cycle, POSE + 0.5)).stale
        assert not contract.holding
    assert not contract.observe(state(3, POSE + 0.5)).stale
    assert "the measured pose jumped" in reason(contract)
    assert np.array_equal(contract.setpoint, POSE)  # which the drives hold


@pytest.mark.parametrize("name", ["position", "velocity", "torque"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_never_believed(name, bad):
    from dataclasses import replace

    spoiled = [replace(state(k), **{name: only(1, bad)}) for k in range(5)]
    assert not any(believing(state(), *spoiled)[2][1:])
    assert not any(believing(*spoiled)[2])


@pytest.mark.parametrize("jump", [-3600.0, -0.01, 0.0, 1e-9, np.nan, -np.inf])
def test_time_goes_on_whatever_the_clock_says(jump):
    """By a cycle where the clock stands or goes back; it counts on from there."""
    shown = [k * PERIOD for k in range(5)] + [4 * PERIOD + jump + k * PERIOD for k in range(1, 5)]
    measured, belief, times = Measured(LIMITS, PERIOD), Belief(), []
    for cycle, time in enumerate(shown):
        measured.take(state(cycle, time=time), belief)
        times.append(belief.time)
    steps = np.diff(times)
    assert (steps >= 0.8 * PERIOD - 1e-12).all()
    assert (steps <= 1.01 * PERIOD).all()


def test_a_clock_that_leaps_is_followed():
    """The last command expires by it, which is safe."""
    contract = started(moved(valid_for=1.0))
    contract.observe(state(1, time=3600.0))
    assert "expired" in reason(contract)


def test_a_lost_measurement_is_carried_on_by_its_motion():
    speed, faster = np.array([0.5, -1.0, 0.25]), np.array([0.1, 0.1, 0.1])
    first = state(0, POSE, speed)
    second = state(1, POSE + PERIOD * speed, speed + PERIOD * faster)
    measured, belief, _ = believing(first, second, state(1, stale=True), state(1, stale=True))
    now = measured.now(belief)
    assert now.velocity == pytest.approx(speed + 3 * PERIOD * faster)
    way = 2 * PERIOD * second.velocity + 0.5 * (2 * PERIOD) ** 2 * faster
    assert now.position == pytest.approx(second.position + way)
    assert now.time == pytest.approx(3 * PERIOD)


def test_nothing_is_known_before_the_first():
    measured, belief, told = believing(state(0, ZERO * np.nan))
    assert told == [False]
    assert measured.now(belief) is None
