"""Coupling: friction and inertia that two joints share, as in the gears of a wrist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    MOST_INERTIA,
    MOST_SLOPE,
    MOST_TORQUE,
    ArmEffect,
    Hypothesis,
    State,
)
from limo_driver.physics.effects.friction import sign_width
from limo_driver.runtime.parameters import JOINT, parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics.effect import ArmMotion, Recorded, SimulatedPlant
    from limo_driver.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class JointCoupling(ArmEffect):
    """Torque on one joint from a shaft that turns with w = v_joint + ratio v_other.

    tau_joint = f_v w + tau_c tanh(w / v_eps) + inertia dw/dt

    What the shaft does to the other joint is an entry of its own, with the joints exchanged.

    Raises:
        ConfigError: The other joint is the joint itself, or the ratio is neither 1 nor -1.

    Source: Gautier, Janot and Vandanjon, "A new closed-loop output error method for parameter
    identification of robot dynamics", IEEE TCST 21(2), 2013 (a coupled wrist).
    """

    name: ClassVar[str] = "joint_coupling"
    sized_by: ClassVar[tuple[str, ...]] = ("f_v", "tau_c", "inertia")
    description: ClassVar[Description] = Description(
        signature="torque goes with the combined motion of two joints",
        shown_by="apart",
        confusions=(
            Confusion(
                "torque_crosstalk",
                "coupling follows the other joint's speed, crosstalk its torque",
                "apart",
            ),
        ),
    )
    joint: int = parameter(JOINT, "the joint that feels the torque")
    other: int = parameter(JOINT, "the other joint", lower=1, upper=64)
    f_v: float = parameter(
        "N m s/rad", "viscous friction", lower=0.0, upper=MOST_SLOPE, default=0.0
    )
    tau_c: float = parameter("N m", "Coulomb friction", lower=0.0, upper=MOST_TORQUE, default=0.0)
    inertia: float = parameter("kg m^2", "inertia", lower=0.0, upper=MOST_INERTIA, default=0.0)
    ratio: float = parameter("1", "1 or -1", lower=-1.0, upper=1.0, default=1.0, chosen=True)
    v_eps: float = sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.other == self.joint:
            raise self._refused("other", "another joint")
        if abs(self.ratio) != 1.0:
            raise self._refused("ratio", "1 or -1")

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint that feels the torque, then the other."""
        return self.joint, self.other

    def friction(self, w: FloatArray) -> FloatArray:
        """Return the friction of the shaft [N m] at its velocity w [rad/s]."""
        return self.f_v * w + self.tau_c * np.tanh(w / self.v_eps)

    def shaft(self, rate: FloatArray) -> FloatArray:
        """Return what a rate (T, n) of the joints is at the shaft, (T,)."""
        return rate[:, self.joint - 1] + self.ratio * rate[:, self.other - 1]

    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return friction and inertia of the shaft on the joint [N m], (T, n)."""
        torque = np.zeros_like(motion.load)
        w, rate = self.shaft(motion.motion.velocity), self.shaft(motion.motion.acceleration)
        torque[:, self.joint - 1] = self.friction(w) + self.inertia * rate
        return torque, state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for it sampled, as heavy as it is."""
        robot.sample(self)
        robot.expect_late(self.joint, inertia=self.inertia)

    @classmethod
    def at_joint(cls, joint: int, recorded: Recorded) -> Iterator[Hypothesis]:
        """Yield it with neighbours, and with every other joint, about which a wrist turns too."""
        for other in (joint - 2, joint - 1, joint + 1, joint + 2):
            for ratio in (1, -1):
                if 1 <= other <= recorded.n:
                    yield cls.between(joint, other, ratio)

    @classmethod
    def between(cls, joint: int, other: int, ratio: int) -> Hypothesis:
        """Return what one joint feels of another's motion."""
        base = cls(joint=joint, other=other, f_v=0.0, tau_c=0.0, inertia=0.0, ratio=ratio)
        terms = (replace(base, f_v=1.0), replace(base, tau_c=1.0), replace(base, inertia=1.0))
        return Hypothesis(
            base.name,
            (joint - 1, other - 1),
            terms,
            lambda c: (replace(base, f_v=float(c[0]), tau_c=float(c[1]), inertia=float(c[2])),),
            positive=True,
        )
