"""Messages as bytes: CDR of ROS 2 types, the same on the wire and in logs, and attachments.

| message | ROS type |
|---|---|
| joint state | sensor_msgs/msg/JointState |
| estimate | limo_msgs/msg/TorqueEstimate, our own |
| event | rcl_interfaces/msg/Log, with a JSON object as text |
| wrench, and its covariance | geometry_msgs/msg/WrenchStamped, std_msgs/msg/Float64MultiArray |

Whatever comes off a wire is either decoded or a `WireFormatError` that names the offset.
"""

from limo_driver.network.messages.cdr import (
    JOINT_STATE,
    LOG,
    MATRIX,
    SCHEMAS,
    TORQUE_ESTIMATE,
    WRENCH,
)
from limo_driver.network.messages.joint_state import (
    Attachment,
    JointStateCodec,
    JointStateMessage,
    LiveJointStateCodec,
    RosAttachment,
    decode_joint_state,
    relabelled,
)
from limo_driver.network.messages.torque_estimate import (
    EstimateDraft,
    Event,
    Level,
    TorqueEstimate,
    TorqueEstimateCodec,
    decode_event,
    decode_torque_estimate,
    encode_matrix,
    encode_wrench,
)

__all__ = [
    "JOINT_STATE",
    "LOG",
    "MATRIX",
    "SCHEMAS",
    "TORQUE_ESTIMATE",
    "WRENCH",
    "Attachment",
    "EstimateDraft",
    "Event",
    "JointStateCodec",
    "JointStateMessage",
    "Level",
    "LiveJointStateCodec",
    "RosAttachment",
    "TorqueEstimate",
    "TorqueEstimateCodec",
    "decode_event",
    "decode_joint_state",
    "decode_torque_estimate",
    "encode_matrix",
    "encode_wrench",
    "relabelled",
]
