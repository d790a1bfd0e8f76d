"""Drives that are told torques: simulated forward as MuJoCo does, identified, and diagnosed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from servo_arms import (
    ARMATURE,
    DAMPING,
    TORQUE,
    commands,
    pushed,
    recorded,
    velocities,
    write_pushed_arm,
)

from estimators.diagnosis.from_motion import diagnose_drives, free_run, identify_drives
from estimators.diagnosis.from_motion.checks.recorded import check_commanded, check_torques
from estimators.diagnosis.from_motion.simulation.free_run import restarted_run
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.app.library.simulating import predict_forward
from limo_driver.errors import ConfigError, ParameterError, RecordingError
from limo_driver.physics import PositionServo, Simulation, Tolerances, TorqueDrive
from limo_driver.recordings.commanded import Commanded

RATE, FRICTION, LATE = 100.0, 0.1, 0.02  # [Hz], [N m], [s]
START = np.array([-0.6, 0.3])
STEP = 2 * np.pi / 4096  # [rad], of the encoder


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_pushed_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=FRICTION)


@pytest.fixture(scope="module")
def arm(path):
    """Return the arm as MJCF states it, known to a tenth, behind drives that are told torques."""
    drives = tuple(TorqueDrive(joint=j, delay=LATE) for j in (1, 2))
    return replace(Simulation.load(path), tolerances=Tolerances(drive=0.1), drives=drives)


@cache
def led(path, seed, seconds=20.0, **drive):
    """Return a recording of the arm as MuJoCo moves it, and the motion without its encoders."""
    time, pace = velocities(seconds, RATE, seed)
    wanted = START + 0.8 * np.cumsum(pace, axis=0) / RATE
    drive = {"late": LATE} | {name: np.asarray(value) for name, value in drive.items()}
    told, position = pushed(path, time, wanted, START, **drive)
    return recorded(time, told, np.round(position / STEP) * STEP, TORQUE), position


def test_it_moves_as_in_mujoco_until_it_drifts(path, arm):
    recording, theirs = led(path, 0, 10.0)
    exact = recorded(recording.time, recording.command, theirs, TORQUE)

    whole, anew = (run(arm, exact) - theirs for run in (free_run, restarted_run))

    assert np.ptp(theirs, axis=0).min() > 1.0
    assert np.abs(whole[:50]).max() < 5e-3  # half a second
    assert np.abs(whole).max() > 0.5  # nothing leads it back
    assert (
        np.sqrt(np.mean(anew[101:] ** 2, axis=0)).max() < 5e-3
    )  # velocities at an end are less sure


def test_joints_and_arm_agree_on_where_errors_begin_anew(path, arm):
    recording, _ = led(path, 3)
    for j, (part,) in enumerate(loaded_joints(arm.body, [recording])):
        alone = part.simulate(rows_of(arm)[j])
        together = restarted_run(arm, recording)[:, j]
        assert np.sqrt(np.mean((alone - together) ** 2)) < 0.01


def test_a_limit_cuts_what_is_told_and_a_gain_multiplies_it(path, arm):
    recording, _ = led(path, 0, 5.0)
    weak = replace(arm, drives=tuple(replace(x, torque_limit=0.2) for x in arm.drives))
    doubled = replace(arm, drives=tuple(replace(x, gain=2.0) for x in arm.drives))
    cut = replace(recording, command=recording.command.clip(-0.2, 0.2))
    twice = replace(recording, command=2.0 * recording.command)

    assert free_run(weak, recording) == pytest.approx(free_run(arm, cut), abs=0.02)
    assert free_run(doubled, recording) == pytest.approx(free_run(arm, twice), abs=1e-9)


@pytest.mark.slow("fits drives")
def test_gain_friction_and_delay_are_found_where_nothing_is_stated(path):
    gain = (1.3, 0.8)
    recordings = [led(path, seed, gain=gain)[0] for seed in (1, 2)]

    found = identify_drives(Simulation(str(path)), recordings)

    for joint, (fit, drive) in enumerate(zip(found.fits, found.simulation.drives, strict=True)):
        assert isinstance(drive, TorqueDrive)
        assert drive.gain == pytest.approx(gain[joint], rel=0.01)
        assert drive.delay == pytest.approx(LATE, abs=0.002)
        assert fit.value("coulomb") == pytest.approx(FRICTION, rel=0.05)
        assert fit.value("damping") == pytest.approx(DAMPING, rel=0.05)
        assert fit.value("inertia") == pytest.approx(ARMATURE, rel=0.1)
    assert "gain [1]" in str(found)


@pytest.mark.slow("diagnoses three arms")
@pytest.mark.parametrize(
    ("hidden", "effect", "value"),
    [
        ({}, "", 0.0),
        ({"gain": (1.0, 0.6)}, "torque_drive", 0.6),
        ({"limit": (np.inf, 0.3)}, "torque_limit", 0.3),
    ],
)
def test_what_is_beyond_its_tolerance_is_named(path, arm, hidden, effect, value):
    recordings = [led(path, seed, **hidden)[0] for seed in (1, 2)]

    verdict = diagnose_drives(arm, recordings).verdict

    joints = [(2,)] if effect else []
    assert [(x.effect, x.joints) for x in verdict.findings] == [(effect, j) for j in joints]
    assert verdict.fit.unit == "rad in 1 s"
    assert any(note.startswith("Torques are commanded at joints 1 (") for note in verdict.notes)
    for finding in verdict.findings:
        (found,) = finding.parameters.values()
        assert found.value == pytest.approx(value, rel=0.1)
        assert "1 1" not in finding.evidence


@pytest.mark.slow("diagnoses an arm")
def test_motors_of_a_description_are_diagnosed_as_the_drives_that_they_are(path):
    recordings = [led(path, seed)[0] for seed in (1, 2)]  # its motors are not late

    found = diagnose_drives(Simulation.load(path), recordings)

    late = [x for x in found.verdict.findings if x.effect != "unknown"]
    assert [(x.effect, x.kind, x.joints) for x in late] == [
        ("drive_delay", "wrong_parameter", (1,)),
        ("drive_delay", "wrong_parameter", (2,)),
    ]
    for finding in late:
        assert finding.parameters["delay"].value == pytest.approx(LATE, abs=0.003)


def test_a_motion_is_predicted_from_torques_and_the_first_position_alone(path, arm):
    recording, _ = led(path, 1, seconds=5.0)

    assert np.array_equal(predict_forward(arm, Commanded.of(recording)), free_run(arm, recording))


def test_motors_of_a_description_are_drives_where_torques_are_told(tmp_path, path):
    geared = write_pushed_arm(tmp_path / "geared.xml", friction=FRICTION, gear=(2.0, 0.5))
    recording, _ = led(path, 1, seconds=5.0, late=0.0)
    told = replace(recording, command=recording.command / np.array([2.0, 0.5]))
    stated = Simulation.load(geared)

    assert stated.drives == ()
    assert stated.with_motors(TORQUE).drives == (
        TorqueDrive(joint=1, gain=2.0),
        TorqueDrive(joint=2, gain=0.5),
    )
    assert stated.with_motors(("command", "command_torque")).drives == (
        TorqueDrive(joint=2, gain=0.5),
    )
    plain = replace(stated, drives=tuple(TorqueDrive(joint=j) for j in (1, 2)))
    assert predict_forward(stated, told) == pytest.approx(predict_forward(plain, recording))


def test_one_arm_may_have_drives_of_all_kinds(path, arm):
    mixed = replace(arm, drives=(PositionServo(joint=1, kp=40.0, kd=1.5), arm.drives[1]))
    recording, _ = led(path, 1, seconds=5.0)
    both = replace(
        recording,
        command=np.stack([recording.position[:, 0], recording.command[:, 1]], axis=1),
        channels=("command", "command_torque"),
    )

    moved = free_run(mixed, both)
    assert np.abs(moved[:50] - both.position[:50]).max() < 0.1
    with pytest.raises(RecordingError, match="lacks command_1: the drive of joint 1 takes rad,"):
        free_run(mixed, recording)


def test_positions_for_a_drive_that_is_told_torques_are_refused(arm):
    time, command = commands(10.0, 50.0)
    recording = recorded(time, command, command + 0.01)
    message = r"lacks command_torque_1: the drive of joint 1 takes N m"
    for run in (free_run, predict_forward):
        with pytest.raises(RecordingError, match=message):
            run(arm, recording)
    for run in (identify_drives, diagnose_drives):
        with pytest.raises(RecordingError, match=message):
            run(arm, [recording])


def test_two_drives_of_a_joint_are_refused(arm):
    with pytest.raises(ConfigError, match="joint 1 has a torque_drive and a position_servo"):
        replace(arm, drives=(*arm.drives, PositionServo(joint=1, kp=20.0)))


@pytest.mark.parametrize(
    "given",
    [{"gain": 0.0}, {"torque_limit": -1.0}, {"tolerances": {"torque_limit": 0.1}}],
)
def test_values_that_no_drive_has_are_refused(given):
    with pytest.raises(ParameterError):
        TorqueDrive(joint=1, **given)


def test_it_comes_back_from_its_file(arm, tmp_path):
    drive = TorqueDrive(joint=2, gain=0.9, torque_limit=2.0, tolerances={"gain": 0.05})
    saved = replace(arm, drives=(drive, arm.drives[0]))
    saved.save(tmp_path / "sim.yaml")

    assert Simulation.load(tmp_path / "sim.yaml").drives == saved.drives


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda c, _: 1000.0 * c, "are the commands in N mm or mA?"),
        (lambda c, _: c / 300.0, "torques of motors before their gears"),
        (lambda c, _: 0.0 * c, "command_torque_1 is always 0 while joint 1 moves"),
        (lambda _, q: np.roll(q, -5, axis=0), "set-points of positions, command_"),
        (lambda c, _: c[:, ::-1], r"joint \d moves as command_torque_\d says, not command_torque_"),
        (lambda c, _: -c, "joint 1 moves against command_torque_1; has one of them the other sign"),
        (lambda c, _: c * [1.0, -1.0], "joint 2 moves against command_torque_2"),
        (lambda c, _: np.concatenate([c[:20], c[:-20]]), "later than the positions that follow"),
    ],
)
def test_commands_that_are_no_torques_are_refused_by_name(path, arm, mistake, message):
    recording, _ = led(path, 1)
    mistaken = replace(recording, command=mistake(recording.command, recording.position))

    with pytest.raises(RecordingError, match=message):
        check_commanded(arm, [mistaken])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_joints_that_count_otherwise_with_their_torques_are_no_mistake_of_commands(path, arm, seed):
    recording, _ = led(path, seed)
    for alike in (lambda x: x * [-1.0, 1.0], lambda x: x[:, ::-1]):
        counted = replace(
            recording, position=alike(recording.position), command=alike(recording.command)
        )
        check_torques(arm, counted)
    check_torques(arm, recording)


def test_torques_before_the_gear_are_taken_with_its_gain(path, arm):
    recording, _ = led(path, 1)
    geared = replace(arm, drives=tuple(replace(drive, gain=300.0) for drive in arm.drives))
    before = replace(recording, command=recording.command / 300.0)

    assert check_commanded(geared, [before]) == ()
