"""The example of an arm on a bus, as it stands: two processes on a real bus."""

import runpy
import sys
from pathlib import Path

import pytest
from ports import free_port

pytestmark = pytest.mark.waits

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture
def config(tmp_path):
    """The example's arm, on a bus of its own, and with patience for a busy machine."""
    text = (EXAMPLES / "can_cia402.yaml").read_text()
    for old, new in (
        ("port: 43113", f"port: {free_port()}"),
        ("watchdog: 0.1", "watchdog: 5"),
        ("rate: 250", "rate: 100"),
        ("hold_after: 25", "hold_after: 200"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "patient.yaml"
    path.write_text(text)
    return path


@pytest.mark.slow("an arm and its drives in two processes, at the pace of a real arm")
def test_the_example_runs(config, tmp_path, monkeypatch, capfd):
    given = {"out": tmp_path / "out", "config": config, "duration": 1.0}
    words = [word for name, value in given.items() for word in (f"--{name}", str(value))]
    monkeypatch.setattr(sys, "argv", ["can_arm.py", *words])
    runpy.run_path(str(EXAMPLES / "can_arm.py"), run_name="__main__")
    said = capfd.readouterr().out
    assert "'faults': []" in said
    assert "joint   torque step   torque rms   difference rms" in said
    assert "0.320 N m" in said
