"""Files of recordings: Parquet, CSV of other programs, logs that were cut, and what is refused."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from recorded_columns import RATE, make_columns, write
from sessions import wait_until

from limo_driver.errors import RecordingError
from limo_driver.recordings.files import recorder
from limo_driver.recordings.recording import Recording
from limo_driver.types import JointState


def test_parquet_round_trip_keeps_every_value(tmp_path):
    columns = make_columns() | {f"temperature_{j}": np.full(400, 30.0 + j) for j in (1, 2, 3)}
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert (len(recording), recording.n, recording.rows_total) == (400, 3, 400)
    assert recording.rate == pytest.approx(RATE)
    assert recording.duration == pytest.approx(3.99)
    assert recording.left_out == ()
    recording.save(tmp_path / "b.parquet")
    again = Recording.load(tmp_path / "b.parquet")
    for name in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(again, name), getattr(recording, name))
    np.testing.assert_array_equal(again.extras["temperature"][0], [31, 32, 33])


def test_csv_reads_as_parquet_does(tmp_path):
    columns = make_columns()
    pa.csv.write_csv(pa.table(columns), tmp_path / "a.csv")
    recording = Recording.load(tmp_path / "a.csv")
    np.testing.assert_array_equal(recording.position[:, 2], columns["position_3"])


def test_more_than_nine_joints_stay_in_order(tmp_path):
    columns = make_columns(n=12)
    recording = Recording.load(write(dict(sorted(columns.items())), tmp_path / "a.parquet"))
    np.testing.assert_array_equal(recording.position[:, 9], columns["position_10"])


def test_files_that_are_no_recording(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        Recording.load(tmp_path / "none.parquet")
    (tmp_path / "text.parquet").write_text("hello")
    with pytest.raises(RecordingError, match="cannot be read as Parquet"):
        Recording.load(tmp_path / "text.parquet")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(RecordingError, match="holds no rows"):
        Recording.load(tmp_path / "empty.csv")


@pytest.fixture
def unfinished(tmp_path, monkeypatch):
    """Return what a recorder has on disk while it runs: 600 rows of 3 joints in several batches."""
    monkeypatch.setattr(recorder, "FLUSH_PERIOD", 0.01)
    log = recorder.partial_path(tmp_path / "whole.parquet")
    columns = make_columns(600)
    with recorder.Recorder(tmp_path / "whole.parquet", 3, {"robot": "arm"}) as writer:
        for k in range(600):
            position, torque = (
                np.array([columns[f"{q}_{j}"][k] for j in (1, 2, 3)])
                for q in ("position", "torque")
            )
            writer.append(JointState(columns["time"][k], position, 0 * position, torque, k))
            if k % 120 == 119:  # the writer's thread decides when a batch goes to disk
                wait_until(lambda rows=k + 1: recorder.read_log(log).num_rows == rows)
        return log.read_bytes()


def test_log_of_a_killed_process_is_read_up_to_where_it_is_cut(tmp_path, unfinished):
    path = tmp_path / "run.parquet"
    sizes = np.linspace(0, len(unfinished), 30).astype(int)
    lengths = []
    for size in sizes:
        (tmp_path / "run.parquet.partial").write_bytes(unfinished[:size])
        try:
            recording = Recording.load(path)
        except RecordingError:  # too short to be of use
            lengths.append(0)
            continue
        lengths.append(len(recording))
        assert "run.parquet was never finished" in recording.warnings[0]
        np.testing.assert_allclose(recording.time, np.arange(len(recording)) / RATE)
    assert lengths[-1] == 600
    assert lengths == sorted(lengths)
    assert len(set(lengths)) > 3


def as_csv(columns, separator=",", header=None):
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(header or columns)]
    return "\n".join([*lines, *(separator.join(map(repr, map(float, row))) for row in rows), ""])


@pytest.mark.parametrize(
    ("header", "encoding"),
    [
        (lambda name: name, "utf-8-sig"),  # with a byte order mark, as spreadsheets write
        (lambda name: f'"{name}"', "utf-8"),
        (lambda name: f" {name} ", "utf-8"),
    ],
)
def test_headers_of_other_programs_are_read(tmp_path, header, encoding):
    columns = make_columns() | {"comment": np.ones(400), "gripper_force": np.ones(400)}
    text = as_csv(columns, header=[header(name) for name in columns])
    (tmp_path / "a.csv").write_text(text, encoding=encoding)
    recording = Recording.load(tmp_path / "a.csv")
    assert (len(recording), recording.n, recording.left_out) == (400, 3, ())


@pytest.mark.parametrize(("separator", "decimal"), [(";", "."), (";", ","), ("\t", ",")])
def test_csv_of_any_separator_is_read(tmp_path, separator, decimal):
    text = as_csv(make_columns(), separator).replace(".", decimal)
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "b.csv").write_text(as_csv(make_columns()))
    read = [Recording.load(tmp_path / f"{name}.csv") for name in "ab"]
    np.testing.assert_array_equal(read[0].torque, read[1].torque)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (as_csv(make_columns(), header=["time", *"abcde", "time"]), "more than one column time"),
        (as_csv(make_columns()).replace("time", "t\N{DEGREE SIGN}C"), "lacks time"),
        (",".join(make_columns()) + "\n", "has 0 usable rows of 0"),
        ("\x00\x01\n\xff,\x02\n", "is no text"),
    ],
)
def test_csv_that_is_no_recording(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text, encoding="latin-1")
    with pytest.raises(RecordingError, match=message) as caught:
        Recording.load(tmp_path / "a.csv")
    assert "\n" not in str(caught.value)


def test_a_folder_and_repeated_columns_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="is a folder"):
        Recording.load(tmp_path)
    columns = make_columns()
    names = ["torque_2" if name == "torque_3" else name for name in columns]
    table = pa.Table.from_arrays([pa.array(v) for v in columns.values()], names=names)
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(RecordingError, match="more than one column torque_2"):
        Recording.load(tmp_path / "a.parquet")


def test_a_file_may_lack_the_torque_of_some_joints(tmp_path):
    columns = make_columns(400)
    whole = Recording.load(write(columns, tmp_path / "whole.parquet"))
    del columns["torque_2"]
    recording = Recording.load(write(columns, tmp_path / "some.parquet"))
    assert "torque_2 is never measured; it is kept as 0" in recording.warnings
    assert not recording.torque[:, 1].any()
    assert (recording.torque[:, 0] == whole.torque[:, 0]).all()
