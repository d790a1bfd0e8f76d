"""The columns of joint physics, row by row, in one compiled loop; `columns` says what they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from estimators.rigid_body.dynamics.newton_euler import inverse_dynamics
from estimators.rigid_body.dynamics.regressor import fill_regressor
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

    # rotation, translation, axis and gravity of a `Chain`, and its links' parameters (n, 10)
    Arm: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]

WIDTHS: Final = np.geomspace(1e-4, 0.3, 14)  # [rad], from an encoder's jitter to a large reach
SPEEDS: Final = np.array([0.003, 0.01, 0.03, 0.1, 0.3])  # [rad/s], creep to a brisk reach
SHARP: Final = np.array([0.001, 0.01])  # [rad/s], of the signs that the filter smooths
STATES: Final = WIDTHS.size + SPEEDS.size + SHARP.size  # of the friction of a joint
HARMONICS: Final = 3
FRICTION_HARMONICS: Final = 2
LAST, LOWEST, HIGHEST = -3, -2, -1  # columns of a joint's memory, after its stops
MEMORIES: Final = 3  # these
DIFFERENCE: Final = 1e-4  # [rad], of the central differences of the load


@compiled(reads=("position", "velocity", "acceleration", "torque", "base"), nogil=True)
def scan(
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    arm: Arm,
    base: NDArray[np.int64],
    step_time: float,
    every: int,
    X: FloatArray,
    about: FloatArray,
) -> None:
    """Advance `memory` (n, ...) in place over T samples and write one row for so many.

    X (n, rows, K) gets the columns, `about` (2, rows, n) the range that each joint has turned in so
    far [rad] and its load [N m]. `base` are the columns of the links' regressor that are kept.
    """
    T, n = position.shape
    rotation, translation, axis, gravity, parameters = arm
    Y = np.zeros((n, 1, parameters.size))
    parent = np.arange(n) - 1  # in series, as `link_parameters` sees to
    load, slope = np.empty(n), np.empty((n, n))
    for t in range(T):
        _remember(memory, position[t])
        if t % every:
            continue
        now, row = slice(t, t + 1), t // every
        q, v, a = position[t], velocity[t], acceleration[t]
        fill_regressor(
            parent, rotation, translation, axis, gravity,
            position[now], velocity[now], acceleration[now], Y,
        )  # fmt: skip
        _load_and_slope(arm, q, v, a, load, slope)
        for j in range(n):
            x = X[j, row]
            for k in range(base.size):
                x[k] = Y[j, 0, base[k]]
            _fill(j, q, v, step_time, a, memory[j], load, slope, torque[t], x[base.size :])
            about[0, row, j] = memory[j, HIGHEST] - memory[j, LOWEST]
            about[1, row, j] = load[j]


@compiled(nogil=True)
def _remember(memory: FloatArray, position: FloatArray) -> None:
    """Advance the memory of each joint in place to its next position."""
    for j in range(position.size):
        own, q = memory[j], position[j]
        if np.isnan(own[LAST]):
            own[LAST] = own[LOWEST] = own[HIGHEST] = q
        step = q - own[LAST]
        own[LAST], own[LOWEST], own[HIGHEST] = q, min(q, own[LOWEST]), max(q, own[HIGHEST])
        for i in range(WIDTHS.size):
            own[i] = min(max(own[i] + step / WIDTHS[i], -1.0), 1.0)


@compiled(nogil=True)
def _load_and_slope(
    arm: Arm,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    load: FloatArray,
    slope: FloatArray,
) -> None:
    """Write ID, (n,) [N m], and d ID / d q_m, (n, n) [N m/rad], first m."""
    inverse_dynamics(*arm, position, velocity, acceleration, load)
    q, below = position.copy(), np.empty(load.size)
    for m in range(load.size):
        q[m] = position[m] + DIFFERENCE
        inverse_dynamics(*arm, q, velocity, acceleration, slope[m])
        q[m] = position[m] - DIFFERENCE
        inverse_dynamics(*arm, q, velocity, acceleration, below)
        q[m] = position[m]
        for j in range(load.size):
            slope[m, j] = (slope[m, j] - below[j]) / (2 * DIFFERENCE)


@compiled(nogil=True)
def _fill(
    j: int,
    position: FloatArray,
    velocity: FloatArray,
    step_time: float,
    acceleration: FloatArray,
    memory: FloatArray,
    load: FloatArray,
    slope: FloatArray,
    torque: FloatArray,
    x: FloatArray,
) -> None:
    """Write all families of joint j but the first into x (K - rigid,)."""
    n, q, v, a, own = position.size, position[j], velocity[j], acceleration[j], load[j]
    states = np.empty(STATES)
    _friction_states(memory[: WIDTHS.size], v, step_time * a, states)
    x[0], x[1] = a, 1.0
    k = 2
    for m in range(n):
        x[k + m] = torque[m]
        x[k + n + m] = slope[m, j]
        x[k + 2 * n + m] = slope[m, j] * load[m]
    k = _append(x, k + 3 * n, states, 1.0)
    x[k], x[k + 1], x[k + 2] = v, v * abs(v), np.sign(v) * np.sqrt(abs(v))
    k = _append(x, k + 3, states, abs(own))
    x[k] = abs(own) * v
    k += 1
    for i in range(1, HARMONICS + 1):
        x[k], x[k + 1] = np.sin(i * q), np.cos(i * q)
        k += 2
    for i in range(1, FRICTION_HARMONICS + 1):
        for wave in (np.sin(i * q), np.cos(i * q)):
            k = _append(x, k, states, wave)
            x[k] = wave * v
            k += 1


@compiled(nogil=True)
def _append(x: FloatArray, k: int, states: FloatArray, factor: float) -> int:
    """Write the states times a factor at k; return where they end."""
    for i in range(states.size):
        x[k + i] = factor * states[i]
    return k + states.size


@compiled(nogil=True)
def _friction_states(stops: FloatArray, v: float, change: float, states: FloatArray) -> None:
    """Write the friction states of a joint whose speed v changes by `change` in a filtered step."""
    k = stops.size
    for i in range(k):  # states[:k] = stops would compile the message of its error
        states[i] = stops[i]
    for i in range(SPEEDS.size):
        states[k + i] = np.tanh(v / SPEEDS[i])
    k += SPEEDS.size
    for i in range(SHARP.size):
        states[k + i] = np.tanh(v / np.sqrt(SHARP[i] ** 2 + change**2))
