"""Set-points keep each limit of the joints, and give away nothing of it: held from both sides."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.robot.setpoints import (
    LIMIT_NAMES,
    PositionLimits,
    first_runaway,
    first_unreadable,
    names_of,
)
from limo_driver.types import JointLimits

PERIOD = 0.004  # [s]
# One joint is slow and soon at speed, one quick and late, and of two the range has zero outside.
LIMITS = JointLimits(
    position_min=np.array([-0.2, 0.5, -3.0]),
    position_max=np.array([0.7, 4.0, -0.1]),
    velocity=np.array([0.1, 5.0, 1.0]),
    acceleration=np.array([7.5, 20.0, 10.0]),
    jerk=np.full(3, 1e3),
    torque=np.ones(3),
    torque_rate=np.ones(3),
)
CHANGE = LIMITS.acceleration * PERIOD  # of velocity in one cycle [rad/s]
MIDDLE = np.array([0.25, 2.25, -1.5])
ZERO = np.zeros(3)
JUST = 1e-7  # relative; less than what rounding is allowed
ROUNDING = 1e-6  # relative, as the module says: a set-point this close to a limit keeps it
some = settings(max_examples=20)
each_joint = pytest.mark.parametrize("j", range(3))
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


def only(j, value, others=ZERO):
    """Return `others` with one joint changed."""
    values = np.array(others, dtype=float)
    values[j] = value
    return values


def follow(target, goal=MIDDLE, position=MIDDLE, velocity=ZERO, limits=LIMITS):
    """Take one step; the limits that changed it are named."""
    found = PositionLimits(limits, PERIOD).follow(target, goal, position, velocity)
    return SimpleNamespace(position=found[0], velocity=found[1], met=names_of(found[2]))


class TestNames:
    def test_are_those_of_the_bits_in_order(self):
        assert LIMIT_NAMES == (
            "position", "velocity", "acceleration", "torque", "torque_rate", "wrench",
            "wrench_rate", "gain_rate", "jerk",
        )  # fmt: skip
        assert [names_of(1 << k) for k in range(10)] == [*((name,) for name in LIMIT_NAMES), ()]
        assert names_of(0) == ()
        assert names_of(0b101010101) == LIMIT_NAMES[::2]


@each_joint
@each_way
class TestOneStep:
    def test_of_acceleration_from_rest(self, j, sign):
        most = sign * CHANGE[j] * PERIOD  # [rad] in the first cycle
        within = only(j, MIDDLE[j] + most * (1 - 1e-3), MIDDLE)
        step = follow(within, goal=within)
        assert np.array_equal(step.position, within)
        assert step.velocity[j] == pytest.approx(sign * CHANGE[j] * (1 - 1e-3), rel=1e-9)
        assert step.met == ()
        step = follow(only(j, MIDDLE[j] + most * 1.001, MIDDLE))
        assert step.met == ("acceleration",)
        beyond = only(j, MIDDLE[j] + most * 5.0, MIDDLE)
        step = follow(beyond, goal=beyond)
        assert step.met[-1] == "acceleration"
        assert step.velocity == pytest.approx(only(j, sign * CHANGE[j]), rel=1e-12)
        assert step.position == pytest.approx(only(j, MIDDLE[j] + most, MIDDLE), rel=1e-12)

    @pytest.mark.parametrize("share", [-0.9, 0.0, 0.5])
    def test_of_acceleration_in_motion(self, j, sign, share):
        """What counts is the change from the speed that the set-point has."""
        speed = share * sign * (LIMITS.velocity[j] - CHANGE[j])
        for factor, met in ((1 - 1e-3, ()), (1 + 0.8 * ROUNDING, ()), (1.001, ("acceleration",))):
            direct = speed + sign * CHANGE[j] * factor
            target = only(j, MIDDLE[j] + direct * PERIOD, MIDDLE)
            goal = only(j, target[j] - direct * PERIOD, MIDDLE)
            step = follow(target, goal=goal, velocity=only(j, speed))
            assert step.met == met, factor
            assert abs(step.velocity[j] - speed) <= CHANGE[j] * (1 + ROUNDING)

    def test_rounding_of_acceleration(self, j, sign):
        for factor, met in ((1 + 0.8e-6, ()), (1 + 1.3e-6, ("acceleration",))):
            direct = sign * CHANGE[j] * factor
            target = only(j, MIDDLE[j] + direct * PERIOD, MIDDLE)
            goal = only(j, MIDDLE[j], MIDDLE)
            assert follow(target, goal=goal).met == met, factor

    def test_rounding_of_velocity(self, j, sign):
        fastest = LIMITS.velocity[j]
        for factor, met in ((1 + 0.8e-6, ()), (1 + 1.3e-6, ("velocity",))):
            direct = sign * fastest * factor
            target = only(j, MIDDLE[j] + direct * PERIOD, MIDDLE)
            step = follow(target, velocity=only(j, sign * fastest))
            assert step.met == met, factor
            if met:
                assert step.velocity[j] == pytest.approx(sign * fastest, rel=1e-12)

    def test_of_velocity(self, j, sign):
        fastest = LIMITS.velocity[j]
        slower = only(j, MIDDLE[j] + sign * fastest * PERIOD * (1 - JUST), MIDDLE)
        step = follow(slower, velocity=only(j, sign * fastest))
        assert step.met == ()
        assert step.position[j] == slower[j]
        quicker = only(j, MIDDLE[j] + sign * (fastest + 0.5 * CHANGE[j]) * PERIOD, MIDDLE)
        step = follow(quicker, velocity=only(j, sign * fastest))
        assert step.met == ("velocity",)
        assert step.velocity == pytest.approx(only(j, sign * fastest), rel=1e-12)
        assert step.position[j] == pytest.approx(MIDDLE[j] + sign * fastest * PERIOD, rel=1e-12)

    def test_target_that_rushes_past_is_joined_only_at_a_speed_that_can_follow(self, j, sign):
        """The target is where the set-point stands, but comes from the side at some speed."""
        for factor, met in ((1 - 1e-3, ()), (1.01, ("acceleration",))):
            goal = only(j, MIDDLE[j] - sign * CHANGE[j] * PERIOD * factor, MIDDLE)
            step = follow(MIDDLE, goal=goal)
            assert (step.velocity[j] == 0.0) == (met == ())
            if not met:
                assert step.met == ()

    def test_of_range(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        position = only(j, end - sign * 0.2 * CHANGE[j] * PERIOD, MIDDLE)
        there = only(j, end, MIDDLE)
        assert follow(there, goal=there, position=position).met == ()
        beyond = only(j, end + sign * 1e-6, MIDDLE)
        for goal in (beyond, there):
            step = follow(beyond, goal=goal, position=position)
            assert step.met == ("position",)
            assert step.position[j] == end
        inside = only(j, end - sign * 1e-6, MIDDLE)
        step = follow(inside, goal=inside, position=position)
        assert (step.met, step.position[j]) == ((), inside[j])

    @pytest.mark.parametrize("beyond", [0.0, 0.005])
    def test_from_the_end_leads_no_further_however_a_target_arrives_there(self, j, sign, beyond):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        position, target = only(j, end + sign * beyond, MIDDLE), only(j, end, MIDDLE)
        for share in (0.5, 1.5, 5.0):
            goal = only(j, end - sign * share * CHANGE[j] * PERIOD, MIDDLE)
            step = follow(target, goal=goal, position=position)
            assert sign * (step.position[j] - position[j]) <= 0.0
            assert (step.position[j] == position[j]) == (beyond == 0.0)

    def test_names_all_limits_that_it_met(self, j, sign):
        step = follow(only(j, MIDDLE[j] + sign * 0.4, MIDDLE))
        assert step.met == ("velocity", "acceleration")
        step = follow(only(j, MIDDLE[j] + sign * 9.0, MIDDLE))
        assert step.met == ("position", "velocity", "acceleration")

    def test_speed_near_the_end_is_what_can_still_be_stopped(self, j, sign):
        """A target that runs towards the end is left in time, and not before."""
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        change, fastest = CHANGE[j], LIMITS.velocity[j]
        for speed in np.linspace(0.1, 0.999, 9) * fastest:
            room = stopping_distance(speed, change)
            if 2.0 * room > abs(end - MIDDLE[j]):
                continue
            for factor, kept in ((1 + 1e-4, True), (1 - 1e-4, False)):
                position = only(j, end - sign * room * factor, MIDDLE)
                target = only(j, position[j] + sign * speed * PERIOD, MIDDLE)
                step = follow(target, goal=position, position=position, velocity=sign * speed
                              * only(j, 1.0))  # fmt: skip
                assert (step.met == ()) == kept
                if not kept:
                    assert step.met[0] == "position"
                    left = abs(end - step.position[j])
                    assert stopping_distance(abs(step.velocity[j]) - change, change) <= left + 1e-12


def stopping_distance(speed, change):
    """Return the way [rad] of a cycle at `speed` and of all that brake after it."""
    way = 0.0
    while speed > 0.0:
        way += speed * PERIOD
        speed -= change
    return way


def run(targets, limits=LIMITS, position=MIDDLE):
    """Follow targets from rest; return positions and velocities of all, with the first."""
    keeps, now = PositionLimits(limits, PERIOD), (position, ZERO, 0)
    goal, path, speeds, met = position, [position], [ZERO], []
    for target in targets:
        now = keeps.follow(target, goal, now[0], now[1])
        goal = target
        path.append(now[0])
        speeds.append(now[1])
        met.append(now[2])
    return np.array(path), np.array(speeds), met


def assert_kept(path, speeds, limits=LIMITS):
    """Check every limit, on positions alone as well as on what is said of their speed."""
    just = 1 + 1.01 * ROUNDING
    assert (path >= limits.position_min - 1e-12).all()
    assert (path <= limits.position_max + 1e-12).all()
    assert np.diff(path, axis=0) == pytest.approx(speeds[1:] * PERIOD, abs=1e-12)
    assert (np.abs(speeds) <= limits.velocity * just).all()
    assert (np.abs(np.diff(speeds, axis=0)) <= CHANGE * just).all()


def fewest_cycles(distance, fastest, change):
    """Return how many cycles a set-point needs from rest to rest."""
    n = 0
    while True:
        n += 1
        rising = np.minimum(np.arange(1, n + 1), np.arange(n, 0, -1)) * change
        if np.minimum(rising, fastest).sum() * PERIOD >= distance * (1 - 1e-9):
            return n


@each_joint
class TestOneTarget:
    @pytest.mark.parametrize("distance", [-1.1, -0.3, -0.01, 2e-3, 0.04, 0.5])
    def test_is_reached_without_overshoot_and_without_dawdling(self, j, distance):
        distance *= 0.3 if j == 0 else 1.0
        goal = only(j, MIDDLE[j] + distance, MIDDLE)
        path, speeds, met = run([goal] * 1000)
        assert_kept(path, speeds)
        assert (np.sign(distance) * (path[:, j] - goal[j]) <= 1e-12).all()
        reached = int(np.argmax(np.abs(path[:, j] - goal[j]) < 1e-12))
        fewest = fewest_cycles(abs(distance), LIMITS.velocity[j], CHANGE[j])
        assert fewest <= reached <= fewest + 2
        assert met[reached:] == [0] * (1000 - reached)
        assert (path[reached:] == path[reached]).all()

    @each_way
    def test_beyond_the_range_is_followed_to_its_end(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        goal = only(j, end + sign * 2.0, MIDDLE)
        path, speeds, met = run([goal] * 2500)
        assert_kept(path, speeds)
        assert path[-1, j] == pytest.approx(end, abs=1e-12)
        assert all(hit & 1 for hit in met)
        reached = int(np.argmax(np.abs(path[:, j] - end) < 1e-12))
        fewest = fewest_cycles(abs(end - MIDDLE[j]), LIMITS.velocity[j], CHANGE[j])
        assert fewest <= reached <= fewest + 2

    @each_way
    @pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
    def test_that_moves_is_caught_up_with_and_then_followed_exactly(self, j, sign, share):
        speed = sign * share * LIMITS.velocity[j]
        T = int(min(400, (0.4 if j == 0 else 1.2) / abs(speed) / PERIOD))
        targets = MIDDLE + np.arange(1, T + 1)[:, None] * only(j, speed * PERIOD)
        path, speeds, met = run(targets)
        assert_kept(path, speeds)
        behind = sign * (targets[:, j] - path[1:, j])
        assert behind.min() >= -1e-12
        caught = met.index(0)
        assert met[caught:] == [0] * (T - caught)
        fewest = fewest_cycles_to_catch_up(abs(speed), LIMITS.velocity[j], CHANGE[j])
        assert fewest <= caught + 1 <= fewest + 3


def fewest_cycles_to_catch_up(speed, fastest, change):
    """Return how many cycles a set-point needs from rest to be with a target that runs off."""
    n = 0
    while True:
        n += 1
        quickest = np.arange(1, n + 1) * change
        braking = speed + np.arange(n, 0, -1) * change
        gained = np.minimum(np.minimum(quickest, braking), fastest).sum()
        if gained >= n * speed * (1 - 1e-9):
            return n


@st.composite
def wandering(draw):
    """Draw targets that rest, jump, run, and leave the range."""
    targets = []
    last = MIDDLE
    for _ in range(draw(st.integers(2, 6))):
        cycles = draw(st.integers(1, 60))
        kind = draw(st.sampled_from(["rest", "jump", "run"]))
        share = np.array(draw(st.lists(st.floats(-1.3, 1.3), min_size=3, max_size=3)))
        if kind == "jump":
            last = MIDDLE + share * 0.6 * (LIMITS.position_max - LIMITS.position_min)
        speed = share * LIMITS.velocity * PERIOD if kind == "run" else ZERO
        steps = last + np.arange(1, cycles + 1)[:, None] * speed
        targets.append(steps)
        last = steps[-1]
    return np.vstack([*targets, np.tile(last, (40, 1))])


class TestAnyTargets:
    @some
    @given(wandering())
    def test_keep_every_limit_and_what_keeps_them_is_sent_unchanged(self, targets):
        path, speeds, met = run(targets)
        assert_kept(path, speeds)
        for target, sent, hit in zip(targets, path[1:], met, strict=True):
            assert 0 <= hit < 8
            assert np.array_equal(target, sent) == (hit == 0)

    @some
    @given(wandering())
    def test_in_one_go_are_those_one_by_one(self, targets):
        path, speeds, met = run(targets)
        together, quick, hit = PositionLimits(LIMITS, PERIOD).follow_path(
            targets, MIDDLE, MIDDLE, ZERO
        )
        assert np.array_equal(together, path[1:])
        assert np.array_equal(quick, speeds[1:])
        assert hit == np.bitwise_or.reduce(met)

    def test_in_one_go_name_the_limits_of_the_first_and_of_the_last(self):
        keeps = PositionLimits(LIMITS, PERIOD)
        rest = np.tile(MIDDLE, (5, 1))
        first, last = rest.copy(), rest.copy()
        last[-1] += 1.0
        first[:] += 10.0
        assert keeps.follow_path(rest, MIDDLE, MIDDLE, ZERO)[2] == 0
        assert names_of(keeps.follow_path(first[:1], MIDDLE, MIDDLE, ZERO)[2])[0] == "position"
        assert keeps.follow_path(last, MIDDLE, MIDDLE, ZERO)[2] & 4


class TestBraking:
    def test_takes_off_what_the_acceleration_allows(self):
        position, velocity = np.array([0.3, 2.0, -1.0]), np.array([0.1, -2.0, 0.05])
        before, limits = (position, velocity), PositionLimits(LIMITS, PERIOD)
        for _ in range(100):
            position, velocity = limits.brake(position, velocity)
            assert position == pytest.approx(before[0] + velocity * PERIOD, abs=1e-15)
            slower = np.maximum(np.abs(before[1]) - LIMITS.acceleration * PERIOD, 0.0)
            assert np.abs(velocity) == pytest.approx(slower, abs=1e-15)
            assert (velocity * before[1] >= 0.0).all()
            before = position, velocity
        assert not velocity.any()

    @each_way
    @pytest.mark.parametrize("room", [0.0, 1e-6, 1e-3, 0.02])
    def test_ends_inside_the_range_however_near_that_ends(self, sign, room):
        end = LIMITS.position_max if sign > 0 else LIMITS.position_min
        position, velocity = end - sign * room, sign * LIMITS.velocity
        limits = PositionLimits(LIMITS, PERIOD)
        for _ in range(300):
            position, velocity = limits.brake(position, velocity)
            assert (sign * (position - end) <= 1e-12).all()
        assert not velocity.any()

    @each_way
    def test_of_an_arm_that_is_outside_goes_no_further(self, sign):
        end = LIMITS.position_max if sign > 0 else LIMITS.position_min
        limits, outside = PositionLimits(LIMITS, PERIOD), end + sign * 0.1
        position, _ = limits.brake(outside, sign * LIMITS.velocity)
        assert np.array_equal(position, outside)
        position, _ = limits.brake(outside, -sign * LIMITS.velocity)  # it comes back, and may
        assert (sign * (position - outside) < 0).all()


class TestStoppable:
    @each_way
    def test_velocities_stop_in_the_range_within_the_acceleration(self, sign):
        end = LIMITS.position_max if sign > 0 else LIMITS.position_min
        limits = PositionLimits(LIMITS, PERIOD)
        for room in (1e-4, 3e-3, 0.05):
            position = end - sign * room
            speed = limits.stoppable(position, sign * 1.139 * LIMITS.velocity)
            assert (np.abs(speed) <= LIMITS.velocity).all()
            for _ in range(300):
                after, slower = limits.brake(position, speed)
                assert (np.abs(slower - speed) <= CHANGE * (1 + 1e-9)).all()
                position, speed = after, slower
            assert (sign * (position - end) <= 1e-12).all()

    def test_velocities_stay_as_they_are_far_from_the_ends(self):
        velocity = 0.9 * LIMITS.velocity * [1, -1, 1]
        assert np.array_equal(PositionLimits(LIMITS, PERIOD).stoppable(MIDDLE, velocity), velocity)


class TestFirstBeyond:
    @each_joint
    @each_way
    def test_is_who_can_only_just_stop_in_the_range(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        speed, change = 0.8 * LIMITS.velocity[j], CHANGE[j]
        limits = PositionLimits(LIMITS, PERIOD)
        stops = speed**2 / (2 * LIMITS.acceleration[j])
        near = stops + 0.5 * speed * PERIOD
        far = stops + 4 * (speed + change) * PERIOD
        for room, beyond in ((near, j + 1), (far, 0)):
            position = only(j, end - sign * room, MIDDLE)
            assert limits.first_beyond(position, only(j, sign * speed), ZERO) == beyond
            assert limits.first_beyond(position, only(j, -sign * speed), ZERO) == 0
        faster = only(j, sign * 6 * LIMITS.acceleration[j])
        position = only(j, end - sign * (stops + 3 * speed * PERIOD), MIDDLE)
        assert limits.first_beyond(position, only(j, sign * speed), faster) == j + 1
        assert limits.first_beyond(position, only(j, sign * speed), -faster) == 0


class TestUnreadable:
    @pytest.mark.parametrize("lowest", [-math.inf, -0.5, 0.0])
    def test_is_what_is_not_finite_or_too_low(self, lowest):
        fine = np.array([0.0, 1e300, 5e-324])
        assert first_unreadable(fine, lowest) == 0
        for j in range(3):
            for bad in (math.nan, math.inf, -math.inf):
                assert first_unreadable(only(j, bad, fine), lowest) == j + 1
        assert first_unreadable(np.array([math.nan, math.nan]), lowest) == 1

    def test_lowest_is_itself_readable(self):
        assert first_unreadable(np.array([0.0, -0.0]), 0.0) == 0
        assert first_unreadable(np.array([0.0, -5e-324]), 0.0) == 2
        assert first_unreadable(np.array([-0.5]), -0.5) == 0
        assert first_unreadable(np.array([-0.5000001]), -0.5) == 1
        assert first_unreadable(np.array([-1e300]), -math.inf) == 0


@each_joint
@each_way
class TestRunaway:
    BOUNDS = np.array([LIMITS.position_min, LIMITS.position_max, LIMITS.velocity])

    def test_is_one_that_leaves_its_range(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        for beyond, speed, found in (
            (0.0, 1e-3, 0),
            (1e-9, 1e-3, j + 1),
            (1e-9, 0.0, 0),  # it stands
            (1e-9, -1e-3, 0),  # it comes back
            (-1e-9, 1e-3, 0),
        ):
            position, velocity = only(j, end + sign * beyond, MIDDLE), only(j, sign * speed)
            assert first_runaway(position, velocity, self.BOUNDS) == found, (beyond, speed)

    def test_is_one_that_is_too_fast(self, j, sign):
        fastest = sign * LIMITS.velocity[j]
        assert first_runaway(MIDDLE, only(j, fastest), self.BOUNDS) == 0
        assert first_runaway(MIDDLE, only(j, fastest * (1 + 1e-9)), self.BOUNDS) == j + 1
        both = np.sign(fastest) * 2.0 * LIMITS.velocity
        assert first_runaway(MIDDLE, both, self.BOUNDS) == 1


@each_way
def test_velocity_is_not_met_by_a_target_that_is_just_as_fast(sign):
    ones = np.ones(1)
    limits = JointLimits(-9 * ones, 9 * ones, ones, ones, ones, ones, ones)
    target = np.array([sign * 2.0**-8])  # in one cycle, at the velocity limit without rounding
    for factor, met in ((1.0, ("acceleration",)), (1 + 2e-6, ("velocity", "acceleration"))):
        _, _, hit = PositionLimits(limits, 2.0**-8).follow(
            target * factor, np.zeros(1), np.zeros(1), np.zeros(1)
        )
        assert names_of(hit) == met


def test_a_range_of_one_point_is_kept():
    limits = replace(LIMITS, position_min=MIDDLE, position_max=MIDDLE)
    step = follow(MIDDLE + 1.0, limits=limits)
    assert np.array_equal(step.position, MIDDLE)
    assert step.met == ("position",)
