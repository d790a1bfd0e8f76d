"""A gripper that a log has is locked where it was, and stays there in all that follows."""

import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.errors import ConfigError

LINK = (
    '<link name="{}"><inertial><origin xyz="0 0 {}"/><mass value="{}"/><inertia ixx=".02" ixy="0" '
    'ixz="0" iyy=".02" iyz="0" izz=".01"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="0 0 .3"/>'
    '<axis xyz="{}"/><limit lower="{}" upper="{}" effort="80" velocity="2"/>{}</joint>'
)
LINKS = (
    ("base", 0, 1),
    ("cart", 0, 3),
    ("upper", 0.2, 2),
    ("lower", 0.2, 1),
    ("a", 0, 0.1),
    ("b", 0, 0.1),
)
JOINTS = (
    ("lift", "prismatic", "base", "cart", "0 0 1", 0, 0.6, ""),
    ("shoulder", "revolute", "cart", "upper", "0 1 0", -2, 2, ""),
    ("elbow", "revolute", "upper", "lower", "0 1 0", -2, 2, ""),
    ("jaw", "prismatic", "lower", "a", "0 1 0", 0, 0.04, ""),
    ("other_jaw", "prismatic", "lower", "b", "0 -1 0", 0, 0.04, '<mimic joint="jaw"/>'),
)
NAMES = ("lift", "shoulder", "elbow")


@pytest.fixture
def robot(tmp_path):
    parts = [LINK.format(*own) for own in LINKS] + [JOINT.format(*own) for own in JOINTS]
    path = tmp_path / "gripping.urdf"
    path.write_text(f'<robot name="gripping">{"".join(parts)}</robot>', encoding="utf-8")
    return str(path)


def log_of(robot, jaw=0.03, velocity=(1, 1, 1), **more):
    model = limo.RobotModel.load(robot)
    time = np.arange(0, 12, 0.005)
    rate = 2 * np.pi * np.array([0.11, 0.13, 0.21])
    phase = np.outer(time, rate) + np.arange(3)
    reach = np.array([0.2, 1.2, 1.2])
    q = np.array([0.3, 0, 0]) + reach * np.sin(phase)
    v, a = reach * rate * np.cos(phase), -reach * rate**2 * np.sin(phase)
    torque = model.inverse_dynamics(q, v, a) + [8, 1, 1] * np.tanh(v / 0.005)
    log = {"t": time}
    for j, name in enumerate(NAMES):
        unit = "m" if name == "lift" else "rad"
        log |= {f"{name}_pos [{unit}]": q[:, j], f"{name}_vel": v[:, j] * velocity[j]}
        log[f"{name}_effort"] = torque[:, j]
    return log | {"jaw_pos": jaw + 0 * time} | more


def test_a_gripper_is_locked_where_a_log_has_it_and_its_other_finger_with_it(robot):
    found = limo.inspect(log_of(robot), robot)
    assert found.proposal.model.description.locked == {"jaw": 0.03, "other_jaw": 0.03}
    assert any("locked where the log has them: jaw at 0.03" in note for note in found.notes())


@pytest.mark.parametrize("chosen", ["#shoulder,lift,elbow", "#lift,[se]*"])
def test_joints_that_are_chosen_leave_its_place_to_the_log(robot, chosen):
    recording = limo.read(log_of(robot), robot + chosen)
    assert recording.n == 3
    assert recording.robot.endswith("jaw=0.03")


def test_a_place_that_is_stated_stays(robot):
    found = limo.inspect(log_of(robot), f"{robot}#jaw=0.01")
    assert found.proposal.model.description.locked["jaw"] == 0.01


@sampled("jaw", [0.9, np.nan, 30.0], "inspects a log each")
def test_a_gripper_in_another_or_no_unit_is_locked_as_near_to_zero_as_it_can_be(robot, jaw):
    found = limo.inspect(log_of(robot, jaw), robot)
    assert found.proposal.model.description.locked["jaw"] == 0.0


def test_a_gripper_in_a_stated_unit_is_locked_there(robot):
    log = {name.replace("jaw_pos", "jaw_pos [mm]"): x for name, x in log_of(robot, 30.0).items()}
    assert limo.inspect(log, robot).proposal.model.description.locked["jaw"] == 0.03


@pytest.mark.slow("identifies and diagnoses an arm")
def test_identification_and_diagnosis_keep_its_place(robot, tmp_path):
    log = log_of(robot)
    found = limo.inspect(log, robot)
    found.mapping.save(tmp_path / "mapping.yaml")
    for mapping in (None, tmp_path / "mapping.yaml"):
        recording = limo.read(log, robot, mapping)
        assert recording.robot.endswith("jaw=0.03")
        for sim in (limo.nominal(robot, recording), limo.identify(robot, recording).simulation):
            assert sim.model.description.locked == {"jaw": 0.03, "other_jaw": 0.03}
        stated = limo.nominal(f"{robot}#jaw=0.02", recording)
        assert stated.model.description.locked["jaw"] == 0.02


def test_a_slide_has_metres_and_newtons(robot):
    units = {item.quantity: item.unit for item in limo.inspect(log_of(robot), robot).proposal.taken}
    assert units == {
        "time": "s",
        "position": "m, rad",
        "torque": "N, N m",
        "velocity": "m/s, rad/s",
    }


def test_velocities_of_a_slide_have_a_unit_of_their_own(robot):
    found = limo.inspect(log_of(robot, velocity=(1e3, 1, 1)), robot)
    assert found.mapping.velocity.unit == ("mm/s", "rad/s", "rad/s")
    assert not any("rate of change" in note for note in found.notes())
    odd = limo.inspect(log_of(robot, velocity=(40, 1, 1)), robot)
    assert any("velocity_1 is 40 times" in note for note in odd.notes())


def test_steps_of_a_slide_are_in_metres(robot):
    log = log_of(robot)
    log["lift_pos [m]"] = np.round(log["lift_pos [m]"], 3)
    log["elbow_pos [rad]"] = np.round(log["elbow_pos [rad]"], 2)
    found = limo.inspect(log, robot)
    said = "position comes in steps of 0.001 m (joint 1), 0.01 rad (joint 3)"
    assert any(line.startswith(said) for line in found.telemetry)


FINGER = '<geom type="box" size=".01 .01 .03" mass=".1"/>'
LIMB = '<geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/>'


@pytest.fixture
def pincers(tmp_path):
    path = tmp_path / "pincers.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="upper">'
        f'<joint name="yaw" axis="0 1 0" range="-2 2"/>{LIMB}<body name="lower" pos="0 0 .3">'
        f'<joint name="tilt" axis="0 1 0" range="-2 2"/>{LIMB}'
        f'<body><joint name="l" type="slide" axis="0 1 0" range="0 .04"/>{FINGER}</body>'
        f'<body><joint name="r" type="slide" axis="0 -1 0" range="0 .04"/>{FINGER}</body>'
        '</body></body></worldbody><equality><joint joint1="l" joint2="r"/></equality></mujoco>',
        encoding="utf-8",
    )
    return path


@pytest.mark.slow("reads a log twice")
def test_coupled_fingers_that_move_in_a_log_of_the_whole_model_are_locked_in_the_middle(pincers):
    time = np.arange(0, 12, 0.005)
    phase = np.outer(time, [0.9, 1.3]) + np.arange(2)
    jaw = np.linspace(0, 0.04, time.size)
    q = np.column_stack([np.sin(phase), jaw, jaw])
    torque = limo.RobotModel.load(pincers).gravity_torque(np.sin(phase))
    force = np.column_stack([torque, 0 * jaw, 0 * jaw])
    log = {"time": time, "qpos": q, "qfrc_actuator": force}
    found = limo.inspect(log, pincers)
    assert found.proposal.model.description.locked == pytest.approx({"l": 0.02, "r": 0.02})
    notes = " ".join(found.notes())
    assert "locked where the log has them: r at 0.02" in notes
    assert "<mimic>" not in notes
    assert limo.nominal(pincers, limo.read(log, pincers)).model.description.locked["r"] == 0.02


def test_a_robot_is_given_to_a_simulation_by_its_name(robot):
    with pytest.raises(ConfigError, match=r"`robot` is a RobotModel, expected its name or path"):
        limo.Simulation(limo.RobotModel.load(robot))
