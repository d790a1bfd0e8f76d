"""The velocity frictions of the catalogue as scalar functions, for compiled code.

They are held equal to the effects' own `torque` by a test.
"""

from __future__ import annotations

import math

from numba import njit

# Rows of parameters: (tau_c, v_eps), (f_v_plus, f_v_minus), (tau_s, v_s, delta, v_eps),
# (tau_plus, tau_minus, v_eps), (coefficient,).
COULOMB, VISCOUS, STRIBECK, ASYMMETRIC, DRAG = 0, 1, 2, 3, 4
PARAMETERS = 4
_SMALL_VELOCITY = 1e-9  # [rad/s]


@njit(cache=True)
def friction_torque(law: int, p0: float, p1: float, p2: float, p3: float, velocity: float) -> float:
    """Return the friction torque [N m] of one law, with its parameters, at `velocity` [rad/s]."""
    if law == COULOMB:
        return p0 * math.tanh(velocity / p1)
    if law == VISCOUS:
        return (p0 if velocity > 0.0 else p1) * velocity
    if law == ASYMMETRIC:
        return (p0 if velocity > 0.0 else p1) * math.tanh(velocity / p2)
    if law == DRAG:
        return p0 * velocity * abs(velocity)
    fade = math.exp(-(abs(velocity / p1) ** p2))
    return p0 * fade * math.tanh(velocity / p3)


@njit(cache=True)
def friction_damping(
    law: int, p0: float, p1: float, p2: float, p3: float, velocity: float
) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest.

    An integrator that takes this damping implicitly dissipates at any step size, where the
    friction itself, taken explicitly, would reverse the motion.
    """
    v = away_from_rest(velocity)
    return friction_torque(law, p0, p1, p2, p3, v) / v


@njit(cache=True)
def away_from_rest(velocity: float) -> float:
    """Return `velocity` [rad/s], of at least a size by which a torque can be divided."""
    return _SMALL_VELOCITY if abs(velocity) < _SMALL_VELOCITY else velocity
