"""Hypothesis: one effect at one place, whose size is still free.

A hypothesis is a few effects of the catalogue at unit size. What they would add to the torque are
columns; their coefficients turn the same effects into the found ones. So what is compared, what is
fitted and what is written to `sim.yaml` are one equation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from estimators.diagnosis.hypotheses.improvement import Enter
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray

Realise: TypeAlias = Callable[["FloatArray"], "tuple[Effect, ...]"]


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place; its coefficients are still free."""

    effect: str
    joints: tuple[int, ...]  # 0-based; empty for the whole arm
    terms: tuple[Effect, ...]  # of unit size, one column each
    realise: Realise  # coefficients → effects
    positive: bool = False  # whether no coefficient can be negative
    settings: tuple[float, ...] = ()  # what is not linear in the torque, for a refinement
    family: Callable[..., Hypothesis] | None = field(default=None, compare=False)
    bounds: tuple[tuple[float, float], ...] = ()  # of the settings
    law: str = ""  # in words, where the effect follows one of several
    enter: Enter | None = field(default=None, compare=False)  # where adding effects is not enough


def single(effect: Effect, name: str, **more: Any) -> Hypothesis:  # noqa: ANN401
    """Return the hypothesis of one effect that is linear in its parameter `name`."""
    joint = getattr(effect, "joint", 0)
    return Hypothesis(effect.name, (joint - 1,), (effect,), _scaled(effect, name), **more)


def _scaled(effect: Any, name: str) -> Realise:  # noqa: ANN401  # an effect of any class
    """Return how one effect grows with its one coefficient."""
    unit = getattr(effect, name)
    return lambda c: (replace(effect, **{name: float(c[0] * unit)}),)
