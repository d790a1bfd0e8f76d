from __future__ import annotations

import json

import pytest

from limo_driver.app.cli.plan import command
from limo_driver.errors import ConfigError, InfeasiblePathError, LimoError
from limo_driver.trajectory import Trajectory


@pytest.fixture
def run(commanded):
    return commanded(command)


def test_plan_writes_trajectory_and_statistics(run, tmp_path):
    out = tmp_path / "a.traj.parquet"
    result = run("--scaffolds", 2, "--seed", 1, "--rate", 100, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    statistics = json.loads(result.stdout)
    trajectory = Trajectory.load(out)
    assert statistics["samples"] == len(trajectory)
    assert statistics["duration"] == pytest.approx(trajectory.duration)
    assert [s.kind for s in trajectory.segments] == ["exploring", "reaching", "exploring"]


def test_plan_prints_a_table(run, tmp_path):
    result = run("--scaffolds", 1, "--rate", 100, "--out", tmp_path / "a.traj.parquet")
    assert "1 scaffolds" in result.stdout
    assert "self-collision" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--scaffolds", 0), ConfigError, "scaffolds is 0, expected a whole number of 1 or more"),
        (("--robot", "kr16"), ConfigError, "'kr16' is neither built in"),
        (("--joint-margin", 130), InfeasiblePathError, "leaves joint 2 no range"),
        (("--out", "."), ConfigError, "cannot be written: it is a folder"),
        (("--out", "/proc/x.parquet"), ConfigError, "cannot be written"),
        (("--out", "a.csv"), ConfigError, "a.csv: cannot be written: Parquet is written, and its"),
        (("--picture", "x.foo"), ConfigError, "expected .png, .pdf, .svg"),
        (("--out", "no/such/folder/a.parquet"), ConfigError, "there is no folder no/such/folder"),
    ],
)
def test_bad_input_is_one_clear_line(run, tmp_path, arguments, error, message):
    result = run("--out", tmp_path / "a.traj.parquet", *arguments)
    assert isinstance(result.exception, error)
    assert isinstance(result.exception, LimoError)  # main() makes it exit status 2
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
