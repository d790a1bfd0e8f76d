"""sensor_msgs/msg/JointState as CDR: the same bytes for native keys, for ROS 2 and in logs."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import WireFormatError
from limo_driver.network.messages.cdr import (
    LITTLE_ENDIAN,
    NANOSECONDS,
    CdrReader,
    RobotCodec,
    check_lengths,
    check_shapes,
    split_time,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray

_DOUBLES: Final = np.dtype("<f8")
_LONGEST = 65536  # bytes, room for a thousand joints; a stranger's names are not read for seconds


class JointStateMessage(NamedTuple):
    """A joint state as it came off the wire; arrays have one value for each name, or none."""

    stamp_ns: int  # of the source
    frame_id: str
    names: tuple[str, ...]
    position: FloatArray  # (n,) or (0,) [rad]
    velocity: FloatArray  # (n,) or (0,) [rad/s]
    torque: FloatArray  # (n,) or (0,) [N m]; `effort` in ROS


class JointStateCodec(RobotCodec):
    """Encodes joint states of one robot; what does not change is encoded once.

    Args:
        names: Joints, in the order of the arrays.
        frame_id: Of the header.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        super().__init__(names, frame_id, "ddd")
        n = len(self.names)
        usual = self._layouts[n, n, n].format
        self._usual = struct.Struct(usual.replace(f"{n}d", f"{8 * n}x"))  # all but the arrays
        self._arrays = -8 * (3 * n + 2)  # where they begin, with a length of 8 bytes between two

    def encode(
        self, stamp_ns: int, position: FloatArray, velocity: FloatArray, torque: FloatArray
    ) -> bytes:
        """Return the message.

        Args:
            stamp_ns: Time of the sample [ns].
            position: Joint positions, shape (n,), or (0,) where unknown [rad].
            velocity: Joint velocities, likewise [rad/s].
            torque: Joint torques, likewise [N m].

        Raises:
            ShapeError: An array has another shape.
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        lengths = len(position), len(velocity), len(torque)
        try:
            return self._layouts[lengths].pack(
                LITTLE_ENDIAN,
                *split_time(stamp_ns),
                self._fixed,
                lengths[0],
                *position.tolist(),
                lengths[1],
                *velocity.tolist(),
                lengths[2],
                *torque.tolist(),
            )
        except (KeyError, struct.error):
            check_shapes(len(self.names), position=position, velocity=velocity, torque=torque)
            raise

    def decode(self, payload: bytes | memoryview) -> JointStateMessage:
        """Return what `decode_joint_state` does, faster if the message is laid out like our own.

        Raises:
            WireFormatError: The payload is malformed; names its offset.
        """
        payload = bytes(payload)
        if self.names and len(payload) == self._usual.size:
            header, seconds, nanoseconds, fixed, *lengths = self._usual.unpack(payload)
            n = len(self.names)
            ours = header == LITTLE_ENDIAN and fixed == self._fixed and nanoseconds < NANOSECONDS
            if ours and lengths == [n, n, n]:
                values = np.frombuffer(payload[self._arrays :], _DOUBLES)  # aligned, as a copy
                return JointStateMessage(
                    seconds * NANOSECONDS + nanoseconds,
                    self.frame_id,
                    self.names,
                    values[:n],
                    values[n + 1 : 2 * n + 1],
                    values[2 * n + 2 :],
                )
        return decode_joint_state(payload)


def decode_joint_state(payload: bytes | memoryview) -> JointStateMessage:
    """Return the joint state that a payload holds, of either byte order.

    Raises:
        WireFormatError: The payload is malformed, or longer than that of any arm; names its offset.
    """
    if len(payload) > _LONGEST:
        raise WireFormatError(
            f"joint state of {len(payload)} bytes, expected at most {_LONGEST}", _LONGEST
        )
    reader = CdrReader(payload)
    message = JointStateMessage(
        reader.time("stamp"),
        reader.string("frame_id"),
        reader.strings("name"),
        reader.doubles("position"),
        reader.doubles("velocity"),
        reader.doubles("effort"),
    )
    reader.end()
    check_lengths(
        reader.offset,
        name=len(message.names),
        position=message.position.size,
        velocity=message.velocity.size,
        effort=message.torque.size,
    )
    return message
