"""A long log goes through memory block by block, and comes out as a short one does."""

from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lanes import sampled
from logged import arm, measured, numbered, written

from limo_driver.app.library import converting
from limo_driver.app.library.converting import convert_bags, convert_log
from limo_driver.errors import RecordingError
from limo_driver.logs.mcap_file import LoggedMessage, McapWriter
from limo_driver.logs.readers.formats import arrays
from limo_driver.logs.ros import joint_state_log
from limo_driver.network.messages import JOINT_STATE, JointStateCodec
from limo_driver.recordings.files import delimited
from limo_driver.recordings.files.batches import blocks_of
from limo_driver.recordings.recording import Recording

TIME, POSITION, _, TORQUE = (every[::2] for every in measured(40.0))  # a block tells the unit
ROWS = 1000  # of a block
pytestmark = pytest.mark.usefixtures("small_memory")


@pytest.fixture
def small_memory(monkeypatch):
    """Logs of a few seconds count as long."""
    few = partial(blocks_of, rows=ROWS)
    for module, name, value in (
        (delimited, "LONG_TEXT", 0),
        (delimited, "blocks_of", few),
        (converting, "LONG_TEXT", 0),
        (converting, "MOST", ROWS),
        (converting, "blocks_of", few),
        (arrays, "most_rows", lambda _: ROWS),
        (arrays, "BLOCK", ROWS),
        (joint_state_log, "BLOCK", ROWS),
    ):
        monkeypatch.setattr(module, name, value)


def log(time=TIME, position=POSITION):
    return {
        "t_ms": np.round(1e3 * time) + 5000.0,
        **numbered("q{}", np.rad2deg(position)),
        **numbered("tau{}", TORQUE),
    }


def as_text(columns, folder):
    return written(columns, folder / "log.csv")


def as_parquet(columns, folder):
    pq.write_table(pa.table(columns), folder / "log.parquet")
    return folder / "log.parquet"


def as_dates(columns, folder):
    dates = np.datetime64("2026-01-01") + columns["t_ms"].astype("timedelta64[ms]")
    rest = {name: values for name, values in columns.items() if name != "t_ms"}
    pq.write_table(pa.table({"time": dates, **rest}), folder / "log.parquet")
    return folder / "log.parquet"


def as_arrays(columns, folder):
    np.savez(folder / "log.npz", **columns)
    return folder / "log.npz"


def as_matrices(columns, folder):
    both = (np.asfortranarray(np.rad2deg(POSITION)), TORQUE)
    np.savez_compressed(folder / "log.npz", t_ms=columns["t_ms"], q=both[0], tau=both[1])
    return folder / "log.npz"


@sampled(
    "write",
    [as_text, as_parquet, as_dates, as_arrays, as_matrices],
    "converts a log twice each",
    first=2,
)
def test_block_by_block_it_is_the_same(tmp_path, monkeypatch, write):
    path = write(log(), tmp_path)
    found = convert_log(path, tmp_path / "long.parquet", arm())
    assert found.samples == found.usable == TIME.size
    assert f"written in {TIME.size // ROWS} blocks" in found.notes[-1]
    monkeypatch.undo()
    convert_log(path, tmp_path / "short.parquet", arm())
    long, short = (Recording.load(tmp_path / f"{name}.parquet") for name in ("long", "short"))
    np.testing.assert_array_equal(long.position, short.position)
    np.testing.assert_array_equal(long.torque, short.torque)
    np.testing.assert_allclose(long.time, short.time, atol=1e-9)


def test_a_torque_that_nobody_measured_costs_the_other_joints_no_row(tmp_path):
    columns = log()
    name = next(key for key in columns if "4" in key and "tau" in key)
    columns[name] = np.where(np.arange(TIME.size) % 40, 0.0, columns[name])
    for key in (key for key in columns if "5" in key and "tau" in key):
        columns[key] = np.full(TIME.size, np.nan)
    found = convert_log(as_text(columns, tmp_path), tmp_path / "part.parquet", arm())
    assert found.usable == TIME.size
    recording = Recording.load(tmp_path / "part.parquet")
    assert len(recording) == TIME.size
    assert recording.torque.any(axis=0).sum() == recording.n - 2


def test_rows_that_are_left_out_are_those_of_the_log(tmp_path):
    columns = log()
    columns["q3"][[7, 3210, 3211]] = np.nan
    found = convert_log(as_parquet(columns, tmp_path), tmp_path / "run.parquet", arm())
    assert found.usable == found.samples - 3
    assert any("rows 7, 3210-3211" in note for note in found.notes)


@pytest.mark.parametrize("row", [2500, 3000, 3001])
def test_another_unit_later_on_is_refused(tmp_path, row):
    columns = log()
    for j in range(7):
        columns[f"q{j}"][row:] = np.deg2rad(columns[f"q{j}"][row:])
    with pytest.raises(RecordingError, match=rf"factor of 57.3 at row {row}: degrees"):
        convert_log(as_parquet(columns, tmp_path), tmp_path / "run.parquet", arm())
    assert not (tmp_path / "run.parquet").exists()


@pytest.mark.parametrize("row", [2500, 3000])
def test_another_unit_of_time_later_on_is_refused(tmp_path, row):
    columns = log()
    then = columns["t_ms"][row:]
    columns["t_ms"][row:] = then[0] + 1e3 * (then - then[0])
    with pytest.raises(RecordingError, match=r"one unit|is the time in milliseconds"):
        convert_log(as_parquet(columns, tmp_path), tmp_path / "run.parquet", arm())


def test_a_clock_that_starts_again_between_blocks_is_refused(tmp_path):
    columns = log()
    columns["t_ms"][3000:] -= columns["t_ms"][3000] - columns["t_ms"][0]
    with pytest.raises(RecordingError, match=r"backwards about row 3000, from .* two recordings"):
        convert_log(as_parquet(columns, tmp_path), tmp_path / "run.parquet", arm())


def test_what_is_damaged_late_leaves_no_recording(tmp_path):
    path = as_text(log(), tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[4000] = lines[4000].replace(lines[4000].split(",")[3], "oops")
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"delimited text: .*'oops'"):
        convert_log(path, tmp_path / "run.parquet", arm())
    assert not (tmp_path / "run.parquet").exists()


def as_bag(path, order):
    """Joint states in an MCAP file, logged in some order."""
    codec, writer = JointStateCodec(arm().joint_names), McapWriter(path)
    stamps = 10**9 * 1_700_000_000 + np.round(1e9 * TIME).astype(np.int64)
    for sequence, k in enumerate(order.tolist()):
        payload = codec.encode(int(stamps[k]), POSITION[k], np.zeros(0), TORQUE[k])
        message = LoggedMessage("/states", JOINT_STATE, payload, sequence, sequence, sequence)
        writer.add(message)
    writer.finish()
    return path


@pytest.mark.slow("converts a bag twice")
def test_a_long_bag_is_in_order_of_its_stamps(tmp_path, monkeypatch):
    order = np.arange(TIME.size)
    for k in (500, 999, 1010, 2999, 4000):  # also across the end of a block
        order[[k, k + 3]] = order[[k + 3, k]]
    bag = as_bag(tmp_path / "bag.mcap", order)
    found = convert_bags([bag], tmp_path / "long.parquet", arm())
    assert found.whole.samples == TIME.size
    assert "written in 5 blocks" in found.whole.notes[-1]
    monkeypatch.undo()
    short = convert_bags([bag], tmp_path / "short.parquet", arm())
    assert found.reordered == short.reordered > 0
    assert not any("blocks" in note for note in short.whole.notes)
    both = [Recording.load(tmp_path / f"{name}.parquet") for name in ("long", "short")]
    np.testing.assert_array_equal(both[0].position, both[1].position)
    np.testing.assert_allclose(both[0].time, TIME, atol=1e-9)


@pytest.mark.slow("writes and reads a bag of many messages")
def test_a_bag_whose_clock_starts_again_is_refused(tmp_path):
    order = np.concatenate([np.arange(3000), np.arange(2000)])
    with pytest.raises(RecordingError, match="runs backwards about row 3000"):
        convert_bags([as_bag(tmp_path / "bag.mcap", order)], tmp_path / "run.parquet", arm())
    assert not (tmp_path / "run.parquet").exists()
