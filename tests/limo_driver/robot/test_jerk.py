"""Jerk is kept where an arm states a limit; range, velocity and acceleration come before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import LIMITS, PERIOD, POSE, SPEC, ZERO, moved, opened, pushed, sprung, state
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.robot.jerk import JerkLimits
from limo_driver.robot.setpoints import names_of

JERK = np.array([200.0, 40.0, 2000.0])  # the last allows all of its acceleration within a cycle
SMOOTH = replace(SPEC, jerk=JERK)
STEP = JERK * PERIOD**2  # of the change of velocity [rad/s]
JUST = 1 + 2e-6


def run(targets, position=POSE):
    """Follow targets from rest; return positions, velocities and the limits met."""
    keeps, now, change = JerkLimits(LIMITS, PERIOD, JERK), (position, ZERO), None
    goal, path, speeds, met = position, [position], [ZERO], []
    for target in targets:
        after = keeps.follow(target, goal, *now, change)
        change, now, goal = after[1] - now[1], after[:2], target
        path.append(after[0])
        speeds.append(after[1])
        met.append(after[2])
    return np.array(path), np.array(speeds), met


def assert_kept(path):
    """Check every limit on positions alone."""
    velocity = np.diff(path, axis=0) / PERIOD
    change = np.diff(velocity, axis=0)
    assert (path >= LIMITS.position_min - 1e-12).all()
    assert (path <= LIMITS.position_max + 1e-12).all()
    assert (np.abs(velocity) <= LIMITS.velocity * JUST).all()
    assert (np.abs(change) <= LIMITS.acceleration * PERIOD * JUST).all()
    assert (np.abs(np.diff(change, axis=0)) <= STEP * JUST + 1e-11).all()


@st.composite
def wandering(draw):
    """Draw targets that rest, jump, run, and leave the range."""
    targets, last = [], POSE
    for _ in range(draw(st.integers(2, 5))):
        cycles = draw(st.integers(1, 60))
        kind = draw(st.sampled_from(["rest", "jump", "run"]))
        share = np.array(draw(st.lists(st.floats(-1.3, 1.3), min_size=3, max_size=3)))
        if kind == "jump":
            last = POSE + share * 0.6 * (LIMITS.position_max - LIMITS.position_min)
        speed = share * LIMITS.velocity * PERIOD if kind == "run" else ZERO
        steps = last + np.arange(1, cycles + 1)[:, None] * speed
        targets.append(steps)
        last = steps[-1]
    return np.vstack([*targets, np.tile(last, (40, 1))])


@settings(max_examples=15, deadline=None)
@given(wandering())
def test_of_any_stream_is_kept_with_all_other_limits(targets):
    path, _, met = run(targets)
    assert_kept(path)
    for target, sent, hit in zip(targets, path[1:], met, strict=True):
        assert np.array_equal(target, sent) == (hit == 0)
        assert hit == 0 or names_of(hit)


@settings(max_examples=15, deadline=None)
@given(wandering(), st.integers(0, 60))
def test_of_braking_is_kept_from_anywhere(targets, cycles):
    """It comes to rest inside the range, whatever was going on."""
    path, speeds, _ = run(targets[:cycles])
    keeps, now = JerkLimits(LIMITS, PERIOD, JERK), (path[-1], speeds[-1])
    change = speeds[-1] - speeds[-2] if len(speeds) > 1 else ZERO
    path = list(path)
    for _ in range(2000):
        after = keeps.brake(*now, change)
        change, now = after[1] - now[1], after
        path.append(after[0])
        if not now[1].any() and not change.any():
            break
    else:
        pytest.fail("it does not come to rest")
    assert_kept(np.array(path))


@pytest.mark.parametrize("distance", [-0.7, -0.02, 0.004, 0.6])
def test_that_is_limited_still_meets_a_target_without_overshoot(distance):
    goal = POSE + distance
    path, _, met = run([goal] * 1200)
    assert_kept(path)
    assert (np.sign(distance) * (path - goal) <= 1e-12).all()
    assert np.array_equal(path[-1], goal)
    assert met[-1] == 0
    assert "jerk" in names_of(met[0])


def test_of_a_smooth_stream_leaves_it_as_it_is():
    """A quintic from rest to rest whose peaks are 0.9 of the tightest limit."""
    s = np.linspace(0.0, 1.0, 401)
    blend = s**3 * (10 - 15 * s + 6 * s**2)
    duration = PERIOD * 400
    peaks = 1.875 / duration / LIMITS.velocity, 5.7736 / duration**2 / LIMITS.acceleration
    away = 0.9 / np.max([*peaks, 60.0 / duration**3 / JERK], axis=0)
    targets = POSE + np.minimum(away, 0.4) * blend[1:, None]
    path, _, met = run(targets)
    assert np.array_equal(path[1:], targets)
    assert not any(met)


def test_in_one_go_is_that_one_by_one():
    targets = POSE + 0.3 * np.sin(0.2 * np.arange(60))[:, None]
    path, speeds, met = run(targets)
    together, quick, hit = JerkLimits(LIMITS, PERIOD, JERK).follow_path(targets, POSE, POSE, ZERO)
    assert np.array_equal(together, path[1:])
    assert np.array_equal(quick, speeds[1:])
    assert hit == np.bitwise_or.reduce(met)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_gives_way_to_the_range(sign):
    """Begun at a speed from which only the full acceleration stops in time, the arm stops."""
    keeps = JerkLimits(LIMITS, PERIOD, JERK)
    end = LIMITS.position_max if sign > 0 else LIMITS.position_min
    q, v, change = end - sign * 0.1, sign * np.array([1.0, 1.0, 0.5]), None
    first = sign * (keeps.follow(q + sign, q + sign, q, v)[1] - v)
    assert first[1] == pytest.approx(-LIMITS.acceleration[1] * PERIOD)  # it brakes at once
    assert first[0] >= -STEP[0] * JUST  # its jerk still lets it stop
    for _ in range(1000):
        goal = q + sign
        q, speed, _ = keeps.follow(goal, goal, q, v, change)
        assert (np.abs(speed - v) <= LIMITS.acceleration * PERIOD * JUST).all()
        change, v = speed - v, speed
    assert (sign * q <= sign * end).all()
    assert q == pytest.approx(end, abs=1e-6)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_of_a_stream_into_the_end_of_the_range_is_given_up_only_where_it_has_to_be(sign):
    """A target that moves smoothly, and is followed exactly until the arm has to brake."""
    end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[0]
    s = np.arange(1, 400) * PERIOD
    way = 0.9 * np.where(s < 1.0, s**3 - 0.5 * s**4, s - 0.5)[:, None]  # to 0.9 rad/s
    path, _, met = run(np.where(np.arange(3) == 0, end + sign * (way - 1.5), POSE),
                       np.where(np.arange(3) == 0, end - sign * 1.5, POSE))  # fmt: skip
    assert_kept(path)
    left = sign * (end - path[:-1, 0])[np.array(met) == 0]
    stops = 0.5 * 0.9**2 / LIMITS.acceleration[0]
    assert stops < left.min() < 3 * stops


def test_leads_an_arm_back_that_stands_outside_its_range():
    path, speeds, _ = run([POSE] * 800, position=LIMITS.position_max + 0.005)
    assert (np.abs(np.diff(speeds, 2, axis=0)) <= STEP * JUST + 1e-11).all()
    assert (np.diff(path[:5], axis=0) < 0.0).all()
    assert np.array_equal(path[-1], POSE)


def test_is_kept_through_holds_and_resumes():
    contract, path = opened(spec=SMOOTH), [POSE]
    random, goal = np.random.default_rng(0), POSE
    for cycle in range(1, 600):
        if cycle % 40 == 0:
            contract.hold("asked")
        if cycle % 40 == 20 or not contract.holding:
            contract.resume()
            if cycle % 20 == 0:
                goal = path[-1] + random.uniform(-0.015, 0.015, 3)
            contract.admit(moved(goal)) if cycle % 3 else contract.stand_in()
        else:
            contract.stand_in()
        contract.observe(state(cycle, contract.following.position))
        path.append(contract.setpoint)
    assert_kept(np.array(path))


def test_is_kept_by_the_set_point_of_a_spring():
    contract, path = opened(spec=SMOOTH), [POSE]
    random, goal = np.random.default_rng(1), POSE
    for cycle in range(1, 300):
        if cycle % 30 == 0:
            goal = POSE + random.uniform(-0.2, 0.2, 3)
        contract.admit(sprung(goal if cycle > 1 else POSE))
        contract.observe(state(cycle, contract.following.position))
        path.append(contract.following.position)
    assert_kept(np.array(path))
    assert np.ptp(path, axis=0).min() > 0.1


def test_begins_anew_where_an_arm_gave_way():
    contract = opened(spec=SMOOTH)
    contract.admit(pushed(np.full(3, 1.0)))
    contract.observe(state(1, POSE, np.full(3, 0.2)))
    sent = contract.admit(moved(POSE))
    assert "jerk" in sent.limited_by
    speed = (sent.position - POSE) / PERIOD
    assert speed == pytest.approx(0.2 - np.minimum(STEP, LIMITS.acceleration * PERIOD), abs=1e-9)
