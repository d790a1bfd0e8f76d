"""States of Franka arms in bags that do not define them, as those of ROS 2 Humble."""

import sqlite3

import numpy as np
from lanes import sampled
from logged import arm, measured
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
NAMES = arm().joint_names
STAMPS = 1_700_000_000_000_000_000 + np.round(TIME * 1e9).astype(np.int64)
STORE = get_typestore(Stores.ROS2_HUMBLE)
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]
HEAD = "std_msgs/Header header\n"
FLAT = (
    "cartesian_collision 6, cartesian_contact 6, q 7, q_d 7, dq 7, dq_d 7, ddq_d 7, theta 7,"
    "dtheta 7, tau_j 7, dtau_j 7, tau_j_d 7, k_f_ext_hat_k 6, elbow 2, elbow_d 2, elbow_c 2,"
    "delbow_c 2,"
    "ddelbow_c 2, joint_collision 7, joint_contact 7, o_f_ext_hat_k 6, o_dp_ee_d 6, o_dp_ee_c 6,"
    "o_ddp_ee_c 6, tau_ext_hat_filtered 7, m_ee 1, f_x_cee 3, i_ee 9, m_load 1, f_x_cload 3, "
    "i_load 9, m_total 1, f_x_ctotal 3, i_total 9, o_t_ee 16, o_t_ee_d 16, o_t_ee_c 16, f_t_ee 16,"
    "ee_t_k 16"
)
AT_THE_END = """float64 time
float64 control_command_success_rate
uint8 ROBOT_MODE_IDLE=1
uint8 robot_mode
Errors current_errors
Errors last_motion_errors
"""
OF_FRANKA = {
    "franka_msgs/msg/CollisionIndicators": "".join(
        f"geometry_msgs/Vector3 v{k}\n" for k in range(4)
    )
    + "float64[7] is_joint_collision\nfloat64[7] is_joint_contact\n",
    "franka_msgs/msg/Elbow": "".join(f"float64[2] e{k}\n" for k in range(5)),
    "franka_msgs/msg/FrankaState": HEAD
    + "".join(
        f"float64{f'[{n}]' if n != '1' else ''} {name}\n"
        for name, n in (item.split() for item in FLAT.split(","))
    )
    + AT_THE_END,
    "franka_msgs/msg/FrankaRobotState": HEAD
    + "CollisionIndicators collision_indicators\nsensor_msgs/JointState measured_joint_state\n"
    "sensor_msgs/JointState desired_joint_state\n"
    "sensor_msgs/JointState measured_joint_motor_state\n"
    "float64[7] ddq_d\nfloat64[7] dtau_j\n"
    "sensor_msgs/JointState tau_ext_hat_filtered\nElbow elbow\n"
    + "".join(f"geometry_msgs/WrenchStamped w{k}\n" for k in range(2))
    + "".join(f"geometry_msgs/InertiaStamped i{k}\n" for k in range(3))
    + "".join(f"geometry_msgs/PoseStamped p{k}\n" for k in range(5))
    + "geometry_msgs/TwistStamped t0\ngeometry_msgs/TwistStamped t1\ngeometry_msgs/AccelStamped a\n"
    + AT_THE_END,
}


def filled(store, kind, known):
    """Return a message of a type with these fields, and something else in all others."""
    values = []
    for name, (node, detail) in store.fielddefs[kind][1]:
        if name in known:
            values.append(known[name])
        elif node == Nodetype.NAME:
            values.append(filled(store, detail, {}))
        elif node == Nodetype.BASE:
            values.append("frame" if detail[0] == "string" else 1)
        else:
            many = detail[1] if node == Nodetype.ARRAY else 0
            values.append(np.full(many, 0.5) if detail[0][1][0] != "string" else [])
    return store.types[kind](*values)


@sampled("kind", ["FrankaState", "FrankaRobotState"], "writes and reads a bag each")
@sampled("flags", [36, 41], "writes and reads a bag each")
def test_states_of_franka_arms_in_bags_without_definitions(tmp_path, kind, flags):
    store, name = get_typestore(Stores.ROS2_HUMBLE), f"franka_msgs/msg/{kind}"
    for own, text in OF_FRANKA.items():
        store.register(get_types_from_msg(text, own))
    errors = "".join(f"bool error_{k}\n" for k in range(flags))
    store.register(get_types_from_msg(errors, "franka_msgs/msg/Errors"))
    State = store.types["sensor_msgs/msg/JointState"]
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/robot_state", name, typestore=store)
        for k, stamp in enumerate(STAMPS.tolist()):
            header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
            flat = {"q": POSITION[k], "q_d": POSITION[k] + 0.01, "tau_j": TORQUE[k]}
            own = State(header, list(NAMES), POSITION[k], VELOCITY[k], TORQUE[k])
            wanted = State(header, list(NAMES), POSITION[k] + 0.01, VELOCITY[k], np.zeros(0))
            nested = {"measured_joint_state": own, "desired_joint_state": wanted}
            known = {"header": header} | (flat if kind == "FrankaState" else nested)
            message = filled(store, name, known)
            writer.write(topic, stamp, store.serialize_cdr(message, name))
    with sqlite3.connect(next((tmp_path / "bag").glob("*.db3"))) as file:
        file.execute("DROP TABLE IF EXISTS message_definitions")
    file.close()
    table = read_table(tmp_path / "bag", joints=NAMES)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided == ()
    columns = mapping.columns(table, arm())
    np.testing.assert_array_equal(columns.position, POSITION)
    np.testing.assert_array_equal(columns.torque, TORQUE)
    np.testing.assert_array_equal(columns.command, POSITION + 0.01)
