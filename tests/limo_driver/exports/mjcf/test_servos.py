"""Drives in an exported MJCF file are those that limo reads out of it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.exports.remainder import unwritten
from limo_driver.physics import (
    PositionServo,
    PreslidingHysteresis,
    Simulation,
    TorqueDrive,
    VelocityServo,
)

ARM = """<mujoco>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".4"/>
      <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .25 0 0" mass=".3"/>
      </body>
    </body>
  </worldbody>
  {actuators}
</mujoco>"""
FOUND = (
    PositionServo(joint=1, kp=17.5, kd=0.8, torque_limit=3.0, delay=0.0145),
    PositionServo(joint=2, kp=16.0, kd=0.6),
)


def exported(tmp_path, actuators):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=actuators))
    simulation = replace(Simulation.load(path), drives=FOUND)
    return limo.export(simulation, "mjcf", tmp_path / "out").file


@sampled(
    "actuators",
    [
        "",
        '<actuator><position joint="shoulder" kp="998" forcerange="-9 9"/></actuator>',
        "<actuator/>",
        '<actuator><general name="s" joint="shoulder" biastype="affine" gainprm="9" '
        'biasprm="0 -9 -1"/></actuator>',
        '<actuator><position joint="shoulder" kp="1"/><position joint="elbow" kp="2"/></actuator>',
    ],
    "writes a file each, and has MuJoCo prove it",
)
def test_the_copy_has_the_drives(tmp_path, actuators):
    file = exported(tmp_path, actuators)

    assert sorted(Simulation.load(file).drives, key=lambda x: x.joint) == list(FOUND)
    assert mujoco.MjModel.from_xml_path(str(file)).nu == 2


def test_drives_that_are_there_already_change_nothing(tmp_path):
    once = exported(tmp_path, "")

    again = limo.export(replace(Simulation.load(once), drives=FOUND), "mjcf", tmp_path / "again")

    assert again.diff == ""


def test_another_kind_of_actuator_is_told(tmp_path):
    with pytest.raises(ConfigError, match=r"joint elbow is moved by <motor>; expected <position>"):
        exported(tmp_path, '<actuator><motor joint="elbow"/></actuator>')


def test_what_an_actuator_has_no_attribute_for_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=""))
    loose = replace(FOUND[0], play=0.02, acceleration=12.0)
    simulation = replace(Simulation.load(path), drives=(loose, FOUND[1]))

    written = limo.export(simulation, "mjcf", tmp_path / "out")
    assert written.unwritten == (
        "play 0.02 rad of the servo of shoulder: no position actuator has it",
        "acceleration 12 rad/s^2 of the servo of shoulder: no position actuator has it",
    )
    simulation = replace(simulation, drives=FOUND)
    assert limo.export(simulation, "mjcf", tmp_path / "plain").unwritten == ()


def test_a_urdf_has_no_numbers_of_drives(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=""))
    mixed = (FOUND[0], VelocityServo(joint=2, kv=3.5))
    for drives, said in (
        ((), ()),
        (FOUND[1:], ("position drives of elbow: this format has no number for them",)),
        (mixed, ("position and velocity drives of shoulder, elbow: this format has no number",)),
    ):
        told = unwritten(replace(Simulation.load(path), drives=drives), "urdf")
        assert len(told) == len(said)
        assert all(line.startswith(start) for line, start in zip(told, said, strict=True))
        assert unwritten(replace(Simulation.load(path), drives=drives), "isaaclab") == ()


TURNING = (
    VelocityServo(joint=1, kv=3.5, torque_limit=3.0, delay=0.0145),
    PositionServo(joint=2, kp=16.0, kd=0.6),
)


@pytest.mark.parametrize(
    "actuators",
    [
        "",
        '<actuator><velocity joint="shoulder" kv="9" forcerange="-9 9"/></actuator>',
        '<actuator><general joint="shoulder" biastype="affine" gainprm="9" biasprm="0 0 -9"/>'
        "</actuator>",
    ],
)
def test_the_copy_has_servos_of_velocity(tmp_path, actuators):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=actuators))

    written = limo.export(replace(Simulation.load(path), drives=TURNING), "mjcf", tmp_path / "out")

    assert sorted(Simulation.load(written.file).drives, key=lambda x: x.joint) == list(TURNING)
    assert written.unwritten == ()


def test_what_an_actuator_of_velocity_has_no_attribute_for_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=""))
    simulation = replace(Simulation.load(path), drives=(replace(TURNING[0], ki=8.0),))

    assert limo.export(simulation, "mjcf", tmp_path / "out").unwritten == (
        "ki 8 N m/rad of the servo of shoulder: no velocity actuator has it",
    )


def test_velocity_beside_another_actuator_is_damping(tmp_path):
    both = '<velocity joint="shoulder" kv="2"/>'
    for other, drives in (
        ('<position joint="shoulder" kp="9" kv="1"/>', (PositionServo(joint=1, kp=9.0, kd=3.0),)),
        ('<motor joint="shoulder"/>', ()),
    ):
        path = tmp_path / "arm.xml"
        path.write_text(ARM.format(actuators=f"<actuator>{other}{both}</actuator>"))
        assert Simulation.load(path).drives == drives


@pytest.mark.parametrize(
    ("kd", "attributes"),
    [(2.7, 'kp="8" kv="0.7"/><velocity joint="shoulder" kv="2"/>'),
     (1.5, 'kp="8" kv="0"/><velocity joint="shoulder" kv="1.5"/>')],
)  # fmt: skip
def test_damping_beside_a_servo_is_not_written_twice(tmp_path, kd, attributes):
    path = tmp_path / "arm.xml"
    beside = '<velocity joint="shoulder" kv="2"/>'
    path.write_text(
        ARM.format(actuators=f'<actuator><position joint="shoulder" kp="9"/>{beside}</actuator>')
    )
    known = Simulation.load(path)
    found = replace(known, drives=(PositionServo(joint=1, kp=8.0, kd=kd),))

    written = limo.export(found, "mjcf", tmp_path / "out")

    assert attributes in written.file.read_text()
    assert Simulation.load(written.file).drives == found.drives
    assert limo.export(known, "mjcf", tmp_path / "same").diff == ""


PUSHED = (
    TorqueDrive(joint=1, gain=2.5, torque_limit=3.0, delay=0.0145),
    TorqueDrive(joint=2, gain=0.9),
)


@pytest.mark.parametrize(
    "actuators",
    [
        "",
        '<actuator><motor joint="shoulder" gear="9" ctrlrange="-1 1"/><motor joint="elbow"/>'
        "</actuator>",
        '<actuator><general joint="shoulder" gear="2" gainprm="4" ctrlrange="-.1 .1"/></actuator>',
    ],
)
def test_the_copy_has_drives_that_are_told_torques(tmp_path, actuators):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=actuators))
    found = replace(Simulation.load(path), drives=PUSHED)

    written = limo.export(found, "mjcf", tmp_path / "out")

    back = Simulation.load(written.file)
    assert back.drives == ()  # motors by themselves are none
    assert back.with_motors(("command_torque",) * 2).drives == PUSHED
    assert written.unwritten == ()
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(written.file)))
    for command, torque in (((0.4, 2.0), (1.0, 1.8)), ((50.0, 2.0), (3.0, 1.8))):
        data.ctrl[:] = np.array(command)[model.actuator_trnid[:, 0]]
        mujoco.mj_step(model, data, 200)
        assert data.qfrc_actuator == pytest.approx(torque)


@pytest.mark.parametrize(
    ("timestep", "delay", "steps"),
    [(0.002, 0.0145, 8), (0.002, 0.014, 7), (0.003, 0.009, 3), (0.01, 0.07, 7), (0.01, 0.004, 1)],
)
def test_torque_of_plain_mujoco_comes_as_late_as_that_of_the_drive(
    tmp_path, timestep, delay, steps
):
    """Delays are whole steps there, the next above, and the same in each of them."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=f'<option timestep="{timestep}" gravity="0 0 0"/>'))
    late = TorqueDrive(joint=1, gain=1.0, delay=delay)
    found = replace(Simulation.load(path), drives=(late,))
    written = limo.export(found, "mjcf", tmp_path / "out")
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(written.file)))
    told, felt = (1e-6 * np.arange(1000)).tolist(), []  # [N m]
    for torque in told:
        data.ctrl[0] = torque
        mujoco.mj_step(model, data)
        felt.append(float(data.actuator_force[0]))
    assert felt == [0.0] * steps + told[:-steps]


@pytest.mark.parametrize(
    ("actuators", "gain", "limit"),
    [
        ('<motor joint="shoulder" gear="9" ctrlrange="-2 2"/>', 9.0, 18.0),
        ('<motor joint="shoulder" gear="9" ctrlrange="-2 2" forcerange="-1 1"/>', 9.0, 9.0),
        ('<general joint="shoulder" gear="3" gainprm="4"/>', 12.0, None),
    ],
)
def test_gears_and_limits_of_motors_are_read(tmp_path, actuators, gain, limit):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=f"<actuator>{actuators}</actuator>"))

    (drive,) = Simulation.load(path).with_motors(("command_torque",) * 2).drives

    assert drive == TorqueDrive(joint=1, gain=gain, torque_limit=limit)


@pytest.mark.parametrize(
    "actuators",
    [
        '<motor joint="shoulder" gear="-1"/>',
        '<motor joint="shoulder"/><velocity joint="shoulder" kv="2"/>',
        '<general joint="shoulder" dyntype="integrator"/>',
    ],
)
def test_what_is_no_motor_alone_is_none(tmp_path, actuators):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=f"<actuator>{actuators}</actuator>"))

    assert Simulation.load(path).with_motors(("command_torque",) * 2).drives == ()


def test_a_motor_is_no_place_for_a_position_servo(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators='<actuator><position joint="elbow"/></actuator>'))
    simulation = replace(Simulation.load(path), drives=(PUSHED[1],))
    with pytest.raises(ConfigError, match="joint elbow is moved by <position>; expected <motor>"):
        limo.export(simulation, "mjcf", tmp_path / "out")


@pytest.mark.parametrize("limit", [None, 3.0])
@pytest.mark.parametrize("motor", ["", '<motor joint="shoulder" gear="9" ctrlrange="-1 1"/>'])
def test_a_drive_beside_bristles_is_read_and_written_again(tmp_path, motor, limit):
    """A motor without input, which is friction, has no control: others' are counted without it."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(actuators=f"<actuator>{motor}</actuator>" if motor else ""))
    bristles = PreslidingHysteresis(joint=1, law="lugre", sigma_0=100.0, tau_c=0.5)
    drive = TorqueDrive(joint=1, gain=2.5, torque_limit=limit)
    found = replace(Simulation.load(path), drives=(drive,), effects=(bristles,))
    once = limo.export(found, "mjcf", tmp_path / "once").file

    back = Simulation.load(once)
    assert back.effects == (bristles,)
    assert back.with_motors(("command_torque",) * 2).drives == (drive,)
    assert limo.export(replace(back, drives=(drive,)), "mjcf", tmp_path / "again").diff == ""

    servo = PositionServo(joint=2, kp=9.0, kd=1.0)
    moved = replace(back, drives=(servo,))
    assert Simulation.load(limo.export(moved, "mjcf", tmp_path / "moved").file).drives == (servo,)


@pytest.mark.parametrize(
    ("limits", "written"),
    [
        ("", 'gear="2.5"'),
        ('ctrlrange="-1 1"', 'gear="2.5" ctrlrange="-1 1" ctrllimited="false"'),
        ('forcerange="-1 1"', 'gear="2.5" forcerange="-1 1" forcelimited="false"'),
    ],
)
def test_a_drive_without_a_limit_takes_away_what_the_file_limits_alone(tmp_path, limits, written):
    path = tmp_path / "arm.xml"
    motor = f'<motor joint="shoulder" gear="9" {limits}/>'.replace(" /", "/")
    path.write_text(ARM.format(actuators=f"<actuator>{motor}</actuator>"))
    free = TorqueDrive(joint=1, gain=2.5)
    found = replace(Simulation.load(path), drives=(free,))
    once = limo.export(found, "mjcf", tmp_path / "once").file
    assert f'<motor joint="shoulder" {written}/>' in once.read_text()

    bound = replace(free, torque_limit=5.0)
    again = replace(Simulation.load(once), drives=(bound,))
    back = Simulation.load(limo.export(again, "mjcf", tmp_path / "again").file)
    assert back.with_motors(("command_torque",) * 2).drives == (bound,)
