"""The columns of the joint-physics model: what the torque of a joint can be linear in.

For joint j at one instant, with load ID = inverse dynamics of the rigid body, torque tau_S of the
simulation, and friction states z of the joint, the families are

    rigid        Y_j(q, dq, ddq), links' parameters       errors of masses, centres and inertias
    armature     ddq_j                                    inertia of the drive
    offset       1                                        offset of the sensor
    gain         tau_S of every joint                     gain of the sensor, crosstalk
    placement    d ID_j / d q_m                           offsets of the encoders
    elasticity   d ID_j / d q_m ID_m                      drives that give way to their load
    friction     z                                        presliding, Coulomb and Stribeck friction
    viscous      dq_j, dq_j |dq_j|, sign(dq_j) √|dq_j|
    load         |ID_j| (z, dq_j)                         friction grows with load
    place        sin, cos (k q_j), k to 3                 once-per-revolution torques
    place_friction  sin, cos (k q_j) (z, dq_j), k to 2    friction depends on the angle

The states z of a joint are stop operators z ← clip(z + Δq, -w, w) / w over a geometric range of
widths w, whose weighted sum is any symmetric hysteresis of Prandtl and Ishlinskii, and smoothed
directions tanh(dq / v) over a range of speeds v, whose differences are Stribeck curves. Two more,
tanh(dq / √(v² + (T ddq)²)), take the time T to change sign that the filter's step response takes.

All grow at most as velocity, load or slope do, but for the viscous family: what extrapolates has to
be what physics extrapolates. Columns are written by one compiled loop, for a recording and for a
single sample alike.

Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 12 (rigid
body); Al-Bender, Lampaert and Swevers, "The generalized Maxwell-slip model", IEEE TAC 2005, and
Visintin, "Differential Models of Hysteresis", 1994 (stops); Hamon, Gautier and Garrec, "New dynamic
model with load-dependent friction", IROS 2011; Armstrong-Hélouvry, Dupont and Canudas de Wit, "A
survey of models ... for the control of machines with friction", Automatica 1994 (Stribeck, angle).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

from estimators.rigid_body.base_parameters import find_base_parameters
from estimators.rigid_body.regressor import PER_LINK, Chain
from estimators.rigid_body.terms import JointTerms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray, Motion

_WIDTHS: Final = np.geomspace(1e-4, 0.3, 14)  # [rad], from an encoder's jitter to a large reach
_SPEEDS: Final = np.array([0.003, 0.01, 0.03, 0.1, 0.3])  # [rad/s], creep to a brisk reach
_SHARP: Final = np.array([0.001, 0.01])  # [rad/s], of the signs that the filter smooths
_STEP_TIME: Final = 0.2  # [1/bandwidth], that a filtered step takes to half its height
_HARMONICS: Final = 3
_FRICTION_HARMONICS: Final = 2
SETTLED: Final = 0.02  # [rad], twice the width within which nearly all presliding takes place
_LAST, _LOWEST, _HIGHEST = -3, -2, -1  # columns of a joint's memory, after its stops
_DIFFERENCE: Final = 1e-4  # [rad], of the central differences of the load


@dataclass(frozen=True)
class Family:
    """Columns of one origin, which share the prior variance of their weights."""

    name: str
    size: int


@dataclass(frozen=True)
class Rows:
    """What is known of T samples before any torque is.

    A joint is settled once it has turned so far that its friction no longer depends on how it came
    to its first position, which nobody knows.
    """

    columns: FloatArray  # (n, T, K)
    settled: NDArray[np.bool_]  # (T, n)

    def of(self, samples: NDArray[np.bool_]) -> Rows:
        """Return those of some samples, by a mask (T,)."""
        return Rows(self.columns[:, samples], self.settled[samples])


@dataclass(frozen=True)
class Columns:
    """The columns of n joints, K each.

    Args:
        body: The rigid body.
        bandwidth: Of the filters on motion and torque [Hz].
    """

    body: RobotModel
    bandwidth: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.body.n

    @cached_property
    def families(self) -> tuple[Family, ...]:
        """All families, in the order of their columns."""
        n, states = self.n, _WIDTHS.size + _SPEEDS.size + _SHARP.size
        sizes = {
            "rigid": self._base.size,
            "armature": 1,
            "offset": 1,
            "gain": n,
            "placement": n,
            "elasticity": n,
            "friction": states,
            "viscous": 3,
            "load": states + 1,
            "place": 2 * _HARMONICS,
            "place_friction": 2 * _FRICTION_HARMONICS * (states + 1),
        }
        return tuple(Family(name, size) for name, size in sizes.items())

    @cached_property
    def family(self) -> NDArray[np.int64]:
        """Which family each column is of, (K,)."""
        return np.repeat(np.arange(len(self.families)), [f.size for f in self.families])

    @property
    def count(self) -> int:
        """Number K of columns of a joint."""
        return self.family.size

    @cached_property
    def _chain(self) -> Chain:
        return Chain.of(self.body)

    @cached_property
    def _base(self) -> NDArray[np.int64]:
        """Columns of the links' regressor that are independent of each other."""
        independent = find_base_parameters(
            self.body, JointTerms(offset=False, armature=False)
        ).independent
        return independent[independent < PER_LINK * self.n]

    def init(self) -> FloatArray:
        """Return the memory before the first sample, a row for each joint.

        It holds the stops, at rest in their middle, the last position, and the range so far.
        """
        memory = np.zeros((self.n, _WIDTHS.size + 3))
        memory[:, _LAST] = np.nan
        return memory

    def advance(
        self, memory: FloatArray, motion: Motion, torque: FloatArray, every: int = 1
    ) -> tuple[Rows, FloatArray]:
        """Compute the columns of T samples that follow `memory`.

        Args:
            memory: Memory after the sample before.
            motion: T samples of n joints.
            torque: Of the simulation, (T, n) [N m].
            every: Give one row for so many samples; memory sees them all.

        Returns:
            The rows, and the memory after the last sample.
        """
        after = memory.copy()
        stops, turned = _remember(after, motion.position, every)
        if every > 1:
            motion, torque = motion[::every], torque[::every]
        load, slope = self._load_and_slope(motion)
        X = np.empty((self.n, len(motion), self.count))
        X[:, :, : self._base.size] = self._chain.regressor(motion)[:, :, self._base]
        _fill(
            motion.position,
            motion.velocity,
            motion.acceleration,
            stops,
            load,
            slope,
            torque,
            _STEP_TIME / self.bandwidth,
            X[:, :, self._base.size :],
        )
        return Rows(X, turned > SETTLED), after

    def _load_and_slope(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return ID, (T, n) [N m], and d ID / d q_m, (n, T, n) [N m/rad], first m."""
        n, shape = self.n, motion.position.shape
        steps = _DIFFERENCE * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
        position = motion.position + steps[:, None]  # (1 + 2n, T, n), in one call for speed
        others = (
            np.broadcast_to(x, position.shape) for x in (motion.velocity, motion.acceleration)
        )
        load = self.body.inverse_dynamics(
            position.reshape(-1, n), *(x.reshape(-1, n) for x in others)
        ).reshape(-1, *shape)
        return load[0], (load[1 : n + 1] - load[n + 1 :]) / (2 * _DIFFERENCE)


@njit(cache=True)
def _remember(
    memory: FloatArray, position: FloatArray, every: int
) -> tuple[FloatArray, FloatArray]:
    """Advance `memory` (n, ...) in place over (T, n); return of some rows r what is remembered.

    Returns:
        The stops, (r, n, w), and the range that each joint has turned in so far, (r, n) [rad].
    """
    T, n = position.shape
    rows = -(-T // every)
    stops, turned = np.empty((rows, n, _WIDTHS.size)), np.empty((rows, n))
    for t in range(T):
        for j in range(n):
            own, q = memory[j], position[t, j]
            if np.isnan(own[_LAST]):
                own[_LAST] = own[_LOWEST] = own[_HIGHEST] = q
            step = q - own[_LAST]
            own[_LAST], own[_LOWEST] = q, min(q, own[_LOWEST])
            own[_HIGHEST] = max(q, own[_HIGHEST])
            for i in range(_WIDTHS.size):
                own[i] = min(max(own[i] + step / _WIDTHS[i], -1.0), 1.0)
            if t % every == 0:
                stops[t // every, j] = own[: _WIDTHS.size]
                turned[t // every, j] = own[_HIGHEST] - own[_LOWEST]
    return stops, turned


@njit(cache=True)
def _fill(
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    stops: FloatArray,
    load: FloatArray,
    slope: FloatArray,
    torque: FloatArray,
    step_time: float,
    X: FloatArray,
) -> None:
    """Write all families but the first into X (n, T, K - rigid)."""
    T, n = position.shape
    states = np.empty(_WIDTHS.size + _SPEEDS.size + _SHARP.size)
    for t in range(T):
        for j in range(n):
            q, v, a, own = position[t, j], velocity[t, j], acceleration[t, j], load[t, j]
            _friction_states(stops[t, j], v, step_time * a, states)
            x = X[j, t]
            x[0], x[1] = a, 1.0
            k = 2
            for m in range(n):
                x[k + m] = torque[t, m]
                x[k + n + m] = slope[m, t, j]
                x[k + 2 * n + m] = slope[m, t, j] * load[t, m]
            k = _append(x, k + 3 * n, states, 1.0)
            x[k], x[k + 1], x[k + 2] = v, v * abs(v), np.sign(v) * np.sqrt(abs(v))
            k = _append(x, k + 3, states, abs(own))
            x[k] = abs(own) * v
            k += 1
            for i in range(1, _HARMONICS + 1):
                x[k], x[k + 1] = np.sin(i * q), np.cos(i * q)
                k += 2
            for i in range(1, _FRICTION_HARMONICS + 1):
                for wave in (np.sin(i * q), np.cos(i * q)):
                    k = _append(x, k, states, wave)
                    x[k] = wave * v
                    k += 1


@njit(cache=True)
def _append(x: FloatArray, k: int, states: FloatArray, factor: float) -> int:
    """Write the states times a factor at k; return where they end."""
    for i in range(states.size):
        x[k + i] = factor * states[i]
    return k + states.size


@njit(cache=True)
def _friction_states(stops: FloatArray, v: float, change: float, states: FloatArray) -> None:
    """Write the friction states of a joint whose speed v changes by `change` in a filtered step."""
    states[: stops.size] = stops
    k = stops.size
    for i in range(_SPEEDS.size):
        states[k + i] = np.tanh(v / _SPEEDS[i])
    k += _SPEEDS.size
    for i in range(_SHARP.size):
        states[k + i] = np.tanh(v / np.sqrt(_SHARP[i] ** 2 + change**2))
