"""Every number that leaves is a step from the last that had effect, whatever fails on the way.

What the arm received is judged here by itself: one command after the other, by the limits alone.
"""

import errno
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fri_messages import POSE
from lanes import sampled
from robot_commands import position
from stepped_arm import HOST, SteppedArm, stepped

from backends.fri import endpoint
from backends.fri import robot as fri_robot
from backends.fri.codec.messages import CommandMode, DriveState, Quality, SafetyState, SessionState
from limo_driver.errors import BackendError, HoldingError
from limo_driver.robot import robot as robot_module
from limo_driver.types import TorqueCommand

ACTIVE = SessionState.COMMANDING_ACTIVE
ROUNDING = 1e-5  # relative
GOAL = np.array(POSE) + 0.6


class Judged:
    """What an arm received since it was asked last."""

    def __init__(self, robot):
        self.robot, self.limits, self.period = robot, robot.spec.limits, robot.spec.period
        self.heard = []

    def commands(self):
        self.robot.arm.listen()
        answers, self.robot.arm.answers[:] = list(self.robot.arm.answers), []
        self.heard += answers
        return self.heard

    def positions(self):
        return np.array([answer.data.joint_position for answer in self.commands()])

    def torques(self):
        return np.array([answer.data.joint_torque for answer in self.commands()])

    def check(self, most=1):
        """Check steps and changes of velocity; `most` cycles may lie between two commands."""
        path = self.positions()
        step, change = np.abs(np.diff(path, axis=0)), np.abs(np.diff(path, n=2, axis=0))
        assert (step <= most * self.limits.velocity * self.period * (1 + ROUNDING)).all()
        if most == 1:
            allowed = self.limits.acceleration * self.period**2 * (1 + 1e-4) + 1e-12
            assert (change <= allowed).all(), (change / allowed).max()
        return path


def moving(robot, cycles=150):
    """Move towards a goal that is far away; return who judges what the arm hears from now on."""
    judged = Judged(robot)
    robot.receive()
    robot.send(position(POSE))
    for _ in range(cycles):
        robot.receive()
        robot.send(position(GOAL))
    judged.check()
    return judged


def pushing(robot, cycles=30):
    judged = Judged(robot)
    robot.receive()
    for _ in range(cycles):
        robot.send(TorqueCommand(torque=np.full(7, 0.5)))
        robot.receive()
    return judged


def reason(robot):
    return robot._contract.save().reason


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
                return replace(made, header=replace(made.header, reflected=said[-1 - late]))

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

    def test_a_confirmation_that_is_late_all_the_time_is_none_that_is_missing(self):
        with stepped() as robot:
            robot.arm.message = lambda arm=robot.arm, **_: replace(
                plain := SteppedArm.message(arm),
                header=replace(plain.header, reflected=max(arm.reflected - 8, 0)),
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
            arm.message = lambda **_: replace(
                plain := SteppedArm.message(arm), header=replace(plain.header, reflected=reflected)
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
    monkeypatch.setattr(endpoint, "_age", lambda _: next(waiting, 0.0))


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
            assert robot.figures.outdated == max(stall - 5, 0)
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
            assert told == [newest - 4 + k for k in range(5)]  # those that waited for 5 ms at most
            assert robot.figures.outdated == 26

    @pytest.mark.parametrize("stall", [9, 12, 40, 90])
    def test_before_a_command_leave_time_to_confirm_it(self, stall, monkeypatch):
        """What came before it left cannot say that it was received."""
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged, wanted = pushing(robot), TorqueCommand(torque=np.full(7, 100.0))
            robot.receive()
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


def once(arm, change):
    """Let the arm's next message be another."""

    def message(**_):
        del arm.message
        return change(SteppedArm.message(arm))

    arm.message = message


def always(arm, change):
    arm.message = lambda **_: change(SteppedArm.message(arm))


def with_sequence(change):
    return lambda message: replace(
        message, header=replace(message.header, sequence=change(message.header.sequence))
    )


def in_mode(mode):
    return lambda message: replace(message, ipo=replace(message.ipo, command_mode=mode))


def of_robot(**changes):
    return lambda message: replace(message, robot=replace(message.robot, **changes))


def of_connection(**changes):
    return lambda message: replace(message, connection=replace(message.connection, **changes))


OFF = (DriveState.ACTIVE,) * 4 + (DriveState.OFF, DriveState.TRANSITIONING, DriveState.ACTIVE)
ANOMALIES = {
    "restarts": (with_sequence(lambda k: k % 100), r"counts its packets anew: \d+ came after \d+"),
    "leaps": (with_sequence(lambda k: k + 5000), "counts its packets anew"),
    "flips a bit": (with_sequence(lambda k: k ^ 1 << 20), "counts its packets anew"),
    "mode": (in_mode(CommandMode.TORQUE), "command mode changed from POSITION to TORQUE"),
    "wrench": (in_mode(CommandMode.WRENCH), "command mode changed from POSITION to WRENCH"),
    "no mode": (in_mode(CommandMode.NONE), "command mode changed from POSITION to NONE"),
    "stop": (of_robot(safety_state=SafetyState.STOP0_OR_1), "safety stop is in force"),
    "drives": (of_robot(drive_states=OFF), "drives of joints 5, 6 are not active"),
    "poor": (of_connection(quality=Quality.POOR), "connection is POOR"),
    "fair": (of_connection(quality=Quality.FAIR), "connection is FAIR"),
}


class TestAnActiveSessionThatSaysSomethingElse:
    @sampled("lasting", [once, always], "holds for the first one already")
    @pytest.mark.parametrize("what", ANOMALIES)
    def test_ends_in_a_hold_within_the_limits(self, what, lasting):
        change, said = ANOMALIES[what]
        with stepped(first_sequence=3000) as robot:
            judged = moving(robot)
            before = len(judged.positions())
            lasting(robot.arm, change)
            assert robot.receive().holding
            with pytest.raises(HoldingError, match=said):
                robot.send(position(GOAL))
            for _ in range(300):
                assert robot.receive().holding
            path = judged.check()
            assert len(path) >= before + 200
            assert robot.standing

    def test_may_say_one_mode_after_the_other(self):
        with stepped() as robot:
            judged = moving(robot)
            for mode in (CommandMode.WRENCH, CommandMode.TORQUE, CommandMode.WRENCH):
                once(robot.arm, in_mode(mode))
                assert robot.receive().holding
            robot.receive()
            judged.check()

    @sampled("lasting", [once, always], "fades for the first one already")
    @pytest.mark.parametrize("what", [name for name in ANOMALIES if name != "mode"])
    def test_lets_torques_fade_within_their_rate(self, what, lasting):
        change, _ = ANOMALIES[what]
        with stepped(mode=CommandMode.TORQUE, first_sequence=3000) as robot:
            judged = pushing(robot)
            lasting(robot.arm, change)
            assert robot.receive().holding
            for _ in range(60):
                robot.receive()
            torques = judged.torques()
            step = np.abs(np.diff(torques, axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()
            assert not torques[-1].any()

    @pytest.mark.parametrize(
        "change",
        [
            with_sequence(lambda k: k + 20), of_connection(quality=Quality.GOOD),
            of_robot(drive_states=()), of_robot(safety_state=None),
        ],
    )  # fmt: skip
    def test_that_goes_with_commands_is_no_reason_to_hold(self, change):
        with stepped() as robot:
            judged = moving(robot)
            always(robot.arm, change)
            for _ in range(100):
                assert not robot.receive().holding
                robot.send(position(GOAL))
            judged.check()

    @pytest.mark.parametrize(("lost", "restarts"), [(21, 1), (20, 0)])
    def test_may_lose_more_packets_than_time_went_by_only_by_20_ms(
        self, lost, restarts, monkeypatch
    ):
        with stepped() as robot:
            moving(robot)
            now = time.monotonic()  # stands still: a busy machine may pause for longer than 1 ms
            monkeypatch.setattr(fri_robot, "time", SimpleNamespace(monotonic=lambda: now))
            monkeypatch.setattr(endpoint, "_age", lambda _: 0.0)
            robot.receive()
            robot.arm.sequence += lost
            assert robot.receive().holding == bool(restarts)
            assert robot.figures.restarts == restarts

    def test_takes_no_commands_before_that_is_over(self):
        with stepped() as robot:
            robot.arm.quality = Quality.POOR
            robot.receive()
            with pytest.raises(BackendError, match=r"nothing may be commanded now: .* is POOR"):
                robot.send(position(POSE))
            robot.arm.quality = Quality.GOOD
            robot.receive()
            robot.send(position(POSE))

    @pytest.mark.parametrize("packets", [1, 2])
    @pytest.mark.parametrize("state", [SessionState.IDLE, SessionState.MONITORING_READY])
    def test_that_it_ended_and_goes_on_at_once_was_never_left(self, packets, state):
        with stepped() as robot:
            judged = moving(robot)
            robot.arm.obey = lambda: None  # nor is it moved by what it does not say
            real = len(judged.positions())
            robot.arm.state = state
            for _ in range(packets):
                assert robot.receive().holding
            robot.arm.listen()
            robot.arm.answers.clear()  # what an arm in COMMANDING_ACTIVE makes of them is its own
            robot.arm.state = ACTIVE
            for _ in range(300):
                assert robot.receive().holding
            path = judged.check()
            assert len(path) > real + 200
