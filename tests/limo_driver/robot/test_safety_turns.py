"""Turns of the safety contract: paths, holds, stand-ins, modes, leads, and what is remembered."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from contracts import (
    COMMANDS,
    LIMITS,
    LONG,
    PERIOD,
    POSE,
    SPEC,
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

from limo_driver.errors import HoldingError, JointLimitError
from limo_driver.robot.safety import SafetyContract, warm_up

each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


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

    def test_fade_a_torque_that_was_as_their_rows_would(self):
        left = []
        for at_once in (False, True):
            contract = started(pushed(only(0, 7.0), valid_for=LONG))
            for cycle in range(1, 5):
                contract.observe(state(cycle))
                contract.admit(pushed(only(0, 50.0), valid_for=LONG))
            contract.observe(state(5))
            if at_once:
                contract.admit_path(np.tile(POSE, (3, 1)))
            else:
                for cycle in range(6, 9):
                    contract.admit(moved())
                    contract.observe(state(cycle))
            left.append(contract.following.torque)
        assert left[0][0] == pytest.approx(7.0 + (4 - 3) * LIMITS.torque_rate[0] * PERIOD)
        assert np.array_equal(*left)

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

    def speed_up(self, cycles=12, way=(0.3, 0.3, 0.3)):
        """Return a contract in motion, in a cycle without a command yet, and what was sent."""
        contract, sent = opened(), [POSE, POSE]
        for cycle in range(cycles):
            contract.observe(state(cycle, sent[-1]))
            sent.append(contract.admit(moved(np.add(POSE, way) if cycle else POSE)).position)
        contract.observe(state(cycles, sent[-1]))
        return contract, sent

    @pytest.mark.parametrize("resumed", [False, True])
    @pytest.mark.parametrize("way", [(0.3, 0.3, 0.3), (0.3, 0.0, 0.0), (0.0, 0.0, -0.3)])
    def test_brakes_within_the_limits_and_as_fast_as_they_allow(self, resumed, way):
        contract, sent = self.speed_up(way=way)
        fastest = np.abs(sent[-1] - sent[-2]) / PERIOD
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

    @pytest.mark.parametrize("way", [(0.3, 0.3, 0.3), (0.0, 0.0, -0.3)])
    def test_while_braking_a_stream_goes_on_from_the_set_point(self, way):
        contract, sent = self.speed_up(way=way)
        contract.hold("asked")
        contract.resume()
        for cycle in range(13, 60):
            sent.append(contract.admit(moved(sent[12])).position)
            contract.observe(state(cycle, sent[-1]))
        assert_kept(np.array(sent))
        assert np.array_equal(sent[-1], sent[12])

    def test_after_braking_a_stream_goes_on_from_the_set_point(self):
        """Which the drives keep, however far from it what leans on the arm has it measured."""
        contract, _ = self.speed_up()
        contract.hold("asked")
        measured = contract.setpoint + 0.01
        for cycle in range(13, 80):
            contract.stand_in()
            contract.observe(state(cycle, measured))
        contract.resume()
        where = contract.setpoint
        with pytest.raises(JointLimitError, match="first position"):
            contract.admit(moved(measured + 0.021))
        path = [where, where]
        for cycle in range(80, 120):
            path.append(contract.admit(moved(measured)).position)
            contract.observe(state(cycle, measured))
        assert_kept(np.array(path))
        assert np.array_equal(path[-1], measured)

    @pytest.mark.parametrize("kind", ["torque", "impedance", "wrench"])
    def test_of_a_compliant_arm_begins_where_it_is(self, kind):
        contract = started(COMMANDS[kind](valid_for=LONG))
        where, speed = POSE + 0.012, np.array([0.5, -1.0, 0.25])
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
        for cycle in (1, 2):
            contract.observe(state(cycle, POSE + cycle * PERIOD * speed, speed))
        contract.observe(state(2, stale=True))
        assert contract.holding
        assert contract.setpoint == pytest.approx(POSE + 3 * PERIOD * speed, abs=1e-15)

    def test_of_a_compliant_arm_begins_after_what_was_sent_already(self):
        contract = started(sprung(valid_for=LONG))
        contract.observe(state(1, POSE + 0.012))
        sent = contract.admit(sprung(POSE + 0.01, stiffness=np.full(3, 10.0)))
        contract.hold("asked")
        assert contract.following.mode is type(sent)
        contract.observe(state(2, POSE + 0.012))
        assert np.array_equal(contract.setpoint, POSE + 0.012)
        assert np.array_equal(contract.stand_in().position, POSE + 0.012)

    def test_begins_where_an_arm_is_that_was_moved_by_hand_before(self):
        contract = opened()
        contract.observe(state(1, POSE + 0.01))
        assert np.array_equal(contract.setpoint, POSE + 0.01)
        contract.hold("asked")
        contract.observe(state(2, POSE + 0.02))
        assert np.array_equal(contract.stand_in().position, POSE + 0.01)

    def test_that_was_asked_for_before_any_measurement_keeps_the_first_pose(self):
        contract = SafetyContract(SPEC)
        contract.hold("asked")
        contract.observe(state())
        contract.observe(state(1, POSE + 0.01))
        assert np.array_equal(contract.stand_in().position, POSE)

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
        where, speed = POSE + 0.012, np.array([0.5, -1.0, 0.25])
        contract.observe(state(1, where, speed))
        with pytest.raises(JointLimitError, match="first position"):
            contract.admit(moved(POSE - 0.01))
        sent = contract.admit(moved(where))
        assert sent.position == pytest.approx(
            where + (speed - np.sign(speed) * LIMITS.acceleration * PERIOD) * PERIOD, abs=1e-15
        )

    @pytest.mark.parametrize("middle", [None, moved, sprung, "hold"])
    def test_goes_on_from_the_torque_that_was(self, middle):
        """Whatever was asked for meanwhile, and had no effect."""
        contract = started(pushed(only(0, 7.0), valid_for=LONG))
        contract.observe(state(1))
        if middle == "hold":
            contract.hold("asked")
            contract.resume()
        elif middle is not None:
            contract.admit(middle())
        sent = contract.admit(sprung(torque=only(0, 20.0)))
        assert sent.torque[0] == pytest.approx(7.0 + 1000.0 * PERIOD)
        sent = contract.admit(pushed(only(0, -9.0)))
        assert sent.torque[0] == pytest.approx(7.0 - 1000.0 * PERIOD)

    def test_goes_on_from_what_is_left_of_a_torque(self):
        contract = started(pushed(only(0, 7.0), valid_for=LONG))
        for cycle in range(1, 4):
            contract.observe(state(cycle))
            contract.admit(pushed(only(0, 20.0), valid_for=LONG))
        contract.observe(state(4))
        contract.admit(moved())  # for one cycle
        contract.observe(state(5))
        assert contract.admit(pushed()).torque[0] == pytest.approx(20.0 - 2 * 1000.0 * PERIOD)

    def test_leaves_nothing_behind_where_nobody_commands_any_more(self):
        """The torque that is left fades also while nothing has to be sent."""
        contract = started(pushed(only(0, 7.0), valid_for=LONG))
        contract.observe(state(1))
        for cycle in range(2, 5):
            contract.admit(pushed(only(0, 30.0), valid_for=LONG))
            contract.observe(state(cycle))
        contract.hold("asked")
        contract.resume()
        for cycle in range(5, 20):
            contract.stand_in()
            contract.observe(state(cycle))
        assert contract.at_rest
        assert contract.stand_in() is None
        assert contract.admit(pushed()).torque[0] == 0.0

    def test_goes_on_from_the_torque_of_an_impedance(self):
        contract = started(sprung(torque=only(0, 7.0)))
        contract.observe(state(1, POSE - only(0, 0.01)))
        contract.admit(sprung(stiffness=only(0, 300.0), torque=only(0, 7.0)))
        contract.observe(state(2, POSE - only(0, 0.01)))
        sent = contract.admit(pushed())
        assert sent.torque[0] == pytest.approx(7.0 + 3.0 - 1000.0 * PERIOD)

    def test_goes_on_from_the_gains_by_which_drives_kept_positions(self):
        """Together at the rate of torques, wherever the arm is that is believed to be there."""
        contract = opened(gains=(only(0, 2e4), only(0, 2e3)))
        for cycle in range(1, 4):
            contract.admit(moved())
            contract.observe(state(cycle))
        sent = contract.admit(sprung(stiffness=only(0, 1e3), damping=only(0, 50.0)))
        softer, looser = 2e4 - sent.stiffness[0], 2e3 - sent.damping[0]
        false, fast = 4.8 * LIMITS.velocity[0] * PERIOD + 0.01, 1.2 * LIMITS.velocity[0]
        assert softer * false + looser * fast == pytest.approx(LIMITS.torque_rate[0] * PERIOD)
        assert softer > 0.0
        assert looser > 0.0
        assert sent.torque == pytest.approx(0.0)

    def test_starts_wrenches_from_zero(self):
        contract = started(wrenched(np.full(6, 4.0)))
        contract.observe(state(1))
        contract.admit(moved())
        contract.observe(state(2))
        assert contract.admit(wrenched(np.full(6, 9.0))).wrench == pytest.approx(np.full(6, 5.0))

    def test_leaves_torques_and_wrenches_behind_at_their_rates(self):
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


def test_gravity_that_moves_on_counts_in_the_rate_of_torques():
    gravity = iter(np.outer(np.resize([0.5, -0.5], 60), np.ones(3)))
    carried = []

    def carry():
        carried.append(next(gravity))
        return carried[-1]

    contract, told = SafetyContract(SPEC, gravity=carry), []
    for cycle in range(40):
        contract.observe(state(cycle))
        told.append(contract.admit(pushed(2 * LIMITS.torque, valid_for=LONG)).torque + carried[-1])
    rate = np.abs(np.diff(told, axis=0)) / PERIOD
    assert (rate <= LIMITS.torque_rate * (1 + 1e-9)).all()
    assert rate.max(axis=0) == pytest.approx(LIMITS.torque_rate)
    assert told[-1] == pytest.approx(LIMITS.torque)


@each_way
def test_a_torque_beside_gravity_reaches_the_limit_of_their_sum(sign):
    """Whoever keeps positions by a spring of its own, too: a pushed arm has none to be limited."""
    gravity, gains = np.full(3, 9.0), (np.full(3, 500.0), np.full(3, 20.0))
    contract = SafetyContract(SPEC, gravity=lambda: sign * gravity, gains=gains)
    for cycle in range(120):
        contract.observe(state(cycle))
        told = contract.admit(pushed(-2 * sign * LIMITS.torque, valid_for=LONG)).torque
    assert told + sign * gravity == pytest.approx(-sign * LIMITS.torque)


class TestGivingWay:
    """It begins only where the arm could stop."""

    @pytest.mark.parametrize("command", [pushed, sprung, wrenched])
    @pytest.mark.parametrize(
        ("away", "speed", "why"), [(0.05, 0.95, "could not have stopped"), (2.0, 1.3, "leaves")]
    )
    def test_is_refused_to_an_arm_that_has_to_brake(self, command, away, speed, why):
        place = only(0, LIMITS.position_max[0] - away, POSE)
        contract = SafetyContract(SPEC)
        contract.observe(state(position=place, velocity=only(0, speed)))
        contract.admit(moved(place))
        contract.hold("asked")
        contract.resume()
        with pytest.raises(HoldingError, match=f"joint 1 {why}"):
            contract.admit(command(place) if command is sprung else command())
        assert contract.holding
        contract.resume()
        contract.admit(moved(place))

    @pytest.mark.parametrize("torque", [-1.0, 0.0, 1.0])
    @each_way
    def test_further_out_of_the_range_is_refused(self, torque, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[0]
        for away, outside in ((0.009, False), (0.011, True)):
            place, push = only(0, end + sign * away, POSE), only(0, torque)
            outward = outside and sign * torque > 0
            for command in (pushed(push), sprung(place, torque=push)):
                contract = SafetyContract(SPEC)
                contract.observe(state(position=place))
                with pytest.raises(HoldingError, match="outside") if outward else nullcontext():
                    contract.admit(command)

    def test_of_a_spring_counts_as_its_torque(self):
        place = only(0, LIMITS.position_max[0] + 0.011, POSE)
        spring = {"stiffness": only(0, 100.0), "torque": only(0, 1.5)}
        for further, outward in ((-0.016, False), (-0.014, True)):
            contract = SafetyContract(SPEC)
            contract.observe(state(position=place))
            with pytest.raises(HoldingError, match="outside") if outward else nullcontext():
                contract.admit(sprung(place + only(0, further), **spring))
