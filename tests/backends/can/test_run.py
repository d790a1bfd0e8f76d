"""`limo run --backend can`, through the command line, on drives that are canopen's."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from arms import NODES, virtual_bus
from canopen_drives import CanopenArm
from ports import free_port
from sync_bus import SyncBus

from backends.can import robot as can_robot
from backends.can.port import BusPort
from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Segment, Trajectory

ARM = """
bus: {{interface: virtual, channel: {channel}}}
robot: iiwa14
rate: 100
watchdog: 1.0
temperature: {{object: 0x2031, step: 0.1}}
answer_timeout: 0.5
joints:
"""
JOINT = "  - {{node: {node}, counts_per_turn: 524288, rated_torque: 100}}\n"


@pytest.fixture
def arm_yaml(tmp_path):
    path = tmp_path / "arm.yaml"
    text = ARM.format(channel=virtual_bus().channel)
    path.write_text(text + "".join(JOINT.format(node=node) for node in NODES))
    return path


@pytest.fixture
def trajectory(tmp_path):
    time = np.linspace(0.0, 0.8, 81)
    s, u = time / 0.8, np.ones((1, 7))
    q = 0.02 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    dq = 0.02 * 30 * (s**2 - 2 * s**3 + s**4) / 0.8
    ddq = 0.02 * 60 * (s - 3 * s**2 + 2 * s**3) / 0.8**2
    path = tmp_path / "short.traj.parquet"
    parts = (values[:, None] * u for values in (q, dq, ddq))
    Trajectory(time, *parts, robot="iiwa14", segments=(Segment("exploring", 0, 81),)).save(path)
    return path


@pytest.fixture
def bus(monkeypatch):
    """Return a bus in place of that of the file: its time passes only where the driver waits."""
    made = SyncBus()
    monkeypatch.setattr(can_robot, "BusPort", lambda bus, *_: BusPort(bus, made, made.now))
    return made


def test_runs_and_records(limo, bus, arm_yaml, trajectory, tmp_path):
    record = tmp_path / "run.parquet"
    with CanopenArm(bus, NODES) as arm:
        done = limo(
            "run", "--backend", "can", "--config", arm_yaml, "--trajectory", trajectory,
            "--record", record, "--json",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert {drive.state for drive in arm.drives} == {0x40}
    summary = json.loads(done.stdout)
    assert summary["limited"] == {}
    assert max(summary["tracking_max"]) < 0.01
    recording = Recording.load(record)
    assert recording.robot == "iiwa14"
    assert recording.torque_resolution == pytest.approx([0.1] * 7)
    assert np.nanmax(recording.temperature, axis=0) == pytest.approx([30.5] * 7, abs=1.0)
    assert recording.position[-1] == pytest.approx([0.02] * 7, abs=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rate: 100", "rate: 1000", "does not fit on a bus"),
        ("node: 13", "node: 15", "joints 3 and 5 have the same node 15"),
        ("iiwa14", "panda", "neither built in"),
        ("interface: virtual", "interface: carrier_pigeon", "carrier_pigeon .* cannot be opened"),
        ("", "", "no drive answers on virtual"),
    ],
)
def test_bad_input_ends_with_one_line(limo, arm_yaml, trajectory, tmp_path, old, new, message):
    arm_yaml.write_text(arm_yaml.read_text().replace(old, new))
    done = limo(
        "run", "--backend", "can", "--config", arm_yaml, "--trajectory", trajectory,
        "--record", tmp_path / "run.parquet",
    )  # fmt: skip
    assert done.returncode != 0
    (line,) = done.stderr.strip().splitlines()
    import re

    assert re.search(message, line)


def test_a_configuration_is_needed(limo, trajectory, tmp_path):
    done = limo(
        "run", "--backend", "can", "--trajectory", trajectory, "--record", tmp_path / "x.parquet"
    )
    assert done.returncode != 0
    assert "--config" in done.stderr


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
