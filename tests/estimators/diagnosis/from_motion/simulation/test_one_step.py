"""Errors from each recorded row on: none of the arm's own simulation, and those of a wrong one."""

from __future__ import annotations

import numpy as np
import pytest
from servo_arms import KP, commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion.judgement.held_out import row_errors
from estimators.diagnosis.from_motion.simulation.constants import with_values
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.physics import Simulation


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    path = write_arm(tmp_path_factory.mktemp("arm") / "arm.xml")
    time, command = commands(8.0, 200.0)
    simulation = Simulation.load(path)
    recording = recorded(time, command, simulated(path, time, command))
    (shoulder, _) = loaded_joints(simulation.body, [recording])
    return shoulder, rows_of(simulation)[0]


def rms(values):
    return float(np.sqrt(np.mean(values[100:-100] ** 2)))  # smoothed velocities end roughly


def test_the_arm_itself_errs_little(moved):
    parts, row = moved
    errors = row_errors(parts, row)

    driven = KP[0] * np.abs(parts[0].command - parts[0].position).max()
    assert errors.step.shape == (len(parts[0].time) - 1,)
    assert rms(errors.step) < 2e-5
    assert rms(errors.torque) < 0.02 * driven


def test_a_wrong_gain_pushes_wrongly_by_its_share_of_the_lag(moved):
    parts, row = moved
    errors = row_errors(parts, with_values(row, {"kp": 1.3 * KP[0]}))

    lag = (parts[0].command - parts[0].position)[:-1]
    assert rms(errors.torque) == pytest.approx(rms(0.3 * KP[0] * lag), rel=0.1)
    assert rms(errors.step) > 3 * rms(row_errors(parts, row).step)
