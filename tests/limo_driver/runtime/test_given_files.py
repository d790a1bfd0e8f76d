"""Small or strange files are refused in one line before they cost time or memory.

`benchmarks/files/bombs.py` prints what each costs a whole command.
"""

import json
import os
import signal
import sqlite3
import struct
import subprocess
import threading
import time
import zipfile
import zlib
from contextlib import closing
from importlib import import_module

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.logs.mcap_file import read_mcap
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording
from limo_driver.runtime import processes
from limo_driver.runtime.declarations import read_json, read_yaml
from limo_driver.runtime.given_files import ReadingBudget, apart, check_file
from limo_driver.trajectory import Trajectory

PATIENCE = 60.0  # [s]; matters only where something waits for ever
READERS = {
    "sim.yaml": read_yaml,
    "aliases.json": lambda path: read_json(path, ConfigError, 1),
    "log.mcap": lambda path: list(read_mcap(path)),
    "log.csv": read_table,
    "log.parquet": read_table,
    "log.npz": read_table,
    "log.db3": read_table,
    "motion.traj.parquet": Trajectory.load,
    "arm.urdf": RobotModel.load,
    "run.parquet": Recording.load,
    "run.csv": Recording.load,
}


def refused(read, path):
    """Return the line with which a reader refuses a file, on a thread that may be left behind."""
    said = []

    def run():
        try:
            read(path)
        except LimoError as error:
            said.append(str(error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert not thread.is_alive(), "it is still read"
    [line] = said
    assert "\n" not in line
    assert path.name in line
    return line


@pytest.mark.parametrize("name", READERS)
def test_links_to_devices_are_refused(tmp_path, name):
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    refused(READERS[name], path)


@pytest.mark.parametrize("name", READERS)
def test_pipes_are_refused(tmp_path, name):
    path = tmp_path / name
    os.mkfifo(path)
    refused(READERS[name], path)


@pytest.mark.parametrize("newline", ["\n", ""])
def test_tables_of_too_many_columns_are_refused(tmp_path, newline):
    path = tmp_path / "wide.csv"
    names = ",".join(["time", *(f"position_{k}" for k in range(1, 100_000))])
    path.write_text(names + newline + ",".join(["0.0"] * 100_000) + newline)
    for read in (read_table, Recording.load):
        assert "has a first line of more than 65536 bytes" in refused(read, path)


def test_robots_of_too_many_joints_are_refused(tmp_path):
    path = tmp_path / "chain.urdf"
    joint = '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/></joint>'
    joints = "".join(f'<link name="l{k}"/>' + joint.format(k, k + 1) for k in range(20_000))
    path.write_text(f'<robot name="chain">{joints}</robot>')
    assert "has 20000 joints, expected at most 1000" in refused(RobotModel.load, path)


def test_simulations_of_too_many_effects_are_refused(tmp_path):
    path = tmp_path / "sim.yaml"
    effect = "  - {effect: viscous_friction, joint: 1, coefficient: 1.0}\n"
    path.write_text("robot: iiwa14\neffects:\n" + effect * 60_000)
    assert "expected at most 262144" in refused(read_yaml, path)


def wide(path):
    """Write an array of 10^12 rows of no width in a few hundred bytes."""
    with zipfile.ZipFile(path, "w") as file, file.open("q.npy", "w") as array:
        shape = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 0)}
        np.lib.format.write_array_header_1_0(array, shape)


def many(path):
    """Write more arrays than a log has, of a row each."""
    np.savez_compressed(path, **{f"a{k}": np.zeros(1) for k in range(5000)})


def computed(path):
    """Write a bag whose messages SQLite computes for ever."""
    with closing(sqlite3.connect(path)) as bag:
        bag.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        bag.execute(
            "CREATE VIEW messages AS WITH RECURSIVE m(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM m) SELECT id, 1 topic_id, id timestamp, x'00' data FROM m"
        )


def packed(path):
    """Write a matrix of 320 MB that is packed a thousand times."""
    count, packing = 40_000_000, zlib.compressobj(1)
    head = [14, 8 * count + 48, 6, 8, 6, 0, 5, 8, count, 1, 1 << 16 | 1, ord("q"), 9, 8 * count]
    data = packing.compress(struct.pack("<14I", *head)) + b"".join(
        packing.compress(bytes(count)) for _ in range(8)
    )
    data += packing.flush()
    start = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2sII", 0x100, b"IM", 15, len(data))
    path.write_bytes(start + data)


def textual(path):
    """Write episodes whose times are texts."""
    (path / "meta").mkdir(parents=True)
    (path / "data").mkdir()
    features = {"observation.state": {"names": {"motors": ["a"]}}}
    info = {"codebase_version": "v2.1", "fps": 100, "total_episodes": 1, "features": features}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    table = {"observation.state": [[0.0]], "timestamp": ["soon"], "episode_index": [0]}
    pq.write_table(pa.table(table), path / "data" / "file-000.parquet")


def garbled(path):
    """Write texts that are none."""
    pq.write_table(pa.table({"note": pa.array([b"\xee"]).cast(pa.string(), safe=False)}), path)


def renamed(path):
    """Write a bag whose table has no name of UTF-8."""
    with closing(sqlite3.connect(path)) as bag:
        bag.execute("CREATE TABLE topics(id, name, type, serialization_format)")
    path.write_bytes(path.read_bytes().replace(b"TABLE topics", b"TABLE t\xeepics"))


def nested(path):
    """Write a description of a data set that is nested deeply."""
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text("[" * 100_000)


@pytest.mark.parametrize(
    ("name", "write", "said"),
    [
        ("log.npz", wide, "holds no rows of numbers"),
        ("log.npz", many, "has 5000 columns, expected at most 4096"),
        ("log.db3", computed, "a table is computed"),
        ("log.mat", packed, "more than 256 MiB of memory to read"),
        ("digits.json", lambda path: path.write_text(f'[{{"t": {"1" * 5000}}}]'), "thousands of"),
        ("large.json", lambda path: path.write_text(f'[{{"t": {2**70}}}, {{"t": 1}}]'), "alike"),
        ("half.json", lambda path: path.write_text('[{"t": "\\ud800"}]'), "half of a character"),
        ("log.parquet", garbled, "Invalid UTF8"),
        ("log.db3", renamed, "is damaged"),
        ("texts", textual, "row 0 is 'soon', expected a number"),
        ("deep", nested, "nested far deeper than a log"),
    ],
)
def test_logs_that_would_take_minutes_or_all_memory_are_refused(tmp_path, name, write, said):
    path = tmp_path / name
    write(path)
    began = time.thread_time()
    with pytest.raises(RecordingError, match=said) as refused:
        limo.read(path, "iiwa14")
    assert "\n" not in str(refused.value)
    assert name in str(refused.value)
    assert time.thread_time() - began < ReadingBudget.seconds


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        pytest.param(
            '<worldbody><replicate count="9999"><replicate count="50"><geom size="1"/>'
            "</replicate></replicate></worldbody>",
            "s of CPU time to read",
            marks=pytest.mark.slow("takes all of its budget"),
        ),
        (
            '<worldbody><replicate count="65536"><geom size="1"/></replicate></worldbody>',
            "its replicate '' has 65536 copies, expected at most 10000",
        ),
        (
            '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
            "its hfield 'h' has 60000 x 60000 values, expected at most 67108864",
        ),
    ],
)
def test_robots_that_unpack_without_end_are_refused(tmp_path, inside, said):
    path = tmp_path / "arm.xml"
    path.write_text(f'<mujoco model="small">{inside}</mujoco>')
    with pytest.raises(ConfigError, match=said) as refusal:  # its time is that of the CPU
        RobotModel.load(path)
    assert "\n" not in str(refusal.value)
    assert path.name in str(refusal.value)


class Looks(threading.Event):
    """Looks that take no time, of which there are a few hundred."""

    def wait(self, timeout=None):  # noqa: ARG002  # as an event has it
        """Say whether all looks were taken."""
        self.left = getattr(self, "left", 300) - 1
        return self.left < 0


@pytest.mark.parametrize(("script", "ends"), [("while :; do :; done", False), ("read x", True)])
def test_a_reader_that_waits_is_ended_and_one_that_computes_is_not(script, ends):
    with subprocess.Popen(["sh", "-c", script], stdin=subprocess.PIPE) as process:
        idle = threading.Event()
        processes._end_idle(process, Looks(), idle)
        assert idle.is_set() == ends
        if not ends:
            assert process.poll() is None
            process.kill()
    assert process.returncode == -signal.SIGKILL


def test_why_a_reader_was_ended_is_said(tmp_path, monkeypatch):
    (tmp_path / "readers.py").write_text("import signal\ndef waits(path):\n    signal.pause()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(processes, "_LOOK", 0.01)
    path = tmp_path / "log.any"
    path.touch()
    with pytest.raises(RecordingError, match=r"log\.any: is damaged, or .* waited a minute"):
        apart(import_module("readers").waits, path, RecordingError)


def test_folders_and_what_is_not_there_are_left_to_who_opens_them(tmp_path):
    check_file(tmp_path, RecordingError)
    check_file(tmp_path / "none", RecordingError)
