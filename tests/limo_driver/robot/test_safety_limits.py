"""Each number of the safety contract, held from both sides.

The numbers stand here as the contract is described to users, not as its module names them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import (
    COMMANDS,
    JUST,
    LIMITS,
    LONG,
    PERIOD,
    POSE,
    SPEC,
    ZERO,
    assert_kept,
    moved,
    only,
    opened,
    pushed,
    reason,
    sprung,
    started,
    state,
    wrenched,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import BackendError, ConfigError, JointLimitError, ShapeError
from limo_driver.robot.safety import SafetyContract, check_readable
from limo_driver.types import JointCommand, PositionCommand

some = settings(max_examples=20)
each_joint = pytest.mark.parametrize("j", range(3))
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])
each_kind = pytest.mark.parametrize("kind", COMMANDS)


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
    """Carried 0.01 rad out of its range, an arm holds; one that gives way, before the end."""

    def near_the_end(self, kind, j, sign):
        """Return a contract of an arm 2 mrad before an end of its range, and that end."""
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        contract, position = SafetyContract(SPEC), only(j, end - sign * 0.002, POSE)
        contract.observe(state(position=position))
        command = COMMANDS[kind](valid_for=LONG)
        if hasattr(command, "position"):
            command = replace(command, position=position)
        contract.admit(command)
        return contract, end

    @each_joint
    @each_way
    def test_may_be_left_a_little(self, j, sign):
        for factor, held in ((1 - JUST, False), (1 + JUST, True)):
            contract, end = self.near_the_end("position", j, sign)
            position = only(j, end + sign * 0.01 * factor, POSE)
            contract.observe(state(1, position, only(j, sign * 0.1)))
            assert contract.holding == held
            if held:
                assert f"joint {j + 1} leaves its range" in reason(contract)

    @each_joint
    @each_way
    @pytest.mark.parametrize("kind", ["torque", "impedance", "wrench"])
    def test_is_not_left_by_arms_that_give_way(self, j, sign, kind):
        for speed, held in ((-0.3, False), (0.0, False), (0.3, True)):
            contract, _ = self.near_the_end(kind, j, sign)
            position = contract._memory.state.position
            contract.observe(state(1, position, only(j, sign * speed)))
            assert contract.holding == held
            if held:
                assert f"joint {j + 1} could not have stopped inside its range" in reason(contract)

    @each_joint
    @each_way
    def test_says_nothing_of_an_arm_that_comes_back_or_stands(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        outside = only(j, end + sign * 0.5, POSE)
        contract = SafetyContract(SPEC)
        contract.observe(state(position=outside))
        contract.admit(pushed(valid_for=LONG))
        contract.observe(state(1, outside, only(j, -sign * 0.1)))
        contract.observe(state(2, outside))
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
    """An arm that was not measured for 0.1 s holds; one that gives way, within 10 ms."""

    @pytest.mark.parametrize("period", [0.001, 0.004, 0.01, 0.02])
    @pytest.mark.parametrize("kind", ["torque", "impedance", "wrench"])
    def test_may_last_10_ms_where_the_arm_gives_way(self, period, kind):
        """What is sent after the hold began reaches the drives within them."""
        contract = started(COMMANDS[kind](valid_for=LONG), spec=replace(SPEC, period=period))
        cycles = max(round(0.01 / period + 1e-9) - 1, 1) if period < 0.005 else 1
        if period == 0.004:
            cycles = 2
        for cycle in range(1, cycles + 1):
            assert not contract.holding
            contract.observe(state(cycle, time=0.0, stale=True))
        assert "no measurement for" in reason(contract)

    def test_is_shorter_where_the_arm_may_get_too_fast(self):
        contract = started(pushed(valid_for=LONG), spec=replace(SPEC, period=0.001))
        contract.observe(state(1, time=0.001, velocity=only(2, 0.0)))
        contract.observe(state(2, time=0.002, velocity=only(2, 0.25)))  # 250 rad/s^2
        contract.observe(state(3, time=0.002, stale=True))
        assert not contract.holding
        contract.observe(state(4, time=0.002, stale=True))
        assert "no measurement for 0.002 s" in reason(contract)

    def test_lets_an_arm_float_that_is_to_do_so(self):
        spec = replace(SPEC, period=0.001, on_loss="float")
        contract, sent = started(pushed(only(0, 3.0), valid_for=LONG), spec=spec), []
        for cycle in range(1, 20):
            contract.observe(state(cycle, time=0.0, stale=True))
            sent.append(contract.stand_in())
        assert contract.holding
        torques = np.array([command.torque[0] for command in sent])
        assert (np.diff(torques) >= -1.0 - 1e-9).all()
        assert torques[-1] == 0.0
        contract.observe(state(20, time=0.02))
        assert np.array_equal(contract.stand_in().position, POSE)

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
        contract = started(moved(valid_for=LONG))
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
        for late, held in ((0.5e-9, 0), (0.9e-9, 0), (1e-9, 0), (1.1e-9, 1), (2e-9, 1)):
            contract = started(moved(valid_for=0.125))
            contract.observe(state(1, time=0.125 + late))
            assert contract.holding == bool(held), late

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

    def test_are_those_of_another_type(self):
        class Faster(PositionCommand):
            pass

        contract = opened()
        for other in (Faster(position=POSE), JointCommand(), None):
            with pytest.raises(ConfigError, match=f"one of Pos.*, not {type(other).__name__}"):
                contract.admit(other)
        assert contract.at_rest

    @each_kind
    def test_are_those_that_a_backend_cannot_carry_out(self, kind):
        def refuse(command):
            raise BackendError(f"no {type(command).__name__}")

        contract = opened(check=refuse)
        with pytest.raises(BackendError, match="no "):
            contract.admit(COMMANDS[kind]())
        assert contract.at_rest
