"""A diagnosis without torque names what is hidden in the concealed arm behind servos."""

import pytest
import servo_cases

import limo_driver as limo


@pytest.mark.slow("ten seconds a case; benchmarks/diagnosis/concealed_servos.py runs many")
@pytest.mark.parametrize(
    ("seed", "hidden", "name", "within"),
    [(0, "payload", "mass", 0.1), (7, "dead_band", "dead_band", 0.1), (12, "", "", 0.0)],
)
def test_what_is_hidden_is_named(seed, hidden, name, within, tmp_path):
    case = servo_cases.make(seed, hidden)
    sim, recordings = case.write(tmp_path)

    findings = limo.diagnose(sim, recordings).verdict.findings

    joints = (case.joint,) if case.joint else ()
    assert [(x.effect, x.joints) for x in findings] == ([(hidden, joints)] if hidden else [])
    if hidden:
        assert findings[0].parameters[name].value == pytest.approx(case.size, rel=within)
