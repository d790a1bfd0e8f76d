"""Entries: the numbers of an effect, one by one, and the effect with some of them moved.

Widths: over which speeds stated dry friction turns its sign is guessed, and its size is known.

A change of friction may act over another width than is stated. Beside what tolerances allow, that
is also how a fit says that all of it is sharper: less of it over the stated width, and as much more
over the other. Only their sum tells whether there is more friction than there may be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import coefficients
from estimators.diagnosis.settings.fitting import NEWTON
from estimators.regression.evidence import REACH
from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import REAL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from limo_driver.physics import Effect, Parameter, Simulation
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Entry:
    """One number among the parameters of an effect."""

    name: str
    at: int | None  # place in a list
    value: float
    deviation: float  # before any data
    within: tuple[float, float]
    is_size: bool  # as far off as it is large, so that at zero there may be none of it


def moved(effect: Any, entries: Sequence[Entry], by: Sequence[float]) -> Effect:  # noqa: ANN401  # of any class
    """Return an effect with some of its numbers moved together, inside their bounds.

    Raises:
        ConfigError: No such part exists; a body may be impossible where each number is not.
    """
    values: dict[str, Any] = {}
    for entry, change in zip(entries, by, strict=True):
        value = float(np.clip(entry.value + change, *entry.within))
        if entry.at is None:
            values[entry.name] = value
        else:
            values.setdefault(entry.name, list(getattr(effect, entry.name)))[entry.at] = value
    whole = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return replace(effect, **whole).fitted_from(effect)


def entries_of(effect: Effect) -> tuple[Entry, ...]:
    """Return the numbers of an effect that are estimated; a zero is a part that it lacks."""
    return tuple(
        Entry(
            known.name,
            at,
            value,
            deviation,
            (known.lower, known.upper),
            not isinstance(known.deviation, float) and known.lower <= 0.0,
        )
        for known in effect.parameters()
        for at, value in numbers_of(effect, known)
        if (deviation := _deviation(effect, known, value))
    )


def numbers_of(effect: Any, known: Parameter) -> Iterator[tuple[int | None, float]]:  # noqa: ANN401  # of any class
    """Yield place in a list and value of the numbers of a parameter that are not chosen."""
    value = getattr(effect, known.name)
    if value is None or known.kind != REAL or known.chosen:
        return
    if known.is_list:
        yield from enumerate(map(float, value))
    else:
        yield None, float(value)


def _deviation(effect: Effect, known: Parameter, value: float) -> float:
    """Return how far a number may be off before any data, in its unit."""
    if known.deviation == "largest":  # one of them may well be near zero
        return max(map(abs, getattr(effect, known.name)))
    return abs(value) if known.deviation is None else known.deviation


def found_in(
    simulation: Simulation, effect: str, joints: Sequence[int], *, missing: bool
) -> Effect | None:
    """Return the effect of an improved simulation that a finding is about.

    Args:
        simulation: The improved simulation.
        effect: Identifier.
        joints: 1-based; of the whole arm all or none. Of what acts on one joint by another, that
            joint comes first: the same with both exchanged is another effect.
        missing: Whether it was added, rather than changed.
    """
    same = [
        item
        for item in simulation.effects
        if item.name == effect and set(item.joints) <= set(joints)
    ]
    same = [item for item in same if item.joints == tuple(joints)] or same
    return (same[-1] if missing else same[0]) if same else None


def off(effect: Effect, given: Simulation) -> FloatArray:
    """Return how far the numbers of an effect are from those given, or from none of it, (c,)."""
    stated = next((item for item in given.effects if item.place == effect.place), None)
    before = {} if stated is None else {(e.name, e.at): e.value for e in entries_of(stated)}
    none = ((e, 0.0 if e.is_size else e.value) for e in entries_of(effect))
    return np.array([e.value - before.get((e.name, e.at), least) for e, least in none])


def possible(effect: Effect, entries: Sequence[Entry], by: FloatArray) -> Effect:
    """Move the numbers of an effect; where that makes an impossible body, its moments stay."""
    try:
        return moved(effect, entries, by.tolist())
    except ConfigError:
        kept = [k for k, entry in enumerate(entries) if entry.name != "inertia"]
        return moved(effect, [entries[k] for k in kept], by[kept].tolist())


def sides(effect: Effect, entry: Entry) -> tuple[Effect, Effect, float]:
    """Return an effect with one number a step larger and smaller, and how far those lie apart.

    Where a step is no longer physically consistent, the effect itself stands for it.
    """
    ends, reached = [effect, effect], [entry.value, entry.value]
    for side, step in enumerate(
        (NEWTON.derivative * entry.deviation, -NEWTON.derivative * entry.deviation)
    ):
        try:
            ends[side] = moved(effect, [entry], [step])
        except ConfigError:
            continue
        reached[side] = float(np.clip(entry.value + step, *entry.within))
    return ends[0], ends[1], (reached[0] - reached[1]) or np.inf


def changes_only_sign_width(problem: RegressionProblem, solution: Solution, member: int) -> bool:
    """Say whether a member makes stated friction sharper or softer, of a size that it may have."""
    candidate = problem.candidates[member]
    if not candidate.other_width:
        return False
    sizes = problem.nuisance.of([candidate.place])
    # of the given simulation: here, values may be held as they are stated
    deviation = (problem.first or problem).nuisance.prior.deviation[sizes]
    return bool((np.abs(change_of(problem, solution, member)) <= REACH * deviation).all())


def change_of(problem: RegressionProblem, solution: Solution, member: int) -> FloatArray:
    """Return by which part of it each size of a stated effect changes, (c,).

    That is what its tolerance takes of the change, and what the member adds.
    """
    sizes = problem.nuisance.of([problem.candidates[member].place])
    within = solution.fitted.mean[: sizes.size][sizes]
    return within + coefficients(problem, solution, member)
