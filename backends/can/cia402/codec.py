"""CANopen CiA 402 on the wire: process data, states, emergencies, and how much a bus can carry.

CiA 402: states of a drive, its set-points and measurements in 8 bytes, and their scaling.

count = direction (q - offset) counts_per_turn gear / 2 pi
per mille = 1000 direction tau / (rated torque of object 6076, at the joint)

Source: CiA 402-2, "Operation modes and application data", sections 8 (states) and 11 to 13.

Emergency messages and error codes of drives, in words.

Source: CiA 301, table 26, and CiA 402-2, table "error codes"; a code that is not listed is told by
the class that its first digits say.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import Enum, IntEnum
from typing import Final

import numpy as np

from backends.can.config import ArmConfig, Cia402Joint
from backends.can.port import BusLoad, Traffic
from limo_driver.types import FloatArray, readonly

TARGETS: Final = struct.Struct("<Hih")  # RPDO1: controlword, target position, torque offset
TORQUE: Final = struct.Struct("<hb")  # RPDO2: target torque, mode
MEASURED: Final = struct.Struct("<Hih")  # TPDO1: statusword, position, torque
STATUS: Final = struct.Struct("<iHb")  # TPDO2: velocity, error code, mode
TEMPERATURE: Final = struct.Struct("<h")  # TPDO3

PER_MILLE: Final = 1e-3
MILLI: Final = 1e-3  # [N m] of the unit of object 6076
MOST_PER_MILLE: Final = 32767.0
MOST_COUNTS: Final = 2.0**31 - 1.0
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
HEARTBEATS_PER_WATCHDOG: Final = 4


class OperatingMode(IntEnum):
    """Modes of operation, objects 6060 and 6061."""

    POSITION = 8  # cyclic synchronous position, CSP
    VELOCITY = 9  # CSV
    TORQUE = 10  # CST


def mode_words(mode: int) -> str:
    """Return a mode of operation in words."""
    return OperatingMode(mode).name.lower() if mode in set(OperatingMode) else f"mode {mode}"


class State(Enum):
    """States of a drive: words, mask and value of the statusword."""

    NOT_READY = ("not ready to switch on", 0x4F, 0x00)
    SWITCH_ON_DISABLED = ("switch-on disabled", 0x4F, 0x40)
    READY = ("ready to switch on", 0x6F, 0x21)
    SWITCHED_ON = ("switched on", 0x6F, 0x23)
    ENABLED = ("operation enabled", 0x6F, 0x27)
    QUICK_STOP = ("quick stop active", 0x6F, 0x07)
    FAULT_REACTION = ("fault reaction active", 0x4F, 0x0F)
    FAULT = ("fault", 0x4F, 0x08)
    UNKNOWN = ("no state of CiA 402", 0x00, 0xFF)

    def __init__(self, words: str, mask: int, value: int) -> None:
        self.words, self.mask, self.pattern = words, mask, value


class Controlword(IntEnum):
    """Commands to the state machine of a drive."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE = 0x0F
    FAULT_RESET = 0x80


def _state_of(statusword: int) -> State:
    return next((s for s in State if statusword & s.mask == s.pattern), State.UNKNOWN)


_STATES: Final = tuple(_state_of(word) for word in range(0x80))

_UP: Final = {
    State.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    State.READY: Controlword.SWITCH_ON,
    State.SWITCHED_ON: Controlword.ENABLE,
    State.ENABLED: Controlword.ENABLE,
}


def state_of(statusword: int) -> State:
    """Return the state that a statusword tells."""
    return _STATES[statusword & 0x7F]


def towards_enabled(state: State, sent: int, *, reset: bool) -> Controlword:
    """Return the next step to `operation enabled`.

    Args:
        state: Where the drive is.
        sent: Controlword of the cycle before: a fault is reset by an edge of its bit.
        reset: Whether a fault may be ended.
    """
    if state in _UP:
        return _UP[state]
    if reset and state is State.FAULT and sent != Controlword.FAULT_RESET:
        return Controlword.FAULT_RESET
    if state is State.QUICK_STOP:
        return Controlword.ENABLE  # transition 16, which drives have that hold after a quick stop
    return Controlword.DISABLE_VOLTAGE if state is State.FAULT else Controlword.QUICK_STOP


class Codec:
    """Set-points to frames and frames to measurements, for all n joints of an arm.

    Args:
        joints: Their drives.
        rated: Object 6076 of each, (n,) [mN m].
    """

    def __init__(self, joints: Sequence[Cia402Joint], rated: Sequence[float]) -> None:
        self.counts_per_radian = readonly([joint.counts_per_radian for joint in joints])
        self.offset = readonly([joint.offset for joint in joints])  # [rad]
        at_joint = [MILLI * r * joint.torque_ratio for r, joint in zip(rated, joints, strict=True)]
        self.torque_resolution = readonly(PER_MILLE * np.array(at_joint))  # [N m] of one per mille
        direction = np.array([joint.direction for joint in joints])
        self._signed_step = readonly(direction * self.torque_resolution)

    def targets(self, position: FloatArray, controlwords: Sequence[int]) -> list[bytes]:
        """Return the RPDO1 of each drive for positions (n,) [rad]."""
        exact = (position - self.offset) * self.counts_per_radian
        counts = np.rint(np.clip(exact, -MOST_COUNTS, MOST_COUNTS)).astype(np.int64).tolist()
        return [
            TARGETS.pack(word, count, 0) for word, count in zip(controlwords, counts, strict=True)
        ]

    def torques(self, torque: FloatArray, mode: OperatingMode) -> list[bytes]:
        """Return the RPDO2 of each drive for torques (n,) [N m]."""
        exact = np.clip(torque / self._signed_step, -MOST_PER_MILLE, MOST_PER_MILLE)
        return [TORQUE.pack(value, mode) for value in np.rint(exact).astype(np.int64).tolist()]

    def positions(self, counts: Sequence[int]) -> FloatArray:
        """Return joint positions, (n,) [rad]."""
        return np.array(counts) / self.counts_per_radian + self.offset

    def velocities(self, counts: Sequence[float]) -> FloatArray:
        """Return joint velocities (n,) [rad/s] of counts per second."""
        return np.array(counts) / self.counts_per_radian

    def measured_torques(self, per_mille: Sequence[int]) -> FloatArray:
        """Return joint torques, (n,) [N m]."""
        return np.array(per_mille) * self._signed_step


def describe(code: int) -> str:
    """Return an error code in words; empty if it is no error."""
    if not code:
        return ""
    text = _EXACT.get(code) or _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0)
    return f"{text or 'error of a class of its own'} (0x{code:04X})"


def bus_load(config: ArmConfig, *, torque: bool = False) -> BusLoad:
    """Return the load at the arm's rate, with worst stuffing.

    Args:
        config: The arm.
        torque: Whether drives are commanded torques, which takes a second frame for each.
    """
    n, rate = len(config.joints), config.rate
    slow = rate / config.status_every
    traffic = [Traffic("SYNC", 1, 0, rate), Traffic("RPDO1", n, 8, rate)]
    if torque:
        traffic.append(Traffic("RPDO2", n, 3, rate))
    traffic += [Traffic("TPDO1", n, 8, rate), Traffic("TPDO2", n, 7, slow)]
    if config.temperature is not None:
        traffic.append(Traffic("TPDO3", n, 2, slow))
    heartbeats = HEARTBEATS_PER_WATCHDOG / config.watchdog
    traffic.append(Traffic("heartbeats", n + 1, 1, heartbeats, cyclic=False))
    bus = config.bus
    return BusLoad(tuple(traffic), bus.bitrate, bus.data_bitrate if bus.fd else None)
