"""A recording survives whatever happens to the process that makes it."""

import errno
import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from lanes import sampled
from sessions import wait_until

from limo_driver.errors import RecordingError
from limo_driver.recordings.files import recorder as recorder_module
from limo_driver.recordings.files.recorder import (
    FLUSH_PERIOD,
    METADATA_KEY,
    Recorder,
    partial_path,
    read_header,
    read_log,
)
from limo_driver.recordings.files.recording_file import read_columns
from limo_driver.recordings.recording import Recording
from limo_driver.runtime import written_by
from limo_driver.types import JointState

pytestmark = pytest.mark.waits

WRITER = """
import sys, time
import numpy as np
from limo_driver.recordings.files.recorder import Recorder
from limo_driver.runtime import written_by
from limo_driver.types import JointState

recorder = Recorder(sys.argv[1], 2, {"robot": "two"})
began, flush = time.monotonic(), recorder._flush

def flush_and_tell():
    rows = recorder.samples
    flush()
    print(rows, flush=True)

recorder._flush = flush_and_tell
for k in range(10**9):
    values = np.full(2, float(k))
    recorder.append(JointState(k * 1e-3, values, values, values, k), values)
    time.sleep(max(0.0, began + k * 1e-3 - time.monotonic()))
"""


def state(k, stale=False):
    values = np.array([k, -k], dtype=float)
    return JointState(k * 1e-3, values, 2 * values, 3 * values, k, stale=stale)


def record(path, count):
    with Recorder(path, 2, {"robot": "two"}) as recorder:
        for k in range(count):
            recorder.append(state(k), np.array([k + 0.5, k - 0.5]))
    return recorder


def test_a_run_that_stopped_says_so_to_its_readers(tmp_path):
    for why in ("", "joint 4 leaves its range or its velocity limit"):
        path = tmp_path / f"run{len(why)}.parquet"
        with Recorder(path, 2, {"robot": "two"}) as recorder:
            for k in range(1000):
                recorder.append(state(k), np.array([k + 0.5, k - 0.5]))
            recorder.stopped = why
        warnings = read_columns(path).warnings
        assert ("the run stopped before its motion ended: " + why in warnings) == bool(why)
        assert read_header(pq.read_table(path))["robot"] == "two"


def test_recording_has_the_columns_of_the_format(tmp_path):
    path = tmp_path / "run.parquet"
    recorder = record(path, 1000)
    table = pq.read_table(path)
    names = [
        f"{q}_{j}" for q in ("position", "velocity", "torque", "target_position") for j in (1, 2)
    ]
    assert table.column_names == ["time", *names]
    assert recorder.samples == table.num_rows == 1000
    assert np.array_equal(table["time"].to_numpy(), np.arange(1000) * 1e-3)
    assert np.array_equal(table["torque_2"].to_numpy(), -3.0 * np.arange(1000))
    assert np.array_equal(table["target_position_1"].to_numpy(), np.arange(1000) + 0.5)
    assert read_header(table) == {"limo": written_by.installed(), "robot": "two"}
    assert list(tmp_path.iterdir()) == [path]  # nothing else is left


def sine_run(path, robot):
    with Recorder(path, 2, {"robot": robot}) as recorder:
        for k in range(600):
            wave = np.sin(0.01 * k + np.arange(2))
            recorder.append(JointState(k * 1e-3, wave, wave, 5 * wave, k), wave)
    return path


def test_recording_knows_its_robot_and_keeps_it(tmp_path):
    recording = Recording.load(sine_run(tmp_path / "run.parquet", "iiwa14"))
    assert recording[:200].robot == "iiwa14"
    recording.save(tmp_path / "copy.parquet")
    assert Recording.load(tmp_path / "copy.parquet").robot == "iiwa14"


@pytest.mark.parametrize("header", [b"{", b"[1]", b"\xff", None])
def test_recording_without_a_readable_header_names_no_robot(tmp_path, header):
    path = sine_run(tmp_path / "run.parquet", "iiwa14")
    metadata = None if header is None else {METADATA_KEY: header}
    pq.write_table(pq.read_table(path).replace_schema_metadata(metadata), path)
    recording = Recording.load(path)
    assert recording.robot == ""
    warned = any("header limo.recording is no JSON object" in text for text in recording.warnings)
    assert warned == (header is not None)


def test_finished_log_reads_the_same(tmp_path):
    record(tmp_path / "run.parquet", 10)
    assert read_log(tmp_path / "run.parquet").equals(pq.read_table(tmp_path / "run.parquet"))


def test_stale_states_are_not_recorded(tmp_path):
    with Recorder(tmp_path / "run.parquet", 2, {}) as recorder:
        recorder.append(state(0))
        recorder.append(state(0, stale=True))
        recorder.append(state(2))
    assert pq.read_table(tmp_path / "run.parquet")["time"].to_pylist() == [0.0, 0.002]


def test_states_without_target_have_none(tmp_path):
    with Recorder(tmp_path / "run.parquet", 2, {}) as recorder:
        recorder.append(state(0))
    assert pq.read_table(tmp_path / "run.parquet")["target_position_1"].to_pylist() == [None]


def test_error_in_the_session_keeps_the_recording(tmp_path):
    def session():
        with Recorder(tmp_path / "run.parquet", 2, {}) as recorder:
            recorder.append(state(0))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        session()
    assert pq.read_table(tmp_path / "run.parquet").num_rows == 1


def test_close_is_idempotent(tmp_path):
    recorder = record(tmp_path / "run.parquet", 3)
    recorder.close()
    assert read_log(tmp_path / "run.parquet").num_rows == 3


def test_the_header_is_on_the_disk_before_the_first_row(tmp_path):
    path = tmp_path / "run.parquet"
    recorder = Recorder(path, 2, {"robot": "two"})
    left = read_log(partial_path(path))  # as a kill would leave it
    assert left.num_rows == 0
    assert read_header(left) == {"limo": written_by.installed(), "robot": "two"}
    recorder.close()


@sampled("flushes", [1, 4], "starts and kills a process each")
def test_killed_process_keeps_all_that_was_flushed(tmp_path, flushes):
    assert FLUSH_PERIOD <= 0.25  # [s], so that at most the last second is lost
    path = tmp_path / "run.parquet"
    command = [sys.executable, "-c", WRITER, str(path)]
    told = [0]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        while len(set(told)) <= flushes:
            told.append(int(child.stdout.readline()))
        os.kill(child.pid, signal.SIGKILL)
        told += [int(line) for line in child.stdout.read().splitlines()]
    assert child.returncode == -signal.SIGKILL
    assert not path.exists()
    table = read_log(partial_path(path))
    assert read_header(table) == {"limo": written_by.installed(), "robot": "two"}
    kept = table["time"].to_numpy()
    assert np.array_equal(table["position_1"].to_numpy(), np.arange(len(kept)))
    assert len(kept) >= told[-1]


def killed_run(path):
    """Record over `path` in another process and kill it with -9."""
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        while not int(child.stdout.readline()):  # rows on the disk
            pass
        os.kill(child.pid, signal.SIGKILL)
    assert child.returncode == -signal.SIGKILL


def test_a_killed_rerun_is_told_when_the_older_recording_is_read(tmp_path):
    path = sine_run(tmp_path / "run.parquet", "iiwa14")
    assert not any("never finished" in text for text in Recording.load(path).warnings)
    killed_run(path)
    recording = Recording.load(path)
    assert len(recording) == 600  # the older one, and it says so
    assert any("run.parquet.partial beside it" in text for text in recording.warnings)


@pytest.mark.slow("starts and kills a process")
def test_the_log_of_a_killed_run_is_not_written_over(tmp_path):
    path = tmp_path / "run.parquet"
    killed_run(path)
    left = partial_path(path).read_bytes()
    with pytest.raises(RecordingError, match="rename it to keep it"):
        Recorder(path, 2, {})
    assert partial_path(path).read_bytes() == left
    partial_path(path).rename(tmp_path / "kept.parquet.partial")
    record(path, 3)
    assert read_log(path).num_rows == 3
    assert read_log(tmp_path / "kept.parquet.partial").num_rows > 0


def test_a_folder_is_refused_before_anything_is_recorded(tmp_path):
    with pytest.raises(RecordingError, match="it is a folder"):
        Recorder(tmp_path, 2, {})
    assert not partial_path(tmp_path).exists()


def test_log_cut_anywhere_reads_up_to_its_last_complete_batch(tmp_path):
    path = tmp_path / "run.parquet"
    recorder = Recorder(path, 2, {"robot": "two"})
    sizes = []
    for k in range(30):
        recorder.append(state(k))
        recorder._flush()
        sizes.append(partial_path(path).stat().st_size)
    whole = partial_path(path).read_bytes()
    recorder.close()
    cut = tmp_path / "cut.parquet.partial"
    for length in range(sizes[0], len(whole), 97):
        cut.write_bytes(whole[:length])
        complete, said = sum(size <= length for size in sizes), []
        assert read_log(cut, said.append).num_rows == complete
        assert len(said) == 1  # that it has no end


def test_a_flipped_bit_of_a_log_costs_its_batch_at_most_and_is_told(tmp_path):
    path = tmp_path / "run.parquet"
    recorder = Recorder(path, 2, {"robot": "two"})
    for k in range(8):
        recorder.append(state(k))
        recorder._flush()
    begun = partial_path(path).read_bytes()
    recorder.close()
    known = read_log(path).to_pydict()
    damaged = tmp_path / "damaged.parquet.partial"
    unchanged = 0
    for at in range(len(begun) // 4, len(begun), 53):
        flipped = bytearray(begun)
        flipped[at] ^= 1 << at % 8
        damaged.write_bytes(flipped)
        said = []
        try:
            rows = read_log(damaged, said.append)
        except RecordingError:
            continue
        assert said
        for name, values in rows.to_pydict().items():
            assert set(values) <= set(known[name])
        unchanged += rows.num_rows == len(known["time"])
    assert unchanged < 200  # of what is padding


@pytest.mark.parametrize("content", [b"", b"time,position_1\n0,0\n", b"\x00" * 64])
def test_file_that_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "other.partial"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"other\.partial: is no log of limo's"):
        read_log(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="No such file"):
        read_log(tmp_path / "none.parquet")


def test_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere.run\.parquet: cannot be written"):
        Recorder(tmp_path / "nowhere" / "run.parquet", 2, {})


def test_a_disk_that_was_full_for_a_while_costs_no_row(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "AGAIN", 0.01)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    path, tries = tmp_path / "run.parquet", []
    recorder = Recorder(path, 2, {})
    sync = recorder._sync
    monkeypatch.setattr(recorder, "_sync", lambda: (tries.append(0), sync()))
    resource.setrlimit(resource.RLIMIT_FSIZE, (partial_path(path).stat().st_size + 100, before[1]))
    try:
        for k in range(400):
            recorder.append(state(k))
        wait_until(lambda: len(tries) > 3)
        assert read_log(partial_path(path)).num_rows == 0
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    for k in range(400, 500):
        recorder.append(state(k))
    recorder.close()
    assert read_log(path)["position_1"].to_pylist() == list(range(500))
    assert [each.name for each in tmp_path.iterdir()] == ["run.parquet"]


def test_full_disk_is_reported_and_not_forgotten(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST_WAITING", 0)
    recorder = Recorder(tmp_path / "run.parquet", 2, {})

    def full():
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder._sync = full
    recorder.append(state(0))
    recorder._thread.join(timeout=120)
    recorder.append(state(1))  # who controls an arm has other cares
    assert not recorder._rows
    with pytest.raises(
        RecordingError, match=r"No space left.*what was written is in .*run\.parquet\.partial"
    ):
        recorder.close()
    recorder._file.close()
