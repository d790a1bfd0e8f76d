"""A log survives whatever happens to the process that writes it, and to the disk."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time
import tracemalloc

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
from rosbags import typesys
from rosbags.rosbag2.storage_mcap import McapReader

from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.mcap_file import McapWriter
from limo_driver.logs.mcap_log import SYNC_PERIOD, LogLimits, McapLog, log_files, read_mcap
from limo_driver.network.messages import JOINT_STATE, LOG, SCHEMAS, Event, JointStateCodec, Level

pytestmark = pytest.mark.waits

CODEC = JointStateCodec(["a", "b"])
TOPIC = "limo/two/state/joints"
START = 1_700_000_000_000_000_000

WRITER = """
import sys, time
import numpy as np
from limo_driver.logs.mcap_log import McapLog
from limo_driver.network.messages import JOINT_STATE, JointStateCodec

codec, log, began = JointStateCodec(["a", "b"]), McapLog(sys.argv[1]), time.monotonic()
for k in range(10**9):
    now = time.time_ns()
    values = np.full(2, float(k))
    log.write("joints", JOINT_STATE, codec.encode(now, values, values, values), now, now, k)
    if k % 10 == 0:
        print(log.written, flush=True)
    time.sleep(max(0.0, began + k * 1e-3 - time.monotonic()))
"""

FULL_DISK = """
import resource, sys, time
import numpy as np
from limo_driver.logs.mcap_log import McapLog
from limo_driver.network.messages import JOINT_STATE

sys.dont_write_bytecode = True  # that would be cut off, and never read again
_, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
failures, random, rounds = [], np.random.default_rng(0), []
log = McapLog(sys.argv[1], on_failure=failures.append)
pause = log._closing.wait
log._closing.wait = lambda seconds: rounds.append(seconds) or pause(seconds)

def write(first, last):
    for k in range(first, last):
        log.write("joints", JOINT_STATE, random.bytes(1000), k, k, k)

def until(condition):
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline, vars(log)
        time.sleep(0.01)

write(0, 50)
until(lambda: log.written == 50)
write(50, 150)
until(lambda: failures)
write(150, 160)  # has no effect but to be counted
seen = len(rounds)
until(lambda: len(rounds) > seen + 50)  # it goes on, and says nothing more
assert len(failures) == 1, failures
assert log.failure is failures[0]
assert log.written == 50
stopped = log.dropped
assert 10 < stopped <= 110, stopped  # what still waits in the queue is not lost
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
log.resume()
write(160, 180)
log.close()
log.close()
assert (log.dropped, log.failure) == (stopped, None), (log.dropped, log.failure)
assert log.written + log.dropped == 180, (log.written, log.dropped)
print(log.written, failures[0])
"""


def write(log, first, last, topic=TOPIC):
    for k in range(first, last):
        values = np.full(2, float(k))
        payload = CODEC.encode(START + k, values, values, values)
        log.write(topic, JOINT_STATE, payload, START + k, START + k - 1, k)


def until(condition):
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def sequences(path, tell=None):
    return [message.sequence for message in read_mcap(path, tell)]


def logged(folder, count=100):
    with McapLog(folder) as log:
        write(log, 0, count)
    (path,) = log_files(folder)
    return path


def test_what_is_written_is_read_back(tmp_path):
    with McapLog(tmp_path / "new" / "logs") as log:
        write(log, 0, 100)
        event = Event(START, Level.INFO, "log", "begun").encode()
        log.write("limo/two/events", LOG, event, START, START, 2**32 + 3)
    assert (log.written, log.dropped) == (101, 0)
    (path,) = log_files(tmp_path / "new" / "logs")
    told = []
    *states, last = read_mcap(path, told.append)
    assert not told
    assert [m.sequence for m in states] == list(range(100))
    assert (states[7].topic, states[7].schema) == (TOPIC, JOINT_STATE)
    assert (states[7].log_time_ns, states[7].publish_time_ns) == (START + 7, START + 6)
    assert CODEC.decode(states[7].payload).position.tolist() == [7.0, 7.0]
    assert (last.topic, last.payload, last.sequence) == ("limo/two/events", event, 3)


def test_other_readers_read_it(tmp_path):
    path = logged(tmp_path)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == 100
        rows = list(reader.iter_messages())
    schema, channel, message = rows[7]
    assert (schema.name, schema.encoding) == (JOINT_STATE, "ros2msg")
    assert (channel.topic, channel.message_encoding) == (TOPIC, "cdr")
    store.register(typesys.get_types_from_msg(schema.data.decode(), schema.name))
    state = store.deserialize_cdr(message.data, schema.name)
    assert (state.name, state.effort.tolist()) == (["a", "b"], [7.0, 7.0])


def test_a_reader_of_ros_bags_reads_it(tmp_path):
    """rosbags parses MCAP by itself, without the package that wrote the file."""
    bag = McapReader(logged(tmp_path))
    bag.open()
    (connection,) = bag.connections
    assert (connection.topic, connection.msgtype) == (TOPIC, JOINT_STATE)
    rows = [
        (stamp, CODEC.decode(data).position[0]) for _, stamp, data in bag.messages([connection])
    ]
    assert rows == [(START + k, float(k)) for k in range(100)]
    bag.close()


@pytest.mark.parametrize(
    ("syncs", "more"),
    [
        (2, 7),
        pytest.param(1, 0, marks=pytest.mark.slow("starts and kills a process each")),
        pytest.param(4, 16, marks=pytest.mark.slow("starts and kills a process each")),
    ],
)
def test_killed_process_keeps_all_that_was_synced(tmp_path, syncs, more):
    """Whatever it does when it is killed: so many tens of messages after a sync."""
    assert SYNC_PERIOD <= 0.25  # [s], so that less than a second is lost
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        told = [0]
        while len(set(told)) <= syncs:
            told.append(int(process.stdout.readline()))
        told += [int(process.stdout.readline()) for _ in range(more)]
        process.send_signal(signal.SIGKILL)
        told += [int(line) for line in process.stdout.read().splitlines()]
    (path,) = log_files(tmp_path)
    warnings = []
    messages = list(read_mcap(path, warnings.append))
    assert len(warnings) == 1
    assert "was never finished" in warnings[0]
    assert [m.sequence for m in messages] == list(range(len(messages)))  # no hole before the end
    assert told[-1] <= len(messages) <= 10 * len(told)


def test_full_disk_stops_logging_until_resumed(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "File too large" in done.stdout
    full, resumed = log_files(tmp_path)
    told = []
    before, after = sequences(full, told.append), sequences(resumed)
    assert "was never finished" in told[0]
    assert before[:50] == list(range(50))
    assert after[-20:] == list(range(160, 180))
    assert before + after == sorted({*before, *after} - set(range(150, 160)))
    assert len(before + after) >= int(done.stdout.split()[0])


@pytest.mark.parametrize("cut", ["header", "first chunk", "last chunk", "index"])
def test_cut_off_file_is_read_to_its_last_complete_chunk(tmp_path, cut):
    with McapLog(tmp_path) as log:
        write(log, 0, 50)
        until(lambda: log.written == 50)
        first = log_files(tmp_path)[0].stat().st_size
        write(log, 50, 100)
        until(lambda: log.written == 100)
        second = log_files(tmp_path)[0].stat().st_size
    (path,) = log_files(tmp_path)
    size, expected = {
        "header": (30, 0),
        "first chunk": (200, 0),
        "last chunk": (first + 100, 50),
        "index": (second + 20, 100),  # the data end with a record of 13 bytes
    }[cut]
    os.truncate(path, size)
    told = []
    assert sequences(path, told.append) == list(range(expected))
    if cut == "index":
        assert not told
    else:
        assert f"of {size} bytes, the rest is cut off" in told[0]


def test_zeros_that_were_never_written_are_no_messages(tmp_path):
    path = logged(tmp_path)
    whole = path.read_bytes()
    with path.open("r+b") as file:
        file.truncate(200)  # within the chunk
        file.truncate(len(whole))
    told = []
    assert sequences(path, told.append) == []
    assert "damaged" in told[0]
    path.write_bytes(whole[:30] + bytes(1000))
    assert sequences(path, told.append) == []
    assert "never finished" in told[1]


def test_any_damage_is_told_and_never_more_than_that(tmp_path):
    path = logged(tmp_path, 20)
    whole = path.read_bytes()
    random, told = np.random.default_rng(0), []
    for k in range(600):
        damaged, at = bytearray(whole), int(random.integers(8, len(whole) - 8))
        if k % 2:
            damaged[at] ^= int(random.integers(1, 256))
        else:
            damaged[at : at + 8] = b"\xff" * 8  # the largest length there is
        path.write_bytes(damaged)
        read = sequences(path, told.append)
        assert read in ([], list(range(20)))
    assert len(told) > 30


@pytest.fixture(scope="module")
def chunked(tmp_path_factory):
    """Write a log of ten chunks of 20; return its bytes with the places of their contents."""
    folder, chunks, each = tmp_path_factory.mktemp("chunked"), 10, 20
    with McapLog(folder) as log:
        ends = []
        for k in range(chunks):
            write(log, k * each, (k + 1) * each)
            until(lambda n=(k + 1) * each: log.written == n)
            ends.append(log_files(folder)[0].stat().st_size)
    (path,) = log_files(folder)
    return path.read_bytes(), ends


@pytest.mark.parametrize("hit", [(4,), (0, 5, 9), tuple(range(10))])
def test_a_damaged_byte_costs_its_chunk_alone_and_is_told(tmp_path, chunked, hit):
    """Also the first chunk, in which the channels are: they stand at the end of the file, too."""
    path, (whole, ends) = tmp_path / "damaged.mcap", chunked
    damaged = bytearray(whole)
    for k in hit:
        damaged[(ends[k - 1] if k else 100) + 150] ^= 0x10
    path.write_bytes(damaged)
    told = []
    left = [k for k in range(200) if k // 20 not in hit]
    assert sequences(path, told.append) == left
    assert len(told) == 1
    assert "damaged in " in told[0]
    assert f"{len(left)} of 200 messages are left" in told[0]


@pytest.mark.parametrize("byte", range(9))
def test_damage_in_the_head_of_a_chunk_costs_that_chunk_alone(tmp_path, chunked, byte):
    path, (whole, ends) = tmp_path / "damaged.mcap", chunked
    at = whole.index(b"\x06", ends[3])  # behind the index of the one before
    for flip in (0x01, 0x80):
        damaged = bytearray(whole)
        damaged[at + byte] ^= flip
        path.write_bytes(damaged)
        told = []
        read = sequences(path, told.append)
        assert set(range(200)) - set(read) <= set(range(80, 100))
        assert told or len(read) == 200


def bomb(size, packed=None, says=None):
    """An MCAP file with one chunk of zstd that unpacks to zeros."""
    content = zstandard.ZstdCompressor(level=19).compress(bytes(size)) if packed is None else packed
    record = struct.pack("<QQQI", 0, 0, size if says is None else says, 0)
    record += struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(content)) + content
    header = struct.pack("<II", 0, 0)
    return (
        MCAP0_MAGIC
        + struct.pack("<BQ", 1, len(header)) + header
        + struct.pack("<BQ", 6, len(record)) + record
        + struct.pack("<BQI", 15, 4, 0)
    )  # fmt: skip


@pytest.mark.slow("packs 256 MiB each")
@pytest.mark.parametrize("says", [1 << 28, 1 << 20, (1 << 63) - 1])
def test_a_small_chunk_that_unpacks_to_much_is_left_out(tmp_path, says):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb(1 << 28, says=says))
    assert path.stat().st_size < 10_000
    told = []
    tracemalloc.start()
    assert sequences(path, told.append) == []
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "would unpack to" in told[0]
    assert most < 10e6  # [bytes]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"\x89MCAP1\r\n"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"x\.mcap: is no MCAP file"):
        list(read_mcap(path))
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        list(read_mcap(tmp_path / "missing.mcap"))


def test_files_rotate_by_size_and_the_oldest_go(tmp_path):
    other = tmp_path / "limo_other_20200101T000000.000000Z.mcap"
    other.write_bytes(bytes(10**6))
    with McapLog(tmp_path, limits=LogLimits(file_bytes=2000, total_bytes=9000)) as log:
        for k in range(0, 400, 50):
            write(log, k, k + 50)
            until(lambda n=k + 50: log.written == n)
    files = log_files(tmp_path, "limo")
    sizes = [path.stat().st_size for path in files]
    assert 1 < len(files) < 8
    assert sum(sizes[:-1]) <= 9000
    assert files == sorted(files)
    kept = [k for path in files for k in sequences(path)]
    assert kept == list(range(kept[0], 400))
    assert kept[0] > 0
    assert other.exists()  # belongs to a log of another name


def test_files_rotate_by_age_and_old_ones_go(tmp_path):
    old = tmp_path / "limo_20200101T000000.000000Z.mcap"
    old.write_bytes(b"")
    os.utime(old, (time.time() - 100,) * 2)
    young = tmp_path / "limo_20200102T000000.000000Z.mcap"
    young.write_bytes(b"")
    with McapLog(tmp_path, limits=LogLimits(file_seconds=0.1, total_seconds=50)) as log:
        for k in range(3):
            write(log, k, k + 1)
            until(lambda n=k + 1: log.written == n)
            until(lambda: log._file is None)
    files = log_files(tmp_path)
    assert old not in files
    assert files[0] == young
    assert [sequences(path) for path in files[1:]] == [[0], [1], [2]]


def test_queue_that_is_full_drops_and_counts(tmp_path, monkeypatch):
    hanging, released, fsync = threading.Event(), threading.Event(), os.fsync

    def hang(number):
        hanging.set()
        released.wait()
        fsync(number)

    with McapLog(tmp_path, limits=LogLimits(queue=10)) as log:
        monkeypatch.setattr(os, "fsync", hang)
        write(log, 0, 1)
        assert hanging.wait(120.0)
        write(log, 1, 31)  # returns while the disk hangs
        assert (log.written, log.dropped) == (0, 20)
        released.set()
    assert (log.written, log.dropped) == (11, 20)
    assert sequences(log_files(tmp_path)[0]) == list(range(11))


def test_what_cannot_be_logged_is_refused_at_once(tmp_path):
    with McapLog(tmp_path) as log:
        with pytest.raises(ConfigError, match="no schema is called 'std_msgs/msg/Empty'; known: "):
            log.write("x", "std_msgs/msg/Empty", b"", 0, 0)
        with pytest.raises(ConfigError, match="times are -1 and 0 ns"):
            log.write("x", next(iter(SCHEMAS)), b"", -1, 0)
    write(log, 0, 2)
    assert log.dropped == 2  # after the end
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="file: cannot be written to: File exists"):
        McapLog(tmp_path / "file")
    with pytest.raises(ConfigError, match="queue is 0, expected a whole number of 1 or more"):
        LogLimits(queue=0)


def test_any_failure_stops_logging_and_leaves_it_able_to_go_on(tmp_path, monkeypatch):
    failures = []
    with McapLog(tmp_path, on_failure=failures.append) as log:
        with monkeypatch.context() as broken:
            broken.setattr(McapWriter, "add", lambda *_: 1 / 0)
            write(log, 0, 1)
            until(lambda: failures)
        assert isinstance(log.failure, ZeroDivisionError)
        log.resume()
        write(log, 1, 3)
    assert (log.written, log.dropped, len(failures)) == (2, 1, 1)
    assert sequences(log_files(tmp_path)[-1]) == [1, 2]
