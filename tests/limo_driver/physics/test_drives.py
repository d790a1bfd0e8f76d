"""Drives in a sim.yaml, and as an MJCF states them."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from limo_driver.errors import ConfigError, ParameterError
from limo_driver.physics import DcMotor, PositionServo, Simulation

MJCF = """<mujoco>
  <worldbody><body><joint name="lift" axis="0 1 0"/><geom type="capsule" size=".02"
    fromto="0 0 0 .3 0 0"/></body></worldbody>
  <actuator>{}</actuator>
</mujoco>"""
SERVO = '<position joint="lift" kp="17.8" kv="0.6" forcerange="-3 3"/>'
DRIVES = (
    PositionServo(joint=1, kp=20.0, kd=0.5, delay=0.02, speed=3.0, torque_limit=2.0),
    DcMotor(joint=1, kt=0.01, resistance=2.0, supply=12.0, gear=345.0),
)


@pytest.fixture
def described(tmp_path):
    """Return the simulation that an MJCF with some actuators is."""

    def simulation(actuators):
        path = tmp_path / "arm.xml"
        path.write_text(MJCF.format(actuators))
        return Simulation.load(path)

    return simulation


def test_position_actuators_of_an_mjcf_are_drives(described):
    assert described(SERVO).drives == (PositionServo(joint=1, kp=17.8, kd=0.6, torque_limit=3.0),)


def test_other_actuators_are_not(described):
    assert described('<motor joint="lift"/><velocity joint="lift" kv="2"/>').drives == ()


def test_drives_come_back_from_a_file(described, tmp_path):
    simulation = Simulation(described("").robot, drives=DRIVES)
    simulation.save(tmp_path / "sim.yaml")

    assert Simulation.load(tmp_path / "sim.yaml").drives == DRIVES


def test_each_parameter_of_a_servo_may_have_its_tolerance(described, tmp_path):
    servo = replace(DRIVES[0], tolerances={"kp": 0.05, "delay": 0.5})
    simulation = Simulation(described("").robot, drives=(servo,))
    simulation.save(tmp_path / "sim.yaml")

    assert "tolerances: {kp: 0.05, delay: 0.5}" in (tmp_path / "sim.yaml").read_text()
    assert Simulation.load(tmp_path / "sim.yaml").drives == (servo,)


def test_drives_that_changed_are_told(described):
    before = Simulation(described("").robot, drives=DRIVES)
    servo = replace(DRIVES[0], kp=12.5)
    after = replace(before, drives=(servo, *DRIVES[1:]))

    said = after.changes_from(before)

    assert "drive: position_servo" in said
    assert "kp: 12.5" in said
    assert "dc_motor" not in said
    assert before.changes_from(before) == ""


def test_a_motor_is_given_other_limits():
    motor = DcMotor(joint=1, kt=0.01, resistance=2.0, supply=6.0, gear=345.0).limited(2.5, 1.2)
    assert (motor.stall, motor.free_speed) == pytest.approx((2.5, 1.2))
    assert (motor.supply, motor.gear) == (6.0, 345.0)


def test_a_file_without_drives_has_those_of_its_robot(described, tmp_path):
    described(SERVO)
    (tmp_path / "sim.yaml").write_text("robot: arm.xml\n")

    assert Simulation.load(tmp_path / "sim.yaml").drives[0].joint == 1


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            "{drive: servo, joint: 1}",
            "drive is 'servo', expected one of position_servo, velocity_servo, torque_drive, "
            "dc_motor",
        ),
        ("{drive: position_servo, joint: 1}", "lacks kp"),
        ("{drive: position_servo, joint: 2, kp: 1}", "joint is 2, expected a joint from 1 to 1"),
        ("{drive: position_servo, joint: 1, kp: -1}", "kp is -1"),
        ("{drive: position_servo, joint: 1, kp: 1, delay: 20}", "delay is 20"),
        (
            "{drive: position_servo, joint: 1, kp: 1, tolerances: {kb: 0.1}}",
            "tolerances is 'kb', expected parameters of kp, kd",
        ),
        (
            "{drive: position_servo, joint: 1, kp: 1, tolerances: {kp: 0}}",
            "kp is 0, expected a number above 0",
        ),
        (
            "{drive: dc_motor, joint: 1, kt: 1, resistance: 1, supply: 1, gear: 1, "
            "tolerances: {stall: 1}}",
            "tolerances is 'stall', expected parameters of kt, resistance, supply, gear",
        ),
        (
            "{drive: position_servo, joint: 1, kp: 1, tolerances: {torque_limit: 0.1}}",
            "tolerances is 'torque_limit', expected parameters that are stated: torque_limit is",
        ),
        (
            "{drive: velocity_servo, joint: 1, kv: 1, tolerances: {delay: 0.1}}",
            "tolerances is 'delay', expected parameters that are stated: delay is not",
        ),
    ],
)
def test_mistakes_are_named_with_their_line(described, tmp_path, entry, message):
    described("")
    (tmp_path / "sim.yaml").write_text(f"robot: arm.xml\ndrives:\n- {entry}\n")

    with pytest.raises(ConfigError, match=re.escape(message)) as refused:
        Simulation.load(tmp_path / "sim.yaml")
    assert refused.value.line == 3


def test_two_servos_of_one_joint_are_refused(described):
    with pytest.raises(ConfigError, match="position_servo, joint 1 is given more than once"):
        Simulation(described("").robot, drives=DRIVES[:1] * 2)


def test_tolerances_are_checked_and_do_not_change_with_what_was_given():
    given = {"kp": 0.1}
    servo = PositionServo(joint=1, kp=20.0, tolerances=given)
    given["kp"] = -5.0
    assert servo.tolerances == {"kp": 0.1}
    with pytest.raises(ParameterError, match="values by name"):
        PositionServo(joint=1, kp=20.0, tolerances=[0.1])
