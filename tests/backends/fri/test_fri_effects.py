"""Every number that leaves is a step from the last that had effect, whatever fails on the way.

What the arm received is judged here by itself: one command after the other, by the limits alone.
"""

import errno

import numpy as np
import pytest
from judged_arm import GOAL, ROUNDING, moving, pushing, reason, stand_still
from lanes import sampled
from robot_commands import position
from stepped_arm import HOST, SteppedArm, stepped

from backends.fri import connection
from backends.fri.codec.messages import CommandMode, Quality, SessionState
from limo_driver.errors import HoldingError
from limo_driver.robot import robot as robot_module
from limo_driver.types import TorqueCommand


class Refusing:
    """The socket of a driver whose network takes nothing for a while."""

    def __init__(self, plain, number=errno.ENETUNREACH):
        self.plain, self.left, self.number = plain, 0, number

    def __getattr__(self, name):
        return getattr(self.plain, name)

    def sendto(self, data, peer):
        if self.left:
            self.left -= 1
            raise OSError(self.number, "Network is unreachable")
        return self.plain.sendto(data, peer)


def refusing(robot):
    robot._link.endpoint._socket = Refusing(robot._link.endpoint._socket)
    return robot._link.endpoint._socket


class TestRefusedByTheNetwork:
    @pytest.mark.parametrize(("cycles", "holds"), [(1, False), (9, False), (10, True), (90, True)])
    def test_positions_wait_and_hold_after_10_ms(self, cycles, holds):
        with stepped() as robot:
            judged = moving(robot)
            network, last = refusing(robot), judged.positions()[-1]
            network.left = cycles
            for _ in range(cycles):
                state = robot.receive()
                if not state.holding:
                    sent = robot.send(position(GOAL))
                    assert sent.limited_by[-1] == "link"
                    assert sent.position == pytest.approx(last, abs=0)
            state = robot.receive()
            assert state.holding == holds
            assert robot.figures.unsent == cycles
            if holds:
                told = r"no command could be sent for 0\.01 s: Network is unreachable"
                with pytest.raises(HoldingError, match=told):
                    robot.send(position(GOAL))
            for _ in range(300):
                robot.receive()
            judged.check()

    def test_first_torque_of_all_was_none(self):
        with stepped(mode=CommandMode.TORQUE) as robot:
            robot.receive()
            refusing(robot).left = 1
            sent = robot.send(TorqueCommand(torque=np.ones(7)))
        assert sent.torque == pytest.approx(np.zeros(7))
        assert sent.limited_by[-1] == "link"

    def test_torques_wait(self):
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged, network = pushing(robot), refusing(robot)
            wanted = TorqueCommand(torque=np.full(7, 100.0))
            for k in range(40):
                network.left = 1 if 10 <= k < 18 else 0
                sent = robot.send(wanted)
                if 10 <= k < 18:
                    assert sent.torque == pytest.approx(judged.torques()[-1], abs=0)
                robot.receive()
            step = np.abs(np.diff(judged.torques(), axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()

    def test_after_a_command_that_left_the_next_one_may_fail_for_as_long_again(self):
        with stepped() as robot:
            judged, network = moving(robot), refusing(robot)
            for k in range(60):
                network.left = int(bool(k % 10))
                assert not robot.receive().holding
                robot.send(position(GOAL))
                network.left = 0
            judged.check()


class TestLostOnTheWayToTheRobot:
    @pytest.mark.parametrize(
        ("period_ms", "multiplier", "lost", "holds"),
        [
            (1, 1, 1, False), (1, 1, 9, False), (1, 1, 10, True), (1, 1, 60, True),
            (4, 1, 2, False), (4, 1, 3, True), (5, 2, 1, False), (2, 3, 1, False),
            (1, 10, 1, False),
        ],
    )  # fmt: skip
    def test_commands_hold_after_10_ms_or_three_periods(self, period_ms, multiplier, lost, holds):
        with stepped(period_ms=period_ms, multiplier=multiplier) as robot:
            judged = moving(robot, 60 // (period_ms * multiplier))
            robot.arm.deaf = lost
            held = []
            for _ in range(lost + 2):
                held.append(robot.receive().holding)
                if not held[-1]:
                    robot.send(position(GOAL))
            assert held[-1] == holds
            if holds:
                assert "received none of the last" in reason(robot)
                assert period_ms * (held.index(True) - 1) <= max(10, 3 * period_ms)
            judged.check(most=max(10 // period_ms, 3))

    @pytest.mark.parametrize("lost", [11, 15, 60, 300])
    @pytest.mark.parametrize("late", [0, 1, 3, 5])
    def test_the_first_that_arrives_is_a_step_from_the_last_that_did(self, lost, late):
        """Also where the robot says some packets later that it arrived."""
        with stepped() as robot:
            judged, arm, said = moving(robot), robot.arm, [robot.arm.reflected] * (late + 1)

            def message(**_):
                said.append(arm.reflected)
                made = SteppedArm.message(arm)
                return made._replace(header=made.header._replace(reflected=said[-1 - late]))

            arm.message = message
            before = len(judged.positions())
            arm.deaf = 10**6
            for k in range(lost + 300):
                if k == lost:
                    arm.deaf = 0
                if not robot.receive().holding:
                    robot.send(position(GOAL))
            path = judged.check()
            assert before + 280 <= len(path) <= before + 300
            assert robot.standing

    def test_torques_go_on_from_the_last_that_arrived(self):
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged = pushing(robot)
            robot.arm.deaf = 60
            for _ in range(100):
                if not robot.receive().holding:
                    robot.send(TorqueCommand(torque=np.full(7, 100.0)))
            step = np.abs(np.diff(judged.torques(), axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()

    @pytest.mark.parametrize(("kept", "most"), [(18, 1), (60, 11)])
    def test_what_the_network_keeps_for_20_ms_comes_beside_one_more_at_most(self, kept, most):
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged, wanted = pushing(robot), TorqueCommand(torque=np.full(7, 100.0))
            robot.arm.listen = lambda: None
            for _ in range(kept):
                if not (state := robot.receive()).holding:
                    robot.send(wanted)
            assert state.holding
            del robot.arm.listen
            for _ in range(100):
                assert robot.receive().holding
            torques = judged.torques()
            steps = np.abs(np.diff(torques, axis=0)) / (robot.spec.limits.torque_rate * 1e-3)
            assert steps.max() <= most * (1 + ROUNDING)
            assert (steps > 1 + ROUNDING).any(axis=1).sum() == (most > 1)
            assert not torques[-1].any()

    def test_a_confirmation_that_is_late_all_the_time_is_none_that_is_missing(self):
        with stepped() as robot:
            robot.arm.message = lambda arm=robot.arm, **_: (
                plain := SteppedArm.message(arm)
            )._replace(
                header=plain.header._replace(reflected=max(arm.reflected - 8, 0)),
            )
            judged = moving(robot, 300)
            assert not robot.receive().holding
            judged.check()

    def test_what_arrives_late_after_all_had_effect(self):
        """The robot is silent of it for 15 ms, then says that it has received everything."""
        with stepped() as robot:
            judged = moving(robot)
            arm, listen = robot.arm, robot.arm.listen
            reflected = arm.reflected
            arm.message = lambda **_: (plain := SteppedArm.message(arm))._replace(
                header=plain.header._replace(reflected=reflected)
            )
            for _ in range(15):
                if not (state := robot.receive()).holding:
                    robot.send(position(GOAL))
            assert state.holding
            del arm.message
            listen()
            last = arm.answers[-1].data.joint_position
            robot.receive()
            robot.receive()
            step = np.abs(judged.positions()[-1] - last)
            assert (step <= robot.spec.limits.velocity * 1e-3 * (1 + ROUNDING)).all()

    def test_closing_waits_for_no_robot_that_hears_nothing(self, monkeypatch):
        monkeypatch.setattr(robot_module, "BRAKING_PATIENCE", 0.0)
        with stepped() as robot:
            moving(robot)
            robot.arm.deaf = 10**6
            for _ in range(12):
                robot.receive()
            packets = robot.figures.received
        assert robot.figures.received < packets + 10


def stalled(robot, monkeypatch, ages):
    """Let packets pile up, of which the driver finds the ages when it goes on."""
    for _ in ages:
        robot.arm.cycle()
    waiting = iter([*ages, 0.0])  # with the packet of the cycle in which it goes on
    monkeypatch.setattr(connection, "_age", lambda _: next(waiting, 0.0))


class TestStallsOfThisComputer:
    @sampled("stall", [50, 5, 8, 80], "brakes as after 50 ms")
    @pytest.mark.parametrize("between", ["nothing", "foreign", "copies"])
    def test_brake_no_harder_than_the_limit(self, stall, between, monkeypatch):
        with stepped() as robot:
            judged = moving(robot)
            arm, other = robot.arm, SteppedArm(port=robot.arm.port, host=HOST)
            for _ in range(stall):
                arm.cycle()
                if between == "foreign":
                    other.send()
                elif between == "copies":
                    arm.send()
            ages = {arm.sequence + 1 - k: 1e-3 * k for k in range(stall + 1)}
            reader = robot._reader.decode
            found = robot._link.endpoint.receive

            def aged(timeout):
                datagram = found(timeout)
                if datagram is None:
                    return None
                sequence = reader(datagram.data).header.sequence
                return datagram._replace(age=ages.get(sequence, 0.0))

            monkeypatch.setattr(robot._link.endpoint, "receive", aged)
            state = robot.receive()
            assert not state.stale
            assert robot.figures.outdated == stall - 1
            if not state.holding:
                robot.send(position(GOAL))
            robot.hold()
            for _ in range(300):
                robot.receive()
            judged.check()
            other.close()

    def test_answer_no_packet_that_others_have_followed(self, monkeypatch):
        with stepped() as robot:
            judged = moving(robot)
            count = len(judged.positions())
            stalled(robot, monkeypatch, [1e-3 * (31 - k) for k in range(30)])
            newest = robot.arm.sequence + 1
            for _ in range(5):
                robot.receive()
                robot.send(position(GOAL))
            told = [answer.header.reflected for answer in judged.commands()[count:]]
            assert told == [newest + k for k in range(5)]
            assert robot.figures.outdated == 30

    def test_between_packet_and_answer_do_not_put_two_answers_into_one_interval(self):
        with stepped() as robot:
            judged = moving(robot)
            count = len(judged.positions())
            arm, followed = robot.arm, robot.receive().sequence
            arm.cycle()  # and this process was set aside meanwhile
            robot._arrived -= 2 * robot.spec.period
            assert "link" in robot.send(position(GOAL)).limited_by
            assert len(judged.positions()) == count
            cycle, arm.cycle = arm.cycle, lambda: None
            assert robot.receive().sequence == followed + 1
            arm.cycle = cycle
            robot.send(position(GOAL))
            assert len(judged.check()) == count + 1
            assert robot.figures.outdated == 1

    @pytest.mark.parametrize("stall", [9, 12, 40, 90])
    def test_before_a_command_leave_time_to_confirm_it(self, stall, monkeypatch):
        """What came before it left cannot say that it was received."""
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged, wanted = pushing(robot), TorqueCommand(torque=np.full(7, 100.0))
            robot.receive()
            stand_still(monkeypatch)
            stalled(robot, monkeypatch, [1e-3 * (stall + 1 - k) for k in range(stall)])
            cycle, robot.arm.cycle = robot.arm.cycle, lambda: None
            for _ in range(4):  # what has piled up is read at once
                robot.send(wanted)
                assert not robot.receive().holding
            robot.arm.cycle = cycle
            for _ in range(8):
                robot.send(wanted)
                assert not robot.receive().holding
            step = np.abs(np.diff(judged.torques(), axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()
            robot.arm.deaf = 60  # what came meanwhile is no excuse
            for _ in range(11):
                robot.send(wanted)
                state = robot.receive()
                if state.holding:
                    break
            assert "received none of the last" in reason(robot)

    def test_are_named_by_a_hold_that_follows(self, monkeypatch):
        with stepped() as robot:
            moving(robot)
            stalled(robot, monkeypatch, [1e-3 * (151 - k) for k in range(150)])
            assert robot.receive().holding
            told = r"expired.*; this program itself came 0\.151 s late: .*limo run --fifo"
            with pytest.raises(HoldingError, match=told):
                robot.send(position(GOAL))

    def test_are_named_by_a_session_that_ends_over_them(self, monkeypatch):
        with stepped() as robot:
            moving(robot)
            stalled(robot, monkeypatch, [1e-3 * (31 - k) for k in range(30)])
            robot.arm.state = SessionState.MONITORING_WAIT
            for _ in range(5):
                robot.receive()
            assert "left COMMANDING_ACTIVE for MONITORING_WAIT" in reason(robot)
            assert "itself came 0.031 s late" in reason(robot)

    @pytest.mark.parametrize(("later", "named"), [(150, True), (250, False)])
    def test_are_not_named_long_after(self, later, named, monkeypatch):
        with stepped() as robot:
            moving(robot)
            stalled(robot, monkeypatch, [1e-3 * (31 - k) for k in range(30)])
            for _ in range(later):
                robot.receive()
                robot.send(position(GOAL))
            robot.arm.quality = Quality.POOR
            for _ in range(5):
                robot.receive()
            assert "POOR" in reason(robot)
            assert ("itself came" in reason(robot)) == named
