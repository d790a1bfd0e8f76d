"""Emergency messages and error codes of drives, in words.

Source: CiA 301, table 26, and CiA 402-2, table "error codes"; a code that is not listed is told by
the class that its first digits say.
"""

from __future__ import annotations

import struct
from typing import Final

LAYOUT: Final = struct.Struct("<HB5s")  # error code, error register, the manufacturer's own

_EXACT: Final = {
    0x2310: "continuous over-current",
    0x2320: "short circuit",
    0x2350: "load level too high (I2t)",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "drive too hot",
    0x4310: "motor too hot",
    0x5441: "emergency stop contact",
    0x6320: "parameter error",
    0x7120: "motor blocked",
    0x7121: "motor blocked",
    0x7305: "encoder 1",
    0x7306: "encoder 2",
    0x7380: "position sensor",
    0x7500: "communication",
    0x8110: "CAN overrun, frames lost",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of the master lost",
    0x8140: "recovered from bus-off",
    0x8210: "PDO too short",
    0x8250: "RPDO timed out: set-points stopped coming",
    0x8311: "excess torque",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8600: "positioning",
    0x8611: "following error",
    0x8700: "SYNC lost",
}
_CLASSES: Final = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input",
    0x22: "current inside the drive",
    0x23: "current at the output",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "DC link voltage",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "drive temperature",
    0x43: "motor temperature",
    0x50: "drive hardware",
    0x60: "drive software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x71: "power",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol",
    0x83: "torque control",
    0x84: "velocity control",
    0x85: "position control",
    0x86: "positioning",
    0x87: "synchronisation",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "error of the manufacturer",
}


def describe(code: int) -> str:
    """Return an error code in words; empty if it is no error."""
    if not code:
        return ""
    text = _EXACT.get(code) or _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0)
    return f"{text or 'error of a class of its own'} (0x{code:04X})"
