"""Servos of velocity: simulated forward as MuJoCo does, identified, and diagnosed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from servo_arms import (
    ARMATURE,
    DAMPING,
    KV,
    VELOCITY,
    commands,
    recorded,
    simulated,
    turned,
    velocities,
    write_turned_arm,
)

from estimators.diagnosis.from_motion import diagnose_drives, free_run, identify_drives
from estimators.diagnosis.from_motion.simulation.free_run import restarted_run
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.app.library.simulating import predict_forward
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import PositionServo, Simulation, Tolerances, VelocityServo
from limo_driver.recordings.commanded import Commanded

RATE, FRICTION = 100.0, 0.1
START = np.array([-0.6, 0.3])
STEP = 2 * np.pi / 4096  # [rad], of the encoder
LATE = 0.03  # [s]
MIXED = ("command", "command_velocity")
RATE_ROWS = round(RATE)  # of a second


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_turned_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=FRICTION)


@pytest.fixture(scope="module")
def arm(path):
    """Return the arm as MJCF states it, known to a tenth."""
    return replace(Simulation.load(path), tolerances=Tolerances(drive=0.1))


@cache
def played(path, seed, seconds=20.0, **servo):
    """Return a recording of the arm as MuJoCo moves it, its servos at 1 kHz."""
    time, command = velocities(seconds, RATE, seed)
    position = turned(path, time, command, START, **servo)
    return recorded(time, command, np.round(position / STEP) * STEP, VELOCITY)


def with_drives(arm, *drives):
    return replace(arm, drives=drives)


def test_actuators_of_velocity_are_drives(arm):
    assert arm.drives == tuple(VelocityServo(joint=j, kv=kv) for j, kv in enumerate(KV, 1))
    assert arm.channels == VELOCITY


def test_it_moves_as_in_mujoco(path, arm):
    time, command = velocities(10.0, RATE, 0)
    theirs = simulated(path, time, command, START)

    ours = free_run(arm, recorded(time, command, theirs, VELOCITY))

    assert np.ptp(theirs, axis=0).min() > 0.5
    assert ours == pytest.approx(theirs, abs=2e-3)


def test_an_integral_holds_the_arm_and_takes_away_what_gravity_does(arm):
    held = with_drives(arm, *(replace(drive, ki=200.0) for drive in arm.drives))
    time = np.arange(400) / RATE
    still = recorded(time, np.full((400, 2), 1e-9), START + np.zeros((400, 2)), VELOCITY)

    assert free_run(held, still) == pytest.approx(still.position, abs=1e-3)
    assert np.abs(free_run(arm, still) - still.position).max() > 0.1  # sinks, slowly


def test_errors_begin_anew_and_joints_and_arm_agree_on_that(path, arm):
    recording = played(path, 3)
    weak = with_drives(arm, *(replace(drive, kv=0.8 * drive.kv) for drive in arm.drives))
    whole, anew = (run(weak, recording) - recording.position for run in (free_run, restarted_run))

    assert np.abs(anew).max() < 0.3 * np.abs(whole).max()
    assert np.abs(anew[101]).max() < 0.1 * np.abs(anew[100]).max()  # rows of 10 ms
    for j, (part,) in enumerate(loaded_joints(arm.body, [recording])):
        alone = part.simulate(rows_of(arm)[j])
        together = restarted_run(arm, recording)[:, j]
        assert alone[RATE_ROWS:] == pytest.approx(together[RATE_ROWS:], abs=5e-3)


@pytest.mark.slow("fits servos")
def test_gain_friction_and_delay_are_found_where_nothing_is_stated(path):
    recordings = [played(path, seed, late=LATE) for seed in (1, 2)]

    found = identify_drives(Simulation(str(path)), recordings)

    assert found.scaled == (True, True)
    for joint, (fit, drive) in enumerate(zip(found.fits, found.simulation.drives, strict=True)):
        assert isinstance(drive, VelocityServo)
        assert drive.kv == pytest.approx(KV[joint], rel=0.05)
        assert drive.delay == pytest.approx(LATE, abs=0.004)
        assert fit.value("coulomb") == pytest.approx(FRICTION, rel=0.1)
        assert fit.value("damping") == pytest.approx(DAMPING, rel=0.3)
        lag = (fit.value("inertia") - ARMATURE) / KV[joint]
        assert abs(lag) < 1.0 / RATE
    assert f"{found.fits[0].value('kv'):.3g}" in str(found)


@pytest.mark.slow("diagnoses four arms")
@pytest.mark.parametrize(
    ("hidden", "effect", "value"),
    [
        ({}, "", 0.0),
        ({"kv": (KV[0], 0.5 * KV[1])}, "velocity_servo", 0.5 * KV[1]),
        ({"late": 0.09}, "drive_delay", 0.09),
        ({"ki": (0.0, 20.0)}, "integral_gain", 20.0),
    ],
)
def test_what_is_beyond_its_tolerance_is_named(path, arm, hidden, effect, value):
    stated = with_drives(arm, *(replace(drive, delay=LATE) for drive in arm.drives))
    recordings = [played(path, seed, **{"late": LATE, **hidden}) for seed in (1, 2)]

    verdict = diagnose_drives(stated, recordings).verdict

    joints = {"": (), "drive_delay": ((1,), (2,))}.get(effect, ((2,),))
    assert sorted((x.effect, x.joints) for x in verdict.findings) == [(effect, j) for j in joints]
    assert verdict.fit.unit == "rad in 1 s"
    assert any("each 1 s it is put back there" in note for note in verdict.notes)
    for finding in verdict.findings:
        (found,) = finding.parameters.values()
        assert found.value == pytest.approx(value, rel=0.1)


@pytest.mark.slow("diagnoses an arm")
def test_one_arm_may_have_both_kinds_of_servo(arm):
    stated = with_drives(arm, PositionServo(joint=1, kp=40.0, kd=1.5), arm.drives[1])
    true = with_drives(stated, stated.drives[0], replace(arm.drives[1], kv=1.4))
    recordings = []
    for seed in (1, 2):
        time, command = velocities(20.0, RATE, seed)
        command[:, 0] = START[0] + 0.5 * command[:, 0]
        begun = recorded(time, command, START + 1e-9 * time[:, None], MIXED)
        position = np.round(free_run(true, begun) / STEP) * STEP
        recordings.append(recorded(time, command, position, MIXED))

    verdict = diagnose_drives(stated, recordings).verdict

    assert [(x.effect, x.joints) for x in verdict.findings] == [("velocity_servo", (2,))]
    assert verdict.fit.unit == "rad in 1 s at joint 2"


def test_positions_for_a_servo_of_velocity_are_refused(arm):
    time, command = commands(10.0, 50.0)
    recording = recorded(time, command, command + 0.01)
    message = r"lacks command_velocity_1: the drive of joint 1 takes rad/s"
    for run in (free_run, predict_forward):
        with pytest.raises(RecordingError, match=message):
            run(arm, recording)
    for run in (identify_drives, diagnose_drives):
        with pytest.raises(RecordingError, match=message):
            run(arm, [recording])


def test_velocities_for_a_position_servo_are_refused(path, arm):
    served = with_drives(arm, *(PositionServo(joint=j, kp=20.0) for j in (1, 2)))
    with pytest.raises(RecordingError, match="lacks command_1: the drive of joint 1 takes rad,"):
        identify_drives(served, [played(path, 1, seconds=5.0)])


def test_a_motion_is_predicted_from_velocities_and_the_first_position_alone(path, arm):
    recording = played(path, 1, seconds=5.0)

    predicted = predict_forward(arm, Commanded.of(recording))

    assert predicted == pytest.approx(recording.position, abs=3.0 * STEP)
    assert np.array_equal(predicted, free_run(arm, recording))


def test_positions_that_were_recorded_as_velocities_are_refused(path, arm):
    recording = played(path, 1, seconds=5.0)
    mistaken = replace(recording, command=recording.position)

    with pytest.raises(RecordingError, match="are these set-points of positions"):
        predict_forward(arm, Commanded.of(mistaken))


def test_two_servos_of_a_joint_are_refused(arm):
    with pytest.raises(ConfigError, match="joint 1 has a velocity_servo and a position_servo"):
        with_drives(arm, *arm.drives, PositionServo(joint=1, kp=20.0))


def test_it_comes_back_from_its_file(arm, tmp_path):
    servo = VelocityServo(
        joint=2, kv=3.0, ki=8.0, torque_limit=2.0, delay=0.02, tolerances={"kv": 0.05}
    )
    saved = with_drives(arm, servo, arm.drives[0])
    saved.save(tmp_path / "sim.yaml")

    assert Simulation.load(tmp_path / "sim.yaml").drives == saved.drives


WHEELS = """<mujoco><option timestep="0.001" integrator="implicitfast"/>
  <default><joint axis="0 0 1" damping="0.05" frictionloss="0.1" armature="0.01"/>
    <geom type="cylinder" size=".1 .02" mass="1" contype="0" conaffinity="0"/></default>
  <worldbody><body><joint name="left"/><geom/>
    <body><joint name="right"/><geom/></body></body></worldbody>
  <actuator><velocity joint="left" kv="2"/><velocity joint="right" kv="2"/></actuator>
</mujoco>"""


def of_wheels(path, kv):
    """Diagnose two wheels, stated with a gain of 2, that turn with others."""
    path.write_text(WHEELS)
    stated = replace(Simulation.load(path), tolerances=Tolerances(drive=0.1))
    time = np.arange(1000) / 50.0
    goals = np.random.default_rng(1).uniform(-6.0, 6.0, (14, 2))
    command = goals[(time / 1.5).astype(int)]
    position = turned(path, time, command, np.zeros(2), kv=kv)
    recording = recorded(time, command, np.round(position / STEP) * STEP, VELOCITY)
    return diagnose_drives(stated, [recording]).verdict


@pytest.mark.slow("diagnoses wheels")
def test_a_wheel_of_another_gain_is_named(tmp_path):
    verdict = of_wheels(tmp_path / "wheels.xml", (2.0, 0.5))

    (found,) = [item for item in verdict.findings if item.effect != "unknown"]
    assert (found.effect, found.joints) == ("velocity_servo", (2,))
    low, high = found.parameters["kv"].ci95
    assert low < 0.5 < high < 1.0


@pytest.mark.slow("diagnoses wheels")
def test_wheels_that_gravity_never_loads_are_held_against_what_is_stated(tmp_path):
    verdict = of_wheels(tmp_path / "wheels.xml", (2.0, 2.0))

    assert verdict.findings == ()
    assert any("of kv, friction, damping and inertia only the ratios" in x for x in verdict.notes)
    friction = [x for x in verdict.identified if x.effect == "coulomb_friction"]
    assert [x.parameters["tau_c"].value for x in friction] == pytest.approx([0.1, 0.1], rel=0.1)
