"""Arms behind drives, simulated forward from commands: against MuJoCo, and what must hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import KP, commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.simulation.constants import ASSISTED, BY_LOAD, RESISTED
from estimators.diagnosis.from_motion.simulation.plant import ServoArm
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import (
    CoulombFriction,
    DcMotor,
    LoadDependentFriction,
    PositionServo,
    PreslidingHysteresis,
    Simulation,
)


@pytest.fixture
def arm(tmp_path):
    return Simulation.load(write_arm(tmp_path / "arm.xml"))


def held(simulation, command, duration=4.0, start=(0.0, 0.0)):
    """Return positions of an arm that is commanded from where it starts to one place."""
    time = np.arange(round(duration * 100)) / 100.0
    command = np.tile(np.array(command, dtype=float), (time.size, 1))
    command[0] = start
    position = np.tile(np.array(start, dtype=float), (time.size, 1))
    return free_run(simulation, recorded(time, command, position))


@pytest.mark.parametrize("limit", [50.0, 2.0])
def test_it_moves_as_in_mujoco(tmp_path, limit):
    path = write_arm(tmp_path / "arm.xml", limit=limit)
    time, command = commands(6.0, 200.0)
    theirs = simulated(path, time, command)

    ours = free_run(Simulation.load(path), recorded(time, command, theirs))

    assert np.abs(command - theirs).max() > 0.05  # there is something to get wrong
    assert np.abs(ours - theirs).max() < 0.02 * np.abs(command - theirs).max()


def test_of_the_positions_only_the_first_is_used(arm):
    time, command = commands(2.0, 100.0)
    start = recorded(time, command, np.tile(command[0], (time.size, 1)))

    assert free_run(arm, start) == pytest.approx(free_run(arm, recorded(time, command, command)))


def test_it_sags_by_load_over_gain(arm):
    target = np.array([-0.4, 0.3])

    at_rest = held(arm, target, start=target)[-1]

    load = arm.body.gravity_torque(at_rest[None])[0]
    assert target - at_rest == pytest.approx(load / np.array([40.0, 25.0]), abs=1e-5)


def test_dry_friction_holds_without_creeping(arm):
    stuck = replace(
        arm, effects=(*arm.effects, *(CoulombFriction(joint=j, tau_c=6.0) for j in (1, 2)))
    )

    assert (held(stuck, [0.02, -0.02]) == 0.0).all()


def test_a_warm_motor_sags_by_what_its_winding_gains(arm):
    target, derating, limit = np.array([-0.4, 0.3]), 1.0, 4.0
    cold = tuple(replace(drive, torque_limit=limit) for drive in arm.drives)
    warm = tuple(replace(drive, derating=derating, heating=0.5) for drive in cold)

    sag, more = (
        target - held(replace(arm, drives=own), target, 8.0, start=target)[-1]
        for own in (cold, warm)
    )

    asked = np.array(KP) * more
    load = arm.body.gravity_torque((target - more)[None])[0]
    assert load == pytest.approx(asked / (1.0 + derating * (asked / limit) ** 2), rel=0.01)
    assert abs(more[0]) > 1.05 * abs(sag[0])


def test_a_motor_of_limited_voltage_is_no_faster_than_it_can_be(arm):
    motor = DcMotor.of_limits(1, stall=50.0, free_speed=0.7)
    quick = replace(arm, drives=(*arm.drives, motor))

    pace = np.abs(np.diff(held(quick, [1.5, 0.0])[:, 0])) * 100.0

    assert motor.stall == pytest.approx(50.0)
    assert motor.free_speed == pytest.approx(0.7)
    assert 0.6 < pace.max() < 0.74  # its own weight helps
    assert np.abs(np.diff(held(arm, [1.5, 0.0])[:, 0])).max() * 100.0 > 1.5


def test_friction_of_a_load_that_resists_is_none_where_it_drives(arm):
    pressed = LoadDependentFriction(joint=1, coefficient=0.4, variant="positive")
    target = np.array([-0.4, 0.3])
    stuck = replace(arm, effects=(*arm.effects, pressed))

    lifted = held(stuck, target, start=(0.0, 0.3))[-1]  # friction holds it below
    lowered = held(stuck, target, start=(-0.8, 0.3))[-1]

    assert abs(lifted[0] - lowered[0]) > 0.005
    both = LoadDependentFriction(joint=1, coefficient=0.4)
    alike = ServoArm.of(replace(arm, effects=(*arm.effects, both, pressed))).rows[0]
    assert alike[BY_LOAD] * alike[[RESISTED, ASSISTED]] == pytest.approx([0.8, 0.4])


def test_an_integral_takes_the_sag_away(arm):
    servos = tuple(replace(drive, ki=40.0) for drive in arm.drives)

    assert held(replace(arm, drives=servos), [-0.4, 0.3], 20.0)[-1] == pytest.approx(
        [-0.4, 0.3], abs=1e-4
    )


def test_a_dead_band_is_an_error_that_stays(arm):
    servos = tuple(replace(drive, dead_band=0.05) for drive in arm.drives)

    sagging, more = held(arm, [-0.4, 0.3])[-1], held(replace(arm, drives=servos), [-0.4, 0.3])[-1]

    assert more - sagging == pytest.approx([0.05, 0.05], abs=2e-3)


def test_a_weak_supply_lets_all_joints_sag_further(arm):
    target, limit, sag = np.array([-0.4, 0.3]), 4.0, 0.8
    servos = tuple(replace(drive, sag=sag, torque_limit=limit) for drive in arm.drives)

    at_rest = held(replace(arm, drives=servos), target, start=target)[-1]

    torque = np.array([40.0, 25.0]) * (target - at_rest)
    supply = 1.0 / (1.0 + sag * np.sum((torque / limit) ** 2))
    assert supply < 0.95
    assert supply * torque == pytest.approx(arm.body.gravity_torque(at_rest[None])[0], abs=1e-4)


def test_a_delay_shifts_the_motion(arm):
    time, command = commands(6.0, 100.0)
    command[300:] = command[:300]
    command[:300] = command[0]  # until it has settled
    recording = recorded(time, command, command)
    late = replace(arm, drives=tuple(replace(drive, delay=0.1) for drive in arm.drives))

    shifted, prompt = free_run(late, recording)[300:], free_run(arm, recording)[290:-10]

    assert np.ptp(prompt, axis=0).min() > 0.3
    assert shifted == pytest.approx(prompt, abs=1e-6)


def test_a_profile_limits_the_speed(arm):
    slow = tuple(replace(x, speed=0.5, acceleration=4.0, kp=900.0, kd=20.0) for x in arm.drives)

    moved = held(replace(arm, drives=slow), [1.0, 0.0], 3.0)[:, 0]

    assert np.diff(moved).max() * 100.0 == pytest.approx(0.5, rel=0.02)
    assert moved[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("repeated", [True, False])
def test_a_command_that_is_repeated_leaves_the_profile(arm, repeated):
    led = tuple(replace(drive, acceleration=4.0, straight=1.0) for drive in arm.drives)
    limited = tuple(replace(drive, straight=0.0) for drive in led)
    time = np.arange(100) / 50.0
    command = np.zeros((time.size, 2))
    command[20:, 0] = 0.4
    if not repeated:
        command[20:, 0] += 1e-6 * np.arange(80)  # another one in each row
    recording = recorded(time, command, np.zeros_like(command))

    free, own, slow = (
        free_run(replace(arm, drives=drives), recording)[:, 0]
        for drives in (arm.drives, led, limited)
    )

    assert free[30] - slow[30] > 0.1
    if repeated:  # a row later than at once
        assert own[24:60] == pytest.approx(free[23:59], abs=0.02)
    else:
        assert own == pytest.approx(slow, abs=1e-5)


def test_a_motor_at_its_voltage_gets_no_faster(arm):
    motor = DcMotor(joint=2, kt=0.01, resistance=2.0, supply=6.0, gear=345.0)
    fast = held(replace(arm, drives=(*arm.drives, motor)), [0.0, 2.5])[:, 1]

    assert motor.free_speed == pytest.approx(6.0 / 3.45)
    falls_into_it = 1.02  # its own weight helps
    assert np.diff(held(arm, [0.0, 2.5])[:, 1]).max() * 100.0 > 2 * motor.free_speed
    assert np.diff(fast).max() * 100.0 < falls_into_it * motor.free_speed


def test_what_cannot_be_run_forward_is_refused_by_name(arm):
    time, command = commands(1.0, 100.0)
    recording = recorded(time, command, command)
    presliding = PreslidingHysteresis(joint=1, stiffness=(5.0,), width=(0.01,))

    with pytest.raises(ConfigError, match=r"presliding_hysteresis, joint 1: .* forward"):
        free_run(replace(arm, effects=(presliding,)), recording)
    lacks = "no position_servo, velocity_servo or torque_drive for joint 2"
    with pytest.raises(ConfigError, match=lacks):
        free_run(replace(arm, drives=(PositionServo(joint=1, kp=1.0),)), recording)
    with pytest.raises(RecordingError, match="lacks command_1"):
        free_run(arm, type(recording).from_arrays(time, command, 0.1 + command))


THIN = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/>
  <inertial pos="0.01 0 0" mass="1e-5" diaginertia="1e-9 1e-9 1e-9"/>
  <body pos=".3 0 0"><joint name="b" axis="0 1 0"/>
    <inertial pos="0.3 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></body></worldbody>
  <actuator><position joint="a" kp="1"/><position joint="b" kp="1"/></actuator></mujoco>"""


def test_velocities_that_do_not_agree_are_told(tmp_path):
    """A point mass at the end of a stretched arm without armature: nearly no inertia one way."""
    (tmp_path / "thin.xml").write_text(THIN)
    time = np.arange(20) / 20.0
    command = np.stack([0.3 * np.sin(9.0 * time), 0.3 * np.sin(7.0 * time)], axis=1)

    with pytest.raises(ConfigError, match="did not agree within"):
        free_run(Simulation.load(tmp_path / "thin.xml"), recorded(time, command, command))
