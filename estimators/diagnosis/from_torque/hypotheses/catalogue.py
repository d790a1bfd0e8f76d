"""Hypotheses: each effect of the catalogue, wherever it could act, at a unit size.

Revision: change the values of bodies and effects that the simulation already has.

Coefficients are relative: 0 keeps a value, and 0.1 makes it a tenth larger.

Entries: the numbers of an effect, one by one, and the effect with some of them moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.responses import Response, difference
from estimators.diagnosis.settings import FINE, LITTLE
from estimators.diagnosis.settings.fitting import REVISION
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import ConfigError
from limo_driver.physics.catalogue import every_effect, known_as
from limo_driver.physics.effect import DiagnosisContext
from limo_driver.runtime.parameters import REAL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.hypotheses.responses import Enter, Improvement
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import Effect, Hypothesis, Parameter, Simulation
    from limo_driver.types import FloatArray


def every(observed: Observations, *, seldom: bool = False) -> Iterator[Hypothesis]:
    """Yield the hypotheses for a recorded arm; `seldom` those for what others leave unexplained."""
    return (item for item in _every(observed) if item.seldom == seldom)


def _every(observed: Observations) -> Iterator[Hypothesis]:
    recorded = recorded_in(observed)
    for joint in range(1, observed.n + 1):
        for effect in every_effect():
            yield from effect.at_joint(joint, recorded)
    for effect in every_effect():
        yield from effect.on_arm(recorded)


def rivals(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield further laws of an effect that was found."""
    effect = known_as(hypothesis.effect)
    if effect is not None:
        yield from effect.further_laws(hypothesis)


def recorded_in(observed: Observations) -> DiagnosisContext:
    """Return what recordings show of an arm before anything is fitted."""
    recordings = observed.recordings
    return DiagnosisContext(
        position=observed.slow.position,
        inertia=np.median(np.diagonal(observed.inertia), axis=0),
        temperature=observed.motion.temperature,
        start=min(float(recording.time[0]) for recording in recordings),
        end=max(float(recording.time[-1]) for recording in recordings),
        longest=max(recording.duration for recording in recordings),
        gravity=np.array(observed.chain.gravity),
        effects=observed.reference.effects,
    )


def relative_change(known: Parameter, coefficient: float) -> float:
    """Return the relative change of a parameter that a coefficient stands for.

    The torque is about linear in the logarithm of a width, and in the inverse of a stiffness that
    winds up; in all others, in the value itself.
    """
    if known.smooths:
        return float(np.clip(np.exp(coefficient), 1 / REVISION.wider, REVISION.wider) - 1.0)
    if known.inverse:
        return 1.0 / max(1.0 - coefficient, REVISION.stiffest) - 1.0
    return coefficient


def beside_stated(known: Parameter, ratio: float) -> tuple[float, float]:
    """Convert coefficients of a stated value for a parameter that has another value at hand.

    Args:
        known: The parameter.
        ratio: Value at hand over the stated one.

    Returns:
        The factor from a coefficient of the stated value to that of the value at hand for the same
        small change, and the coefficient of the stated value that gives the value at hand.
    """
    if known.smooths:
        return 1.0, float(np.log(ratio))
    if known.inverse:
        return ratio, 1.0 - 1.0 / ratio
    return 1.0 / ratio, ratio - 1.0


def reviser(place: int, parameters: Sequence[Parameter]) -> Enter:
    """Return a function that enters coefficients (c,) of as many parameters of an effect."""

    def enter(improvement: Improvement, c: FloatArray) -> None:
        for known, coefficient in zip(parameters, c, strict=True):
            improvement.revise(place, known.name, relative_change(known, float(coefficient)))

    return enter


def sharpener(place: int, sizes: Sequence[Parameter], sharp: Parameter, width: float) -> Enter:
    """Return a function that enters coefficients (c,) of sizes that act over another width.

    What is stated and what comes to it become one effect again, over a width between theirs.

    Args:
        place: Of the effect in the given simulation.
        sizes: The parameters that change.
        sharp: The width of the effect's smoothed sign.
        width: The one over which the change acts, in the unit of the parameter.
    """

    def enter(improvement: Improvement, c: FloatArray) -> None:
        effect: Any = improvement.effects[place]
        given = [getattr(improvement.given.effects[place], known.name) for known in sizes]
        stated = sum(abs(getattr(effect, known.name)) for known in sizes)
        more = float(np.abs(c) @ np.abs(given))
        reviser(place, sizes)(improvement, c)
        if more > 0.0:
            own = getattr(effect, sharp.name)
            between = own * (width / own) ** (more / (stated + more))
            improvement.effects[place] = improvement.effects[place].with_value(sharp.name, between)

    return enter


def derivative(observed: Observations, effect: Effect, name: str) -> Response:
    """Return the torque of a relative change of 1 of an effect's parameter, to first order."""
    value = getattr(effect, name)
    known = next(item for item in effect.parameters() if item.name == name)
    ahead, behind = (
        float(np.clip(value + sign * LITTLE * value, known.lower, known.upper)) for sign in (1, -1)
    )
    joints, values = difference(
        effect.with_value(name, ahead), effect.with_value(name, behind), observed
    )
    return Response(joints, values * value / (ahead - behind))


def mover(link: int, scale: FloatArray) -> Enter:
    """Return a function that enters relative coefficients (10,) of a link's body (0-based).

    Args:
        link: Which link.
        scale: Its `relative_inertia`, (10, 10).
    """
    return lambda improvement, c: improvement.move_inertia(link, scale @ c)


def relative_inertia(body: Inertial) -> FloatArray:
    """Return d(m, m c, I at the joint frame) / d(relative m, c, I at the com), (10, 10).

    A component of the centre of mass is relative to the distance of that centre.
    """
    m, c = body.mass, np.array(body.com)
    tensor = body.tensor()
    scale = np.zeros((PER_LINK, PER_LINK))
    at_origin = _point(m, c)
    scale[0, 0], scale[1:4, 0], scale[4:, 0] = m, m * c, at_origin
    lever = np.full(3, max(float(np.linalg.norm(c)), REVISION.least_lever))
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = lever[axis]
        scale[1 + axis, 1 + axis] = m * lever[axis]
        ahead, behind = (_point(m, c + sign * REVISION.lever_step * d) for sign in (1, -1))
        scale[4:, 1 + axis] = (ahead - behind) / (2 * REVISION.lever_step)
    moments = np.diag(tensor)
    for column, (i, k) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        size = np.sqrt(moments[i] * moments[k]) * (1.0 if i == k else REVISION.products)
        scale[4 + column, 4 + column] = size
    return scale


def _point(m: float, c: FloatArray) -> FloatArray:
    tensor = m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array(
        [tensor[0, 0], tensor[0, 1], tensor[1, 1], tensor[0, 2], tensor[1, 2], tensor[2, 2]]
    )


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
    for side, step in enumerate((FINE * entry.deviation, -FINE * entry.deviation)):
        try:
            ends[side] = moved(effect, [entry], [step])
        except ConfigError:
            continue
        reached[side] = float(np.clip(entry.value + step, *entry.within))
    return ends[0], ends[1], (reached[0] - reached[1]) or np.inf
