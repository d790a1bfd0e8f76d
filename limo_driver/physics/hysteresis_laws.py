"""Laws of presliding hysteresis, compiled: each advances a state along T positions.

The last entry of every state is the last position, NaN before the first. A step between two
positions is taken as monotonic, and each law is integrated exactly along it where that is
possible: the torque does not depend on the sampling, only on the reversals in the samples.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_SHORT_STEP = 0.05  # [presliding distances] of one Runge-Kutta step, for exponents up to 1
_FAR = 25.0  # [presliding distances] after which any exponent slides, to 1e-10


@njit(cache=True)
def maxwell_slip(
    state: FloatArray, position: FloatArray, stiffness: FloatArray, width: FloatArray
) -> FloatArray:
    """Advance the deflections in place; return the torques (T,) [N m]."""
    torque = np.zeros(position.size)
    last = state[-1]
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        last = position[t]
        for i in range(width.size):
            state[i] = min(max(state[i] + step, -width[i]), width[i])
            torque[t] += stiffness[i] * state[i]
    state[-1] = last
    return torque


@njit(cache=True)
def lugre(
    state: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    sigma_0: float,
    sigma_1: float,
    tau_c: float,
    tau_s: float,
    v_s: float,
) -> FloatArray:
    """Advance the bristles' deflection in place; return the torques (T,) [N m].

    Along a step of constant sliding torque g, z runs exponentially to its end ±g / sigma_0.
    """
    torque = np.zeros(position.size)
    z, last = state[0], state[-1]
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        last = position[t]
        v = velocity[t]
        g = tau_c + tau_s * math.exp(-((v / v_s) ** 2))
        end = math.copysign(g / sigma_0, step)
        z = end + (z - end) * math.exp(-sigma_0 * abs(step) / g)
        torque[t] = sigma_0 * z + sigma_1 * (v - sigma_0 * abs(v) / g * z)
    state[0], state[-1] = z, last
    return torque


@njit(cache=True)
def dahl(
    state: FloatArray, position: FloatArray, sigma_0: float, tau_c: float, exponent: float
) -> FloatArray:
    """Advance the torque in place; return the torques (T,) [N m].

    With x = 1 - tau sign(dq) / tau_c, dx/d|q| = -(sigma_0 / tau_c) x^exponent has a closed form.
    """
    torque = np.zeros(position.size)
    last = state[-1]
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        last = position[t]
        direction = 1.0 if step >= 0.0 else -1.0
        x = max(1.0 - state[0] * direction / tau_c, 0.0)
        run = sigma_0 * abs(step) / tau_c
        if abs(exponent - 1.0) < 1e-9:  # noqa: PLR2004  # the limit of the other form
            x *= math.exp(-run)
        elif x > 0.0:
            power = x ** (1.0 - exponent) + (exponent - 1.0) * run
            x = power ** (1.0 / (1.0 - exponent)) if power > 0.0 else 0.0
        state[0] = direction * tau_c * (1.0 - x)
        torque[t] = state[0]
    state[-1] = last
    return torque


@njit(cache=True)
def bouc_wen(
    state: FloatArray,
    position: FloatArray,
    sigma_0: float,
    tau_c: float,
    beta_ratio: float,
    exponent: float,
) -> FloatArray:
    """Advance the torque over tau_c in place; return the torques (T,) [N m]."""
    torque = np.zeros(position.size)
    last = state[-1]
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        last = position[t]
        run = min(sigma_0 * abs(step) / tau_c, _FAR)
        direction = 1.0 if step >= 0.0 else -1.0
        parts = math.ceil(run * max(exponent, 1.0) / _SHORT_STEP)
        zeta = state[0] * direction
        for _ in range(parts):
            h = run / parts
            k1 = _bouc_wen_slope(zeta, beta_ratio, exponent)
            k2 = _bouc_wen_slope(zeta + 0.5 * h * k1, beta_ratio, exponent)
            k3 = _bouc_wen_slope(zeta + 0.5 * h * k2, beta_ratio, exponent)
            k4 = _bouc_wen_slope(zeta + h * k3, beta_ratio, exponent)
            zeta += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        state[0] = direction * min(max(zeta, -1.0), 1.0)
        torque[t] = tau_c * state[0]
    state[-1] = last
    return torque


@njit(cache=True)
def _bouc_wen_slope(zeta: float, beta_ratio: float, exponent: float) -> float:
    """Return d zeta / d run in the direction of motion; zeta is positive where it resists."""
    sign = 1.0 if zeta >= 0.0 else -1.0
    return 1.0 - abs(zeta) ** exponent * (beta_ratio * sign + 1.0 - beta_ratio)


@njit(cache=True)
def preisach(
    state: FloatArray, position: FloatArray, up: FloatArray, down: FloatArray, weight: FloatArray
) -> FloatArray:
    """Switch the relays in place; return the torques (T,) [N m]."""
    torque = np.zeros(position.size)
    for t in range(position.size):
        q = position[t]
        for i in range(up.size):
            if np.isnan(state[-1]):
                state[i] = 1.0 if q > 0.5 * (up[i] + down[i]) else -1.0
            if q > up[i]:
                state[i] = 1.0
            elif q < down[i]:
                state[i] = -1.0
            torque[t] += weight[i] * state[i]
        state[-1] = q
    return torque
