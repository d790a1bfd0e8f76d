"""control_msgs/msg/DynamicJointState of ros2_control: interfaces by name, joint by joint."""

from __future__ import annotations

from typing import Final

import numpy as np

from limo_driver.errors import WireFormatError
from limo_driver.network.messages import JointStateMessage
from limo_driver.network.messages.cdr import CdrReader

DYNAMIC_JOINT_STATE: Final = "control_msgs/msg/DynamicJointState"
_QUANTITIES: Final = ("position", "velocity", "effort")
_MOST: Final = 1000  # joints


def decode_dynamic(payload: bytes | memoryview) -> JointStateMessage:
    """Return the joint state that a payload holds; NaN where a joint lacks an interface.

    Raises:
        WireFormatError: The payload is malformed; names its offset.
    """
    reader = CdrReader(payload)
    stamp, frame, names = reader.time("stamp"), reader.string("frame_id"), reader.strings("names")
    many = reader.number("I", "interface_values")
    if many != len(names) or many > _MOST:
        raise WireFormatError(
            f"{many} interface_values of {len(names)} joints, expected as many", reader.offset
        )
    values = np.full((len(_QUANTITIES), many), np.nan)
    for j in range(many):
        interfaces, own = reader.strings("interface_names"), reader.doubles("values")
        if own.size != len(interfaces):
            raise WireFormatError(
                f"{own.size} values of {len(interfaces)} interfaces", reader.offset
            )
        for interface, value in zip(interfaces, own.tolist(), strict=True):
            if interface in _QUANTITIES:
                values[_QUANTITIES.index(interface), j] = value
    reader.end()
    position, velocity, effort = values
    return JointStateMessage(stamp, frame, names, position, velocity, effort)
