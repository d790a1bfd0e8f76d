"""Wrenches on the wire, and their covariance, for which ROS 2 has no message of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.network.messages.cdr import CdrWriter

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


def encode_wrench(stamp_ns: int, frame_id: str, wrench: FloatArray) -> bytes:
    """Return a WrenchStamped.

    Args:
        stamp_ns: Time of the wrench [ns].
        frame_id: In whose axes, and about whose origin, it is.
        wrench: Force, then torque, (6,) [N, N m].
    """
    writer = CdrWriter()
    writer.time(stamp_ns)
    writer.string(frame_id)
    writer.doubles(wrench)
    return bytes(writer.data)


def encode_matrix(label: str, matrix: FloatArray) -> bytes:
    """Return a Float64MultiArray of two dimensions.

    Args:
        label: Of both of them.
        matrix: (r, c), which goes row by row.
    """
    rows, columns = matrix.shape
    writer = CdrWriter()
    writer.number("I", matrix.ndim)
    for size, stride in ((rows, rows * columns), (columns, columns)):
        writer.string(label)
        writer.number("I", size)
        writer.number("I", stride)
    writer.number("I", 0)  # offset of the data
    writer.number("I", matrix.size)
    writer.doubles(matrix)
    return bytes(writer.data)
