"""Messages as bytes: CDR of ROS 2 types, the same on the wire and in logs, and attachments.

| message | ROS type |
|---|---|
| joint state | sensor_msgs/msg/JointState |
| estimate | limo_msgs/msg/TorqueEstimate, our own |
| event | rcl_interfaces/msg/Log, with a JSON object as text |

Whatever comes off a wire is either decoded or a `WireFormatError` that names the offset.
"""

from limo_driver.network.messages.cdr import JOINT_STATE, LOG, SCHEMAS, TORQUE_ESTIMATE
from limo_driver.network.messages.joint_state import (
    Attachment,
    JointStateCodec,
    JointStateMessage,
    RosAttachment,
    decode_joint_state,
    relabelled,
)
from limo_driver.network.messages.torque_estimate import (
    Event,
    Level,
    TorqueEstimate,
    TorqueEstimateCodec,
    decode_event,
    decode_torque_estimate,
)

__all__ = [
    "JOINT_STATE",
    "LOG",
    "SCHEMAS",
    "TORQUE_ESTIMATE",
    "Attachment",
    "Event",
    "JointStateCodec",
    "JointStateMessage",
    "Level",
    "RosAttachment",
    "TorqueEstimate",
    "TorqueEstimateCodec",
    "decode_event",
    "decode_joint_state",
    "decode_torque_estimate",
    "relabelled",
]
