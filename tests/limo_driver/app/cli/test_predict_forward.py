"""`limo predict --free-running`: from commands and the first position alone, not from nonsense."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from limo_driver.app.cli.predict import command as predict
from limo_driver.app.library.simulating import predict_forward
from limo_driver.physics import Simulation
from limo_driver.recordings.channels import Columns
from limo_driver.recordings.commanded import Commanded
from limo_driver.recordings.files.recording_file import write_columns
from limo_driver.recordings.recording import Recording

TIME, COMMAND = commands(10.0, 50.0)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Write an arm of some delay, as one file."""
    folder = tmp_path_factory.mktemp("arm")
    given = Simulation.load(write_arm(folder / "arm.xml", friction=0.1))
    late = replace(given, drives=tuple(replace(drive, delay=0.04) for drive in given.drives))
    late.save(folder / "sim.yaml")
    return folder / "sim.yaml"


@pytest.fixture(scope="module")
def position(arm):
    return free_run(Simulation.load(arm), recorded(TIME, COMMAND, COMMAND))


@pytest.fixture
def predicted(arm, commanded, tmp_path):
    """Predict from columns as they were logged; return how it ended, and the positions by row."""

    def run(time, command, position):
        none = np.full_like(position, np.nan)
        write_columns(Columns(time, position, none, command=command), tmp_path / "run.parquet")
        files = (tmp_path / "run.parquet", "--sim", arm, "--out", tmp_path / "moved.parquet")
        done = commanded(predict)(*files, "--free-running")
        if done.exit_code:
            return done, None
        table = pq.read_table(tmp_path / "moved.parquet")
        return done, np.stack([table[f"position_{j}"].to_numpy() for j in (1, 2)], axis=1)

    return run


def first_alone(position):
    return np.where(np.arange(TIME.size)[:, None] == 0, position, np.nan)


def test_positions_behind_the_first_have_no_say(predicted, position):
    frozen, spiked = position.copy(), position.copy()
    frozen[200:230] = position[200]
    spiked[[100, 150, 300]] += 1.5

    _, whole = predicted(TIME, COMMAND, position)
    for other in (first_alone(position), frozen, spiked):
        _, again = predicted(TIME, COMMAND, other)
        assert np.array_equal(again, whole)
    assert np.isfinite(whole).all()
    assert whole == pytest.approx(position, abs=1e-9)


def test_it_starts_once_and_keeps_the_last_command_through_a_gap(predicted, position):
    kept = np.ones(TIME.size, dtype=bool)
    kept[200:300] = False
    moved = position.copy()
    moved[300:] += 0.2  # as where somebody pushed the arm meanwhile

    done, found = predicted(TIME[kept], COMMAND[kept], moved[kept])

    assert "1 gap; the longest, 2.02 s, after 3.98 s; the command before stays" in done.output
    held = COMMAND.copy()
    held[200:300] = COMMAND[199]
    _, expected = predicted(TIME, held, first_alone(position))
    assert found == pytest.approx(expected[kept], abs=1e-4)


def test_years_between_two_rows_are_no_years_of_simulation(predicted, position):
    time = TIME + np.where(np.arange(TIME.size) < 300, 0.0, 1e8)

    done, found = predicted(time, COMMAND, first_alone(position))

    assert done.exit_code == 0
    assert np.isfinite(found).all()


def test_rows_without_command_are_empty_and_named(predicted, position):
    command = COMMAND.copy()
    command[40, 1] = np.nan

    done, found = predicted(TIME, command, position)

    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [40]
    assert "1 row left out: a value is missing or not finite (row 40)" in done.output


def test_it_begins_with_the_first_row_that_has_a_position(predicted, position):
    late = position.copy()
    late[:25] = np.nan

    done, found = predicted(TIME, COMMAND, late)

    assert np.isnan(found[:25]).all()
    assert found[25] == pytest.approx(position[25])
    assert "25 rows left out: no position was recorded yet (rows 0-24)" in done.output


@pytest.mark.parametrize(
    ("mistake", "told"),
    [
        (np.rad2deg, "are the commands in degrees"),
        (lambda c: 100.0 * c / np.abs(c).max(), "normalised, as -100 to 100"),
        (lambda c: np.gradient(c, axis=0), "are the commands deltas?"),
        (lambda c: c[:, ::-1], "are joints exchanged?"),
        (np.negative, "has one of them the other sign?"),
        (lambda c: np.roll(c, 12, axis=0), "or more later than the positions that follow them"),
    ],
)
def test_commands_that_are_no_set_points_are_refused(mistake, told, predicted, position, tmp_path):
    done, _ = predicted(TIME, mistake(COMMAND), position)

    assert done.exit_code != 0
    assert told in str(done.exception or done.output)
    assert not (tmp_path / "moved.parquet").exists()


def test_degrees_are_refused_without_positions_too(predicted, position):
    done, _ = predicted(TIME, np.rad2deg(COMMAND), first_alone(position))

    assert "are the commands in degrees, or normalised" in str(done.exception or done.output)


def test_without_any_position_it_cannot_start(predicted, position):
    done, _ = predicted(TIME, COMMAND, np.full_like(position, np.nan))

    assert "no row has a position of all joints" in str(done.exception or done.output)


def test_an_arm_far_from_all_commands_is_told(predicted, position):
    done, _ = predicted(TIME, 0.02 * COMMAND, first_alone(position - 0.3))

    assert "rad away from all of its commands; are these deltas" in done.output


def test_a_stall_is_told(predicted, position):
    stalled = position.copy()
    stalled[300:, 1] = stalled[300, 1]

    done, found = predicted(TIME, COMMAND, stalled)

    assert "joint 2 is stalled" in done.output
    assert found == pytest.approx(position, abs=1e-9)


def test_a_plan_that_was_never_played_needs_no_positions(arm, position):
    """Neither does one of an arm that was told to stay where it is."""
    planned = Recording.from_arrays(TIME, COMMAND, command=COMMAND)
    still = np.tile(COMMAND[:1], (TIME.size, 1))
    rested = predict_forward(arm, Recording.from_arrays(TIME, still + 1e-3, command=still))

    assert predict_forward(arm, planned) == pytest.approx(position)
    assert predict_forward(arm, Commanded.of(planned)) == pytest.approx(position)
    assert np.ptp(rested[-50:], axis=0).max() < 1e-3
