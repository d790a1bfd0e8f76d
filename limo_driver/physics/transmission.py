"""Transmission between drive and link: elasticity, play, ripple and the inertia of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.physics.effect import MotionEffect, State, TorqueEffect, parameter

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class JointElasticity(MotionEffect):
    """Wind-up of the gear between encoder and link, q_link = q - tau / stiffness - cubic tau³.

    tau is the nominal rigid-body torque. The deflection is quasi-static: right while it changes
    slowly against the motion, as in creeping and holding, and not for vibration. Over whole
    stretches, `Simulation.predict_stretches` lets it move.

    Source: Spong, "Modeling and control of elastic joint robots", J. Dyn. Sys. 1987.
    """

    name: ClassVar[str] = "joint_elasticity"
    stiffness: float = parameter("N m/rad", "stiffness", lower=10.0, upper=1e8)
    cubic: float = parameter(
        "rad/(N m)^3", "cubic compliance", lower=-1e-3, upper=1e-3, default=0.0
    )

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], (T,)."""
        return motion.load / self.stiffness + self.cubic * motion.load**3, state


@dataclass(frozen=True, kw_only=True)
class Backlash(MotionEffect):
    """Play between drive and link, q_link = q - (gap / 2) tanh(tau / tau_eps).

    tau is the nominal rigid-body torque: it decides on which flank the teeth rest. Within tau_eps
    of zero load the link floats through the gap, held by what little friction it has; that
    friction's own hysteresis is left out, as is the impact.

    Source: Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica
    38(10), 2002.
    """

    name: ClassVar[str] = "backlash"
    gap: float = parameter("rad", "whole play", lower=0.0, upper=0.2)
    tau_eps: float = parameter(
        "N m", "load at which the flank is reached", lower=1e-3, upper=50.0, default=0.5
    )

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], (T,)."""
        return 0.5 * self.gap * np.tanh(motion.load / self.tau_eps), state


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
