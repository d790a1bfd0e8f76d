"""Damiao's frames: MIT commands, their replies, and registers.

A command is position 16 bits, velocity 12, stiffness 12, damping 12 and torque 12, packed from the
highest bit on; position, velocity and torque span ranges that each motor keeps in registers. No
code is exactly zero in a symmetric range: the one nearest to it is half a step off.

Source: Damiao, "DM-J4310-2EC V1.1 user manual", sections on MIT mode and registers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from limo_driver.errors import WireFormatError

FRAME: Final = 8  # [bytes], of everything
STIFFEST: Final = 500.0  # [N m/rad], full scale of kp
MOST_DAMPING: Final = 5.0  # [N m s/rad], full scale of kd
FULL_12: Final = 0xFFF
FULL_16: Final = 0xFFFF
REGISTERS: Final = 0x7FF  # arbitration id on which registers are asked for
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT_UNIT: Final = 50e-6  # [s], of register 9
MIT_MODE: Final = 1  # of register 10
ENABLE, DISABLE, ZERO, CLEAR = (bytes((0xFF,) * 7 + (last,)) for last in (0xFC, 0xFD, 0xFE, 0xFB))
SPECIAL: Final = 0xFF_FFFF_FFFF_FFFF  # first seven bytes of those
DAMPING_STEP: Final = 1 << 12  # of a command
_REGISTER = struct.Struct("<HBB4s")
_FLOAT, _WHOLE = struct.Struct("<f"), struct.Struct("<I")


class Register(IntEnum):
    """Registers that a driver needs."""

    REPLY_ID = 7
    TIMEOUT = 9
    MODE = 10
    POSITION_RANGE = 21
    VELOCITY_RANGE = 22
    TORQUE_RANGE = 23


FLOATS: Final = {Register.POSITION_RANGE, Register.VELOCITY_RANGE, Register.TORQUE_RANGE}


class Status(IntEnum):
    """Status that a motor gives in its reply."""

    DISABLED = 0x0
    ENABLED = 0x1
    OVERVOLTAGE = 0x8
    UNDERVOLTAGE = 0x9
    OVERCURRENT = 0xA
    HOT_TRANSISTORS = 0xB
    HOT_WINDING = 0xC
    LOST_COMMUNICATION = 0xD
    OVERLOAD = 0xE

    @property
    def words(self) -> str:
        """The status, as people read it."""
        return self.name.lower().replace("_", " ")

    @property
    def is_fault(self) -> bool:
        """Whether the motor switched itself off."""
        return self not in {Status.DISABLED, Status.ENABLED}


@dataclass(frozen=True)
class Ranges:
    """Full scale of a motor's values, each from minus to plus."""

    position: float  # [rad]
    velocity: float  # [rad/s]
    torque: float  # [N m]

    @property
    def torque_step(self) -> float:
        """Smallest change of a torque [N m]."""
        return 2 * self.torque / FULL_12


@dataclass(frozen=True)
class MitCommand:
    """torque of the motor = stiffness (position - q) + damping (velocity - dq) + torque."""

    position: float  # [rad]
    velocity: float  # [rad/s]
    stiffness: float  # [N m/rad]
    damping: float  # [N m s/rad]
    torque: float  # [N m]


@dataclass(frozen=True)
class Reply:
    """Measurements of a motor."""

    status: int  # of `Status`, or one that no manual names
    motor: int  # low four bits of its id
    position: float  # [rad]
    velocity: float  # [rad/s]
    torque: float  # [N m]
    transistors: int  # [°C]
    winding: int  # [°C]


def encode_command(command: MitCommand, ranges: Ranges) -> bytes:
    """Return a command's 8 bytes; values beyond the ranges are cut to them."""
    word = _code(command.position, -ranges.position, ranges.position, FULL_16)
    word = word << 12 | _code(command.velocity, -ranges.velocity, ranges.velocity, FULL_12)
    word = word << 12 | _code(command.stiffness, 0.0, STIFFEST, FULL_12)
    word = word << 12 | _code(command.damping, 0.0, MOST_DAMPING, FULL_12)
    word = word << 12 | _code(command.torque, -ranges.torque, ranges.torque, FULL_12)
    if word >> 8 == SPECIAL:  # all at full scale would switch the motor off, or move its zero
        word -= DAMPING_STEP
    return word.to_bytes(FRAME, "big")


def decode_command(data: bytes, ranges: Ranges) -> MitCommand:
    """Return what 8 bytes command.

    Raises:
        WireFormatError: Another length.
    """
    word = int.from_bytes(_whole(data), "big")
    return MitCommand(
        _value(word >> 48, -ranges.position, ranges.position, FULL_16),
        _value(word >> 36 & FULL_12, -ranges.velocity, ranges.velocity, FULL_12),
        _value(word >> 24 & FULL_12, 0.0, STIFFEST, FULL_12),
        _value(word >> 12 & FULL_12, 0.0, MOST_DAMPING, FULL_12),
        _value(word & FULL_12, -ranges.torque, ranges.torque, FULL_12),
    )


def encode_reply(reply: Reply, ranges: Ranges) -> bytes:
    """Return a reply's 8 bytes."""
    word = _code(reply.position, -ranges.position, ranges.position, FULL_16)
    word = word << 12 | _code(reply.velocity, -ranges.velocity, ranges.velocity, FULL_12)
    word = word << 12 | _code(reply.torque, -ranges.torque, ranges.torque, FULL_12)
    head = (reply.status & 0xF) << 4 | reply.motor & 0xF
    return bytes((head, *word.to_bytes(5, "big"), reply.transistors & 0xFF, reply.winding & 0xFF))


def decode_reply(data: bytes, ranges: Ranges) -> Reply:
    """Return the content of a motor's reply.

    Raises:
        WireFormatError: Another length.
    """
    head, transistors, winding = _whole(data)[0], data[6], data[7]
    word = int.from_bytes(data[1:6], "big")
    return Reply(
        head >> 4,
        head & 0xF,
        _value(word >> 24, -ranges.position, ranges.position, FULL_16),
        _value(word >> 12 & FULL_12, -ranges.velocity, ranges.velocity, FULL_12),
        _value(word & FULL_12, -ranges.torque, ranges.torque, FULL_12),
        transistors,
        winding,
    )


def register_frame(motor: int, what: int, register: int = 0, value: float = 0) -> bytes:
    """Return a request for a register, or its answer: `READ`, `WRITE` or `REFRESH`."""
    layout = _FLOAT if register in FLOATS else _WHOLE
    packed = layout.pack(value if register in FLOATS else int(value))
    return _REGISTER.pack(motor, what, register, packed)


def decode_register(data: bytes) -> tuple[int, int, int, float]:
    """Return motor, `READ`, `WRITE` or `REFRESH`, register, and value.

    Raises:
        WireFormatError: Another length.
    """
    motor, what, register, packed = _REGISTER.unpack(_whole(data))
    (value,) = (_FLOAT if register in FLOATS else _WHOLE).unpack(packed)
    return motor, what, register, value


def status_words(status: int) -> str:
    """Return a status as people read it."""
    try:
        return Status(status).words
    except ValueError:
        return f"status {status:X}"


def _whole(data: bytes) -> bytes:
    if len(data) != FRAME:
        raise WireFormatError(f"a frame of Damiao's has {FRAME} bytes", len(data))
    return data


def _code(value: float, lower: float, upper: float, full: int) -> int:
    return min(max(round((value - lower) / (upper - lower) * full), 0), full)


def _value(code: int, lower: float, upper: float, full: int) -> float:
    return lower + code * (upper - lower) / full
