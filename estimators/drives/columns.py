"""Columns of the table that compiled code reads: the constants of one joint and its drive a row."""

from __future__ import annotations

from typing import Final

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
    "fading",  # [N m s/rad], what the motor loses with speed
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
    "offset",  # [N m], which the joint needs beside the rigid body
    "spring",  # [N m/rad]
    "rest",  # [rad]
    "cubic",  # [N m/rad³]
    "zero",  # [rad], encoder minus link
    "play",  # [rad], between the servo's encoder and the joint
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
    FADING,
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
    OFFSET,
    SPRING,
    REST,
    CUBIC,
    ZERO,
    PLAY,
) = range(len(NAMES))
UNLIMITED: Final = ("integral_limit", "speed", "acceleration", "torque_limit", "stall")
