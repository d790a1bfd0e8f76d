"""What is stated of drives and zeros is reported where it differs, and taken where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion import diagnose_drives, free_run, identify_drives
from estimators.diagnosis.from_motion.checks.conventions import (
    as_counted,
    from_zeros,
    with_zeros,
    without_zeros,
    zeros_of,
)
from estimators.diagnosis.from_motion.simulation.loads import ArmChange
from limo_driver.physics import EncoderOffset, Simulation


@pytest.mark.slow("diagnoses an arm")
def test_a_weak_servo_and_late_commands_are_reported_though_neither_is_beyond(tmp_path):
    stated = Simulation.load(write_arm(tmp_path / "arm.xml", friction=0.05, kd=(0.0, 0.0)))
    first, second = stated.drives
    true = replace(
        stated, drives=(replace(first, delay=0.03), replace(second, kp=0.6 * second.kp, delay=0.03))
    )
    recordings = []
    for pace in (1.0, 0.7):
        time, command = commands(12.0, 100.0, pace)
        position = free_run(true, recorded(time, command, command + 1e-9 * time[:, None]))
        recordings.append(recorded(time, command, np.round(position / 1e-3) * 1e-3))

    found = diagnose_drives(stated, recordings)

    reported = {(x.name, x.joints): x for x in found.verdict.values if x.reported}
    assert {("kp", (2,)), ("delay", (1,)), ("delay", (2,))} <= set(reported)
    assert reported["kp", (2,)].fitted == pytest.approx(0.6 * second.kp, rel=0.05)
    assert reported["kp", (2,)].joint_names == ("elbow",)
    assert reported["delay", (1,)].fitted == pytest.approx(0.03, abs=0.005)
    assert set(found.verdict.states) >= {"stated values differ", "physics is missing"}
    assert "agree" not in found.headline()
    assert "P gain of joint 2 (elbow)" in str(found)


@pytest.mark.slow("diagnoses an arm")
def test_drives_as_they_are_stated_agree(tmp_path):
    stated = Simulation.load(write_arm(tmp_path / "arm.xml", friction=0.05, kd=(0.0, 0.0)))
    time, command = commands(12.0, 100.0)
    position = free_run(stated, recorded(time, command, command + 1e-9 * time[:, None]))
    told = recorded(time, command, np.round(position / 1e-3) * 1e-3)

    found = diagnose_drives(stated, [told])

    assert found.verdict.states == ("agrees",)
    assert not any(item.reported for item in found.verdict.values)


ZERO = np.array([0.0, 0.25])  # [rad]


@pytest.fixture
def arm(tmp_path):
    """Return the arm's file, and a recording whose second encoder reads another zero."""
    path = write_arm(tmp_path / "arm.xml", friction=0.05)
    time, command = commands(24.0, 50.0)
    position = simulated(path, time, command)
    return path, recorded(time, command + ZERO, position + ZERO)


def stating(path, offset):
    """Return what an arm's file states, with a zero of its second encoder [rad]."""
    simulation = Simulation.load(path)
    more = EncoderOffset(joint=2, offset=offset)
    return replace(simulation, effects=(*simulation.effects, more))


def test_a_stated_zero_changes_nothing_of_what_is_identified(arm):
    path, recording = arm
    plain = recorded(recording.time, recording.command - ZERO, recording.position - ZERO)

    known = identify_drives(stating(path, 0.25), [recording], intervals=False)
    none = identify_drives(Simulation.load(path), [plain], intervals=False)

    for one, other in zip(known.fits, none.fits, strict=True):
        np.testing.assert_allclose(one.row, other.row, rtol=1e-6)
    assert zeros_of(known.simulation).tolist() == pytest.approx(ZERO)


@pytest.mark.slow("diagnoses two arms")
def test_another_zero_adds_to_the_one_that_is_stated(arm):
    path, recording = arm

    right = diagnose_drives(stating(path, 0.25), [recording])
    wrong = diagnose_drives(stating(path, 0.1), [recording])

    assert "encoder_offset" not in [one.effect for one in right.findings]
    (found,) = [one for one in wrong.findings if one.effect == "encoder_offset"]
    assert (found.kind, found.joints) == ("wrong_parameter", (2,))
    assert found.evidence.startswith("with an offset of 0.1 rad, as stated, ")
    low, high = found.parameters["offset"].ci95
    assert low < 0.25 < high
    for one in (right, wrong):
        assert zeros_of(one.simulation).tolist() == pytest.approx(ZERO, abs=0.02)
        assert zeros_of(one.before)[1] in {0.25, 0.1}  # as it was given


def test_recordings_count_from_the_links_zeros_and_simulations_get_theirs_back(arm):
    path, recording = arm
    simulation = stating(path, 0.25)

    counted = from_zeros(recording, zeros_of(simulation))

    np.testing.assert_allclose(counted.position, recording.position - ZERO)
    np.testing.assert_allclose(counted.command, recording.command - ZERO)
    bare = without_zeros(simulation)
    assert not zeros_of(bare).any()
    assert zeros_of(with_zeros(bare, ZERO)).tolist() == ZERO.tolist()


def test_velocities_and_torques_that_were_told_have_no_zero(arm):
    _, recording = arm
    channels = ("command_velocity", "command_torque")

    counted = from_zeros(replace(recording, channels=channels), ZERO)

    np.testing.assert_array_equal(counted.command, recording.command)
    np.testing.assert_allclose(counted.position, recording.position - ZERO)


def test_zeros_go_with_joints_that_are_exchanged_or_counted_the_other_way():
    change = ArmChange((0.0, 0.0), (-1, 1), order=(1, 0))

    assert as_counted(np.array([0.1, 0.3]), change).tolist() == [-0.3, 0.1]
