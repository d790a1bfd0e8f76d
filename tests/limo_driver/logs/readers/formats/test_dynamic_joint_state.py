"""Dynamic joint states of ros2_control in bags."""

import numpy as np
import pytest
from logged import arm, measured
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from limo_driver.logs.readers.formats.reading import read_table

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
STAMPS = 1_700_000_000 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
STORE = get_typestore(Stores.ROS2_HUMBLE)
JointState = STORE.types["sensor_msgs/msg/JointState"]
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]
NAMES = arm().joint_names
ORDER = [2, 0, 6, 5, 4, 3, 1]
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
