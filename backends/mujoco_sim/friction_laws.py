"""The velocity frictions of the catalogue as scalar functions, for compiled code.

They are held equal to the effects' own `torque` by a test.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from numba import njit

from limo_driver.physics.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

COULOMB, VISCOUS, STRIBECK = 0, 1, 2  # rows of parameters: (tau_c, v_eps), (f_v,), (tau_s, v_s, δ)
SMALL_VELOCITY = 1e-9  # [rad/s]


@njit(cache=True)
def friction_torque(law: int, parameters: FloatArray, velocity: float) -> float:
    """Return the friction torque [N m] of one law at `velocity` [rad/s]."""
    if law == COULOMB:
        return parameters[0] * math.tanh(velocity / parameters[1])
    if law == VISCOUS:
        return parameters[0] * velocity
    fade = math.exp(-(abs(velocity / parameters[1]) ** parameters[2]))
    return parameters[0] * fade * math.tanh(velocity / SIGN_WIDTH)


@njit(cache=True)
def friction_damping(law: int, parameters: FloatArray, velocity: float) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest."""
    v = SMALL_VELOCITY if abs(velocity) < SMALL_VELOCITY else velocity
    return friction_torque(law, parameters, v) / v
