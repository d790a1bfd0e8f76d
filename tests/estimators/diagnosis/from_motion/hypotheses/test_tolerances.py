"""How well each stated value of a drive is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import diagnose_drives, free_run
from estimators.diagnosis.from_motion.search import beliefs, stated_guess
from estimators.diagnosis.from_motion.simulation.constants import COULOMB, DAMPING, value_in
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from limo_driver.physics import DcMotor, Simulation


@pytest.fixture
def stated(tmp_path):
    """Return an arm whose first servo has tolerances of its own."""
    simulation = Simulation.load(write_arm(tmp_path / "arm.xml"))  # kd 1.5 and damping 0.2
    own = {"kp": 0.05, "kd": 0.6, "delay": 0.7}
    first = replace(simulation.drives[0], delay=0.02, tolerances=own)
    return replace(simulation, drives=(first, *simulation.drives[1:]))


def test_values_have_their_own_tolerance_or_that_of_all(stated):
    first, second = tolerances_of(stated)

    assert [value_in(first, name) for name in ("kp", "delay", COULOMB)] == [0.05, 0.7, 0.3]
    assert [value_in(second, name) for name in ("kp", "delay", DAMPING)] == pytest.approx([0.3] * 3)


def test_damping_is_known_as_well_as_its_parts(stated):
    damping = value_in(tolerances_of(stated)[0], DAMPING)

    assert damping == pytest.approx((1.5 * 0.6 + 0.2 * 0.3) / 1.7)


def test_what_is_believed_is_as_wide_as_the_tolerances(stated):
    rows = stated_guess(rows_of(stated)).rows

    first, second = beliefs(rows, tolerances_of(stated))

    assert first["kp"].deviation == 0.05
    assert first["delay"].deviation == 0.7
    assert second["kp"].deviation == 0.3
    assert second["offset"].deviation == beliefs(rows, 0.3)[1]["offset"].deviation


MOTOR = DcMotor(
    joint=2,
    kt=0.01,
    resistance=2.0,
    supply=6.0,
    gear=300.0,
    tolerances={"kt": 0.03, "gear": 0.04, "supply": 0.12, "resistance": 0.05},
)


def test_limits_of_a_motor_are_known_as_well_as_what_makes_them(stated):
    _, second = tolerances_of(replace(stated, drives=(*stated.drives, MOTOR)))

    assert value_in(second, "free_speed") == pytest.approx(0.13)  # hypot(0.03, 0.04, 0.12)
    assert value_in(second, "stall") == pytest.approx(np.hypot(0.13, 0.05))


def test_a_motor_without_tolerances_is_known_as_well_as_all_drives(stated):
    plain = replace(MOTOR, tolerances={})
    _, second = tolerances_of(replace(stated, drives=(*stated.drives, plain)))

    assert value_in(second, "free_speed") == pytest.approx(0.3 * np.sqrt(3.0))
    assert value_in(second, "stall") == pytest.approx(0.6)


@pytest.mark.slow("diagnoses three arms")
@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (1.15, False), (0.5, True)])
def test_a_motor_is_believed_within_its_tolerances_and_named_beyond(tmp_path, factor, named):
    arm = Simulation.load(write_arm(tmp_path / "arm.xml", friction=0.1))
    stated = replace(
        arm, drives=(*arm.drives, MOTOR), tolerances=replace(arm.tolerances, drive=0.1)
    )
    true = replace(stated, drives=(*arm.drives, replace(MOTOR, supply=factor * MOTOR.supply)))
    recordings = []
    for pace in (1.0, 0.7):
        time, command = commands(20.0, 100.0, pace)
        command[:, 1] += 0.4 * np.sign(np.sin(2.7 * pace * time))  # steps, beyond the speed
        position = free_run(true, recorded(time, command, command + 1e-9 * time[:, None]))
        recordings.append(recorded(time, command, np.round(position / 1e-3) * 1e-3))

    found = diagnose_drives(stated, recordings)

    named_as = [(x.effect, x.kind, x.joints) for x in found.findings]
    assert named_as == ([("voltage_limit", "wrong_parameter", (2,))] if named else [])
    assert any("Of the motor of joint 2 (" in note for note in found.verdict.notes)
    motor = next(drive for drive in found.simulation.drives if isinstance(drive, DcMotor))
    assert motor.free_speed == pytest.approx(factor * MOTOR.free_speed, rel=0.1)
    assert motor.gear == MOTOR.gear
