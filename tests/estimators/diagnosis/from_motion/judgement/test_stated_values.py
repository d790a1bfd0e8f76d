"""Drives that differ inside their tolerances are reported, with what nobody stated of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import diagnose_drives, free_run
from limo_driver.physics import Simulation


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
