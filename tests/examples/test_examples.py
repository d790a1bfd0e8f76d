"""The examples run as they stand; the demo, which takes minutes, is run by `make demo`."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("predict_torque", "beyond the rigid body"),
        ("creep_and_reverse", "the arm holds"),
        ("your_csv", "questions: none"),
        pytest.param(
            "your_mjcf",
            "Payload of 0.5|model.xml: changed; MuJoCo alone needs what limo predicts|to 0.00% of",
            marks=pytest.mark.slow("diagnoses, and exports"),
        ),  # of 0.6 kg
        pytest.param(
            "your_bag",
            "left aside: 2000 messages of finger_left, finger_right on /joint_states",
            marks=pytest.mark.slow("writes and reads a bag"),
        ),
        pytest.param(
            "feel_a_probe",
            "where nothing touched: |pressed with 15 N: 15.",
            marks=pytest.mark.slow("plans, identifies and learns"),
        ),
        pytest.param(
            "weigh_by_servos",
            "payload, at the flange: mass 0.1",
            marks=pytest.mark.slow("plays three minutes of commands, and diagnoses"),
        ),
        pytest.param(
            "watch_a_fleet",
            "questions: none|unit_3: Coulomb friction of joint 2 (stick) rose from 3.98 to 7.49",
            marks=pytest.mark.slow("diagnoses eighteen recordings"),
        ),
        pytest.param(
            "diagnose_simulated",
            "] at the flange; presliding hysteresis at joint 4.",
            marks=pytest.mark.slow("diagnoses two minutes of motion"),
        ),
    ],
)
def test_the_example_runs(name, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some write their output to out/
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert [part for part in says.split("|") if part not in printed] == []


def test_the_demo_says_how_it_is_used(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["demo.py", "--help"])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(str(EXAMPLES / "demo.py"), run_name="__main__")
    assert "--scaffolds" in capsys.readouterr().out
