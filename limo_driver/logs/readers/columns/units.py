"""Units in which logs hold motion and torque, as factors to SI."""

from __future__ import annotations

import math
from typing import Final

SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TURN: Final = 2 * math.pi

# By quantity: what one unit is in rad, rad/s, N m; K for a temperature.
UNITS: Final[dict[str, dict[str, float]]] = {
    "position": {
        "rad": 1.0,
        "deg": math.pi / 180,
        "mrad": 1e-3,
        "turn": _TURN,
        "m": 1.0,
        "mm": 1e-3,
    },
    "velocity": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "mrad/s": 1e-3,
        "turn/s": _TURN,
        "rpm": _TURN / 60,
        "m/s": 1.0,
        "mm/s": 1e-3,
    },
    # a current says nothing of the torque without a `factor` in N m for each unit of it
    "torque": {
        "N m": 1.0,
        "mN m": 1e-3,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "kN m": 1e3,
        "A": 1.0,
        "mA": 1e-3,
        "N": 1.0,
    },
    "temperature": {"°C": 1.0},
}
UNITS["command"] = UNITS["position"]
UNITS["command_velocity"] = UNITS["velocity"]
UNITS["command_torque"] = UNITS["torque"]
CURRENTS: Final = ("A", "mA")

# How names and brackets write them; a name is cut into words, in lower case, without signs.
WRITTEN: Final = {
    "rad": "rad",
    "radian": "rad",
    "radians": "rad",
    "deg": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "mrad": "mrad",
    "m": "m",
    "metres": "m",
    "meters": "m",
    "mm": "mm",
    "rev": "turn",
    "revs": "turn",
    "turns": "turn",
    "rad/s": "rad/s",
    "rads": "rad/s",
    "radps": "rad/s",
    "deg/s": "deg/s",
    "°/s": "deg/s",
    "degs": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "rpm": "rpm",
    "nm": "N m",
    "n m": "N m",
    "n*m": "N m",
    "n.m": "N m",
    "n·m": "N m",
    "mnm": "mN m",
    "nmm": "N mm",
    "ncm": "N cm",
    "knm": "kN m",
    "a": "A",
    "amp": "A",
    "amps": "A",
    "ma": "mA",
    "c": "°C",
    "°c": "°C",
    "s": "s",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "us": "us",
    "usec": "us",
    "micros": "us",
    "ns": "ns",
    "nsec": "ns",
    "nanos": "ns",
    "nanosec": "ns",
    "nanoseconds": "ns",
}


def quantity_of(unit: str) -> str:
    """Return the quantity that is measured in a unit; `time` for seconds, or nothing."""
    if unit in SECONDS:
        return "time"
    return next((quantity for quantity, units in UNITS.items() if unit in units), "")
