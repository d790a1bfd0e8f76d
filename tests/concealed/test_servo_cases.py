"""A diagnosis without torque names what is hidden in the concealed arm behind servos."""

import os
from pathlib import Path

import gripper_cases
import pytest
import servo_cases
from told_cases import PUSHING, TURNING

import limo_driver as limo

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
SO101 = DATA / "so101" / "robot" / "so101_new_calib.xml"


@pytest.mark.slow("ten seconds a case; benchmarks/diagnosis/concealed_servos.py runs many")
@pytest.mark.parametrize(
    ("seed", "hidden", "rate", "name", "within"),
    [
        (7, "dead_band", 200.0, "dead_band", 0.1),
        (2016, "position_servo", 50.0, "kp", 0.1),  # half of the gain that is stated
        (7003, "integral_gain", 200.0, "ki", 0.1),
        (8500, "gear_ratio", 200.0, "ratio", 0.1),
        (620003, "stribeck_friction", 200.0, "tau_s", 0.2),
        (7007, "supply_sag", 200.0, "sag", 0.2),
        (9302, "swapped_joints+backlash+encoder_offset", 200.0, "", 0.0),
        (300, "punch", 200.0, "punch", 0.1),
        (301, "thermal_derating", 200.0, "derating", 0.1),
        (302, "torque_limit", 200.0, "torque_limit", 0.1),
        (303, "voltage_limit", 200.0, "free_speed", 0.1),
        (12, "", 200.0, "", 0.0),
        (1027, "", 200.0, "", 0.0),  # in which a body of 0.01 kg explains a little
    ],
)
def test_what_is_hidden_is_named(seed, hidden, rate, name, within, tmp_path):
    case = servo_cases.make(seed, tuple(filter(None, hidden.split("+"))), rate)
    sim, recordings = case.write(tmp_path)

    findings = limo.diagnose(sim, recordings).verdict.findings

    assert {(x.effect, x.joints) for x in findings} == {(x.effect, x.joints) for x in case.hidden}
    if name:
        value = next(x for x in findings if x.effect == case.hidden[0].effect).parameters[name]
        assert value.value == pytest.approx(case.hidden[0].size, rel=within)


@pytest.mark.slow("half a minute a case; benchmarks/diagnosis/concealed_servos.py runs many")
@pytest.mark.parametrize(
    ("told", "seed", "hidden"),
    [
        (TURNING, 2, "velocity_servo"),
        (TURNING, 3, "drive_delay"),
        (TURNING, 4, ""),
        (PUSHING, 2, "torque_drive"),
        (PUSHING, 4, ""),
    ],
)
def test_what_is_hidden_in_an_arm_that_is_told_no_positions_is_named(told, seed, hidden, tmp_path):
    case = told.make(seed, (hidden,) if hidden else ())
    sim, recordings = case.write(tmp_path)

    findings = limo.diagnose(sim, recordings).verdict.findings

    assert {(x.effect, x.joints) for x in findings} == {(x.effect, x.joints) for x in case.hidden}


@pytest.mark.slow("half a minute; benchmarks/diagnosis/concealed_servos.py --gripper runs many")
@pytest.mark.skipif(not SO101.exists(), reason=f"no {SO101}; name its folder in LIMO_DATA")
def test_what_all_else_explains_once_it_is_fitted_again_is_not_named(tmp_path):
    case = gripper_cases.make(910015, (), SO101, 200.0)  # joint 6 moves as with some punch
    sim, recordings = case.write(tmp_path)

    found = limo.diagnose(sim, recordings)

    assert found.verdict.findings == ()
    assert [drive.punch for drive in found.after.drives] == [0.0] * 6
