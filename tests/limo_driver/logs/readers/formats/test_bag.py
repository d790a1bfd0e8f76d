"""Joint states in ROS 2 bags: of one robot among others, and in bags that were cut off."""

import re
import sqlite3

import numpy as np
import pytest
import zstandard
from logged import arm, measured
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.recordings.recording import Recording

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
STAMPS = 1_700_000_000 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
STORE = get_typestore(Stores.ROS2_HUMBLE)
JointState = STORE.types["sensor_msgs/msg/JointState"]
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]
NAMES = arm().joint_names


def bag(path, messages, storage=StoragePlugin.SQLITE3):
    """Write joint states (topic, names, rows) with a writer that shares no code with ours."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        topics = {}
        for topic, names, columns in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(
                    topic, JointState.__msgtype__, typestore=STORE
                )
            for k, stamp in enumerate(STAMPS.tolist()):
                header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
                values = (POSITION, VELOCITY, TORQUE)
                own = [np.ascontiguousarray(v[k, columns]) for v in values]
                data = STORE.serialize_cdr(JointState(header, names, *own), JointState.__msgtype__)
                writer.write(topics[topic], stamp, data)
    return path


ORDER = [2, 0, 6, 5, 4, 3, 1]
SHUFFLED = ("/joint_states", [NAMES[j] for j in ORDER], ORDER)
GRIPPER = ("/joint_states", ["finger_left", "finger_right"], [0, 1])
OTHER = ("/other/joint_states", ["left_knee", "right_knee"], [0, 1])


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_joints_of_a_bag_come_by_name_beside_a_gripper(tmp_path, storage):
    path = bag(tmp_path / "bag", [SHUFFLED, GRIPPER, OTHER], storage)
    table = read_table(path, joints=NAMES)
    np.testing.assert_array_equal(table.columns["time"], STAMPS)
    for j, name in enumerate(NAMES):
        np.testing.assert_array_equal(table.columns[f"position.{name}"], POSITION[:, j])
        np.testing.assert_array_equal(table.columns[f"effort.{name}"], TORQUE[:, j])
    assert "left aside: 500 messages of finger_left, finger_right" in table.notes[-1]


def test_joints_of_a_bag_named_like_an_ampere_are_joints(tmp_path):
    shuffled = ("/joint_states", [f"A{j + 1}" for j in ORDER], ORDER)
    table = read_table(bag(tmp_path / "bag", [shuffled]), joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.position.columns == tuple(f"position.A{j}" for j in range(1, 8))
    assert mapping.position.unit == ("rad",)
    assert mapping.torque.unit == ("N m",)
    assert mapping.velocity.unit == ("rad/s",)


def test_a_bag_without_its_metadata_is_read_as_a_file(tmp_path):
    path = bag(tmp_path / "bag", [SHUFFLED])
    (path / "metadata.yaml").unlink()
    (file,) = path.glob("*.db3")
    assert read_table(file, joints=NAMES).rows == TIME.size


def test_a_packed_bag(tmp_path):
    (file,) = bag(tmp_path / "bag", [SHUFFLED]).glob("*.db3")
    packed = tmp_path / "bag.db3.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress(file.read_bytes()))
    assert read_table(packed, joints=NAMES).rows == TIME.size


@pytest.mark.parametrize("part", [0.75, 0.9])
def test_a_bag_that_is_cut_off_is_read_as_far_as_it_goes(tmp_path, part):
    (file,) = bag(tmp_path / "bag", [SHUFFLED]).glob("*.db3")
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * part)])
    table = read_table(file, joints=NAMES)
    assert 0.5 * TIME.size < table.rows < TIME.size
    assert re.search(r"is damaged after \d+ messages and was read up to there", table.notes[0])


@pytest.mark.parametrize("kept", [50, 3000, 8192])
def test_a_bag_of_which_hardly_anything_is_left_is_called_damaged(tmp_path, kept):
    (file,) = bag(tmp_path / "bag", [SHUFFLED]).glob("*.db3")
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(RecordingError, match=r"is damaged or cut off|is no SQLite file"):
        read_table(file, joints=NAMES)


def test_topics_that_could_both_be_meant_are_named(tmp_path):
    both = [
        ("/left/joint_states", list(NAMES), range(7)),
        ("/right/joint_states", list(NAMES), range(7)),
    ]
    path = bag(tmp_path / "bag", [(t, n, list(c)) for t, n, c in both])
    with pytest.raises(RecordingError, match=r"meant: 500 messages .* on /left.* on /right.*topic"):
        read_table(path, joints=NAMES)
    assert read_table(path, topic="/left/joint_states", joints=NAMES).rows == TIME.size


def test_two_arms_in_one_message_are_a_question(tmp_path):
    names = [f"{side}_{name}" for side in ("left", "right") for name in NAMES]
    path = bag(tmp_path / "bag", [("/joint_states", names, [*range(7), *ORDER])])
    questions = propose(read_table(path, joints=NAMES), arm()).mapping.undecided
    assert "position.left_joint1 … position.left_joint7 or position.right_joint1" in questions[0]


def test_a_bag_of_something_else_says_what_it_holds(tmp_path):
    with sqlite3.connect(tmp_path / "other.db3") as other:
        other.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        other.execute("CREATE TABLE messages (id, topic_id, timestamp, data)")
        other.execute("INSERT INTO topics VALUES (1, '/scan', 'sensor_msgs/msg/LaserScan', 'cdr')")
        other.execute("INSERT INTO messages VALUES (1, 1, 0, x'00')")
    other.close()
    with pytest.raises(RecordingError, match=r"it holds /scan \(sensor_msgs/msg/LaserScan\)"):
        read_table(tmp_path / "other.db3")


def stamped(path, stamps):
    """Write joint states with these stamps, received at the times of the motion."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/joint_states", JointState.__msgtype__, typestore=STORE)
        for k, stamp in enumerate(stamps.tolist()):
            header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
            state = JointState(header, list(NAMES), *(v[k] for v in (POSITION, VELOCITY, TORQUE)))
            data = STORE.serialize_cdr(state, JointState.__msgtype__)
            writer.write(topic, int(STAMPS[k]), data)
    return read_table(path, joints=NAMES)


def test_stamps_that_were_never_set_are_the_times_of_receipt(tmp_path):
    table = stamped(tmp_path / "bag", np.zeros_like(STAMPS))
    np.testing.assert_array_equal(table.columns["time"], STAMPS)
    assert f"{TIME.size} messages have no stamp (0): their times are those at" in table.notes[0]


def test_messages_that_were_overtaken_are_put_in_order(tmp_path):
    stamps = STAMPS.copy()
    stamps[100:104] = stamps[[101, 102, 103, 100]]
    table = stamped(tmp_path / "bag", stamps)
    np.testing.assert_array_equal(table.columns["time"], STAMPS)
    first = f"position.{NAMES[0]}"
    np.testing.assert_array_equal(table.columns[first][100:104], POSITION[[103, 100, 101, 102], 0])
    assert "1 messages were logged after one with a later stamp" in table.notes


def test_a_clock_of_a_bag_that_was_set_back_stays_in_the_order_of_the_messages(tmp_path):
    stamps = np.where(np.arange(TIME.size) >= 250, STAMPS - 400_000_000, STAMPS)
    table = stamped(tmp_path / "bag", stamps)
    np.testing.assert_array_equal(table.columns["time"], stamps)
    mapping = propose(table, arm()).mapping
    recording = Recording.from_columns(mapping.columns(table, arm()))
    assert [part.start for part in recording.segments] == [0, 250]
    assert "the clock was set back by 0.4 s at row 250" in " ".join(recording.warnings)


def test_two_publishers_on_one_topic_are_refused(tmp_path):
    stamps = np.where(np.arange(TIME.size) % 2, STAMPS, STAMPS + 10**9)
    with pytest.raises(RecordingError, match="backwards at 50% of the messages; are these two pub"):
        stamped(tmp_path / "bag", stamps)


def test_efforts_that_hold_no_number_are_named(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "TORQUE", np.full_like(TORQUE, np.nan))
    table = read_table(bag(tmp_path / "bag", [SHUFFLED]), joints=NAMES)
    assert table.unread == {"effort": "no number in any message"}
    mapping = propose(table, arm()).mapping
    with pytest.raises(RecordingError, match=r"no measured torque \(effort holds no number in any"):
        mapping.columns(table, arm())
