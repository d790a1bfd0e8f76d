"""What the simulated controller makes of answers, and how its arm moves: no network, no clock."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from backends.fri.codec.messages import CommandData, CommandMode, ControlMode
from backends.fri.simulator.arm import Compliance, ControlledArm, SetpointPath
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.judge import CommandJudge, CommandLimits, Wanted
from backends.fri.simulator.report import REMEMBERED, Arrival, Ledger
from backends.fri.simulator.session import POSE, ControllerSettings, quaternion
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000
POSE_ARRAY = np.array(POSE)
ARM = RobotModel.load("iiwa14")


def answered(ledger: Ledger, reflected: int, sequence: int = 0) -> Arrival:
    return ledger.receive(sequence, reflected, 10**12)


def one_each_period(period: int = 2 * MS) -> Ledger:
    return Ledger(multiplier=1, late_ns=MS, period_ns=period)


def counts(ledger: Ledger) -> tuple[int, int, int, int]:
    assert ledger.expected == ledger.in_time + ledger.late + ledger.lost
    return ledger.expected, ledger.in_time, ledger.late, ledger.lost


def test_answers_are_in_time_late_repeated_or_unknown() -> None:
    ledger = one_each_period()
    ledger.send(0, expects_answer=True)
    assert ledger.receive(0, 0, MS // 2) is Arrival.IN_TIME
    assert ledger.receive(1, 0, MS) is Arrival.REPEATED
    assert ledger.receive(2, 1, MS) is Arrival.UNKNOWN
    assert ledger.judge(MS) == [True]
    for k in (1, 2):
        ledger.send(2 * k * MS, expects_answer=True)
        assert ledger.judge(2 * (k + 1) * MS) == [False]
    ledger.send(6 * MS, expects_answer=True)
    assert ledger.receive(3, 1, 7 * MS) is Arrival.LATE
    assert ledger.receive(4, 3, 7 * MS) is Arrival.IN_TIME
    assert ledger.judge(8 * MS) == [True]
    assert counts(ledger) == (4, 2, 1, 1)
    assert (ledger.slow, ledger.repeated, ledger.unknown) == (1, 1, 1)


def test_a_controller_that_wakes_up_late_gives_the_client_no_less_time() -> None:
    """Sent 1.5 ms late: the next wake is half a millisecond later, and says nothing yet."""
    ledger = one_each_period()
    ledger.send(3 * MS // 2, expects_answer=True)
    assert ledger.close_interval()
    assert ledger.judge(2 * MS) == []
    ledger.send(2 * MS, expects_answer=True)
    assert ledger.receive(0, 0, 3 * MS) is Arrival.IN_TIME
    assert ledger.judge(4 * MS) == [True, False]
    assert counts(ledger) == (2, 1, 0, 1)


def test_a_controller_that_reads_late_does_not_make_late_answers_come_in_time() -> None:
    ledger = one_each_period()
    ledger.send(0, expects_answer=True)
    assert ledger.receive(0, 0, 2 * MS + 1) is Arrival.LATE
    assert ledger.judge(10 * MS) == [False]
    assert counts(ledger) == (1, 0, 1, 0)


def test_what_is_lost_does_not_hide_behind_what_comes_late_or_twice() -> None:
    ledger = one_each_period()
    for k in range(6):
        ledger.send(2 * k * MS, expects_answer=True)
        if k != 3:
            ledger.receive(k, k, 2 * k * MS + MS)
        ledger.judge(2 * (k + 1) * MS)
        ledger.receive(k, 0, 2 * k * MS + MS)  # again and again
    assert counts(ledger) == (6, 5, 0, 1)


def test_one_answer_is_expected_in_each_receive_interval() -> None:
    ledger = Ledger(multiplier=3, period_ns=MS)
    for number in range(9):
        assert ledger.close_interval() == (number in {3, 6})
        assert ledger.judge(number * MS) == ([True] if number in {3, 6} else [])
        ledger.send(number * MS, expects_answer=True)
        if number % 3 == 1:  # a client may count from any packet
            answer = ledger.receive(number // 3, number, number * MS + 1)
            assert answer is Arrival.IN_TIME
    assert ledger.judge(9 * MS) == [True]
    assert counts(ledger) == (3, 3, 0, 0)
    assert ledger.gaps == 0


def test_packets_before_the_first_answer_are_not_lost_but_unheard() -> None:
    ledger = one_each_period()
    for k in range(5):
        ledger.send(2 * k * MS, expects_answer=True)
    ledger.judge(10 * MS)
    assert (ledger.unheard, *counts(ledger)) == (5, 0, 0, 0, 0)


def test_the_clients_own_counter_tells_gaps_and_restarts() -> None:
    ledger = Ledger(multiplier=1)
    for sequence in (0, 1, 4, 0, 1):
        ledger.send(0, expects_answer=True)
        answered(ledger, ledger.sent - 1, sequence)
    assert (ledger.gaps, ledger.restarts) == (2, 1)


def test_packets_of_long_ago_and_of_the_end_are_not_to_be_answered() -> None:
    ledger = Ledger(multiplier=1)
    for _ in range(REMEMBERED + 1):
        ledger.send(0, expects_answer=True)
    assert answered(ledger, 0) is Arrival.UNKNOWN
    ledger.send(0, expects_answer=False)
    assert answered(ledger, ledger.sent - 1) is Arrival.REPEATED


def test_counters_wrap() -> None:
    ledger = Ledger(multiplier=1, sent=(1 << 32) - 1)
    for reflected, sequence in (((1 << 32) - 1, (1 << 32) - 1), (0, 0)):
        assert ledger.next_sequence == reflected
        ledger.send(0, expects_answer=True)
        assert ledger.receive(sequence, reflected, 0) is Arrival.IN_TIME
        assert ledger.judge(0) == [True]
    assert (ledger.restarts, ledger.gaps) == (0, 0)


def judge(mode: CommandMode = CommandMode.POSITION) -> CommandJudge:
    return CommandJudge(mode, ARM.limits, CommandLimits(), interval=2e-3)


SEVEN, SIX = (0.1,) * 7, (0.1,) * 6


@pytest.mark.parametrize(
    ("mode", "data", "complaint"),
    [
        (CommandMode.POSITION, None, "without data"),
        (CommandMode.POSITION, CommandData(), "without position"),
        (CommandMode.POSITION, CommandData(joint_position=(0.0,) * 6), "6 values, expected 7"),
        (CommandMode.POSITION, CommandData(joint_position=(math.nan,) * 7), "not finite"),
        (CommandMode.TORQUE, CommandData(joint_position=SEVEN), "without torque in torque mode"),
        (CommandMode.WRENCH, CommandData(joint_position=SEVEN), "without wrench in wrench mode"),
        (CommandMode.WRENCH, CommandData(wrench=(math.inf,) * 6), "not finite"),
        (CommandMode.POSITION, CommandData(SEVEN, joint_torque=SEVEN), "with torque in position"),
        (CommandMode.TORQUE, CommandData(SEVEN, wrench=SIX, joint_torque=SEVEN), "with wrench in"),
    ],
)
def test_what_cannot_be_read_is_left_out(
    mode: CommandMode, data: CommandData | None, complaint: str
) -> None:
    assert complaint in judge(mode).read(data)[1]


@pytest.mark.parametrize(
    ("mode", "data"),
    [
        (CommandMode.POSITION, CommandData(joint_position=SEVEN)),
        (CommandMode.POSITION, CommandData(joint_position=SEVEN, joint_torque=(0.0,) * 7)),
        (CommandMode.TORQUE, CommandData(joint_position=SEVEN, joint_torque=SEVEN)),
        (CommandMode.TORQUE, CommandData(joint_torque=SEVEN)),
        (CommandMode.WRENCH, CommandData(joint_position=SEVEN, wrench=SIX)),
    ],
)
def test_what_can_be_read(mode: CommandMode, data: CommandData) -> None:
    wanted, complaint = judge(mode).read(data)
    assert complaint == ""
    assert wanted.wrench is None or wanted.wrench.tolist() == list(SIX)


def test_a_step_is_as_long_as_the_velocity_limit_allows() -> None:
    most = ARM.limits.velocity[1] * 2e-3
    step = np.zeros(7)
    step[1] = 0.999 * most
    assert judge().stops(Wanted(POSE_ARRAY + step), POSE_ARRAY, 1) == ""
    assert "illegal axis delta: joint 2" in judge().stops(
        Wanted(POSE_ARRAY + 1.01 * step), POSE_ARRAY, 1
    )
    assert judge().stops(Wanted(POSE_ARRAY + 3 * step), POSE_ARRAY, 3) == ""  # two were lost
    assert judge().stops(Wanted(POSE_ARRAY + 11 * step), POSE_ARRAY, 100)


def test_ranges_torques_and_wrenches_are_limited() -> None:
    edge = np.array(ARM.limits.position_max)
    assert judge().stops(Wanted(edge), edge, 1) == ""
    assert "joint 1 is told to go to" in judge().stops(Wanted(edge + 1e-4), edge, 1)
    torque = np.zeros(7)
    torque[6] = -41.0
    assert "joint 7 is told -41 N m, at most 40" in judge().stops(Wanted(torque=torque), edge, 1)
    wrench = np.array([0.0, 0.0, 0.0, 51.0, 0.0, 0.0])
    assert "wrench component 4 is told 51" in judge().stops(Wanted(wrench=wrench), edge, 1)


def test_in_commanding_wait_the_ipo_position_is_mirrored() -> None:
    assert judge().confirms(Wanted(POSE_ARRAY), POSE_ARRAY) == ""
    off = POSE_ARRAY.copy()
    off[3] += 0.011
    assert "joint 4 has to mirror" in judge().confirms(Wanted(off), POSE_ARRAY)


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_the_set_point_reaches_a_command_without_steps_of_velocity(steps: int) -> None:
    path = SetpointPath(np.zeros(7), np.full(7, 5.0), steps)
    told = [path.follow(np.full(7, 1e-3 * steps * min(k, 20)), steps) for k in range(60)]
    positions = np.concatenate([np.zeros((1, 7)), *told])
    velocity = np.diff(positions, axis=0) / 1e-3
    assert path.position == pytest.approx(np.full(7, 0.02 * steps))
    assert path.velocity == pytest.approx(np.zeros(7), abs=1e-9)
    assert np.abs(velocity).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(velocity, axis=0)).max() <= 1.0 / steps + 1e-9


@pytest.mark.parametrize("steps", [1, 5])
def test_one_lost_command_is_bridged_and_more_lead_to_rest_on_the_last(steps: int) -> None:
    def told(lost: set[int]) -> np.ndarray:
        path = SetpointPath(np.zeros(7), np.full(7, 5.0), steps)
        commands = (None if k in lost else np.full(7, 1e-3 * k) for k in range(40))
        return np.concatenate([path.follow(command, steps) for command in commands])

    assert told({20}) == pytest.approx(told(set()))
    many = told(set(range(20, 60)))
    assert many[-1] == pytest.approx(np.full(7, 0.019))
    assert np.abs(np.diff(many[-5:], axis=0)).max() == 0.0


def test_what_moves_brakes_within_its_acceleration_and_then_follows_the_program() -> None:
    path = SetpointPath(np.zeros(7), np.full(7, 5.0), 2)
    for k in range(1, 50):
        path.follow(np.full(7, 1e-3 * k), 2)
    speed = path.velocity[0]
    assert speed == pytest.approx(0.5)
    path.rest_at(path.position, path.velocity)
    told = np.concatenate([path.rest(np.zeros(7), 2) for _ in range(100)])
    velocity = np.diff(told[:, 0]) / 1e-3
    assert np.diff(velocity).min() >= -5.0 * 1e-3 - 1e-9
    assert velocity[-1] == 0.0
    stood = path.position.copy()
    assert path.rest(np.full(7, 1e-4), 2)[-1] == pytest.approx(stood + 1e-4)
    assert path.rest(np.zeros(7), 2)[-1] == pytest.approx(stood)


@pytest.fixture(scope="module")
def arm() -> ControlledArm:
    return ControlledArm(None, Compliance(), POSE)


def moved(arm: ControlledArm, **command: np.ndarray) -> np.ndarray:
    for _ in range(300):
        state = arm.advance(np.repeat(POSE_ARRAY[None], 10, axis=0), **command)
    assert np.abs(state.velocity).max() < 1e-3
    return state.position - POSE_ARRAY


def test_commands_move_the_arm_as_their_control_says(arm: ControlledArm) -> None:
    own = Compliance()
    arm.take_control(ControlMode.POSITION, POSE_ARRAY)
    assert np.abs(moved(arm)).max() < 1e-6
    arm.take_control(ControlMode.JOINT_IMPEDANCE, POSE_ARRAY)
    torque = np.zeros(7)
    torque[0] = 5.0
    assert moved(arm, torque=torque)[0] == pytest.approx(5.0 / own.joint[0], rel=0.01)
    arm.take_control(ControlMode.POSITION, POSE_ARRAY)
    moved(arm)
    arm.take_control(ControlMode.CARTESIAN_IMPEDANCE, POSE_ARRAY)
    force = np.array([0.0, 10.0, 0.0, 0.0, 0.0, 0.0])
    before = arm.nominal.flange_pose(POSE_ARRAY)[:3, 3]
    after = arm.nominal.flange_pose(POSE_ARRAY + moved(arm, wrench=force))[:3, 3]
    assert after - before == pytest.approx([0.0, 10.0 / own.translation, 0.0], abs=1e-4)
    arm.take_control(ControlMode.POSITION, POSE_ARRAY)


def test_external_torque_is_measured_minus_the_robots_own_model() -> None:
    arm = ControlledArm(None, Compliance(), POSE)
    push = np.zeros(7)
    push[1] = 12.0
    arm.push(push)
    for _ in range(100):
        state = arm.advance(np.repeat(POSE_ARRAY[None], 10, axis=0))
    assert state.external_torque == pytest.approx(-push, abs=0.05)
    assert state.torque - state.model_torque == pytest.approx(state.external_torque)


PENDULUM = """<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="10"/></joint></robot>"""


def test_fri_is_for_seven_joints(tmp_path: Path) -> None:
    urdf = tmp_path / "pendulum.urdf"
    urdf.write_text(PENDULUM, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"FRI is for arms with 7 joints; .* has 1"):
        ControlledArm(Simulation(robot=str(urdf)), Compliance(), POSE)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, math.pi, -3.0])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 3)])
def test_a_quaternion_is_that_of_its_matrix(axis: tuple[float, ...], angle: float) -> None:
    n = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    R = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    w, *v = quaternion(R)
    expected = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * n)])
    assert abs(np.dot(expected, [w, *v])) == pytest.approx(1.0)
    assert w >= 0


@pytest.mark.parametrize(
    ("mode", "period", "multiplier", "allowed"),
    [
        (CommandMode.POSITION, 10, 1, True),
        (CommandMode.POSITION, 2, 6, False),
        (CommandMode.TORQUE, 5, 1, True),
        (CommandMode.TORQUE, 3, 2, False),
        (CommandMode.WRENCH, 10, 1, False),
    ],
)
def test_commanding_needs_short_receive_intervals(
    mode: CommandMode, period: int, multiplier: int, *, allowed: bool
) -> None:
    settings = ControllerSettings(
        Address("127.0.0.1", 30200), mode=mode, period_ms=period, multiplier=multiplier
    )
    assert bool(settings.monitoring_only) != allowed


def test_an_address_may_leave_its_port_open_where_one_is_known() -> None:
    assert Address.parse("127.0.0.2", "--bind", port=0) == ("127.0.0.2", 0)
    assert Address.parse("127.0.0.2:30200", "--bind", port=0) == ("127.0.0.2", 30200)
    for text in ("127.0.0.2", "127.0.0.2:", ":30200", "127.0.0.2:x", "127.0.0.2:-1"):
        with pytest.raises(ConfigError, match=r"--client .* is no HOST:PORT"):
            Address.parse(text, "--client")
