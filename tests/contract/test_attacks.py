"""Ways past the safety contract that were found by attacking it, closed on every simulated arm."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled
from robot_commands import START, impedance, position
from wire_rules import POSITION, TORQUE
from wire_tap import tapped

from limo_driver.errors import CycleTimeoutError, HoldingError, JointLimitError
from limo_driver.model import RobotModel
from limo_driver.robot.registry import open_robot
from limo_driver.types import PositionCommand, TorqueCommand

ROUNDING = 1e-5  # relative


def torque(values, **options):
    return TorqueCommand(torque=np.asarray(values, dtype=float), **options)


def loaded(robot, joint=0, most=110.0, cycles=12):
    """Push with a joint until the torque is high; return the last state."""
    robot.receive()
    wanted = most * np.eye(7)[joint]
    for _ in range(cycles):
        robot.send(torque(wanted))
        state = robot.receive()
    return state


def torque_steps(robot, applied):
    """Largest step of torque between cycles, as a share of what its rate allows."""
    told = np.array([item.torque for item in applied if item.mode == TORQUE])
    step = robot.spec.limits.torque_rate * robot.spec.period
    return float((np.abs(np.diff(told, axis=0)) / step).max())


class TestTorqueRate:
    def test_is_kept_through_a_position_of_the_same_cycle(self, robot):
        applied, state = tapped(robot), loaded(robot)
        robot.send(position(state.position))
        sent = robot.send(torque(np.zeros(7)))
        robot.receive()
        assert "torque_rate" in sent.limited_by
        assert torque_steps(robot, applied) <= 1 + ROUNDING
        assert np.array_equal(applied[-1].torque, sent.torque)

    def test_is_kept_through_a_hold_that_ended_at_once(self, robot):
        applied, _ = tapped(robot), loaded(robot)
        robot.hold()
        robot.resume()
        robot.send(torque(np.zeros(7)))
        robot.receive()
        assert torque_steps(robot, applied) <= 1 + ROUNDING

    def test_of_a_hold_that_ended_at_once_is_not_applied_for_ever(self, robot):
        applied, _ = tapped(robot), loaded(robot)
        robot.hold()
        robot.resume()
        for _ in range(300):
            robot.receive()
        assert applied[-1].mode == POSITION
        assert robot.standing


class TestRange:
    @pytest.mark.parametrize("joint", [0, 6])
    @pytest.mark.parametrize("how", ["hold", "position"])
    def test_is_kept_by_an_arm_that_was_fast_near_its_end(self, joint, how):
        """An arm that is brought there against all braking: the last cycle before the command."""
        with open_robot("virtual", robot="iiwa14", initial_position=START) as robot:
            limits = robot.spec.limits
            loaded(robot, joint, most=1.0, cycles=2)
            near = limits.position_max[joint] - 3e-3
            robot._position = np.where(np.arange(7) == joint, near, robot._position)
            robot._velocity = limits.velocity * np.eye(7)[joint]
            for _ in range(4):  # where it was put is believed after some measurements
                robot._position = np.where(np.arange(7) == joint, near, robot._position)
                state = robot.receive()
            applied = tapped(robot)
            if how == "hold":
                robot.hold()
            elif not state.holding:
                robot.send(position(np.minimum(state.position, limits.position_max)))
            for _ in range(300):
                state = robot.receive()
            told = np.array([item.position for item in applied if item.mode == POSITION])
            assert told.max(axis=0)[joint] <= limits.position_max[joint] + 1e-9
            assert state.position[joint] <= limits.position_max[joint] + 1e-9

    @sampled("joint", [0, 3, 6], "seconds of cycles each")
    @sampled("kind", ["torque", "impedance"], "seconds of cycles each")
    def test_is_kept_by_arms_that_are_pushed_towards_its_end(self, backend, joint, kind):
        """Braked when it just can be, and never beyond."""
        limits = RobotModel.load("iiwa14").limits
        start = np.array(START)
        start[joint] = limits.position_max[joint] - 1.0  # far enough to be fast there
        with open_robot(backend, robot="iiwa14", initial_position=start) as robot:
            state, furthest, fastest = robot.receive(), -np.inf, 0.0
            gain = np.array([8.0, 8.0, 4.0, 4.0, 1.0, 1.0, 0.3])
            for _ in range(6000):
                if state.holding:
                    break
                speed = 0.8 * limits.velocity[joint] * np.eye(7)[joint]
                push = 3 * gain * (speed - state.velocity)
                if kind == "torque":
                    robot.send(torque(push))
                else:
                    robot.send(impedance(state.position, 0.0, 0.0, push))
                state = robot.receive()
                furthest = max(furthest, state.position[joint])
                fastest = max(fastest, state.velocity[joint] / limits.velocity[joint])
            assert state.holding
            assert fastest > 0.6
            for _ in range(1500):
                state = robot.receive()
                furthest = max(furthest, state.position[joint])
            assert furthest <= limits.position_max[joint]
            assert state.position[joint] > limits.position_max[joint] - 0.2  # not long before it
            with pytest.raises(HoldingError, match=f"joint {joint + 1} .*range"):
                robot.send(position(state.position))

    @sampled("joint", [0, 6], "seconds of cycles each")
    @sampled("alternately", [True, False], "seconds of cycles each")
    def test_is_kept_by_a_program_that_resumes_whenever_the_arm_holds(self, joint, alternately):
        """Torque towards the end of the range, with a position in every other cycle or without."""
        push = [20.0, 0.5][joint == 6] * np.eye(7)[joint]
        with open_robot("virtual", robot="iiwa14", initial_position=START) as robot:
            limits, state = robot.spec.limits, robot.receive()
            furthest, fastest = -np.inf, 0.0
            for k in range(2500):
                if state.holding:
                    robot.resume()
                with suppress(HoldingError):
                    robot.send(position(state.position) if alternately and k % 2 else torque(push))
                state = robot.receive()
                furthest = max(furthest, (state.position - limits.position_max)[joint])
                fastest = max(fastest, (np.abs(state.velocity) / limits.velocity)[joint])
            assert furthest < 0.012  # what an arm may be carried out of its range, and two cycles
            assert 0.3 < fastest < 1.5


class TestVelocity:
    def test_of_set_points_is_kept_where_the_arm_exceeds_it(self):
        with open_robot("virtual", robot="iiwa14", initial_position=START) as robot:
            fastest = robot.spec.limits.velocity
            loaded(robot, most=1.0, cycles=2)
            for _ in range(3):
                robot._velocity = 1.139 * fastest * np.eye(7)[0]
                state = robot.receive()
            applied = tapped(robot)
            before = state.position
            for _ in range(40):
                robot.send(position(before + 0.01 * np.eye(7)[0], valid_for=0.2))
                robot.receive()
            path = np.array([before, *(item.position for item in applied)])
            speed = np.abs(np.diff(path, axis=0)) / robot.spec.period
            assert (speed <= fastest * (1 + ROUNDING)).all()

    def test_of_set_points_is_kept_where_a_stream_starts_anew(self):
        """What the gear's hysteresis leaves between set-point and measurement is no step."""
        with open_robot(
            "mujoco", simulation="examples/iiwa14_hysteretic.yaml", initial_position=START
        ) as robot:
            applied, state = tapped(robot), robot.receive()
            random = np.random.default_rng(1)
            for _ in range(12):
                goal = state.position + random.uniform(-0.2, 0.2, 7)
                start = robot.setpoint
                for k in range(120):
                    part = 0.5 - 0.5 * np.cos(np.pi * k / 120)
                    robot.send(position(start + part * (goal - start)))
                    state = robot.receive()
                robot.hold()
                for _ in range(150):
                    state = robot.receive()
                robot.resume()
                robot.send(position(state.position))
                state = robot.receive()
            path = np.array([item.position for item in applied])
            speed = np.abs(np.diff(path, axis=0)) / robot.spec.period
            assert (speed <= robot.spec.limits.velocity * (1 + ROUNDING)).all()


class TestMeasurements:
    def open(self):
        return open_robot("virtual", robot="iiwa14", initial_position=START)

    @staticmethod
    def spoil(robot, **values):
        """Make every measurement of an arm have these values from now on."""
        cycle = robot._cycle_once
        robot._cycle_once = lambda: replace(cycle(), **values)

    @pytest.mark.parametrize("name", ["position", "velocity", "torque"])
    def test_that_are_not_finite_from_the_start_are_none(self, name):
        with self.open() as robot:
            self.spoil(robot, **{name: np.full(7, np.nan)})
            with pytest.raises(CycleTimeoutError):
                robot.receive()

    @pytest.mark.parametrize("name", ["position", "velocity", "torque"])
    def test_that_are_not_finite_are_lost_ones_and_lead_to_a_hold(self, name):
        with self.open() as robot:
            applied, _ = tapped(robot), loaded(robot, cycles=5)
            self.spoil(robot, **{name: np.full(7, np.nan)})
            for _ in range(12):
                state = robot.receive()
                assert state.stale
                assert np.isfinite(state.position).all()
            assert state.holding
            for _ in range(100):
                robot.receive()
            assert all(np.isfinite(item.position).all() for item in applied)
            assert applied[-1].mode == POSITION

    def test_that_jump_are_not_followed(self):
        """One false pose, and commands of torque that end beside it: the hold is where it was."""
        with self.open() as robot:
            loaded(robot, most=0.0, cycles=20)
            cycle, false = robot._cycle_once, iter([0.5])
            robot._cycle_once = lambda: replace(
                (true := cycle()), position=true.position + next(false, 0.0)
            )
            assert robot.receive().stale
            robot.hold()
            robot.receive()
            assert np.abs(robot.setpoint - START).max() < 0.01

    def test_whose_clock_goes_back_let_commands_expire(self):
        with self.open() as robot:
            state = robot.receive()
            robot.send(position(state.position, valid_for=0.1))
            self.spoil(robot, time=-3600.0)
            for _ in range(130):
                state = robot.receive()
            assert state.holding

    @pytest.mark.parametrize("joint", range(7))
    def test_that_stay_away_end_torques_within_10_ms(self, joint):
        with self.open() as robot:
            applied = tapped(robot)
            half = 0.5 * robot.spec.limits.torque[joint] * np.eye(7)[joint]
            state = robot.receive()
            while not state.holding and abs(state.velocity[joint]) < 0.2:
                robot.send(torque(half, valid_for=1.0))
                state = robot.receive()
            robot.lose_measurements(10**6)
            before = len(applied)
            for _ in range(12):
                robot.receive()
            assert TORQUE not in [item.mode for item in applied[before + 10 :]]
            gap = np.abs(applied[before + 10].position - robot._position)
            assert gap.max() < 0.01


class TestImpedance:
    def test_that_is_switched_on_and_off_keeps_the_torque_rate(self, robot):
        """Stiffness 0 and the highest in turn, far from the set-point."""
        applied = tapped(robot)
        states = [robot.receive()]
        stiffest = 1e5 if type(robot).__name__ == "VirtualRobot" else 2e4
        stiffest *= robot.spec.limits.torque / 320.0
        for k in range(400):
            goal = states[0].position + min(1.0, k / 300) * 0.3 * np.eye(7)[5]
            try:
                robot.send(impedance(goal, stiffest * (k > 350 and k % 2), 0.0))
            except HoldingError:
                break
            states.append(robot.receive())
        assert k > 352
        step = robot.spec.limits.torque_rate * robot.spec.period
        most = robot.spec.limits.torque
        for before, after, state in zip(applied, applied[1:], states[:-1], strict=False):
            q, v = state.position, state.velocity
            total = [
                np.clip(g.stiffness * (after.position - q) - g.damping * v + g.torque, -most, most)
                for g in (before, after)
            ]
            if before.mode == after.mode:
                assert (np.abs(total[1] - total[0]) <= step * (1 + ROUNDING)).all()


def test_what_comes_back_says_what_limo_did_and_not_what_the_caller_said(robot):
    state = robot.receive()
    given = PositionCommand(position=state.position, limited_by=("torque", "luck"))
    assert robot.send(given).limited_by == ()


def test_first_positions_still_have_to_be_near(robot):
    state = robot.receive()
    with pytest.raises(JointLimitError, match="first position"):
        robot.send(position(state.position + 0.1))
