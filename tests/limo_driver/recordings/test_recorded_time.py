"""Time that comes as whole numbers or dates: understood where there is one meaning, and said."""

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from recorded_columns import make_columns, write

from limo_driver.errors import RecordingError
from limo_driver.recordings.channels import RATES, seconds, unit_of
from limo_driver.recordings.recording import Recording

BEGAN = 1_753_000_000_123_456_789  # [ns], 19 digits
COLUMNS = make_columns()
TIME = COLUMNS["time"]
NANOSECONDS = BEGAN + np.round(1e9 * TIME).astype(np.int64)


def load(tmp_path, time, ending="parquet"):
    path = tmp_path / f"a.{ending}"
    columns = COLUMNS | {"time": time}
    if ending == "csv":
        pa.csv.write_csv(pa.table(columns), path)
    else:
        write(columns, path)
    return Recording.load(path)


@pytest.mark.parametrize("ending", ["parquet", "csv"])
@pytest.mark.parametrize(
    ("time", "said"),
    [
        (NANOSECONDS, "whole numbers with steps of 10000000, which are nanoseconds"),
        (NANOSECONDS.astype(np.uint64), "which are nanoseconds"),
        (NANOSECONDS // 1000, "steps of 10000, which are microseconds"),
        (NANOSECONDS.astype("datetime64[ns]"), "datetime64"),
    ],
)
def test_what_can_only_be_one_unit_is_taken_as_it_and_said(tmp_path, ending, time, said):
    recording = load(tmp_path, time, ending)
    (told,) = recording.warnings
    assert said in told
    assert told.endswith("taken as seconds since the first row")
    np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-9)


def test_durations_are_understood(tmp_path):
    recording = load(tmp_path, (NANOSECONDS - BEGAN).astype("timedelta64[ns]"))
    np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-9)


def test_an_empty_cell_is_left_out(tmp_path):
    time = pa.array(NANOSECONDS, mask=np.arange(NANOSECONDS.size) == 7)
    recording = load(tmp_path, time)
    assert [item.rows for item in recording.left_out] == [(7,)]
    np.testing.assert_allclose(recording.time, np.delete(TIME, 7), rtol=0, atol=1e-9)


def test_arrays_are_understood_as_files_are():
    position = np.stack([COLUMNS[f"position_{j}"] for j in (1, 2, 3)], axis=1)
    for time in (NANOSECONDS, NANOSECONDS.astype("datetime64[ns]")):
        recording = Recording.from_arrays(time, position, position)
        np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-9)
        assert len(recording.warnings) == 1


@pytest.mark.parametrize(
    ("time", "said"),
    [
        (
            NANOSECONDS.astype(float),
            r"in seconds; is the time in nanoseconds, with steps of 1e\+07",
        ),
        (1e6 * TIME, "is the time in microseconds"),
        (np.round(1e3 * TIME).astype(int), "is the time in milliseconds, with steps of 10"),
        (np.arange(TIME.size), "is the time in milliseconds, with steps of 1?"),  # or counts rows
        (1000 * np.round(1e9 * TIME).astype(int), "expected 10 to 5000 Hz and time in seconds$"),
    ],
)
def test_what_could_be_something_else_is_refused_with_what_was_expected(tmp_path, time, said):
    with pytest.raises(RecordingError, match=said):
        load(tmp_path, time)


def test_no_step_can_be_of_two_units():
    steps = np.geomspace(1e-3, 1e10, 4001)
    for step, unit in ((step, unit_of(step)) for step in steps):
        within = [
            name
            for name, per in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))
            if RATES[0] <= per / step <= RATES[1]
        ]
        assert within == ([] if unit is None else [unit])
    assert unit_of(0) is None


def test_no_rows_are_no_time():
    assert seconds(np.zeros(0, dtype=np.int64))[0].shape == (0,)


def moved(change, rows=slice(None)):
    """Return a recording of two joints in motion, with stamps that are changed."""
    even = 0.004 * np.arange(3000)
    phase = np.outer(even, [0.9, 1.7])
    stamps = change(even.copy())
    return Recording.from_arrays(stamps[rows], np.sin(phase)[rows], 5 * np.cos(phase)[rows])


def late_from(row, by):
    return lambda t: np.where(np.arange(t.size) >= row, t + by, t)


@pytest.mark.parametrize(
    ("by", "way"),
    [(-0.5, "back"), (-0.02, "back"), (-3600.0, "back"), (0.5, "forward"), (1e8, "forward")],
)
def test_a_clock_that_was_set_cuts_a_recording_and_no_row_is_lost(by, way):
    recording = moved(late_from(1500, by))
    assert len(recording) == 3000
    assert [(part.start, part.stop) for part in recording.segments] == [(0, 1500), (1500, 3000)]
    assert recording.duration == pytest.approx(0.004 * 2998 + 0.1)
    said = f"the clock was set {way} by {abs(by):.4g} s at row 1500, while the arm moved on: cut"
    assert recording.warnings[0].startswith(said)


def test_a_clock_that_was_set_twice_is_cut_twice():
    recording = moved(lambda t: late_from(2500, 7.0)(late_from(1500, -0.5)(t)))
    assert [part.start for part in recording.segments] == [0, 1500, 2500]


@pytest.mark.parametrize("by", [-0.5, 0.5])
def test_a_gap_and_another_recording_are_no_step_of_the_clock(by):
    recording = moved(lambda t: t, np.r_[0:1500, 1625:3000])
    assert not [warning for warning in recording.warnings if "clock" in warning]
    with pytest.raises(RecordingError, match="are these two recordings in one file"):
        moved(late_from(1400, -by - 4.5), np.r_[0:1200, 1400:3000])


def test_rows_that_were_lost_while_the_time_ran_on_are_a_cut():
    rows = np.r_[0:1500, 1625:3000]
    recording = moved(lambda t: np.where(np.arange(3000) >= 1625, t - 0.5, t), rows)
    assert len(recording.segments) == 2
    (left,) = {item.reason for item in recording.left_out if "jumps" in item.reason}
    assert left == "position_1 jumps as no joint moves: cut there"
    assert 2840 < len(recording) < 2875
    assert not {1499, 1500} & set(recording.rows.tolist())


@pytest.mark.parametrize("by", [-0.0045, -0.006, -0.009, 0.0045, 0.006, 0.009])
@pytest.mark.parametrize("every", [40, 33])
def test_a_few_stamps_out_of_time_cost_their_rows_alone(every, by):
    wrong = np.append(np.arange(every, 2990, every), np.arange(every, 300, every) + 4)

    def change(time):
        time[wrong] += by
        return time

    recording = moved(change)
    assert sorted({*range(3000)} - {*recording.rows.tolist()}) == sorted(wrong.tolist())
    assert {item.reason for item in recording.left_out} == {"the time does not increase"}


def test_stamps_that_are_early_time_and_again_are_refused():
    def change(time):
        time[5::5] -= 0.006
        return time

    with pytest.raises(RecordingError, match="the time runs backwards in 599 of 3000 rows"):
        moved(change)
