"""Constants of one joint and its drive: one table of what is known of each, and rows of values.

Compiled code takes the constants of a joint as a row, in the order of the table. Fits see
logarithms, within bounds.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.model.units import unit_of
from limo_driver.physics.drives import LONGEST_DELAY, MOST_SAG

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.types import FloatArray

LEAST, MOST = 1e-6, 1e5  # in the unit of each: the logarithm of nothing is needed
STEP: Final = 0.02  # of a logarithm, or of a signed value in its unit, that a slope is taken over


class Constant(NamedTuple):
    """What is known of a constant of any joint."""

    name: str
    unit: str
    effect: str = ""  # whose value it is, as a verdict names it; nothing if it is never reported
    in_words: str = ""
    parameter: str = ""  # its name in that effect, if it has another one there
    absent: float = 0.0  # its value where there is no such thing
    gear: int = 0  # power of the gear's ratio in what is seen at the joint
    bounds: tuple[float, float] = (LEAST, MOST)  # of a fit
    signed: bool = False  # whether it may be below zero


# fmt: off
CONSTANTS: Final = (
    # what every joint has, behind a drive of one of three gains
    Constant("kp", "N m/rad", "position_servo", "a P gain", gear=1),
    Constant("kv", "N m s/rad", "velocity_servo", "a velocity gain", gear=1),
    Constant("gain", "1", "torque_drive", "a gain", gear=1),  # torque over the one commanded
    Constant("delay", "s", "drive_delay", "a delay", bounds=(LEAST, LONGEST_DELAY)),
    Constant("plus", "N m", "coulomb_friction", "dry friction", "tau_c", gear=1),  # moving positive
    Constant("minus", "N m", gear=1),
    Constant("viscous_plus", "N m s/rad", "viscous_friction", "damping", "f_v", gear=2),
    Constant("viscous_minus", "N m s/rad", gear=2),
    Constant("inertia", "kg m^2", "armature", "armature", gear=2),
    Constant("offset", "N m", "torque_offset", "an offset", signed=True),  # beside the rigid body
    # what some have; friction that fades later than within its bounds is dry friction
    Constant("stribeck", "N m", "stribeck_friction", "stiction", "tau_s", gear=1),
    Constant("v_s", "rad/s", "stribeck_friction", absent=1.0, bounds=(1e-3, 0.3)),
    Constant("by_load", "1", "load_dependent_friction", "friction by load", "coefficient",
             bounds=(LEAST, 3.0)),  # beyond, no gear is driven
    Constant("assisted", "1", "load_dependent_friction", absent=1.0,
             bounds=(0.1, 1.5)),  # factor of that while the load drives the joint
    Constant("dead_band", "rad", "dead_band", "a dead band", bounds=(LEAST, 0.5)),
    Constant("speed", "rad/s", "profile_speed", "a profile's speed", absent=np.inf),
    Constant("acceleration", "rad/s^2", "profile_acceleration", "a profile's acceleration",
             absent=np.inf),
    Constant("torque_limit", "N m", "torque_limit", "a torque limit", absent=np.inf, gear=1),
    Constant("spring", "N m/rad", "spring_load", "a spring", "stiffness"),
    Constant("play", "rad", "backlash", "play", "gap",
             bounds=(LEAST, 0.2)),  # between the servo's encoder and the joint
    Constant("gear", "1", "gear_ratio", "a gear's ratio", "ratio", absent=1.0),  # over the stated
    Constant("ki", "N m/(rad s)", "integral_gain", "an I gain", gear=1),
    Constant("punch", "N m", "punch", "punch", gear=1),
    Constant("derating", "1", "thermal_derating", "derating",
             bounds=(LEAST, MOST_SAG)),  # resistance that a stalled winding gains, over its own
    Constant("heating", "s", "thermal_derating", absent=1.0,
             bounds=(1.0, 1e3)),  # what warms faster or slower looks like another gain
    Constant("free_speed", "rad/s", "voltage_limit", "a speed without load", absent=np.inf,
             gear=-1),  # at which the motor without load stops gaining speed
    Constant("stall", "N m", "voltage_limit", absent=np.inf, gear=1),
    # what is stated, or of the whole arm
    Constant("kd", "N m s/rad", gear=2),
    Constant("integral_limit", "N m", absent=np.inf, gear=1),
    Constant("resolution", "rad"),
    Constant("drag", "N m s^2/rad^2"),
    Constant("delta", "1", absent=1.0),  # exponent of the fading of stiction
    Constant("resisted", "1", absent=1.0),  # factor of friction by load while the load resists
    Constant("rest", "rad"),  # of the spring
    Constant("cubic", "N m/rad^3"),
    Constant("zero", "rad", signed=True),  # encoder minus link
    Constant("sag", "1"),  # resistance of the supply over that of a motor's winding
    Constant("inside", "1"),  # share of the damping that the servo makes, within its torque limit
    Constant("restart", "s", absent=np.inf),  # after which errors begin anew where the joint was
    Constant("straight", "1"),  # whether a command that is sent again is followed at once
)
(
    KP, KV, GAIN, DELAY, PLUS, MINUS, VISCOUS_PLUS, VISCOUS_MINUS, INERTIA, OFFSET, STRIBECK, V_S,
    BY_LOAD, ASSISTED, DEAD_BAND, SPEED, ACCELERATION, TORQUE_LIMIT, SPRING, PLAY, GEAR, KI, PUNCH,
    DERATING, HEATING, FREE_SPEED, STALL, KD, INTEGRAL_LIMIT, RESOLUTION, DRAG, DELTA, RESISTED,
    REST, CUBIC, ZERO, SAG, INSIDE, RESTART, STRAIGHT,
) = range(len(CONSTANTS))
# fmt: on

DAMPING, COULOMB = "damping", "coulomb"  # columns that recordings cannot tell apart, as one
_TIED: Final = {COULOMB: (PLUS, MINUS), DAMPING: (VISCOUS_PLUS, VISCOUS_MINUS)}
COLUMNS: Final = {one.name: (k,) for k, one in enumerate(CONSTANTS)} | _TIED  # by name
GAINS: Final = ("kp", "kv", "gain")  # of which a drive has one
BASE: Final = ("kp", DAMPING, COULOMB, "delay", "inertia", "offset")
SIGNED: Final = tuple(one.name for one in CONSTANTS if one.signed)
ABSENT: Final = np.array([one.absent for one in CONSTANTS])  # a row in which there is nothing
_GEARING: Final = np.array([one.gear for one in CONSTANTS])
USUAL: Final = tuple(CONSTANTS[k].effect for k in (KP, KV, GAIN, DELAY, PLUS, VISCOUS_PLUS, INERTIA,
                                                   OFFSET))  # fmt: skip  # what every joint has


def _by_effect() -> dict[str, dict[str, str]]:
    whole = {columns[0]: name for name, columns in _TIED.items()}
    found = defaultdict[str, dict[str, str]](dict)
    for k, one in enumerate(CONSTANTS):
        if one.effect:
            found[one.effect][whole.get(k, one.name)] = one.unit
    return dict(found)


# Of each effect, the constants that are its values, with their units; the first is its size.
KINDS: Final = _by_effect()


def kinds_of(*, slides: bool) -> dict[str, dict[str, str]]:
    """Return `KINDS` with the units of a joint that slides, or turns."""
    return {
        effect: {name: unit_of(unit, (slides,)) for name, unit in units.items()}
        for effect, units in KINDS.items()
    }


def constant_of(name: str) -> Constant:
    """Return what is known of a constant; of tied ones, of the first."""
    return CONSTANTS[COLUMNS[name][0]]


@dataclass(frozen=True)
class BelievedValue:
    """What is believed of one parameter before any data."""

    value: float
    deviation: float  # in the unit of the value, or of its logarithm where it cannot be negative


def value_in(row: FloatArray, name: str) -> float:
    """Return one of the constants, by name."""
    return float(row[COLUMNS[name][0]])


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
        new[list(COLUMNS[name])] = value
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
    least, most = constant_of(name).bounds
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


def geared(row: FloatArray) -> FloatArray:
    """Return constants as seen at the joint, of a motor behind another gear than the stated one.

    The servo's encoder is on the joint: its gains are torque of the motor by angle of the joint.
    """
    ratio = row[GEAR]
    if ratio == 1.0:
        return row
    new = row * ratio**_GEARING
    new[GEAR] = 1.0
    return new
