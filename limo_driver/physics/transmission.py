"""Transmission between drive and link: elasticity, play, ripple and the inertia of the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.compiled import compiled
from limo_driver.parameters import parameter
from limo_driver.physics.effect import MotionEffect, State, TorqueEffect

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray

_LIGHT = 1e-9  # [kg m²]


@dataclass(frozen=True, kw_only=True)
class JointElasticity(MotionEffect):
    """Wind-up of the gear between encoder and link, q_link = q - tau / stiffness - cubic tau³.

    tau is the nominal rigid-body torque. The deflection is quasi-static: right while it changes
    slowly against the motion, as in creeping and holding, and not for vibration. Over whole
    stretches, `Simulation.predict_stretches` lets it move.

    Source: Spong, "Modeling and control of elastic joint robots", J. Dyn. Sys. 1987.
    """

    name: ClassVar[str] = "joint_elasticity"
    agility: ClassVar[float] = 0.7  # a spring never winds up faster than its load changes
    stiffness: float = parameter("N m/rad", "stiffness", lower=10.0, upper=1e8)
    cubic: float = parameter(
        "rad/(N m)^3", "cubic compliance", lower=-1e-3, upper=1e-3, default=0.0
    )

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], (T,)."""
        return wind_up(motion.load, 1.0 / self.stiffness, self.cubic), state


def wind_up(
    load: FloatArray, compliance: float | FloatArray, cubic: float | FloatArray
) -> FloatArray:
    """Return compliance load + cubic load³ [rad], the equation of `JointElasticity`."""
    return load * (compliance + cubic * load * load)


@dataclass(frozen=True, kw_only=True)
class Backlash(MotionEffect):
    """Play between drive and link, q_link = q - x with |x| ≤ gap / 2.

    The load presses the teeth on one flank. When it changes sign, the link floats across the gap,
    inertia ddx = tau with tau the nominal rigid-body torque, and no torque passes until it meets
    the other flank, where it stays: the impact is without rebound. A link of unknown inertia
    crosses at once.

    Source: Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica
    38(10), 2002.
    """

    name: ClassVar[str] = "backlash"
    agility: ClassVar[float] = 4.0  # an impact is sharper than the motion
    needs_inertia: ClassVar[bool] = True
    gap: float = parameter("rad", "whole play", lower=0.0, upper=0.2)

    def initial_state(self) -> State:
        """Return a link at rest in the middle, and no previous time."""
        return np.array([0.0, 0.0, np.nan])

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], (T,)."""
        inertia = np.full_like(motion.load, _LIGHT) if motion.inertia is None else motion.inertia
        after = state.copy()
        ahead = np.ascontiguousarray(motion.load / inertia)
        return _float(after, motion.time, ahead, 0.5 * self.gap), after


@compiled(reads=("time", "ahead"), nogil=True)
def _float(state: FloatArray, time: FloatArray, ahead: FloatArray, flank: float) -> FloatArray:
    """Advance (displacement, its speed, last time) in place; return displacements (T,) [rad].

    `ahead` is the acceleration of the displacement while the link floats, (T,) [rad/s²].
    """
    x, speed, last = state
    displacement = np.empty(time.size)
    for t in range(time.size):
        if np.isnan(last):
            x = math.copysign(flank, ahead[t]) if ahead[t] != 0.0 else 0.0
        else:
            step = time[t] - last
            x += speed * step + 0.5 * ahead[t] * step**2
            speed += ahead[t] * step
        if abs(x) >= flank:
            x, speed = math.copysign(flank, x), 0.0
        last = time[t]
        displacement[t] = x
    state[0], state[1], state[2] = x, speed, last
    return displacement


@dataclass(frozen=True, kw_only=True)
class Armature(TorqueEffect):
    """Inertia of the drive seen from the joint, tau = inertia ddq; absent from a link-side torque.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 9.6.
    """

    name: ClassVar[str] = "armature"
    inertia: float = parameter("kg m^2", "reflected inertia", lower=0.0, upper=1e3)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return inertia ddq [N m], (T,)."""
        return self.inertia * motion.acceleration, state


@dataclass(frozen=True, kw_only=True)
class TorqueRipple(TorqueEffect):
    """Torque that repeats with the angle, tau = Σ amplitude_i sin(cycles_per_rev_i q + phase_i).

    The cogging of a motor behind a gear of ratio r has cycles_per_rev = poles times r.

    Raises:
        ConfigError: The lists differ in length.

    Source: Taghirad and Bélanger, "Modeling and parameter identification of harmonic drive
    systems", J. Dyn. Sys. Meas. Control 120(4), 1998.
    """

    name: ClassVar[str] = "torque_ripple"
    cycles_per_rev: tuple[float, ...] = parameter(
        "1/rev", "cycles in a revolution of the joint", lower=1e-3, upper=1e6
    )
    amplitude: tuple[float, ...] = parameter("N m", "amplitude", lower=0.0, upper=1e3)
    phase: tuple[float, ...] = parameter("rad", "phase", lower=-1e3, upper=1e3)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("cycles_per_rev", "amplitude", "phase")

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the sum of the harmonics at the position of each sample [N m], (T,)."""
        torque = np.zeros_like(motion.position)
        for N, A, phi in zip(self.cycles_per_rev, self.amplitude, self.phase, strict=True):
            torque += A * np.sin(N * motion.position + phi)
        return torque, state
