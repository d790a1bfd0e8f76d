"""Tables of any format: what is in them, and what cannot be read."""

import gzip
import json
import re
import sqlite3
from contextlib import suppress

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from logged import PERIOD, arm, measured, numbered, written
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.foreign.formats import npz
from limo_driver.foreign.formats.reading import read_table
from limo_driver.foreign.proposals.proposal import propose
from limo_driver.logs.message_layout import MessageLayout

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
STAMPS = 1_700_000_000 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
STORE = get_typestore(Stores.ROS2_HUMBLE)
JointState = STORE.types["sensor_msgs/msg/JointState"]
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]
NAMES = arm().joint_names


def log():
    return {"t": TIME, **numbered("q{}", POSITION), **numbered("tau{}", TORQUE)}


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_text_of_any_separator(tmp_path, separator):
    path = written(log(), tmp_path / "log.txt", separator, comment="# an iiwa\n\n")
    table = read_table(path)
    assert list(table.columns) == list(log())
    np.testing.assert_allclose(table.columns["q3"], POSITION[:, 3], rtol=1e-8)


@pytest.mark.parametrize(
    ("encoding", "note"),
    [("utf-8-sig", ""), ("utf-16", ""), ("utf-16-be", ""), ("cp1252", "taken for that of Windows")],
)
def test_text_of_any_encoding(tmp_path, encoding, note):
    text = "Zeit [ms];Winkel 1 [°]\n" + "".join(f"{k};{k},5\n" for k in range(3))
    path = tmp_path / "log.csv"
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    path.write_bytes(mark + text.encode(encoding))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["Winkel 1 [°]"], [0.5, 1.5, 2.5])
    assert note in " ".join(table.notes)
    assert bool(note) == bool(table.notes)


def test_text_that_is_packed(tmp_path):
    plain = written(log(), tmp_path / "log.csv")
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(plain.read_bytes()))
    np.testing.assert_array_equal(read_table(path).columns["q3"], read_table(plain).columns["q3"])
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(RecordingError, match=re.escape(str(path))) as refused:
        read_table(path)
    assert "\n" not in str(refused.value)


def test_text_with_decimal_commas(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t;q0\n0,0;1,5\n0,1;-2,5e-1\n", encoding="utf-8")
    np.testing.assert_array_equal(read_table(path).columns["q0"], [1.5, -0.25])


@pytest.mark.parametrize("cell", ["", "None", "NaN", "null", "#N/A"])
def test_cells_without_a_value_are_no_text(tmp_path, cell):
    path = tmp_path / "log.csv"
    path.write_text(f"t,q0\n0.0,1.5\n0.1,{cell}\n0.2,2.5\n", encoding="utf-8")
    np.testing.assert_array_equal(read_table(path).columns["q0"], [1.5, np.nan, 2.5])


def test_text_whose_names_stand_in_a_comment(tmp_path):
    path = tmp_path / "log.dat"
    path.write_text("# t q0\n0 1\n1 2\n", encoding="utf-8")
    assert list(read_table(path).columns) == ["t", "q0"]


def test_text_without_names(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("0,1\n1,2\n", encoding="utf-8")
    table = read_table(path)
    assert list(table.columns) == ["column_1", "column_2"]
    assert "no line of names" in table.notes[0]
    assert table.rows == 2


def test_a_column_of_words_is_named_as_unread(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,mode\n0,idle\n1,move\n", encoding="utf-8")
    assert read_table(path).unread == {"mode": "string"}


def test_a_row_that_is_cut_off_is_left_out_and_told(tmp_path):
    path = written(log(), tmp_path / "log.csv")
    text = path.read_text()
    path.write_text(text[: len(text) - 40])
    table = read_table(path)
    assert table.rows == TIME.size - 1
    assert "1 row left out: another number of cells than the 15 of the first line" in table.notes[0]


def test_many_rows_that_are_cut_off_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,q0\n" + "0,1\n" * 20 + "0\n" * 5, encoding="utf-8")
    said = "has 5 rows with another number of cells, expected 2 as in its first line$"
    with pytest.raises(RecordingError, match=said):
        read_table(path)


DAMAGED = [
    ("log.csv", b"", "holds no rows"),
    ("log.csv", b"t,q0,q1,ta", "ends in its first line"),
    ("log.csv", b"\x00\x01\xff\xfe" * 50, "is no text"),
    ("log.csv", b"t,t\n0,1\n", "more than one column t"),
    ("log.csv", b"t,q0\n" + b"0,1\n" * 90 + b"x,1\n", "column t holds text in 1 of 91.* row 90"),
    ("log.parquet", b"PAR1 and no more", "cannot be read as Parquet"),
    ("log.npz", b"PK\x03\x04 and no more", "cannot be read as .npz"),
    ("log.mcap", b"no bag", "is no MCAP file"),
    ("log.db3", b"no bag", "is no SQLite file"),
    ("log.xlsx", b"any", "of a kind that is not known, expected delimited text"),
]


@pytest.mark.parametrize(("name", "content", "said"), DAMAGED)
def test_what_is_damaged_is_refused_in_one_line(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=said) as refused:
        read_table(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_lists_in_parquet_are_columns(tmp_path):
    table = pa.table({"t": TIME, "state": list(POSITION), "odd": [[0.0]] * 499 + [[0.0, 1.0]]})
    pq.write_table(table, tmp_path / "log.parquet")
    read = read_table(tmp_path / "log.parquet")
    np.testing.assert_array_equal(read.columns["state[6]"], POSITION[:, 6])
    assert "different lengths" in read.unread["odd"]


def test_arrays_of_numpy(tmp_path):
    images = np.zeros((len(TIME), 5000))
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, dt=PERIOD, note=np.array(["a"]), i=images)
    read = read_table(tmp_path / "log.npz")
    np.testing.assert_array_equal(read.columns["q[2]"], POSITION[:, 2])
    assert read.unread.keys() == {"note", "i"}
    assert read.unread["i"] == "an array of shape (500, 5000)"


def test_why_arrays_of_numpy_are_not_read_is_said(tmp_path):
    short, texts = np.zeros((len(TIME) - 5, 3)), POSITION.astype(str)
    odd = np.array([{}, 1], dtype=object)
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, tau=short, dq=texts, odd=odd)
    unread = read_table(tmp_path / "log.npz").unread
    assert unread["tau"] == f"an array of shape {short.shape} beside {len(TIME)} rows"
    assert unread["dq"] == "texts"
    assert unread["odd"] == "objects of Python"


@pytest.mark.parametrize("kind", [np.str_, np.bytes_])
def test_an_array_of_texts_names_the_columns_of_others(tmp_path, kind):
    names = np.array([f"arm_{k}" for k in range(7)]).astype(kind)
    path = tmp_path / "log.npz"
    np.savez(path, t=TIME, q=POSITION, wide=np.c_[POSITION, TIME], joint_names=names)
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["q[arm_3]"], POSITION[:, 3])
    assert "wide[7]" in table.columns  # of which they are no names
    assert table.notes == ("joint_names names the columns of arrays as wide",)
    np.savez(path, t=TIME, q=POSITION, joint_names=names, units=np.full(7, "rad").astype(kind))
    assert "q[arm_3]" in read_table(path).columns  # texts that repeat are none
    np.savez(path, t=TIME, q=POSITION, joint_names=names, others=names[::-1])
    found = read_table(path)
    assert "q[3]" in found.columns  # two could be meant
    assert set(found.unread) == {"joint_names", "others"}


def test_arrays_that_are_packed_as_no_log_is_are_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(npz, "_LARGE", 1 << 20)
    np.savez_compressed(tmp_path / "log.npz", t=TIME, q=np.zeros((len(TIME), 4000)))
    with pytest.raises(RecordingError, match=r"unpacks to 15 MiB, \d+ times its size: nearly"):
        read_table(tmp_path / "log.npz")


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


DYNAMIC = """
std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
"""


def dynamic_bag(path, also_joint_states):
    """Dynamic joint states of ros2_control, written by code that is not ours."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = get_types_from_msg(DYNAMIC, "control_msgs/msg/DynamicJointState")
    kinds |= get_types_from_msg(
        "string[] interface_names\nfloat64[] values\n", "control_msgs/msg/InterfaceValue"
    )
    store.register(kinds)
    State = store.types["control_msgs/msg/DynamicJointState"]
    Value = store.types["control_msgs/msg/InterfaceValue"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/dynamic", State.__msgtype__, typestore=store)
        plain = writer.add_connection("/plain", JointState.__msgtype__, typestore=store)
        for k, stamp in enumerate(STAMPS.tolist()):
            header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
            own = [
                Value(["effort", "position"], np.array([TORQUE[k, j], POSITION[k, j]]))
                for j in ORDER
            ]
            state = State(header, [NAMES[j] for j in ORDER], own)
            writer.write(topic, stamp, store.serialize_cdr(state, State.__msgtype__))
            if also_joint_states:
                values = (POSITION[k], VELOCITY[k], TORQUE[k])
                other = JointState(header, list(NAMES), *map(np.ascontiguousarray, values))
                writer.write(plain, stamp, store.serialize_cdr(other, JointState.__msgtype__))
    return path


@pytest.mark.parametrize("also", [False, True])
def test_dynamic_joint_states_are_read_where_there_are_no_others(tmp_path, also):
    table = read_table(dynamic_bag(tmp_path / "bag", also), joints=NAMES)
    assert ("/plain" in table.kind) == also
    np.testing.assert_array_equal(table.columns[f"position.{NAMES[4]}"], POSITION[:, 4])
    np.testing.assert_array_equal(table.columns[f"effort.{NAMES[0]}"], TORQUE[:, 0])
    assert (f"velocity.{NAMES[0]}" in table.columns) == also


POINT = """float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
"""
HEAD = "std_msgs/Header header\n"
FRANKA = "".join(
    f"float64[7] {name}\n" for name in ("q", "q_d", "dq", "theta", "tau_j", "dtau_j", "tau_j_d")
)
NESTED = """# as the arm's own driver has it
CollisionIndicators collision_indicators
sensor_msgs/JointState measured_joint_state
sensor_msgs/JointState desired_joint_state
sensor_msgs/JointState measured_joint_motor_state
float64[7] ddq_d
geometry_msgs/PoseStamped o_t_ee
float64 time
uint8 ROBOT_MODE_IDLE=1
uint8 robot_mode
"""
AXES = "".join(f"float32 a{j}\n" for j in range(1, 8))
TYPES = {
    "trajectory_msgs/msg/JointTrajectoryPoint": POINT,
    "iiwa_msgs/msg/JointQuantity": AXES,
    "iiwa_msgs/msg/JointPosition": HEAD + "JointQuantity position\n",
    "iiwa_msgs/msg/JointTorque": HEAD + "JointQuantity torque\n",
    "franka_msgs/msg/CollisionIndicators": "bool[6] is_contact\nstring<=9[<=3] why\n",
    "franka_msgs/msg/FrankaRobotState": HEAD + NESTED,
    "franka_msgs/msg/FrankaState": HEAD + FRANKA,
    "lab_msgs/msg/Arm": HEAD + "string[] name\nfloat64[] position\nfloat64[] effort\n",
} | {
    f"control_msgs/msg/{name}": HEAD
    + "string[] joint_names\n"
    + "".join(f"trajectory_msgs/JointTrajectoryPoint {field}\n" for field in fields)
    for name, fields in {
        "JointTrajectoryControllerState": ("desired", "actual", "error"),
        "NewerState": ("reference", "feedback", "error", "output"),
    }.items()
}
JTC = "control_msgs/msg/JointTrajectoryControllerState"


def typed_bag(path, storage, topics, name=JTC, types=TYPES):
    """Write messages of types that ROS has not of its own, with their definitions in the bag."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    own = dict(types) | {JTC: types[name]}
    for kind, text in own.items():
        store.register(get_types_from_msg(text, kind))
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic, (kind, make) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, stamp in enumerate(STAMPS.tolist()):
                header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
                message = store.types[kind](header, *make(store.types, k))
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return path


def trajectory_state(fields, torque):
    def make(types, k):
        Point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
        Duration = types["builtin_interfaces/msg/Duration"]
        made = {
            "measured": (POSITION[k], VELOCITY[k], np.zeros(0), TORQUE[k] if torque else None),
            "commanded": (POSITION[k] + 0.01, VELOCITY[k], np.zeros(0), None),
            "other": (np.full(7, 0.01), np.zeros(0), np.zeros(0), None),
        }
        points = []
        for which in fields:
            arrays = [np.zeros(0) if v is None else np.ascontiguousarray(v) for v in made[which]]
            points.append(Point(*[v[ORDER] if v.size else v for v in arrays], Duration(1, 2)))
        return [[NAMES[j] for j in ORDER], *points]

    return make


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize(
    ("name", "fields", "torque"),
    [
        (JTC, ("commanded", "measured", "other"), True),
        (JTC, ("commanded", "measured", "other"), False),
        ("control_msgs/msg/NewerState", ("commanded", "measured", "other", "other"), True),
    ],
)
def test_states_of_trajectory_controllers_have_commands(tmp_path, storage, name, fields, torque):
    topics = {"/arm_controller/state": (JTC, trajectory_state(fields, torque))}
    path = typed_bag(tmp_path / "bag", storage, topics, name)
    table = read_table(path, joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided == ()
    columns = mapping.columns(table, arm())
    np.testing.assert_allclose(columns.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(columns.command, POSITION + 0.01, atol=1e-12)
    np.testing.assert_allclose(columns.time, TIME, atol=1e-9)
    assert np.isnan(columns.torque).all() != torque
    if torque:
        np.testing.assert_allclose(columns.torque, TORQUE, atol=1e-12)


BODIES = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
SIX = ("reference", "feedback", "error", "output", "desired", "actual")


@pytest.mark.parametrize(
    ("points", "bodies"),
    [(("desired", "actual", "error"), False), (("desired", "actual", "error"), True), (SIX, True)],
    ids=["Galactic", "Humble before 4.4", "Humble"],
)
def test_bags_without_definitions_have_the_states_of_controllers(tmp_path, points, bodies):
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = f"{HEAD}string[] joint_names\n"
    text += "".join(f"trajectory_msgs/JointTrajectoryPoint {name}\n" for name in points)
    if bodies:
        text += "string[] multi_dof_joint_names\n"
        text += "".join(f"{BODIES} multi_dof_{name}\n" for name in points)
    store.register(get_types_from_msg(text, JTC))
    which = {"actual": "measured", "feedback": "measured", "error": "other", "output": "other"}
    make = trajectory_state([which.get(name, "commanded") for name in points], torque=True)
    path = tmp_path / "bag"
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/arm/state", JTC, typestore=store)
        Body = store.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
        Duration = store.types["builtin_interfaces/msg/Duration"]
        more = [[], *[Body([], [], [], Duration(0, 0)) for _ in points]] if bodies else []
        for k, stamp in enumerate(STAMPS.tolist()):
            header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
            message = store.types[JTC](header, *make(store.types, k), *more)
            writer.write(topic, stamp, store.serialize_cdr(message, JTC))
    with sqlite3.connect(next(path.glob("*.db3"))) as file:
        file.execute("DROP TABLE IF EXISTS message_definitions")
    file.close()
    table = read_table(path, joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided == ()
    columns = mapping.columns(table, arm())
    np.testing.assert_allclose(columns.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(columns.torque, TORQUE, atol=1e-12)


def nested_state(types, k):
    State = types["sensor_msgs/msg/JointState"]
    Pose = types["geometry_msgs/msg/PoseStamped"]
    origin = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    head, none = Header(Stamp(1, 2), "base"), np.zeros(0)

    def joints(position, effort):
        return State(head, list(NAMES), position, VELOCITY[k], effort)

    collision = types["franka_msgs/msg/CollisionIndicators"](np.zeros(6, dtype=bool), ["a", "bc"])
    return (
        collision,
        joints(POSITION[k], TORQUE[k]),
        joints(POSITION[k] + 0.01, none),
        joints(POSITION[k] + 0.02, none),
        np.zeros(7),
        Pose(head, origin),
        17.0,
        1,
    )


def flat_state(types, k):  # noqa: ARG001
    return (
        POSITION[k],
        POSITION[k] + 0.01,
        VELOCITY[k],
        POSITION[k] + 0.02,
        TORQUE[k],
        0 * TORQUE[k],
        1 + TORQUE[k],
    )


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("franka_msgs/msg/FrankaRobotState", nested_state),
        ("franka_msgs/msg/FrankaState", flat_state),
    ],
)
def test_states_of_franka_arms(tmp_path, storage, kind, make):
    path = typed_bag(tmp_path / "bag", storage, {"/robot_state": (kind, make)})
    table = read_table(path, joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided == ()
    columns = mapping.columns(table, arm())
    np.testing.assert_array_equal(columns.position, POSITION)
    np.testing.assert_array_equal(columns.torque, TORQUE)
    np.testing.assert_array_equal(columns.command, POSITION + 0.01)


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_position_and_torque_on_two_topics_are_one_log(tmp_path, storage):
    def axes(values):
        return lambda types, k: (types["iiwa_msgs/msg/JointQuantity"](*values[k].tolist()),)

    topics = {
        "/iiwa/command/JointPosition": ("iiwa_msgs/msg/JointPosition", axes(POSITION + 0.01)),
        "/iiwa/state/JointPosition": ("iiwa_msgs/msg/JointPosition", axes(POSITION)),
        "/iiwa/state/JointTorque": ("iiwa_msgs/msg/JointTorque", axes(TORQUE)),
    }
    table = read_table(typed_bag(tmp_path / "bag", storage, topics), joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided == ()
    columns = mapping.columns(table, arm())
    np.testing.assert_array_equal(columns.position, POSITION.astype(np.float32))
    np.testing.assert_array_equal(columns.torque, TORQUE.astype(np.float32))
    assert "torques are those of /iiwa/state/JointTorque at the nearest stamp" in table.notes


def labs_state(types, k):  # noqa: ARG001
    return [list(NAMES), POSITION[k], TORQUE[k]]


def test_a_type_that_nobody_knows_is_read_where_its_topic_is_asked_for(tmp_path):
    topics = {"/arm": ("lab_msgs/msg/Arm", labs_state)}
    path = typed_bag(tmp_path / "bag", StoragePlugin.MCAP, topics)
    with pytest.raises(
        RecordingError, match=r"no joint states; it holds /arm \(lab_msgs/msg/Arm\)"
    ):
        read_table(path, joints=NAMES)
    table = read_table(path, topic="/arm", joints=NAMES)
    np.testing.assert_array_equal(table.columns[f"effort.{NAMES[3]}"], TORQUE[:, 3])


def test_a_type_that_the_bag_does_not_define_is_refused_with_what_to_do(tmp_path):
    topics = {"/arm": ("lab_msgs/msg/Arm", labs_state)}
    path = typed_bag(tmp_path / "bag", StoragePlugin.SQLITE3, topics)
    with sqlite3.connect(next(path.glob("*.db3"))) as file:
        file.execute("DROP TABLE message_definitions")
    file.close()
    with pytest.raises(RecordingError, match="the bag does not define it; `ros2 bag convert`"):
        read_table(path, topic="/arm", joints=NAMES)


@pytest.mark.parametrize(
    ("definition", "said"),
    [
        ("pkg/Other other\n", "lacks the type pkg/Other"),
        ("Own own\n", "holds itself"),
        ("float64 = 3\n", "is no field of a message"),
    ],
)
def test_a_definition_that_makes_no_sense_is_refused(definition, said):
    with pytest.raises(WireFormatError, match=said):
        MessageLayout("pkg/msg/Own", definition)


@given(st.binary(max_size=64))
def test_damaged_messages_of_any_type_are_refused(payload):
    layout = MessageLayout("pkg/msg/Own", "string[] name\nfloat64[] q\nuint8[3] a\nint32 b\n")
    with suppress(WireFormatError):
        layout.decode(b"\x00\x01\x00\x00" + payload)


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


class Trap:
    """Runs code where it is read back from a pickle."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was opened",))


def words(folder):
    names = [f"q{j}" for j in range(7)]
    pq.write_table(pa.table({"t": TIME} | {n: ["a"] * TIME.size for n in names}), folder / "l.pq")
    return folder / "l.pq"


def pickled(folder):
    trap = np.empty(TIME.size, dtype=object)
    trap[:] = Trap()
    np.savez(folder / "l.npz", t=TIME, q=trap)
    return folder / "l.npz"


def text_for_numbers(folder):
    path = written(log(), folder / "l.csv")
    path.write_text(path.read_text().replace("\n0", "\nzero", 1))
    return path


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (words, "has no positions of the 7 joints"),
        (pickled, "has no positions of the 7 joints|cannot be read as .npz"),
        (text_for_numbers, "column t holds text in 1 of 500"),
    ],
)
def test_wrong_types_are_refused_in_one_line(tmp_path, make, said):
    with pytest.raises(RecordingError, match=said) as refused:
        propose(read_table(make(tmp_path)), arm())
    assert "\n" not in str(refused.value)


def test_a_bag_of_something_else_says_what_it_holds(tmp_path):
    with sqlite3.connect(tmp_path / "other.db3") as other:
        other.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        other.execute("CREATE TABLE messages (id, topic_id, timestamp, data)")
        other.execute("INSERT INTO topics VALUES (1, '/scan', 'sensor_msgs/msg/LaserScan', 'cdr')")
        other.execute("INSERT INTO messages VALUES (1, 1, 0, x'00')")
    other.close()
    with pytest.raises(RecordingError, match=r"it holds /scan \(sensor_msgs/msg/LaserScan\)"):
        read_table(tmp_path / "other.db3")


def dataset(folder, version, torque=True):
    """A LeRobotDataset of two episodes; v3.0 keeps them in one file."""
    half = TIME.size // 2
    names = {"motors": [f"{name}.pos" for name in NAMES]}
    features = {"observation.state": {"dtype": "float32", "shape": [7], "names": names}}
    columns = {
        "observation.state": list(POSITION),
        "timestamp": np.tile(TIME[:half], 2),
        "episode_index": np.repeat([0, 1], half),
        "frame_index": np.tile(np.arange(half), 2),
    }
    if torque:
        features["observation.effort"] = {"names": [f"{name}.effort" for name in NAMES]}
        columns["observation.effort"] = list(TORQUE)
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 250, "robot_type": "iiwa14", "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    table = pa.table(columns)
    if version == "v3.0":
        pq.write_table(table, data / "file-000.parquet")
    else:
        for k in range(2):
            pq.write_table(table.slice(k * half, half), data / f"episode_00000{k}.parquet")
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_a_dataset(tmp_path, version):
    folder = dataset(tmp_path / "set", version)
    table = read_table(folder)
    np.testing.assert_array_equal(
        table.columns[f"observation.state.{NAMES[3]}.pos"], POSITION[:, 3]
    )
    steps = np.diff(table.columns["timestamp"])
    assert (steps > 0).all()
    assert np.flatnonzero(steps > 0.5).tolist() == [TIME.size // 2 - 1]
    assert "2 episodes" in table.notes[0]
    one = read_table(folder, episode=1)
    np.testing.assert_array_equal(
        one.columns[f"observation.effort.{NAMES[0]}.effort"], TORQUE[TIME.size // 2 :, 0]
    )


def test_episodes_whose_files_are_missing_are_counted(tmp_path):
    folder = dataset(tmp_path / "set", "v2.1")
    info = json.loads((folder / "meta" / "info.json").read_text()) | {"total_episodes": 2}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    assert not any("says that there are" in note for note in read_table(folder).notes)
    (folder / "data" / "chunk-000" / "episode_000001.parquet").unlink()
    assert read_table(folder).notes == (
        "meta/info.json says that there are 2 episodes; the files here hold 1",
    )


def test_an_episode_that_is_not_there(tmp_path):
    with pytest.raises(RecordingError, match="no episode 7; it has 2, from 0 to 1"):
        read_table(dataset(tmp_path / "set", "v3.0"), episode=7)


def test_a_version_that_is_not_known(tmp_path):
    folder = dataset(tmp_path / "set", "v3.0")
    (folder / "meta" / "info.json").write_text('{"codebase_version": "v9"}')
    with pytest.raises(RecordingError, match="version 'v9' of LeRobotDataset, expected one of v2"):
        read_table(folder)
