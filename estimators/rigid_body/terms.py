"""Terms of one joint each that stand beside the inertias, linear in their parameter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics import Armature, CoulombFriction, TorqueOffset, ViscousFriction

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from limo_driver.physics import Effect, JointEffect
    from limo_driver.types import FloatArray

SIGN_WIDTHS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # [rad/s]


@dataclass(frozen=True)
class Term:
    """One parameter of every joint and the effect of the catalogue that it becomes."""

    effect: str  # identifier in the catalogue
    parameter: str
    unit: str
    positive: bool  # no negative value makes sense
    make: Callable[[int, float], Effect]  # of the 1-based joint and the value


@dataclass(frozen=True)
class JointTerms:
    """Terms of a model beside the inertias: friction always, the others as wanted.

    Args:
        sign_widths: Widths v_eps of the smoothed sign of Coulomb friction [rad/s]; of several, the
            one that fits best is chosen for each joint.
        offset: Model a constant offset of each torque sensor.
        armature: Model the inertia of each drive, where it can be told from the links'.
        chosen: The width of each joint, once chosen [rad/s].

    Raises:
        ConfigError: A width that is not above 0, or not finite.

    Example:
        >>> limo.identify("iiwa14", "run.parquet", terms=limo.JointTerms(armature=False))
    """

    sign_widths: tuple[float, ...] = SIGN_WIDTHS
    offset: bool = True
    armature: bool = True
    chosen: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not self.sign_widths or not all(0 < width < np.inf for width in self.sign_widths):
            listed = ", ".join(f"{width:g}" for width in self.sign_widths)
            raise ConfigError(
                f"sign width {listed or '(none)'} rad/s: has to be above 0 and finite"
            )

    def with_choice(self, choice: tuple[int, ...]) -> JointTerms:
        """Return the terms with one of the widths, by its index, for each joint."""
        return replace(self, chosen=tuple(self.sign_widths[index] for index in choice))

    def width(self, joint: int) -> float:
        """Return the chosen width of a 1-based joint [rad/s]; the first until one is chosen."""
        return self.sign_widths[0] if self.chosen is None else self.chosen[joint - 1]

    def all(self) -> tuple[Term, ...]:
        """Return the terms in the order of their columns; armature is last."""
        terms = [
            _term(ViscousFriction, "f_v"),
            _term(CoulombFriction, "tau_c", lambda joint: {"v_eps": self.width(joint)}),
        ]
        if self.offset:
            terms.append(_term(TorqueOffset, "offset"))
        if self.armature:
            terms.append(_term(Armature, "inertia"))
        return tuple(terms)

    def columns(
        self, velocity: FloatArray, acceleration: FloatArray, sign: FloatArray | None = None
    ) -> FloatArray:
        """Return every term's column, (T, n, terms); `sign` replaces the smoothed sign."""
        if sign is None:
            widths = [self.width(j + 1) for j in range(velocity.shape[1])]
            sign = np.tanh(velocity / np.array(widths))
        columns = [velocity, sign]
        if self.offset:
            columns.append(np.ones_like(velocity))
        if self.armature:
            columns.append(acceleration)
        return np.stack(columns, axis=2)


def _term(
    effect: type[JointEffect],
    name: str,
    more: Callable[[int], Mapping[str, float]] = lambda joint: {},  # noqa: ARG005
) -> Term:
    """Return the term of one parameter of an effect, with what else the effect needs at a joint."""
    known = next(item for item in effect.parameters() if item.name == name)
    make: Callable[..., JointEffect] = effect
    return Term(
        effect.name,
        name,
        known.unit,
        known.lower >= 0.0,
        lambda joint, value: make(joint=joint, **{name: value}, **more(joint)),
    )
