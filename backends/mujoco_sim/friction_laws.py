"""Frictions as dampings, for compiled code that integrates them."""

from __future__ import annotations

from limo_driver.physics.effects.friction_laws import friction_torque
from limo_driver.runtime.compiled import compiled

_SMALL_VELOCITY = 1e-9  # [rad/s]


@compiled(inline="always")
def friction_damping(
    law: int, p0: float, p1: float, p2: float, p3: float, velocity: float
) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest.

    An integrator that takes this damping implicitly dissipates at any step size, where the
    friction itself, taken explicitly, would reverse the motion.
    """
    v = away_from_rest(velocity)
    return friction_torque(law, p0, p1, p2, p3, v) / v


@compiled(inline="always")
def away_from_rest(velocity: float) -> float:
    """Return `velocity` [rad/s], of at least a size by which a torque can be divided."""
    return _SMALL_VELOCITY if abs(velocity) < _SMALL_VELOCITY else velocity
