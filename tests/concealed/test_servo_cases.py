"""A diagnosis without torque names what is hidden in the concealed arm behind servos."""

import pytest
import servo_cases

import limo_driver as limo


@pytest.mark.slow("ten seconds a case; benchmarks/diagnosis/concealed_servos.py runs many")
@pytest.mark.parametrize(
    ("seed", "hidden", "rate", "name", "within"),
    [
        (0, "payload", 200.0, "mass", 0.1),
        (7, "dead_band", 200.0, "dead_band", 0.1),
        (2016, "position_servo", 50.0, "kp", 0.1),  # half of the gain that is stated
        (12, "", 200.0, "", 0.0),
        (1027, "", 200.0, "", 0.0),  # in which a body of 0.01 kg explains a little
    ],
)
def test_what_is_hidden_is_named(seed, hidden, rate, name, within, tmp_path):
    case = servo_cases.make(seed, hidden, rate)
    sim, recordings = case.write(tmp_path)

    findings = limo.diagnose(sim, recordings).verdict.findings

    joints = (case.joint,) if case.joint else ()
    assert [(x.effect, x.joints) for x in findings] == ([(hidden, joints)] if hidden else [])
    if hidden:
        assert findings[0].parameters[name].value == pytest.approx(case.size, rel=within)
