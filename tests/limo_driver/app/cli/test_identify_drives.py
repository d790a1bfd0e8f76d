"""`limo identify` of an arm that tells no torque: what is odd is told, what is wrong refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from limo_driver.app.cli.diagnose import command as diagnose
from limo_driver.app.cli.identify import command as identify
from limo_driver.physics import Simulation

TIME, COMMAND = commands(10.0, 50.0)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=0.1)


@pytest.fixture(scope="module")
def position(arm):
    given = Simulation.load(arm)
    late = replace(given, drives=tuple(replace(drive, delay=0.04) for drive in given.drives))
    return free_run(late, recorded(TIME, COMMAND, COMMAND))


@pytest.fixture
def identified(arm, commanded, tmp_path):
    """Identify from a recording; return what was printed, and where files are."""

    def run(recording, *more):
        recording.save(tmp_path / "run.parquet")
        files = (tmp_path / "run.parquet", "--robot", arm, "--out", tmp_path / "sim.yaml")
        return commanded(identify)(*files, *more)

    return run


def later(rows):
    return np.concatenate([COMMAND[:1].repeat(rows, axis=0), COMMAND[:-rows]])


@pytest.mark.parametrize(
    ("mistake", "told"),
    [
        (np.rad2deg, "are the commands in degrees"),
        (lambda c: np.gradient(c, axis=0), "are the commands deltas?"),
        (lambda c: c[:, ::-1], "are joints exchanged?"),
        (lambda _: later(12), "or more later than the positions that follow them"),
    ],
)
def test_commands_that_are_no_set_points_are_refused(mistake, told, identified, position, tmp_path):
    done = identified(recorded(TIME, mistake(COMMAND), position))

    assert done.exit_code != 0
    assert told in str(done.exception or done.output)
    assert not (tmp_path / "sim.yaml").exists()


@pytest.mark.parametrize("option", [("--bandwidth", 5), ("--moving-only",), ("--no-offset",)])
def test_what_is_of_torque_alone_is_refused(option, identified, position):
    done = identified(recorded(TIME, COMMAND, position), *option)

    name = option[0].replace("--no-", "--")
    assert str(done.exception) == f"{name} is for recordings with torque; these have none"


@pytest.mark.parametrize("option", ["--bandwidth", "--gain-tolerance"])
def test_a_diagnosis_refuses_what_is_of_torque_alone(option, arm, commanded, position, tmp_path):
    recorded(TIME, COMMAND, position).save(tmp_path / "run.parquet")
    files = (tmp_path / "run.parquet", "--robot", arm, "--out", tmp_path / "found")
    done = commanded(diagnose)(*files, option, 5)

    assert str(done.exception) == f"{option} is for recordings with torque; these have none"


@pytest.mark.slow("identifies servos twice")
def test_what_is_odd_is_told_and_written(identified, position, tmp_path):
    stalled = position.copy()
    stalled[300:, 1] = stalled[300, 1]
    kept = np.ones(TIME.size, dtype=bool)
    kept[200:220] = False
    recording = recorded(TIME[kept], COMMAND[kept], stalled[kept])

    printed = identified(recording).output
    told = json.loads(identified(recording, "--json").stdout)

    page = (tmp_path / "sim.html").read_text()
    for text in ("joint 2 is stalled", "rows are missing: 1 gap;"):
        assert f"note: {text}" in printed
        assert any(text in note for note in told["warnings"])
        assert text in page
    assert told["rows"][0]["used"] == kept.sum()


def test_delay_that_is_missing_is_told(arm, commanded, position, tmp_path):
    """As where commands were recorded two rows later than they were sent."""
    recorded(TIME, later(2), position).save(tmp_path / "run.parquet")
    stated = tmp_path / "stated.xml"
    stated.write_text(arm.read_text().replace('kp="', 'delay="0.04" nsample="4" kp="'))

    done = commanded(identify)(
        tmp_path / "run.parquet", "--robot", stated, "--out", tmp_path / "sim.yaml"
    )

    assert "note: No joint has a delay, although 0.04 s are stated" in done.output


def test_motion_in_order_has_no_notes(identified, position):
    told = json.loads(identified(recorded(TIME, COMMAND, position), "--json").stdout)

    assert told["warnings"] == []
