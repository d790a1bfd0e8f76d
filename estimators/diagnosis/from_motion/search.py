"""The search for what an arm has beyond what is stated, without torque.

Beginning with the stated drives and friction, whatever explains most joins the fit, one after the
other, as long as it is worth it. Until then stated values stay within their tolerances: many of
them, bent a little, would take the place of the one thing that is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.arm import (
    ArmFit,
    ArmGuess,
    ArmProblem,
    Weights,
    at_bound,
    fit_arm,
)
from estimators.diagnosis.from_motion.fitting.joint import EVALUATIONS, GLANCE
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.free_run import MOVED, commanded_range
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
from estimators.diagnosis.from_motion.suspects import (
    COUNTED,
    Suspect,
    beliefs,
    stated_beside,
    suspects_of,
)
from estimators.regression.evidence import REACH
from limo_driver.types import FloatArray

_COM: Final = 0.1  # [m], likewise of a payload's centre of mass
_ZERO: Final = 0.3  # [rad]
_SAG: Final = 0.5  # of a motor's winding, likewise of the supply's resistance
_MASS: Final = 1.0  # of the arm's own
_WORTH: Final = 16.0  # [nat], that a suspect has to explain
_EACH: Final = 2.0  # [nat], for each of its constants
_MOST: Final = 4
_FIRST, _GLANCE, _TRY = 12, 2, 4  # steps of fits
# Slopes over larger steps lead past what friction makes rough, those over smaller ones along
# valleys in which gains and a body change together.
_FINE: Final = 1e-3
_LIKELY: Final = 2  # suspects that are looked at longer, of either kind


@dataclass(frozen=True)
class Searched:
    """What was found in the recordings, with the fit that has it."""

    fit: ArmFit
    suspects: tuple[Suspect, ...]


def stated_guess(stated: FloatArray) -> ArmGuess:
    """Return a guess that begins with the stated constants, damping of servos beyond their limits.

    A stated motor has its servo's damping within its own limits, as it is simulated forward.

    Args:
        stated: Constants of each joint, (n, columns).
    """
    rows = np.stack(
        [
            c.with_values(
                row,
                {
                    c.DAMPING: c.value_in(row, c.DAMPING) + c.value_in(row, "kd"),
                    "kd": 0.0,
                    "inside": _share(row) if _has_motor(row) else 0.0,
                },
            )
            for row in stated
        ]
    )
    names = tuple((*c.base_of(row), *stated_beside(row)) for row in rows)
    return ArmGuess(rows, names, ArmChange.none(len(rows)))


def _share(row: FloatArray) -> float:
    """Return which part of a joint's damping is its servo's, as stated."""
    damping = c.value_in(row, "kd") + c.value_in(row, c.DAMPING)
    return c.value_in(row, "kd") / damping if damping > 0.0 else 0.0


def _has_motor(row: FloatArray) -> bool:
    return bool(np.isfinite(c.value_in(row, "stall")))


def search(
    loads: ArmLoads, stated: FloatArray, tolerance: FloatArray | float, tick: float
) -> Searched:
    """Look for what an arm has beyond what is stated.

    Args:
        loads: Of the recordings.
        stated: Constants of each joint, (n, columns).
        tolerance: Deviations of their logarithms, likewise, or one of all.
        tick: Step of the encoders [rad].
    """
    guess = _of_moved(stated_guess(stated), loads)
    mass = sum(own.mass for own in loads.body.inertials.values())
    shared = {
        "mass": c.BelievedValue(0.0, _MASS * mass),
        "sag": c.BelievedValue(0.0, _SAG),
        **{f"com_{axis}": c.BelievedValue(0.0, _COM) for axis in "xyz"},
        **{f"zero_{j + 1}": c.BelievedValue(0.0, _ZERO) for j in range(loads.n)},
    }
    weights, believed = _weights(loads, guess, tick), beliefs(guess.rows, tolerance)
    problem = ArmProblem(loads, weights, believed, shared, within=REACH, tick=tick)
    fit = fit_arm(problem, guess, _FIRST)
    other = _limited(guess, stated)
    if not _alike(problem, guess, other):
        fit = min(fit, fit_arm(problem, other, _FIRST), key=lambda own: own.cost)
    found = _searched(fit, guess.rows)
    other = _limited(found.fit.guess, stated)
    if not _alike(found.fit.problem, found.fit.guess, other):
        moved = fit_arm(found.fit.problem, other, GLANCE)
        if moved.cost < found.fit.cost - _WORTH:
            again = fit_arm(problem, _limited(fit.guess, stated), _FIRST)
            return _searched(again, guess.rows)
    return found


def _of_moved(guess: ArmGuess, loads: ArmLoads) -> ArmGuess:
    """Return a guess in which nothing is fitted of a joint that no command moves."""
    moved = commanded_range(loads.recordings) > MOVED
    names = tuple(own if did else () for own, did in zip(guess.names, moved, strict=True))
    return replace(guess, names=names)


def _limited(guess: ArmGuess, stated: FloatArray) -> ArmGuess:
    """Return a guess in which servos limit what their damping asks for, too, if they did not.

    A servo that limits its motor's current does; one that limits its voltage leaves out what the
    motor brakes by itself. It is of one kind in all servos of an arm.

    Args:
        guess: Which is of the other kind.
        stated: Constants of each joint, (n, columns), which tell the servos' own damping.
    """
    rows = guess.rows.copy()
    asked = [
        j
        for j, row in enumerate(stated)
        if np.isfinite(c.value_in(row, "torque_limit")) and not _has_motor(row)
    ]
    within = any(c.value_in(rows[j], "inside") for j in asked)
    for j in asked:
        rows[j] = c.with_values(rows[j], {"inside": 0.0 if within else _share(stated[j])})
    return replace(guess, rows=rows)


def _alike(problem: ArmProblem, one: ArmGuess, other: ArmGuess) -> bool:
    """Say whether two guesses move the arm alike, as where no limit is reached."""
    pairs = zip(problem.errors(one), problem.errors(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def _searched(fit: ArmFit, stated: FloatArray) -> Searched:
    """Add what explains most, one after the other, as long as it is worth it.

    Args:
        fit: Of stated values alone, which stay within their tolerances.
        stated: Constants of each joint that fits began with, (n, columns).
    """
    fit = reweighted(fit)
    chosen = list[Suspect]()
    while len(chosen) < _MOST:
        every = suspects_of(fit.problem.loads, fit.guess, stated)
        waiting = [one for one in every if not any(known.excludes(one) for known in chosen)]
        glances = [fit_arm(fit.problem, x.added(fit.guess), _GLANCE, x.affects) for x in waiting]
        looks = [_Look.at(fit, waiting[k], glances[k]) for k in _likely(fit, waiting, glances)]
        if not looks or (best := max(looks, key=lambda look: look.worth)).worth < _WORTH:
            break
        best = _simplest(best, looks)
        chosen.append(best.one)
        if best.one.effect in COUNTED:
            fit = reweighted(best.fit)
            break  # all else is better looked for where joints count as described
        fit = _converge(best.fit)
    fit, kept = _still_worth(fit, chosen)
    for k, one in enumerate(kept):
        if one.effect == "payload":
            fit, kept[k] = _carried(fit, one)
    free = replace(fit.problem, within=np.inf, over=_FINE)
    return Searched(reweighted(fit_arm(free, fit.guess, EVALUATIONS)), tuple(kept))


def _likely(fit: ArmFit, waiting: Sequence[Suspect], glances: Sequence[ArmFit]) -> list[int]:
    """Return which suspects to look at: that explain most, or most of a joint's own errors.

    A joint that is far away errs slowly and its few independent rows say little, so that a small
    error of another joint outweighs it in nats.
    """
    worth = [_worth(fit, one, new) for one, new in zip(waiting, glances, strict=True)]
    before = [_cost_where(one, fit) for one in waiting]
    part = [
        (old - new.cost) / max(old, 1.0) if np.isfinite(own) else -np.inf
        for own, old, new in zip(worth, before, glances, strict=True)
    ]
    ranked = [
        k
        for score in (worth, part)
        for k in _first(waiting, np.argsort(-np.array(score), kind="stable").tolist())
    ]
    return [k for k in dict.fromkeys(ranked) if np.isfinite(worth[k])]


def _first(waiting: Sequence[Suspect], order: Sequence[int]) -> Iterator[int]:
    """Yield the first suspects of an order; of one thing in several forms, each that comes by."""
    seen = list[Suspect]()
    for k in order:
        if not any(waiting[k].excludes(known) for known in seen):
            seen.append(waiting[k])
        if len(seen) > _LIKELY:
            return
        yield k


def fit_without(found: Searched, one: Suspect) -> Searched:
    """Return what was found, fitted again without one suspect.

    Args:
        found: With it.
        one: The suspect.
    """
    fit = reweighted(_less(found.fit, one))
    return Searched(fit, tuple(other for other in found.suspects if other != one))


def is_needed(found: Searched, one: Suspect) -> bool:
    """Say whether a suspect still explains what it had to: motion, or what others would be off by.

    Constants that are fitted again without it may foretell as well, and be far from what is stated.
    """
    return _is_worth(one, _less(found.fit, one), found.fit)


def _less(fit: ArmFit, one: Suspect) -> ArmFit:
    """Return a fit without a suspect."""
    return fit_arm(fit.problem, one.removed(fit.guess), GLANCE)


def _is_worth(one: Suspect, without: ArmFit, fit: ArmFit) -> bool:
    return without.cost - fit.cost >= _WORTH + _EACH * len(one.names)


def _simplest(best: _Look, looks: Sequence[_Look]) -> _Look:
    """Return what explains the same of a joint with fewer constants, at the end of both fits.

    Looks are short, and each is judged by the errors that it leaves.
    """
    simpler = [x for x in looks if x.one.joint == best.one.joint and x.one.price < best.one.price]
    fit = _converge(best.fit) if simpler else best.fit
    for look in simpler:
        other = fit_arm(replace(fit.problem, over=_FINE), look.fit.guess, EVALUATIONS)
        if other.cost + _EACH * look.one.price <= fit.cost + _EACH * best.one.price:
            return look
    return best


def _weights(loads: ArmLoads, guess: ArmGuess, tick: float) -> Weights:
    """Return how much rows say, by the errors of a fit whose stated values may be anything.

    A joint that a wrong value keeps far away errs slowly: its rows, few independent ones among
    them, would not outweigh what is believed of that value.
    """
    free = frozenset((j, name) for j, names in enumerate(guess.names) for name in names)
    even = Weights(np.ones(loads.n), np.ones(loads.n))
    start = ArmProblem(loads, even, [{} for _ in range(loads.n)], tick=tick)
    fit = fit_arm(start.weighted_by(start.errors(guess)), replace(guess, free=free), _FIRST)
    return Weights.of(fit.errors, tick)


def _still_worth(fit: ArmFit, chosen: Sequence[Suspect]) -> tuple[ArmFit, list[Suspect]]:
    """Leave out what others that joined later explain."""
    kept = list(chosen)
    for one in chosen[:-1]:
        less = _less(fit, one)
        if not _is_worth(one, less, fit):
            kept.remove(one)
            fit = reweighted(less)
    return fit, kept


def reweighted(fit: ArmFit) -> ArmFit:
    """Return a fit that goes on with weights that its errors ask for."""
    problem = fit.problem.weighted_by(fit.errors)
    return fit_arm(problem, fit.guess, _TRY, errors=fit.errors, deviations=True)


def _carried(fit: ArmFit, one: Suspect) -> tuple[ArmFit, Suspect]:
    """Return a load on the link that explains most, given all that joined after it."""
    others = (x for x in fit.problem.loads.carriers if x != one.carrier)
    for other in (replace(one, carrier=link) for link in others):
        new = fit_arm(fit.problem, other.added(one.removed(fit.guess)), EVALUATIONS)
        if new.cost + _inner_load(other) < fit.cost + _inner_load(one):
            return reweighted(new), other
    return fit, one


def _inner_load(one: Suspect) -> float:
    """Return what a load has to explain beyond one at the end [nat].

    On the axis of the last joint it is nearly the same on either side.
    """
    return _WORTH if one.carrier is not None else 0.0


def _converge(fit: ArmFit) -> ArmFit:
    """Return a fit that has come to its end, along valleys too: what it leaves is asked about next.

    Args:
        fit: With a suspect that has just joined.
    """
    fit = reweighted(fit)
    fine = fit_arm(replace(fit.problem, over=_FINE), fit.guess, EVALUATIONS, errors=fit.errors)
    return reweighted(replace(fine, problem=fit.problem))


@dataclass(frozen=True)
class _Look:
    """A suspect looked at for longer.

    Errors that it explains are no noise: how much rows say is taken from those that it leaves, and
    the fit without it is judged by the same.
    """

    one: Suspect
    fit: ArmFit
    worth: float

    @classmethod
    def at(cls, fit: ArmFit, one: Suspect, glance: ArmFit) -> _Look:
        new = fit_arm(fit.problem, glance.guess, _TRY, one.affects, glance.errors)
        problem = fit.problem.weighted_by(new.errors)
        new = fit_arm(problem, new.guess, GLANCE, errors=new.errors)
        old = fit_arm(problem, fit.guess, GLANCE, errors=fit.errors)
        return cls(one, new, _worth(old, replace(one, shared=True), new))


def _worth(fit: ArmFit, one: Suspect, new: ArmFit) -> float:
    """Return what a suspect explains beyond its constants [nat]."""
    change = new.guess.change
    if one.effect == "payload" and change.mass <= 0.0:
        return -np.inf
    if any(at_bound(name, change.value(name)) for name in new.guess.shared):
        return -np.inf
    return _cost_where(one, fit) - new.cost - _EACH * one.price - _inner_load(one)


def _cost_where(one: Suspect, fit: ArmFit) -> float:
    """Return what the errors of a fit cost at the joints that a suspect affects [nat]."""
    return fit.problem.cost(fit.guess, fit.errors, one.affects or range(fit.problem.loads.n))
