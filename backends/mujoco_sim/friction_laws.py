"""The velocity frictions of the catalogue as scalar functions, for compiled code.

They are held equal to the effects' own `torque` by a test.
"""

from __future__ import annotations

import math

from numba import njit

from limo_driver.physics.friction import SIGN_WIDTH

COULOMB, VISCOUS, STRIBECK = 0, 1, 2  # rows of parameters: (tau_c, v_eps), (f_v,), (tau_s, v_s, δ)
SMALL_VELOCITY = 1e-9  # [rad/s]


@njit(cache=True)
def friction_torque(law: int, p0: float, p1: float, p2: float, velocity: float) -> float:
    """Return the friction torque [N m] of one law, with its parameters, at `velocity` [rad/s]."""
    if law == COULOMB:
        return p0 * math.tanh(velocity / p1)
    if law == VISCOUS:
        return p0 * velocity
    fade = math.exp(-(abs(velocity / p1) ** p2))
    return p0 * fade * math.tanh(velocity / SIGN_WIDTH)


@njit(cache=True)
def friction_damping(law: int, p0: float, p1: float, p2: float, velocity: float) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest."""
    if law == VISCOUS:
        return p0
    v = SMALL_VELOCITY if abs(velocity) < SMALL_VELOCITY else velocity
    return friction_torque(law, p0, p1, p2, v) / v
