"""Terms of one joint each that stand beside the inertias, linear in their parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.physics import Armature, CoulombFriction, TorqueOffset, ViscousFriction
from limo_driver.physics.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Term:
    """One parameter of every joint and the effect of the catalogue that it becomes."""

    effect: str  # identifier in the catalogue
    parameter: str
    unit: str
    positive: bool  # no negative value makes sense
    column: Callable[[FloatArray, FloatArray], FloatArray]  # of velocity and acceleration (T, n)
    make: Callable[[int, float], Effect]  # of the 1-based joint and the value


@dataclass(frozen=True)
class JointTerms:
    """Which terms a model has beside the inertias.

    Args:
        sign_width: Width v_eps of the smoothed sign of Coulomb friction [rad/s].
        offset: Model a constant offset of each torque sensor.
        armature: Model the inertia of each drive, where it can be told from the links'.
    """

    sign_width: float = SIGN_WIDTH
    offset: bool = True
    armature: bool = True

    def all(self) -> tuple[Term, ...]:
        """Return the terms in the order of the regressor's columns; armature is last."""
        width = self.sign_width
        terms = [
            Term(
                "viscous_friction",
                "f_v",
                "N m s/rad",
                True,
                lambda v, _: v,
                lambda joint, value: ViscousFriction(joint=joint, f_v=value),
            ),
            Term(
                "coulomb_friction",
                "tau_c",
                "N m",
                True,
                lambda v, _: np.tanh(v / width),
                lambda joint, value: CoulombFriction(joint=joint, tau_c=value, v_eps=width),
            ),
        ]
        if self.offset:
            terms.append(
                Term(
                    "torque_offset",
                    "offset",
                    "N m",
                    False,
                    lambda v, _: np.ones_like(v),
                    lambda joint, value: TorqueOffset(joint=joint, offset=value),
                )
            )
        if self.armature:
            terms.append(
                Term(
                    "armature",
                    "inertia",
                    "kg m^2",
                    True,
                    lambda _, a: a,
                    lambda joint, value: Armature(joint=joint, inertia=value),
                )
            )
        return tuple(terms)

    def columns(self, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return every term's column, (T, n, number of terms)."""
        return np.stack([term.column(velocity, acceleration) for term in self.all()], axis=2)
