"""Columns of the table that compiled code reads: the constants of one joint and its drive a row."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

NAMES: Final = (
    "kp",  # [N m/rad]
    "kd",  # [N m s/rad]
    "ki",  # [N m/(rad s)]
    "integral_limit",  # [N m]
    "dead_band",  # [rad]
    "punch",  # [N m]
    "speed",  # [rad/s]
    "acceleration",  # [rad/s²]
    "torque_limit",  # [N m]
    "delay",  # [s]
    "resolution",  # [rad]
    "stall",  # [N m], of the motor
    "free_speed",  # [rad/s], at which the motor without load stops gaining speed
    "inertia",  # [kg m²], of the drive
    "plus",  # [N m], dry friction moving positive
    "minus",  # [N m], and negative
    "viscous_plus",  # [N m s/rad]
    "viscous_minus",  # [N m s/rad]
    "drag",  # [N m s²/rad²]
    "stribeck",  # [N m], break-away beyond dry friction
    "v_s",  # [rad/s], at which that fades
    "delta",  # exponent of the fading
    "by_load",  # dry friction by N m of load
    "resisted",  # factor of that while the load resists the motion
    "assisted",  # and while it drives it
    "offset",  # [N m], which the joint needs beside the rigid body
    "spring",  # [N m/rad]
    "rest",  # [rad]
    "cubic",  # [N m/rad³]
    "zero",  # [rad], encoder minus link
    "play",  # [rad], between the servo's encoder and the joint
    "gear",  # ratio of the gear over the stated one, between motor and encoder
    "sag",  # resistance of the supply over that of a motor's winding
    "derating",  # resistance that a stalled motor's winding gains in the end, over its own
    "heating",  # [s], in which it does
    "inside",  # share of the damping that the servo makes, within its torque limit
    "kv",  # [N m s/rad], of a servo of velocity, which has no kp
    "restart",  # [s], after which errors begin anew where the joint was
    "straight",  # whether a command that is sent again is followed at once, without the profile
    "gain",  # of a drive that is told torques, and has no other: torque over the one commanded
)
(
    KP,
    KD,
    KI,
    INTEGRAL_LIMIT,
    DEAD_BAND,
    PUNCH,
    SPEED,
    ACCELERATION,
    TORQUE_LIMIT,
    DELAY,
    RESOLUTION,
    STALL,
    FREE_SPEED,
    INERTIA,
    PLUS,
    MINUS,
    VISCOUS_PLUS,
    VISCOUS_MINUS,
    DRAG,
    STRIBECK,
    V_S,
    DELTA,
    BY_LOAD,
    RESISTED,
    ASSISTED,
    OFFSET,
    SPRING,
    REST,
    CUBIC,
    ZERO,
    PLAY,
    GEAR,
    SAG,
    DERATING,
    HEATING,
    INSIDE,
    KV,
    RESTART,
    STRAIGHT,
    GAIN,
) = range(len(NAMES))
UNLIMITED: Final = (
    "integral_limit",
    "speed",
    "acceleration",
    "torque_limit",
    "stall",
    "free_speed",
    "restart",
)
_GEARED: Final = {  # powers of the gear's ratio in what is seen at the joint
    1: (KP, KV, GAIN, KI, INTEGRAL_LIMIT, PUNCH, TORQUE_LIMIT, STALL, PLUS, MINUS, STRIBECK),
    2: (KD, INERTIA, VISCOUS_PLUS, VISCOUS_MINUS),
    -1: (FREE_SPEED,),
}


def geared(row: FloatArray) -> FloatArray:
    """Return constants as seen at the joint, of a motor behind another gear than the stated one.

    The servo's encoder is on the joint: its gains are torque of the motor by angle of the joint.
    """
    ratio = row[GEAR]
    if ratio == 1.0:
        return row
    new = row.copy()
    for power, columns in _GEARED.items():
        new[list(columns)] *= ratio**power
    new[GEAR] = 1.0
    return new
