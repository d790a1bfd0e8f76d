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
