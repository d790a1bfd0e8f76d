"""The laws of friction that depend on velocity alone, compiled.

Each law has a number and up to `PARAMETERS` parameters, of which it takes the first ones. Effects,
simulations and the simulated robot all evaluate the one function below.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

# Laws and their parameters: (tau_c, v_eps), (f_v_plus, f_v_minus), (tau_s, v_s, delta, v_eps),
# (tau_plus, tau_minus, v_eps), (coefficient,).
COULOMB, VISCOUS, STRIBECK, ASYMMETRIC, DRAG = 0, 1, 2, 3, 4
PARAMETERS = 4


@compiled(inline="always")
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


@compiled(reads=("parameters", "velocity"), nogil=True)
def friction_torques(law: int, parameters: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the torque of one law at many velocities, (N,) [N m]; parameters (PARAMETERS,)."""
    p0, p1, p2, p3 = parameters
    torque = np.empty(velocity.size)
    for t in range(velocity.size):
        torque[t] = friction_torque(law, p0, p1, p2, p3, velocity[t])
    return torque


@compiled(reads=("velocity", "joint", "law", "parameters"), nogil=True)
def add_frictions(
    torque: FloatArray,
    velocity: FloatArray,
    joint: NDArray[np.int64],
    law: NDArray[np.int64],
    parameters: FloatArray,
) -> None:
    """Add F frictions to `torque` (T, n) [N m], in place, at `velocity` (T, n) [rad/s].

    Args:
        torque: What they are added to.
        velocity: Of all joints.
        joint: 0-based joint of each friction, (F,).
        law: Its law, (F,).
        parameters: Its parameters, (F, PARAMETERS).
    """
    for f in range(joint.size):
        j, kind = joint[f], law[f]
        p0, p1, p2, p3 = parameters[f]
        for t in range(torque.shape[0]):
            torque[t, j] += friction_torque(kind, p0, p1, p2, p3, velocity[t, j])
