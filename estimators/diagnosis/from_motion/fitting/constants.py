"""Constants of one joint and its drive as they are fitted: logarithms, within bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation.plant import NAMES
from limo_driver.physics.drives import LONGEST_DELAY, MOST_SAG

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.types import FloatArray

DAMPING, COULOMB = "damping", "coulomb"  # columns that recordings cannot tell apart, as one
BASE: Final = ("kp", DAMPING, COULOMB, "delay", "inertia", "offset")
GAINS: Final = ("kp", "kv", "gain")  # of which a drive has one
SIGNED: Final = ("offset", "zero")  # what may be below zero
LEAST, MOST = 1e-6, 1e5  # in the unit of each: the logarithm of nothing is needed
STEP: Final = 0.02  # of a logarithm, or of a signed value in its unit, that a slope is taken over
_TIED: Final = {COULOMB: ("plus", "minus"), DAMPING: ("viscous_plus", "viscous_minus")}
_BOUNDS: Final = {
    "v_s": (1e-3, 0.3),  # [rad/s]; friction that fades later is dry friction
    "assisted": (0.1, 1.5),
    "by_load": (LEAST, 3.0),  # beyond, no gear is driven
    "delay": (LEAST, LONGEST_DELAY),
    "play": (LEAST, 0.2),  # [rad], most that a backlash may be
    "dead_band": (LEAST, 0.5),  # [rad]
    "derating": (LEAST, MOST_SAG),
    "heating": (1.0, 1e3),  # [s]; what warms faster or slower looks like another gain
}


@dataclass(frozen=True)
class BelievedValue:
    """What is believed of one parameter before any data."""

    value: float
    deviation: float  # in the unit of the value, or of its logarithm where it cannot be negative


def value_in(row: FloatArray, name: str) -> float:
    """Return one of the constants, by name."""
    return float(row[NAMES.index(_TIED.get(name, (name,))[0])])


def gain_of(row: FloatArray) -> str:
    """Return which gain a drive has, of `GAINS`.

    Args:
        row: The constants of its joint.
    """
    return next((name for name in GAINS[1:] if value_in(row, name) > 0.0), GAINS[0])


def base_of(row: FloatArray) -> tuple[str, ...]:
    """Return the constants that every joint with such a drive has.

    Args:
        row: The constants of its joint.
    """
    return (gain_of(row), *BASE[1:])


def with_values(row: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """Return constants with some replaced, by name."""
    new = row.copy()
    for name, value in values.items():
        for column in _TIED.get(name, (name,)):
            new[NAMES.index(column)] = value
    return new


def inner(name: str, value: float) -> float:
    """Return a value as it is fitted: its logarithm, but for signed ones."""
    return value if name in SIGNED else float(np.log(max(value, LEAST)))


def outer(name: str, value: float) -> float:
    """Return the value of what is fitted, within its bounds.

    Args:
        name: Of the constant.
        value: Its logarithm, but for signed ones.
    """
    if name in SIGNED:
        return value
    least, most = _BOUNDS.get(name, (LEAST, MOST))
    return min(max(float(np.exp(min(value, np.log(MOST)))), least), most)


def stepped(row: FloatArray, steps: Mapping[str, float]) -> FloatArray:
    """Return constants a step away, of logarithms but for signed values.

    Args:
        row: All constants.
        steps: By name.
    """
    return with_values(
        row,
        {name: outer(name, inner(name, value_in(row, name)) + by) for name, by in steps.items()},
    )
