"""An active session that says something that does not go with commands ends in a hold."""

import numpy as np
import pytest
from fri_messages import GENERATIONS, POSE
from judged_arm import ACTIVE, GOAL, ROUNDING, moving, pushing, stand_still
from lanes import sampled
from robot_commands import position
from stepped_arm import SteppedArm, stepped

from backends.fri.answers import DOUBTED, FLICKER
from backends.fri.codec.messages import CommandMode, DriveState, Quality, SafetyState, SessionState
from limo_driver.errors import BackendError, HoldingError
from limo_driver.types import TorqueCommand


def once(arm, change):
    """Let the arm's next message be another."""

    def message(**_):
        del arm.message
        return change(SteppedArm.message(arm))

    arm.message = message


def always(arm, change):
    arm.message = lambda **_: change(SteppedArm.message(arm))


def with_sequence(change):
    return lambda message: message._replace(
        header=message.header._replace(sequence=change(message.header.sequence))
    )


def in_mode(mode):
    return lambda message: message._replace(ipo=message.ipo._replace(command_mode=mode))


def of_robot(**changes):
    return lambda message: message._replace(robot=message.robot._replace(**changes))


def of_connection(**changes):
    return lambda message: message._replace(connection=message.connection._replace(**changes))


LONGEST = round(1e3 * DOUBTED) - 1  # packets
LEFT_FOR = [SessionState.IDLE, SessionState.MONITORING_READY, SessionState.COMMANDING_WAIT]
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
            stand_still(monkeypatch)
            robot.receive()
            robot.arm.sequence += lost
            assert robot.receive().holding == bool(restarts)
            assert robot.figures.restarts == restarts

    def test_does_not_make_a_command_late_by_a_count_that_leaps(self):
        def confirming_late(ahead):
            return lambda message: message._replace(
                header=message.header._replace(
                    sequence=message.header.sequence + ahead, reflected=message.header.reflected - 1
                )
            )

        with stepped() as robot:
            judged = moving(robot)
            for ahead in (0, 0, 8, 0, 0, 12, 0, 0, 16, 0, 0, 20, 0, 0):
                always(robot.arm, confirming_late(ahead))
                robot.receive()
            judged.check()

    @pytest.mark.parametrize("leaps_at", [11, 15, 22])
    def test_is_no_word_of_commands_that_were_lost_meanwhile(self, leaps_at):
        """Of one whose counter leaps once: what it received last it says as before."""
        with stepped(mode=CommandMode.TORQUE, first_sequence=3000) as robot:
            judged = pushing(robot)
            wanted = TorqueCommand(torque=np.full(7, 100.0))
            robot.arm.deaf = 10
            for k in range(60):
                if k == leaps_at:
                    once(robot.arm, with_sequence(lambda sequence: sequence + 5000))
                if not robot.receive().holding:
                    robot.send(wanted)
            torques = judged.torques()
            step = np.abs(np.diff(torques, axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()
            assert not torques[-1].any()

    def test_takes_no_commands_before_that_is_over(self):
        with stepped() as robot:
            robot.arm.quality = Quality.POOR
            robot.receive()
            with pytest.raises(BackendError, match=r"nothing may be commanded now: .* is POOR"):
                robot.send(position(POSE))
            robot.arm.quality = Quality.GOOD
            robot.receive()
            robot.send(position(POSE))

    @sampled("packets", [LONGEST, 1, FLICKER + 1], "is doubted for as long")
    @pytest.mark.parametrize("state", LEFT_FOR)
    def test_that_it_ended_and_goes_on_at_once_was_never_left(self, packets, state):
        with stepped() as robot:
            judged = moving(robot)
            robot.arm.obey = lambda: None  # nor is it moved by what it does not say
            real = len(judged.positions())
            robot.arm.state = state
            for _ in range(packets):
                assert robot.receive().holding
            robot.arm.state = ACTIVE
            for _ in range(300):
                assert robot.receive().holding
            path = judged.check()
            assert len(path) > real + 200

    @sampled("packets", [LONGEST, 1, FLICKER + 1], "is doubted for as long")
    @sampled("speed", [1.5, 0.0], "does not change what is believed")
    @pytest.mark.parametrize("state", LEFT_FOR)
    def test_that_it_ended_does_not_let_torques_drop(self, packets, state, speed):
        with stepped(mode=CommandMode.TORQUE) as robot:
            judged = pushing(robot)
            step = speed * robot.spec.limits.velocity * 1e-3  # a torque that stays carries it far
            obey, arm = robot.arm.obey, robot.arm

            def carried():
                obey()
                arm.position = arm.position - step if arm.state is state else arm.position

            arm.obey = carried
            real = len(judged.torques())
            robot.arm.state = state
            for _ in range(packets):
                assert robot.receive().holding
            robot.arm.state = ACTIVE
            for _ in range(60):
                assert robot.receive().holding
            torques = judged.torques()
            step = np.abs(np.diff(torques, axis=0))
            assert (step <= robot.spec.limits.torque_rate * 1e-3 * (1 + ROUNDING)).all()
            assert torques[real - 1].any()
            assert not torques[-1].any()

    @pytest.mark.parametrize("generation", GENERATIONS[:2])
    @pytest.mark.parametrize("state", LEFT_FOR[:2])
    def test_that_it_ended_for_long_goes_on_where_the_arm_was_left(self, state, generation):
        with stepped(generation=generation) as robot:
            judged = moving(robot)
            robot.arm.ipo = np.array(POSE) - 0.5  # where the application would have it
            robot.arm.state = state
            for _ in range(3 * LONGEST):
                robot.receive()
            robot.arm.state = ACTIVE
            left = robot.arm.position.copy()
            for _ in range(10):
                assert robot.receive().holding
            assert judged.commands()[-1].data.joint_position == pytest.approx(left, abs=1e-3)

    def test_that_it_waits_is_answered_once_it_goes_on_doing_so(self):
        with stepped() as robot:
            judged = moving(robot)
            real = len(judged.commands())
            robot.arm.state = SessionState.COMMANDING_WAIT
            for _ in range(LONGEST + 1):
                assert robot.receive().holding
                assert len(judged.commands()) == real
            robot.receive()
            assert len(judged.commands()) == real + 1

    def test_that_it_ended_and_waits_in_order_is_answered_at_once(self):
        with stepped() as robot:
            judged = moving(robot)
            robot.arm.state = SessionState.MONITORING_READY
            for _ in range(FLICKER + 1):
                robot.receive()
            robot.arm.state = SessionState.COMMANDING_WAIT
            robot.receive()
            robot.receive()
            assert judged.commands()[-1].data.joint_position == tuple(robot.arm.ipo)
