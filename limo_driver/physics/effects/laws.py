"""Laws of friction and hysteresis, one sample after the other, compiled.

The laws of friction that depend on velocity alone, compiled.

Each law has a number and up to `PARAMETERS` parameters, of which it takes the first ones. Effects,
simulations and the simulated robot all evaluate the one function below.

Laws of presliding hysteresis, compiled: each advances its memory along a path, in place.

A path is three rows of T samples, (3, T): position, step since the sample before, velocity. A step
is taken as monotonic, and each law is integrated exactly along it where that is possible: the
torque does not depend on the sampling, only on the reversals in the samples. The last entry of
every memory is the last position, NaN before the first. Parameters come in the order in which
`hysteresis.LAWS` lists them. All laws return the torques, (T,) [N m].
"""

from __future__ import annotations

import math

import numpy as np

from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray

# Laws and their parameters: (tau_c, v_eps), (f_v_plus, f_v_minus), (tau_s, v_s, delta, v_eps),
# (tau_plus, tau_minus, v_eps), (coefficient,).
COULOMB, VISCOUS, STRIBECK, ASYMMETRIC, DRAG = 0, 1, 2, 3, 4
PARAMETERS = 4
ROW = PARAMETERS + 3  # with the speed at which it ends, and the slopes beyond, up and down
POSITION, STEP, VELOCITY = 0, 1, 2  # rows of a path [rad, rad, rad/s]
_SHORT_STEP = 0.05  # [presliding distances] of one Runge-Kutta step, for exponents up to 1
_SLIDING = 1e-12  # of tau_c, at most, is yet to come where the joint slides
_FAR = 25.0  # [presliding distances] after which any exponent slides, to 1e-10


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
    torque: FloatArray, velocity: FloatArray, joint: IntArray, law: IntArray, parameters: FloatArray
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


@compiled(reads=("position", "velocity"), nogil=True)
def path_of(memory: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the path from the last position in `memory` on, (3, T), and leave its end there."""
    path = np.empty((3, position.size))
    for t in range(position.size):
        _go(memory, path, t, position[t], velocity[t])
    return path


@compiled(inline="always")
def _go(memory: FloatArray, path: FloatArray, t: int, position: float, velocity: float) -> None:
    path[POSITION, t], path[VELOCITY, t] = position, velocity
    path[STEP, t] = 0.0 if np.isnan(memory[-1]) else position - memory[-1]
    memory[-1] = position


@compiled(reads=("path", "stiffness", "width"), nogil=True)
def maxwell_slip(
    memory: FloatArray, path: FloatArray, stiffness: FloatArray, width: FloatArray
) -> FloatArray:
    """Advance the deflections."""
    torque = np.zeros(path.shape[1])
    for t in range(torque.size):
        for i in range(width.size):
            memory[i] = min(max(memory[i] + path[STEP, t], -width[i]), width[i])
            torque[t] += stiffness[i] * memory[i]
    return torque


@compiled(reads=("position", "velocity", "joint", "ends", "stiffness", "width"), nogil=True)
def add_maxwell_slips(
    torque: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    memory: FloatArray,
    joint: IntArray,
    ends: IntArray,
    stiffness: FloatArray,
    width: FloatArray,
) -> None:
    """Advance several effects at once; add their torques to (T, n), in place.

    Args:
        torque: What they are added to, (T, n) [N m].
        position: Of all joints, (T, n) [rad].
        velocity: The same, (T, n) [rad/s].
        memory: Of one effect after the other, advanced in place.
        joint: 0-based joint of each effect, (E,).
        ends: Where the elements of each effect end among all, (E,).
        stiffness: Of all elements, (k,) [N m/rad].
        width: The same, (k,) [rad].
    """
    start = 0
    for e in range(joint.size):
        j, end = joint[e], ends[e]
        own = memory[start + e : end + e + 1]  # each effect has its last position behind
        path = np.empty((3, position.shape[0]))
        for t in range(position.shape[0]):  # columns are another type than `path_of` takes
            _go(own, path, t, position[t, j], velocity[t, j])
        added = maxwell_slip(own, path, stiffness[start:end], width[start:end])
        for t in range(added.size):  # torque[:, j] += ... would compile the message of its error
            torque[t, j] += added[t]
        start = end


@compiled(nogil=True)
def lugre(
    memory: FloatArray,
    path: FloatArray,
    sigma_0: float,
    tau_c: float,
    sigma_1: float,
    tau_s: float,
    v_s: float,
) -> FloatArray:
    """Advance the bristles' deflection.

    Along a step of constant sliding torque g, z runs exponentially to its end ±g / sigma_0.
    """
    torque = np.zeros(path.shape[1])
    z = memory[0]
    for t in range(torque.size):
        step, v = path[STEP, t], path[VELOCITY, t]
        g = tau_c + tau_s * math.exp(-((v / v_s) ** 2))
        end = math.copysign(g / sigma_0, step)
        z = end + (z - end) * math.exp(-sigma_0 * abs(step) / g)
        torque[t] = sigma_0 * z + sigma_1 * (v - sigma_0 * abs(v) / g * z)
    memory[0] = z
    return torque


@compiled(nogil=True)
def dahl(
    memory: FloatArray, path: FloatArray, sigma_0: float, tau_c: float, exponent: float
) -> FloatArray:
    """Advance the torque.

    With x = 1 - tau sign(dq) / tau_c, dx/d|q| = -(sigma_0 / tau_c) x^exponent has a closed form.
    """
    torque = np.zeros(path.shape[1])
    tau = memory[0]
    for t in range(torque.size):
        step = path[STEP, t]
        direction = 1.0 if step >= 0.0 else -1.0
        x = max(1.0 - tau * direction / tau_c, 0.0)
        run = sigma_0 * abs(step) / tau_c
        if abs(exponent - 1.0) < 1e-9:  # noqa: PLR2004  # the limit of the other form
            x *= math.exp(-run)
        elif x > 0.0:
            power = x ** (1.0 - exponent) + (exponent - 1.0) * run
            x = power ** (1.0 / (1.0 - exponent)) if power > 0.0 else 0.0
        tau = direction * tau_c * (1.0 - x)
        torque[t] = tau
    memory[0] = tau
    return torque


@compiled(nogil=True)
def bouc_wen(
    memory: FloatArray,
    path: FloatArray,
    sigma_0: float,
    tau_c: float,
    beta_ratio: float,
    exponent: float,
) -> FloatArray:
    """Advance the torque over tau_c."""
    torque = np.zeros(path.shape[1])
    for t in range(torque.size):
        step = path[STEP, t]
        run = min(sigma_0 * abs(step) / tau_c, _FAR)
        direction = 1.0 if step >= 0.0 else -1.0
        parts = math.ceil(run * max(exponent, 1.0) / _SHORT_STEP)
        zeta, h = memory[0] * direction, run / max(parts, 1)
        for _ in range(parts):
            k1 = _bouc_wen_slope(zeta, beta_ratio, exponent)
            if abs(k1) * run < _SLIDING:
                break
            k2 = _bouc_wen_slope(zeta + 0.5 * h * k1, beta_ratio, exponent)
            k3 = _bouc_wen_slope(zeta + 0.5 * h * k2, beta_ratio, exponent)
            k4 = _bouc_wen_slope(zeta + h * k3, beta_ratio, exponent)
            zeta += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        memory[0] = direction * min(max(zeta, -1.0), 1.0)
        torque[t] = tau_c * memory[0]
    return torque


@compiled(nogil=True)
def _bouc_wen_slope(zeta: float, beta_ratio: float, exponent: float) -> float:
    """Return d zeta / d run in the direction of motion; zeta is positive where it resists."""
    sign = 1.0 if zeta >= 0.0 else -1.0
    return 1.0 - abs(zeta) ** exponent * (beta_ratio * sign + 1.0 - beta_ratio)


@compiled(nogil=True)
def preisach(
    memory: FloatArray, path: FloatArray, up: FloatArray, down: FloatArray, weight: FloatArray
) -> FloatArray:
    """Switch the relays, which are 1, -1, or 0 before the first sample."""
    torque = np.zeros(path.shape[1])
    for t in range(torque.size):
        q = path[POSITION, t]
        for i in range(up.size):
            if memory[i] == 0.0:
                memory[i] = 1.0 if q > 0.5 * (up[i] + down[i]) else -1.0
            if q > up[i]:
                memory[i] = 1.0
            elif q < down[i]:
                memory[i] = -1.0
            torque[t] += weight[i] * memory[i]
    return torque
