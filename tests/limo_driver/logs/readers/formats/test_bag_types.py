"""States of types that a bag defines, or does not: of controllers, Franka arms and iiwas."""

import sqlite3
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lanes import sampled
from logged import arm, measured
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.ros.message_layout import MessageLayout

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
STAMPS = 1_700_000_000 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
STORE = get_typestore(Stores.ROS2_HUMBLE)
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]
NAMES = arm().joint_names
ORDER = [2, 0, 6, 5, 4, 3, 1]
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
    "lab_msgs/msg/Drives": HEAD
    + "float64[] angle\nfloat64[] motor_torque\nfloat64[] x\nuint8 mode\n",
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


@sampled("storage", list(StoragePlugin), "writes and reads a bag each")
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


@sampled(
    ("points", "bodies"),
    [(("desired", "actual", "error"), False), (("desired", "actual", "error"), True), (SIX, True)],
    "writes and reads a bag each",
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


@sampled("storage", list(StoragePlugin), "writes and reads a bag each")
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


def test_of_a_topic_that_is_asked_for_every_number_is_a_column(tmp_path):
    def drives(types, k):  # noqa: ARG001
        return [POSITION[k], TORQUE[k], 2 * TORQUE[k], 3]

    topics = {"/drives": ("lab_msgs/msg/Drives", drives)}
    path = typed_bag(tmp_path / "bag", StoragePlugin.MCAP, topics)
    with pytest.raises(RecordingError, match="of one that `topic` names, the numbers are read"):
        read_table(path, joints=NAMES)
    table = read_table(path, topic="/drives", joints=NAMES)
    assert {"x[0]", "x[6]"} <= table.columns.keys()
    columns = replace(propose(table, arm()).mapping, undecided=()).columns(table, arm())
    np.testing.assert_array_equal(columns.position, POSITION)
    np.testing.assert_array_equal(columns.torque, TORQUE)


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
