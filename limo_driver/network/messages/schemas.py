"""Definitions of the messages as ros2msg texts: a type, then each type that it is made of."""

from __future__ import annotations

JOINT_STATE = "sensor_msgs/msg/JointState"
TORQUE_ESTIMATE = "limo_msgs/msg/TorqueEstimate"
LOG = "rcl_interfaces/msg/Log"
ENCODING = "ros2msg"  # of the schemas, as MCAP calls it

_SEPARATOR = "=" * 80
_TIME = f"""{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEADER = f"""{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""

SCHEMAS = {
    JOINT_STATE: f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}{_TIME}""",
    TORQUE_ESTIMATE: f"""std_msgs/Header header
string[] name
float64[] torque
float64[] std
float64[] external
bool[] outside
string model
bool fallback
bool reset
{_HEADER}{_TIME}""",
    LOG: f"""byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME}""",
}
