"""Transmission between drive and link: elasticity and the inertia of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from limo_driver.physics.effect import MotionEffect, State, TorqueEffect, parameter

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class JointElasticity(MotionEffect):
    """Wind-up of the gear between encoder and link, q_link = q - tau / stiffness - cubic tau³.

    tau is the nominal rigid-body torque. The deflection is quasi-static: right while it changes
    slowly against the motion, as in creeping and holding, and not for vibration.

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
class Armature(TorqueEffect):
    """Inertia of the drive seen from the joint, tau = inertia ddq; absent from a link-side torque.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 9.6.
    """

    name: ClassVar[str] = "armature"
    inertia: float = parameter("kg m^2", "reflected inertia", lower=0.0, upper=1e3)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return inertia ddq [N m], (T,)."""
        return self.inertia * motion.acceleration, state
