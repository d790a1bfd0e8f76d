"""The player of commands: at their times, with what was in force when encoders were read."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

import limo_driver as limo

PLAYER = run_path(str(Path(__file__).parents[2] / "examples" / "play_servos.py"))
TIME = np.arange(0.0, 4.0, 0.02)
ARM = """<mujoco><option timestep="0.002"/><worldbody>
  <body><joint name="turn" axis="0 0 1" damping="1" armature=".02"/><geom size=".05" mass="1"/>
    <body pos="0 0 .1"><joint name="lift" axis="0 1 0" damping="1" armature=".02"/>
      <geom size=".05" mass=".1"/></body>
  </body></worldbody>
  <actuator><position joint="lift" kp="40"/><position joint="turn" kp="40"/></actuator>
</mujoco>"""  # whose actuators stand in another order
COMMANDS = np.column_stack([TIME, 0.3 * np.sin(TIME), 0.5 * np.cos(TIME)])


class Arm:
    """An arm that is where it was told to be, and a clock that it moves."""

    def __init__(self):
        self.position, self.time, self.sent = np.array([1.0, -1.0]), 0.0, []

    def send(self, goal):
        self.sent.append(np.array(goal))
        self.position = np.array(goal)

    def read(self):
        self.time += 0.003
        return self.position

    def sleep(self, seconds):
        self.time += seconds


@pytest.fixture
def played():
    arm = Arm()
    rows = PLAYER["play"](COMMANDS, arm.send, arm.read, lambda: arm.time, arm.sleep)
    return arm, rows


def test_rows_are_sent_at_their_times(played):
    arm, rows = played
    np.testing.assert_allclose(rows[:, 0], TIME, atol=0.004)
    np.testing.assert_allclose(arm.sent[-len(TIME) :], COMMANDS[:, 1:])


def test_the_command_beside_a_position_is_in_force_from_there_on(played):
    _, rows = played
    np.testing.assert_allclose(rows[:, 1:3], COMMANDS[:, 1:], atol=1e-12)
    np.testing.assert_allclose(rows[1:, 3:], rows[:-1, 1:3])  # where the goal before led it


def test_the_arm_is_led_to_the_first_pose(played):
    arm, _ = played
    approach = np.array(arm.sent[: -len(TIME)])
    assert np.abs(np.diff(approach, axis=0)).max() < 0.02
    np.testing.assert_allclose(approach[-1], COMMANDS[0, 1:], atol=1e-12)


def test_motors_are_counted_as_lerobot_does():
    low, high = PLAYER["GRIPPER"]
    assert PLAYER["counted"]("gripper", (low + high) / 2) == pytest.approx(50.0)
    assert PLAYER["counted"]("elbow_flex", np.pi / 2) == pytest.approx(90.0)
    for name in ("gripper", "elbow_flex"):
        assert PLAYER["in_rad"](name, PLAYER["counted"](name, 0.7)) == pytest.approx(0.7)


def test_a_simulated_arm_is_moved_by_its_own_actuators(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    arm = PLAYER["SimulatedArm"](str(tmp_path / "arm.xml"))
    rows = PLAYER["play"](COMMANDS, arm.send, arm.read, arm.now, arm.sleep)
    np.testing.assert_allclose(rows[:, 0], TIME, atol=0.002)
    lag = np.abs(rows[:, 3:] - rows[:, 1:3]).max(axis=0)
    assert np.all((lag > 1e-3) & (lag < 0.1))


def test_what_is_saved_is_a_recording(played, tmp_path):
    PLAYER["save"](played[1], tmp_path / "run.csv")
    recording = limo.read(tmp_path / "run.csv")
    assert recording.command.shape == (len(TIME), 2)
    assert not recording.has_torque
