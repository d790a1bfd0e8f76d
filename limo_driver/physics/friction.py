"""Friction without memory: functions of the joint velocity."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.physics.effect import State, TorqueEffect, parameter

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray

SIGN_WIDTH = 0.002  # [rad/s], width of the smoothed sign where an effect has no own
_SMALL_VELOCITY = 1e-9  # [rad/s]


@dataclass(frozen=True, kw_only=True)
class VelocityFriction(TorqueEffect):
    """Friction that is a function of velocity alone."""

    @abstractmethod
    def torque(self, velocity: FloatArray) -> FloatArray:
        """Return the friction torque [N m] at `velocity` [rad/s]; same shape."""

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Evaluate `torque` over T samples."""
        return self.torque(motion.velocity), state


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(VelocityFriction):
    """Dry friction, tau = tau_c tanh(v / v_eps).

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "coulomb_friction"
    tau_c: float = parameter("N m", "friction torque while sliding", lower=0.0, upper=1e3)
    v_eps: float = parameter(
        "rad/s", "width of the smoothed sign", lower=1e-6, upper=1.0, default=SIGN_WIDTH
    )

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Return tau_c tanh(v / v_eps) [N m]."""
        return self.tau_c * np.tanh(velocity / self.v_eps)


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(VelocityFriction):
    """Friction in proportion to velocity, tau = f_v v.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "viscous_friction"
    f_v: float = parameter("N m s/rad", "slope", lower=0.0, upper=1e4)

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Return f_v v [N m]."""
        return self.f_v * velocity


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(VelocityFriction):
    """Excess of dry friction at creep, tau = tau_s exp(-|v / v_s|^delta) tanh(v / v_eps).

    v_eps is 2 mrad/s as for Coulomb friction: another width would look like presliding.

    Source: Armstrong-Hélouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and
    compensation methods for the control of machines with friction", Automatica 1994, eq. (3).
    """

    name: ClassVar[str] = "stribeck_friction"
    tau_s: float = parameter("N m", "excess over Coulomb at rest", lower=0.0, upper=1e3)
    v_s: float = parameter("rad/s", "Stribeck velocity", lower=1e-5, upper=10.0)
    delta: float = parameter("1", "shape exponent", lower=0.5, upper=4.0, default=2.0)

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Return tau_s exp(-|v / v_s|^delta) tanh(v / v_eps) [N m]."""
        fade = np.exp(-(np.abs(velocity / self.v_s) ** self.delta))
        return self.tau_s * fade * np.tanh(velocity / SIGN_WIDTH)


def secant(friction: VelocityFriction, velocity: FloatArray) -> FloatArray:
    """Return tau(v) / v [N m s/rad], the damping that gives the friction at v; limit at v = 0.

    An integrator that takes this damping implicitly dissipates at any step size, where the
    friction itself, taken explicitly, would reverse the motion.
    """
    v = np.where(np.abs(velocity) < _SMALL_VELOCITY, _SMALL_VELOCITY, velocity)
    return friction.torque(v) / v
