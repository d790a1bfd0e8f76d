"""Each number and each turn of the safety contract, held from both sides.

The numbers stand here as the contract is described to users, not as its module names them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import BackendError, ConfigError, HoldingError, JointLimitError, ShapeError
from limo_driver.safety import SafetyContract, check_readable, warm_up
from limo_driver.types import (
    ImpedanceCommand,
    JointLimits,
    JointState,
    PositionCommand,
    RobotSpec,
    TorqueCommand,
    WrenchCommand,
    WrenchLimits,
)

PERIOD = 0.0078125  # [s], 2^-7: sums of it have no rounding
LIMITS = JointLimits(
    position_min=np.array([-2.0, -1.0, 0.5]),
    position_max=np.array([2.0, 1.5, 3.0]),
    velocity=np.array([1.0, 2.0, 0.5]),
    acceleration=np.array([10.0, 8.0, 4.0]),
    jerk=np.full(3, 1e3),
    torque=np.array([100.0, 50.0, 10.0]),
    torque_rate=np.array([1000.0, 600.0, 200.0]),
)
WRENCH = WrenchLimits(wrench=np.full(6, 50.0), rate=np.full(6, 640.0))
SPEC = RobotSpec("arm", ("a", "b", "c"), LIMITS, PERIOD, WRENCH)
POSE = np.array([0.0, 0.25, 1.5])
ZERO = np.zeros(3)
JUST = 0.01  # relative: a factor of 1.05 on a limit is noticed
LONG = 1.0  # [s], the longest that a command may be valid
some = settings(derandomize=True, deadline=None, max_examples=40)
each_joint = pytest.mark.parametrize("j", range(3))
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


def only(j, value, others=ZERO):
    """Return `others` with one joint changed."""
    values = np.array(others, dtype=float)
    values[j] = value
    return values


def state(cycle=0, position=POSE, velocity=ZERO, *, time=None, stale=False):
    when = cycle * PERIOD if time is None else time
    return JointState(when, position, velocity, ZERO, cycle, stale=stale)


def moved(values=POSE, **options):
    return PositionCommand(position=np.array(values, dtype=float), **options)


def pushed(values=ZERO, **options):
    return TorqueCommand(torque=np.array(values, dtype=float), **options)


def sprung(values=POSE, **options):
    given = {"stiffness": ZERO, "damping": ZERO, "torque": ZERO} | options
    return ImpedanceCommand(position=np.array(values, dtype=float), **given)


def wrenched(values=(0.0,) * 6, **options):
    return WrenchCommand(wrench=np.array(values, dtype=float), **options)


COMMANDS = {"position": moved, "torque": pushed, "impedance": sprung, "wrench": wrenched}
each_kind = pytest.mark.parametrize("kind", COMMANDS)


def opened(*, spec=SPEC, **options):
    """Return a contract that has seen the arm at rest."""
    contract = SafetyContract(spec, **options)
    contract.observe(state())
    return contract


def started(command, *, spec=SPEC, **options):
    """Return a contract under way, in its first cycle."""
    contract = opened(spec=spec, **options)
    contract.admit(command)
    return contract


def reason(contract):
    """Return why an arm holds; empty if it does not."""
    if not contract.holding:
        return ""
    with pytest.raises(HoldingError) as refused:
        contract.admit(pushed())
    return str(refused.value)


class TestFirstCommand:
    """It starts within 0.02 rad of the measured pose."""

    @each_joint
    @each_way
    @pytest.mark.parametrize("command", [moved, sprung])
    def test_has_to_be_near(self, j, sign, command):
        start = only(j, 0.125, POSE)  # so that the differences below have no rounding
        contract = SafetyContract(SPEC)
        contract.observe(state(position=start))
        with pytest.raises(
            JointLimitError, match=r"first position.*start from the measured"
        ) as off:
            contract.admit(command(only(j, 0.125 + sign * 0.02 * (1 + JUST), start)))
        assert off.value.joint == j + 1
        assert off.value.bounds == pytest.approx((0.105, 0.145), rel=1e-12)
        assert contract.at_rest
        contract.admit(command(only(j, 0.125 + sign * 0.02 * (1 - JUST), start)))
        assert not contract.at_rest

    def test_may_be_just_as_far_as_that(self):
        origin = replace(LIMITS, position_min=np.full(3, -2.0))
        contract = SafetyContract(replace(SPEC, limits=origin))
        contract.observe(state(position=ZERO))
        contract.admit(moved([0.02, -0.02, 0.0]))

    @each_joint
    def test_tolerance_may_be_another(self, j):
        with pytest.raises(JointLimitError):
            opened(start_tolerance=0.3).admit(moved(only(j, POSE[j] + 0.31, POSE)))
        opened(start_tolerance=0.3).admit(moved(only(j, POSE[j] + 0.29, POSE)))

    def test_tells_the_joint_that_is_furthest_off(self):
        with pytest.raises(JointLimitError) as off:
            opened().admit(moved(np.add(POSE, [0.03, -0.05, 0.04])))
        assert (off.value.joint, off.value.given) == (2, pytest.approx(0.2))

    @pytest.mark.parametrize("command", [pushed, wrenched])
    def test_without_a_position_may_be_anywhere(self, command):
        opened().admit(command())

    def test_answers_a_state(self):
        with pytest.raises(BackendError, match="receive"):
            SafetyContract(SPEC).admit(moved())

    @each_kind
    def test_needs_a_measurement_of_its_cycle(self, kind):
        contract = opened()
        contract.observe(state(1, stale=True))
        with pytest.raises(BackendError, match="measurement is lost"):
            contract.admit(COMMANDS[kind]())
        contract.observe(state(2))
        contract.admit(COMMANDS[kind]())

    def test_is_led_within_the_limits_to_what_was_commanded(self):
        contract = opened()
        sent = contract.admit(moved(POSE + 0.015))
        assert set(sent.limited_by) <= {"velocity", "acceleration"}
        assert np.abs(sent.position - POSE) == pytest.approx(LIMITS.acceleration * PERIOD**2)


class TestRange:
    """An arm that is carried 0.01 rad out of its range holds."""

    @each_joint
    @each_way
    @each_kind
    def test_may_be_left_a_little(self, j, sign, kind):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        for factor, held in ((1 - JUST, False), (1 + JUST, True)):
            contract = started(COMMANDS[kind](valid_for=LONG))
            position = only(j, end + sign * 0.01 * factor, POSE)
            contract.observe(state(1, position, only(j, sign * 0.1)))
            assert contract.holding == held
            if held:
                assert f"joint {j + 1} leaves its range" in reason(contract)

    @each_joint
    @each_way
    def test_says_nothing_of_an_arm_that_comes_back_or_stands(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        contract = started(pushed(valid_for=LONG))
        contract.observe(state(1, only(j, end + sign * 0.5, POSE), only(j, -sign * 0.1)))
        contract.observe(state(2, only(j, end + sign * 0.5, POSE)))
        assert not contract.holding

    @each_joint
    @each_way
    def test_is_kept_by_set_points(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        contract = SafetyContract(SPEC)
        contract.observe(state(position=only(j, end, POSE)))
        sent = contract.admit(moved(only(j, end + sign * 0.01, POSE)))
        assert sent.limited_by == ("position",)
        assert sent.position[j] == end


class TestSpeed:
    """An arm that moves at more than 1.2 times its velocity limit holds."""

    @each_joint
    @each_way
    @each_kind
    def test_may_exceed_its_limit_a_little(self, j, sign, kind):
        for factor, held in ((1 - JUST, False), (1 + JUST, True)):
            contract = started(COMMANDS[kind](valid_for=LONG))
            speed = only(j, sign * 1.2 * LIMITS.velocity[j] * factor)
            contract.observe(state(1, velocity=speed))
            assert contract.holding == held
            if held:
                assert f"joint {j + 1} leaves its range or its velocity" in reason(contract)

    def test_matters_only_while_commands_are_followed(self):
        contract = opened()
        contract.observe(state(1, velocity=3 * LIMITS.velocity))
        assert not contract.holding


class TestStaleness:
    """An arm that was not measured for 0.1 s holds."""

    @pytest.mark.parametrize("period", [0.001, 0.004, 0.02])
    def test_may_last_a_while(self, period):
        spec = replace(SPEC, period=period)
        contract = started(moved(valid_for=LONG), spec=spec)
        cycles = round(0.1 / period)
        for cycle in range(1, cycles):
            contract.observe(state(cycle, time=0.0, stale=True))
            assert not contract.holding, cycle
        for cycle in range(cycles, cycles + 2):
            contract.observe(state(cycle, time=0.0, stale=True))
        assert "no measurement for 0.1" in reason(contract)

    def test_may_last_just_as_long_as_that(self):
        contract = started(moved(valid_for=LONG), spec=replace(SPEC, period=0.1))
        contract.observe(state(1, time=0.0, stale=True))
        assert not contract.holding
        contract.observe(state(2, time=0.0, stale=True))
        assert "no measurement for 0.2 s" in reason(contract)

    def test_ends_with_a_measurement(self):
        contract = started(moved(valid_for=LONG), spec=replace(SPEC, period=0.06))
        for cycle in range(1, 8):
            fresh = cycle % 2 == 0
            contract.observe(state(cycle, time=0.06 * (cycle if fresh else cycle - 1),
                                   stale=not fresh))  # fmt: skip
        assert not contract.holding

    def test_hides_neither_range_nor_speed_of_the_next_measurement(self):
        contract = started(pushed(valid_for=LONG))
        contract.observe(state(1, velocity=9 * LIMITS.velocity, stale=True))  # nothing new
        assert not contract.holding
        contract.observe(state(2, velocity=9 * LIMITS.velocity))
        assert contract.holding


class TestExpiry:
    """A command is valid for 1 s at most, and what is not followed by another leads to a hold."""

    @each_kind
    @pytest.mark.parametrize(
        ("valid_for", "fine"),
        [
            (0.0, False), (-1e-9, False), (-0.5, False), (1e-9, True), (0.5, True), (1.0, True),
            (1.0 + 1e-12, False), (1.01, False), (float("nan"), False), (float("inf"), False),
        ],
    )  # fmt: skip
    def test_has_bounds(self, kind, valid_for, fine):
        contract = opened()
        command = COMMANDS[kind](valid_for=valid_for)
        if fine:
            contract.admit(command)
        else:
            with pytest.raises(ConfigError, match=r"valid_for = .* at most 1 s"):
                contract.admit(command)
            assert contract.at_rest

    @each_kind
    @pytest.mark.parametrize("valid_for", [0.0625, 0.125, 1.0])
    def test_comes_in_time(self, kind, valid_for):
        for late, held in ((-JUST * valid_for, False), (0.0, False), (JUST * valid_for, True)):
            contract = started(COMMANDS[kind](valid_for=valid_for))
            contract.observe(state(1, time=valid_for + late))
            assert contract.holding == held
            if held:
                assert f"the last command expired after {valid_for:.3g} s" in reason(contract)

    def test_counts_0_1_seconds_unless_told(self):
        for time, held in ((0.1 * (1 - JUST), False), (0.1 * (1 + JUST), True)):
            contract = started(moved())
            contract.observe(state(1, time=time))
            assert contract.holding == held

    def test_rounding_of_time_is_a_nanosecond(self):
        for late, held in ((0.5e-9, False), (0.9e-9, False), (1.1e-9, True), (2e-9, True)):
            contract = started(moved(valid_for=0.125))
            contract.observe(state(1, time=0.125 + late))
            assert contract.holding == held, late

    def test_counts_from_the_last_command_and_not_the_first(self):
        contract = started(moved(valid_for=0.0625))
        for cycle in range(1, 20):
            contract.observe(state(cycle))
            assert not contract.holding
            contract.admit(moved(valid_for=0.0625))
        contract.observe(state(27))
        assert not contract.holding
        contract.observe(state(28))
        assert contract.holding

    def test_counts_on_while_measurements_are_lost(self):
        contract = started(moved(valid_for=0.03125))
        for cycle in range(1, 5):
            contract.observe(state(0, stale=True))
            assert not contract.holding, cycle
        contract.observe(state(0, stale=True))
        assert "expired after 0.0312 s" in reason(contract)

    def test_of_a_refused_command_changes_nothing(self):
        contract = started(moved(valid_for=0.0625))
        contract.observe(state(4))
        with pytest.raises(JointLimitError):
            contract.admit(moved([np.nan] * 3, valid_for=LONG))
        contract.observe(state(9))
        assert contract.holding


class TestLimitsOfSetPoints:
    """Each command is sent as it is, or changed and said to be."""

    @each_joint
    @each_way
    def test_acceleration(self, j, sign):
        for factor, met in ((1 - JUST, ()), (1 + JUST, ("acceleration",))):
            contract = started(moved())
            contract.observe(state(1))
            step = sign * LIMITS.acceleration[j] * PERIOD**2
            command = moved(only(j, POSE[j] + step * factor, POSE))
            sent = contract.admit(command)
            assert sent.limited_by == met
            if met:
                assert sent.position == pytest.approx(only(j, POSE[j] + step, POSE), rel=1e-12)
            else:
                assert sent is command

    @each_joint
    @each_way
    @pytest.mark.parametrize("command", [pushed, lambda torque: sprung(torque=torque)])
    def test_torque_and_its_rate(self, j, sign, command):
        step, most = sign * LIMITS.torque_rate[j] * PERIOD, sign * LIMITS.torque[j]
        for factor, met in ((1 - JUST, ()), (1 + JUST, ("torque_rate",))):
            sent = opened().admit(command(only(j, step * factor)))
            assert sent.limited_by == met
            assert sent.torque[j] == pytest.approx(step * min(factor, 1.0), rel=1e-12)
        contract = opened()
        for cycle in range(1, 60):
            sent = contract.admit(command(only(j, most * (1 + JUST))))
            assert "torque" in sent.limited_by
            contract.observe(state(cycle))
        assert sent.limited_by == ("torque",)
        assert sent.torque == pytest.approx(only(j, most))
        assert contract.admit(command(only(j, most * (1 - 1e-9)))).limited_by == ()

    @pytest.mark.parametrize("k", range(6))
    @each_way
    def test_wrench_and_its_rate(self, k, sign):
        def of(value):
            return wrenched(sign * value * np.eye(6)[k])

        for factor, met in ((1 - JUST, ()), (1 + JUST, ("wrench_rate",))):
            sent = opened().admit(of(640.0 * PERIOD * factor))
            assert sent.limited_by == met
            assert sent.wrench[k] == pytest.approx(sign * 5.0 * min(factor, 1.0))
        contract = opened()
        for cycle in range(1, 13):
            sent = contract.admit(of(50.0 * (1 + JUST)))
            contract.observe(state(cycle))
        assert sent.limited_by == ("wrench",)
        assert sent.wrench == pytest.approx(sign * 50.0 * np.eye(6)[k])

    def test_wrench_is_refused_by_a_robot_that_takes_none(self):
        contract = opened(spec=replace(SPEC, wrench_limits=None))
        with pytest.raises(BackendError, match="arm takes no wrench"):
            contract.admit(wrenched())
        assert contract.at_rest
        contract.admit(moved())

    @some
    @given(st.lists(st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3), min_size=1,
                    max_size=12))  # fmt: skip
    def test_what_is_sent_keeps_them_whatever_is_commanded(self, jumps):
        contract = started(moved())
        sent, cycle = [POSE, POSE], 0
        for jump in jumps:
            for _ in range(8):
                cycle += 1
                contract.observe(state(cycle, sent[-1]))
                sent.append(contract.admit(moved(POSE + jump)).position)
        assert_kept(np.array(sent))

    @some
    @given(st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3))
    def test_what_is_sent_comes_to_rest_where_it_was_commanded(self, offsets):
        """Also in the last cycles of a motion, which brake by less than a whole step."""
        contract, goal = started(moved()), POSE + offsets
        sent = [POSE, POSE]
        for cycle in range(1, 60):
            contract.observe(state(cycle, sent[-1]))
            command = contract.admit(moved(goal))
            sent.append(command.position)
            assert (command.limited_by == ()) == np.array_equal(command.position, goal)
            assert np.array_equal(sent[-1], contract.save().after.position)
        assert_kept(np.array(sent))
        assert np.array_equal(sent[-1], goal)


def assert_kept(path):
    velocity = np.diff(path, axis=0) / PERIOD
    acceleration = np.diff(velocity, axis=0) / PERIOD
    assert (path >= LIMITS.position_min).all()
    assert (path <= LIMITS.position_max).all()
    assert (np.abs(velocity) <= LIMITS.velocity * (1 + 2e-6)).all()
    assert (np.abs(acceleration) <= LIMITS.acceleration * (1 + 2e-6)).all()


class TestUnreadableCommands:
    @each_joint
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize(
        ("kind", "name", "unit"),
        [
            ("position", "position", "rad"), ("torque", "torque", "N m"),
            ("impedance", "position", "rad"), ("impedance", "torque", "N m"),
            ("impedance", "stiffness", "N m/rad"), ("impedance", "damping", "N m s/rad"),
        ],
    )  # fmt: skip
    def test_are_refused_by_joint_and_name(self, j, bad, kind, name, unit):
        command = replace(COMMANDS[kind](), **{name: only(j, bad, POSE)})
        with pytest.raises(JointLimitError, match="nothing was sent") as refused:
            check_readable(command, 3)
        assert (refused.value.joint, refused.value.quantity) == (j + 1, name)
        assert refused.value.unit == unit

    @each_joint
    @pytest.mark.parametrize("name", ["stiffness", "damping"])
    def test_are_negative_gains(self, j, name):
        check_readable(sprung(**{name: ZERO}), 3)
        with pytest.raises(JointLimitError, match=f"joint {j + 1}: {name}"):
            check_readable(sprung(**{name: only(j, -1e-9)}), 3)

    @pytest.mark.parametrize("k", range(6))
    def test_are_wrenches_that_are_not_finite(self, k):
        check_readable(wrenched(np.full(6, -1e9)), 3)
        with pytest.raises(JointLimitError, match="wrench") as refused:
            check_readable(wrenched(np.where(np.arange(6) == k, np.nan, 0.0)), 3)
        assert (refused.value.joint, refused.value.unit) == (k + 1, "N or N m")

    @pytest.mark.parametrize("n", [2, 4])
    def test_are_those_for_another_arm(self, n):
        for command in (moved(np.zeros(n)), pushed(np.zeros(n))):
            with pytest.raises(ShapeError, match=r"\(3,\)"):
                check_readable(command, 3)
        with pytest.raises(ShapeError, match=r"wrench.*\(6,\)"):
            check_readable(wrenched(np.zeros(n)), 3)

    @each_kind
    def test_are_those_that_a_backend_cannot_carry_out(self, kind):
        def refuse(command):
            raise BackendError(f"no {type(command).__name__}")

        contract = opened(check=refuse)
        with pytest.raises(BackendError, match="no "):
            contract.admit(COMMANDS[kind]())
        assert contract.at_rest


class TestPaths:
    def test_are_admitted_as_their_rows_would_be(self):
        targets = POSE + np.linspace(0.0, 0.3, 30)[:, None] * [1.0, -1.0, 0.5]
        one, other = opened(), opened()
        rows = []
        for cycle, target in enumerate(targets):
            one.observe(state(cycle))
            rows.append(one.admit(moved(target)))
        other.observe(state())
        path, met = other.admit_path(targets)
        assert np.array_equal(path, [row.position for row in rows])
        assert set(met) == set().union(*(row.limited_by for row in rows))
        for contract in (one, other):  # of the last cycle
            contract.observe(state(30))
        assert np.array_equal(one.setpoint, other.setpoint)
        after = [contract.admit(moved(targets[-1])) for contract in (one, other)]
        assert np.array_equal(after[0].position, after[1].position)

    @pytest.mark.parametrize("T", [1, 2, 17])
    def test_are_valid_from_their_last_row(self, T):
        for late, held in ((-1, False), (0, False), (1, True)):
            contract = opened()
            contract.admit_path(np.tile(POSE, (T, 1)))  # each for 0.1 s, 12.8 cycles
            contract.observe(state(T - 1 + 12 + late))
            assert contract.holding == held

    @pytest.mark.parametrize("row", [0, 3, 5])
    def test_that_cannot_be_read_are_refused_whole(self, row):
        targets = np.tile(POSE, (6, 1))
        targets[row, 1] = np.nan
        contract = opened()
        with pytest.raises(JointLimitError, match="joint 2: position nan"):
            contract.admit_path(targets)
        assert contract.at_rest

    def test_start_near_the_measured_pose(self):
        with pytest.raises(JointLimitError, match="first position"):
            opened().admit_path(np.tile(POSE, (6, 1)) + 0.021)

    def test_are_the_callers(self):
        contract = opened()
        path, _ = contract.admit_path(np.tile(POSE, (4, 1)))
        path[:] = 7.0
        contract.observe(state(4))
        assert np.array_equal(contract.setpoint, POSE)


class TestHolding:
    def test_begins_idle_and_at_rest(self):
        contract = opened()
        assert (contract.holding, contract.at_rest, contract.standing) == (False, True, True)
        assert contract.stand_in() is None
        assert np.array_equal(contract.setpoint, POSE)

    def test_goes_on_until_told_and_keeps_its_first_reason(self):
        contract = started(moved())
        contract.hold("a light curtain")
        contract.hold("something else")
        assert "a light curtain" in reason(contract)
        assert (contract.at_rest, contract.standing) == (False, True)
        contract.resume()
        assert contract.at_rest
        contract.resume()
        contract.admit(moved())
        assert not contract.holding
        contract.resume()  # which is nothing to an arm that follows commands
        assert not contract.at_rest

    def test_keeps_the_pose(self):
        contract = started(moved())
        contract.hold("asked")
        for cycle in range(1, 5):
            contract.observe(state(cycle))
            assert np.array_equal(contract.stand_in().position, POSE)

    def speed_up(self, cycles=12):
        """Return a contract in motion, in a cycle without a command yet, and what was sent."""
        contract, sent = opened(), [POSE, POSE]
        for cycle in range(cycles):
            contract.observe(state(cycle, sent[-1]))
            sent.append(contract.admit(moved(POSE if not cycle else POSE + 0.3)).position)
        contract.observe(state(cycles, sent[-1]))
        return contract, sent

    @pytest.mark.parametrize("resumed", [False, True])
    def test_brakes_within_the_limits_and_as_fast_as_they_allow(self, resumed):
        contract, sent = self.speed_up()
        fastest = (sent[-1] - sent[-2]) / PERIOD
        contract.hold("asked")
        cycles = 0
        while not contract.standing:
            if resumed and cycles == 3:
                contract.resume()
            sent.append(contract.stand_in().position)
            cycles += 1
            contract.observe(state(12 + cycles, sent[-1]))
        assert_kept(np.array([*sent, sent[-1], sent[-1]]))
        assert cycles == np.ceil((fastest / (LIMITS.acceleration * PERIOD)).max() - 1e-9)
        assert (contract.stand_in() is None) == resumed

    def test_begins_braking_after_what_was_sent_already(self):
        contract, sent = self.speed_up()
        sent.append(contract.admit(moved(POSE + 0.3)).position)
        contract.hold("asked")
        contract.observe(state(13, sent[-1]))
        sent.append(contract.stand_in().position)
        assert_kept(np.array(sent))

    def test_while_braking_a_stream_goes_on_from_the_set_point(self):
        contract, sent = self.speed_up()
        contract.hold("asked")
        contract.resume()
        for cycle in range(13, 60):
            sent.append(contract.admit(moved(sent[12])).position)
            contract.observe(state(cycle, sent[-1]))
        assert_kept(np.array(sent))
        assert np.array_equal(sent[-1], sent[12])

    def test_after_braking_a_stream_starts_from_the_measured_pose(self):
        contract, _ = self.speed_up()
        contract.hold("asked")
        for cycle in range(13, 80):
            contract.stand_in()
            contract.observe(state(cycle, POSE + 0.01))
        contract.resume()
        assert np.abs(contract.setpoint - POSE - 0.01).max() > 1e-3
        sent = contract.admit(moved(POSE + 0.01))
        assert np.array_equal(sent.position, POSE + 0.01)
        assert sent.limited_by == ()

    @pytest.mark.parametrize("kind", ["torque", "impedance", "wrench"])
    def test_of_a_compliant_arm_begins_where_it_is(self, kind):
        contract = started(COMMANDS[kind](valid_for=LONG))
        where, speed = POSE + 0.2, np.array([0.5, -1.0, 0.25])
        contract.observe(state(1, where, speed))
        contract.hold("asked")
        slower = speed - np.sign(speed) * LIMITS.acceleration * PERIOD
        assert contract.setpoint == pytest.approx(where, abs=1e-15)
        assert contract.stand_in().position == pytest.approx(where + slower * PERIOD, abs=1e-15)

    @each_way
    def test_of_a_compliant_arm_follows_no_more_than_its_velocity_limit(self, sign):
        contract = started(pushed(valid_for=LONG))
        contract.observe(state(1, velocity=sign * 3 * LIMITS.velocity))
        slower = sign * (LIMITS.velocity - LIMITS.acceleration * PERIOD)
        assert contract.stand_in().position == pytest.approx(POSE + slower * PERIOD, abs=1e-15)

    def test_of_a_compliant_arm_that_was_not_measured_begins_where_it_will_be(self):
        contract = started(pushed(valid_for=LONG))
        speed = np.array([0.5, -1.0, 0.25])
        contract.observe(state(1, velocity=speed))
        for _ in range(5):
            contract.observe(state(1, velocity=speed, stale=True))
        contract.hold("asked")
        assert contract.setpoint == pytest.approx(POSE + 5 * PERIOD * speed, abs=1e-15)

    def test_of_a_compliant_arm_forgets_what_was_to_come(self):
        contract = started(sprung(valid_for=LONG))
        contract.observe(state(1, POSE + 0.2))
        contract.admit(sprung(POSE + 0.1))
        contract.hold("asked")
        contract.observe(state(2, POSE + 0.2))
        assert np.array_equal(contract.setpoint, POSE + 0.2)

    def test_without_a_measurement_sends_nothing(self):
        contract = SafetyContract(SPEC)
        contract.hold("asked")
        assert contract.stand_in() is None
        assert contract.holding


class TestStandIn:
    def test_goes_on_with_the_last_command(self):
        """What was limited goes on towards what was commanded."""
        contract, sent = started(moved()), [POSE]
        contract.observe(state(1))
        sent.append(contract.admit(moved(POSE + 0.02)).position)
        for cycle in range(2, 8):
            contract.observe(state(cycle, sent[-1]))
            sent.append(contract.stand_in().position)
        assert_kept(np.array([POSE, POSE, *sent]))
        assert (np.diff(sent, axis=0) > 0).all()

    def test_repeats_torques(self):
        contract = started(pushed([1.0, 0.0, 0.0]))
        contract.observe(state(1))
        assert np.array_equal(contract.stand_in().torque, [1.0, 0.0, 0.0])

    def test_is_nothing_for_an_arm_that_nobody_commanded(self):
        assert opened().stand_in() is None


class TestChangingTheMode:
    def test_starts_from_the_measured_pose_and_motion(self):
        contract = started(pushed(valid_for=LONG))
        where, speed = POSE + 0.2, np.array([0.5, -1.0, 0.25])
        contract.observe(state(1, where, speed))
        with pytest.raises(JointLimitError, match="first position"):
            contract.admit(moved())
        sent = contract.admit(moved(where))
        assert sent.position == pytest.approx(
            where + (speed - np.sign(speed) * LIMITS.acceleration * PERIOD) * PERIOD, abs=1e-15
        )

    def test_starts_torques_from_zero(self):
        contract = started(pushed(only(0, 7.0), valid_for=LONG))
        contract.observe(state(1))
        sent = contract.admit(sprung(torque=only(0, 9.0)))
        assert sent.torque[0] == pytest.approx(1000.0 * PERIOD)

    def test_starts_wrenches_from_zero(self):
        contract = started(wrenched(np.full(6, 4.0)))
        contract.observe(state(1))
        contract.admit(moved())
        contract.observe(state(2))
        assert contract.admit(wrenched(np.full(6, 9.0))).wrench == pytest.approx(np.full(6, 5.0))

    def test_after_a_hold_starts_torques_and_wrenches_from_zero(self):
        contract = opened()
        contract.lead(POSE)
        for command in (wrenched(np.full(6, 4.0)), pushed(only(0, 7.0))):
            contract.admit(command)
            contract.observe(state(1))
            contract.hold("asked")
            contract.resume()
        assert contract.admit(wrenched(np.full(6, 9.0))).wrench == pytest.approx(np.full(6, 5.0))
        contract.observe(state(2))
        contract.hold("asked")
        contract.resume()
        assert contract.admit(pushed(only(0, 9.0))).torque[0] == pytest.approx(7.8125)


class TestLead:
    def test_begins_streams_where_another_one_has_the_arm(self):
        contract = SafetyContract(SPEC)
        contract.lead(POSE + 0.01)
        contract.observe(state())
        assert np.array_equal(contract.setpoint, POSE + 0.01)
        contract.observe(state(1))
        assert np.array_equal(contract.setpoint, POSE + 0.01)
        assert np.array_equal(contract.admit(moved(POSE + 0.01)).position, POSE + 0.01)

    def test_rests(self):
        contract, _ = TestHolding().speed_up()
        contract.admit(moved(POSE + 0.3))
        contract.hold("asked")
        contract.lead(POSE)
        contract.observe(state(13))
        assert contract.standing
        assert np.array_equal(contract.setpoint, POSE)

    def test_is_not_needed(self):
        contract = SafetyContract(SPEC)
        contract.observe(state(position=POSE + 0.3))
        assert np.array_equal(contract.setpoint, POSE + 0.3)


class TestMemory:
    def test_of_a_set_point_that_could_not_be_sent_is_forgotten(self):
        contract = started(moved())
        contract.observe(state(1))
        first = contract.admit(moved(POSE + 0.01)).position
        contract.withhold()
        contract.observe(state(2))
        assert np.array_equal(contract.setpoint, POSE)
        assert np.array_equal(contract.admit(moved(POSE + 0.01)).position, first)

    def test_can_be_saved_and_restored(self):
        contract = started(moved())
        saved = contract.save()
        contract.hold("asked")
        contract.restore(saved)
        assert not contract.holding
        contract.hold("asked")
        contract.restore(saved)  # what was saved is no part of what goes on
        assert not contract.holding

    def test_restores_only_what_was_saved(self):
        with pytest.raises(TypeError, match="expected what save"):
            opened().restore({})


def test_warming_up_needs_no_arm():
    warm_up(SPEC)
    warm_up(replace(SPEC, wrench_limits=None))
