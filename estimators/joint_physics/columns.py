"""Columns of joint physics: the terms in which the torque of a joint is linear.

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
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from estimators.rigid_body.base_parameters import BaseParameters, find_base_parameters
from estimators.rigid_body.regressor import (
    PER_LINK,
    RegressorChain,
    fill_regressor,
    inverse_dynamics,
    link_parameters,
)
from estimators.rigid_body.terms import JointTerms
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.types import BoolArray, FloatArray, IntArray, Motion

    Arm: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]

_STEP_TIME: Final = 0.2  # [1/bandwidth], that a filtered step takes to half its height
SETTLED: Final = 0.02  # [rad], twice the width within which nearly all presliding takes place
WIDTHS: Final = np.geomspace(1e-4, 0.3, 14)  # [rad], from an encoder's jitter to a large reach
SPEEDS: Final = np.array([0.003, 0.01, 0.03, 0.1, 0.3])  # [rad/s], creep to a brisk reach
SHARP: Final = np.array([0.001, 0.01])  # [rad/s], of the signs that the filter smooths
STATES: Final = WIDTHS.size + SPEEDS.size + SHARP.size  # of the friction of a joint
HARMONICS: Final = 3
FRICTION_HARMONICS: Final = 2
LAST, LOWEST, HIGHEST = -3, -2, -1  # columns of a joint's memory, after its stops
MEMORIES: Final = 3  # these
DIFFERENCE: Final = 1e-4  # [rad], of the central differences of the load


@dataclass(frozen=True)
class Family:
    """Columns of one origin, which share the prior variance of their weights."""

    name: str
    size: int


@dataclass(frozen=True)
class ColumnRows:
    """Signals of T samples that follow from the motion alone.

    A joint is settled once it has turned so far that its friction no longer depends on how it came
    to its first position, which nobody knows.
    """

    columns: FloatArray  # (n, T, K)
    about: FloatArray  # (2, T, n), range turned in so far [rad] and load [N m]

    @property
    def settled(self) -> BoolArray:
        """Mark joints whose stops no longer depend on their initial state, (T, n)."""
        return self.about[0] > SETTLED

    def of(self, samples: BoolArray) -> ColumnRows:
        """Return those of some samples, by a mask (T,)."""
        return ColumnRows(self.columns[:, samples], self.about[:, samples])


@dataclass(frozen=True)
class JointColumns:
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
        n, states = self.n, STATES
        sizes = {
            "rigid": self.base.size,
            "armature": 1,
            "offset": 1,
            "gain": n,
            "placement": n,
            "elasticity": n,
            "friction": states,
            "viscous": 3,
            "load": states + 1,
            "place": 2 * HARMONICS,
            "place_friction": 2 * FRICTION_HARMONICS * (states + 1),
        }
        return tuple(Family(name, size) for name, size in sizes.items())

    @cached_property
    def family(self) -> IntArray:
        """Family of each column, (K,)."""
        return np.repeat(np.arange(len(self.families)), [f.size for f in self.families])

    @property
    def count(self) -> int:
        """Number K of columns of a joint."""
        return self.family.size

    def of_family(self, name: str) -> slice:
        """Return where the columns of a family are."""
        names = [family.name for family in self.families]
        rows = np.flatnonzero(self.family == names.index(name))
        return slice(int(rows[0]), int(rows[-1]) + 1)

    @cached_property
    def stops(self) -> IntArray:
        """Columns of the stops: constant, with load, with each wave; (families, widths)."""
        waves = self.of_family("place_friction").start
        starts = [self.of_family(name).start for name in ("friction", "load")]
        starts += [waves + k * (STATES + 1) for k in range(2 * FRICTION_HARMONICS)]
        return np.array(starts)[:, None] + np.arange(WIDTHS.size)

    @cached_property
    def friction(self) -> IntArray:
        """Columns of friction: constant, with load, with each wave; (families, states and dq)."""
        speed = np.full(len(self.stops), STATES)  # after the states of its family, but one
        speed[0] = self.of_family("viscous").start - self.stops[0, 0]
        return np.column_stack([self.stops[:, :1] + np.arange(STATES), self.stops[:, 0] + speed])

    @cached_property
    def _arm(self) -> Arm:
        """Constants of the rigid body for the compiled scan."""
        chain = RegressorChain.of(self.body)
        parameters = link_parameters(self.body)
        return chain.rotation, chain.translation, chain.axis, chain.gravity, parameters

    @cached_property
    def base(self) -> IntArray:
        """Columns of the links' regressor that are independent of each other."""
        independent = self._parameters.independent
        return independent[independent < PER_LINK * self.n]

    @cached_property
    def _parameters(self) -> BaseParameters:
        return find_base_parameters(self.body, JointTerms(offset=False, armature=False))

    @cached_property
    def last_link(self) -> FloatArray:
        """Weights of the family `rigid` by each parameter of the last link, (b, 10)."""
        full = np.zeros((self._parameters.mixing.shape[1] + self._parameters.rank, PER_LINK))
        full[PER_LINK * (self.n - 1) : PER_LINK * self.n] = np.eye(PER_LINK)
        return self._parameters.reduce(full)[self._parameters.independent < PER_LINK * self.n]

    @cached_property
    def constants(self) -> tuple[Arm, IntArray, float, int, float]:
        """What compiled code wants to know of them: see `prediction`."""
        return self._arm, self.base, self.step_time, self.count, SETTLED

    @property
    def step_time(self) -> float:
        """Time that a filtered step of the velocity takes to half its height [s]."""
        return _STEP_TIME / self.bandwidth

    def init(self) -> FloatArray:
        """Return the memory before the first sample, a row for each joint.

        It holds the stops, at rest in their middle, the last position, and the range so far.
        """
        memory = np.zeros((self.n, WIDTHS.size + MEMORIES))
        memory[:, LAST] = np.nan
        return memory

    def advance(
        self, memory: FloatArray, motion: Motion, torque: FloatArray, every: int = 1
    ) -> tuple[ColumnRows, FloatArray]:
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
        rows = -(-len(motion) // every)
        X, about = np.empty((self.n, rows, self.count)), np.empty((2, rows, self.n))
        scan(
            after,
            np.ascontiguousarray(motion.position),
            np.ascontiguousarray(motion.velocity),
            np.ascontiguousarray(motion.acceleration),
            np.ascontiguousarray(torque),
            self._arm,
            self.base,
            self.step_time,
            np.full(self.n, np.inf),
            every,
            X,
            about,
        )
        return ColumnRows(X, about), after


@compiled(reads=("position", "velocity", "acceleration", "torque", "base", "fastest"), nogil=True)
def scan(
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    arm: Arm,
    base: IntArray,
    step_time: float,
    fastest: FloatArray,
    every: int,
    X: FloatArray,
    about: FloatArray,
) -> None:
    """Advance `memory` (n, ...) in place over T samples and write one row for so many.

    X (n, rows, K) gets the columns, `about` (2, rows, n) the range that each joint has turned in so
    far [rad] and its load [N m]. `base` are the columns of the links' regressor that are kept. What
    friction grows by with speed stays, beyond the fastest (n,) [rad/s], what it is there.
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
            own = x[base.size :]
            _fill(j, q, v, fastest[j], step_time, a, memory[j], load, slope, torque[t], own)
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
    fastest: float,
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
    v = min(max(v, -fastest), fastest)
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
