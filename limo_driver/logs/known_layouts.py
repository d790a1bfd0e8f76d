"""Layouts of messages whose definition a bag lacks: `.db3` before ROS 2 Iron has none.

A type may have changed from one distribution to the next, and a bag does not say which it is of.
The layout is the one that takes every byte of a message, no more and no fewer.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

from limo_driver.errors import WireFormatError
from limo_driver.logs.message_layout import MessageLayout, layout_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.logs.message_layout import DecodedMessage

_STATE: Final = "control_msgs/msg/JointTrajectoryControllerState"
_HEAD: Final = "std_msgs/Header header\n"
_PARTS: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation",
    "geometry_msgs/Twist": "Vector3 linear\nVector3 angular",
    "trajectory_msgs/JointTrajectoryPoint": "float64[] positions\nfloat64[] velocities\n"
    "float64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start",
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": "geometry_msgs/Transform[] transforms\n"
    "geometry_msgs/Twist[] velocities\ngeometry_msgs/Twist[] accelerations\n"
    "builtin_interfaces/Duration time_from_start",
    "iiwa_msgs/JointQuantity": "\n".join(f"float32 a{j}" for j in range(1, 8)),
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset",
}
_FORMER: Final = ("desired", "actual", "error")
_NEWER: Final = ("reference", "feedback", "error", "output")


def _state(points: Sequence[str], *, with_bodies: bool) -> str:
    """Return the definition of a state of a trajectory controller."""
    text = f"{_HEAD}string[] joint_names\n"
    text += "".join(f"trajectory_msgs/JointTrajectoryPoint {name}\n" for name in points)
    if with_bodies:
        kind = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
        text += "string[] multi_dof_joint_names\n"
        text += "".join(f"{kind} multi_dof_{name}\n" for name in points)
    return text


_KNOWN: Final = {
    _STATE: (
        _state((*_NEWER, "desired", "actual"), with_bodies=True),  # Humble, since 4.4
        _state(_NEWER, with_bodies=True),
        _state(_FORMER, with_bodies=True),  # Humble, before
        _state(_FORMER, with_bodies=False),  # Foxy, Galactic
    ),
    "std_msgs/msg/Float64MultiArray": ("MultiArrayLayout layout\nfloat64[] data",),
} | {
    f"iiwa_msgs/msg/Joint{name}": (f"{_HEAD}JointQuantity {name.lower()}",)
    for name in ("Position", "Torque", "Velocity")
}


class KnownLayout:
    """Reads messages of a type by whichever of its layouts takes all of a message.

    Args:
        layouts: Of the distributions of ROS 2.
    """

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._layouts = tuple(layouts)

    def decode(self, payload: bytes | memoryview) -> DecodedMessage:
        """Return the numbers of one message.

        Raises:
            WireFormatError: No layout takes all of it.
        """
        error = WireFormatError("of no known layout", 0)
        for layout in self._layouts:
            try:
                return layout.decode(payload)
            except WireFormatError as found:
                error = found
        raise error


@lru_cache(maxsize=64)
def layout_for(name: str, definition: bytes) -> MessageLayout | KnownLayout | str:
    """Return the layout of a type, as the bag defines it or as it is known, or why there is none.

    Args:
        name: Of the type.
        definition: As the bag has it; empty where it has none.
    """
    if definition or name not in _KNOWN:
        return layout_of(name, definition)
    parts = "".join(f"{'=' * 80}\nMSG: {kind}\n{text}\n" for kind, text in _PARTS.items())
    return KnownLayout([MessageLayout(name, f"{text}\n{parts}") for text in _KNOWN[name]])
