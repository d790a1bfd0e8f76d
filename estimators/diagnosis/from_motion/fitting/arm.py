"""All joints of an arm fitted together, with what they share: zeros of encoders, a payload.

Each joint is simulated forward alone, so that a step of Levenberg and Marquardt costs a simulation
per constant and joint. What is believed of a constant counts as its square only near: far from it,
recordings decide, unless constants are kept within a number of deviations.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.joint import COARSE, independent
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.settings import FAR, FINE, MAD
from estimators.regression.definite import SymmetricSpectrum
from limo_driver.physics.drives import MOST_SAG
from limo_driver.physics.effects.sensing import FARTHEST_ZERO

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import BoolArray, FloatArray

_SHARED_BOUNDS: Final = {"zero": (-FARTHEST_ZERO, FARTHEST_ZERO), "sag": (0.0, MOST_SAG)}
_AT_END: Final = 1e-6  # deviations from the end of where a constant is kept, that are none
_RUN_AWAY: Final = 100.0  # [rad], of a joint that constants tried make unstable
_ENOUGH: Final = 1e-3  # of a nat, gained by a step
_STUCK: Final = 1e6  # damping, at which nothing moves any more
_STRETCH: Final = 2.0  # of a logarithm, the longest step


@dataclass(frozen=True)
class ArmGuess:
    """Constants of an arm, and which of them are fitted."""

    rows: FloatArray  # (n, columns)
    names: tuple[tuple[str, ...], ...]  # of each joint
    change: ArmChange
    shared: tuple[str, ...] = ()
    free: frozenset[tuple[int, str]] = (
        frozenset()
    )  # joints and constants of which nothing is believed

    def moved(self, step: FloatArray, own: Sequence[int]) -> ArmGuess:
        """Return the guess a step away.

        Args:
            step: Of the constants of the joints `own`, in their order, and of what is shared.
            own: Joints that are fitted, 0-based.
        """
        rows, at = self.rows.copy(), 0
        for j in own:
            many = len(self.names[j])
            rows[j] = c.stepped(
                rows[j], dict(zip(self.names[j], step[at : at + many].tolist(), strict=True))
            )
            at += many
        change = self.change
        for name, size in zip(self.shared, step[at:].tolist(), strict=True):
            least, most = _SHARED_BOUNDS.get(name.partition("_")[0], (-np.inf, np.inf))
            change = change.with_value(name, min(max(change.value(name) + size, least), most))
        return replace(self, rows=rows, change=change)


@dataclass(frozen=True)
class Weights:
    """How much the errors of each joint say."""

    scale: FloatArray  # (n,) [rad], typical
    many: FloatArray  # (n,), by which rows count: independent ones over all

    @classmethod
    def of(cls, errors: Sequence[FloatArray], least: float) -> Weights:
        """Take them from the errors of a fit.

        Args:
            errors: Of each joint [rad].
            least: That encoders make [rad].
        """
        scale = [max(MAD * float(np.median(np.abs(e))), least) for e in errors]
        many = [
            independent(np.clip(e, -COARSE * s, COARSE * s)) / e.size
            for e, s in zip(errors, scale, strict=True)
        ]
        return cls(np.array(scale), np.array(many))


@dataclass(frozen=True)
class ArmProblem:
    """What is fitted to: recordings, their weights, and what is believed."""

    loads: ArmLoads
    weights: Weights
    priors: Sequence[Mapping[str, c.BelievedValue]]  # of each joint
    shared: Mapping[str, c.BelievedValue] = field(default_factory=dict)
    kept: BoolArray | None = None  # rows of all stretches, in a row
    over: float = c.STEP  # what slopes are taken over, of a logarithm or a signed value in its unit
    within: float = np.inf  # deviations from what is believed, that constants are kept within
    tick: float = 0.0  # [rad], step of the encoders, that errors are taken to be at least

    def weighted_by(self, errors: Sequence[FloatArray]) -> ArmProblem:
        """Return the same with the weights that the errors of a fit ask for."""
        return replace(self, weights=Weights.of(errors, self.tick))

    def errors(self, guess: ArmGuess) -> list[FloatArray]:
        """Return simulated minus recorded positions of each joint [rad]."""
        parts = self.loads.parts(guess.change)
        with ThreadPoolExecutor() as pool:
            return list(pool.map(self.errors_of, parts, guess.rows))

    def away(self, guess: ArmGuess, j: int) -> dict[str, float]:
        """Return how far the constants of a joint are from what is believed, in deviations."""
        return {
            name: (c.inner(name, c.value_in(guess.rows[j], name)) - c.inner(name, prior.value))
            / prior.deviation
            for name, prior in self.priors[j].items()
            if name in guess.names[j] and (j, name) not in guess.free
        }

    def kept_within(self, guess: ArmGuess) -> ArmGuess:
        """Return a guess whose constants are no farther from what is believed than they may be."""
        if self.within == np.inf:
            return guess
        rows = guess.rows.copy()
        for j, row in enumerate(rows):
            beyond = {n: x for n, x in self.away(guess, j).items() if abs(x) > self.within}
            ends = {name: np.copysign(self.within, x) for name, x in beyond.items()}
            own = {name: self.priors[j][name] for name in ends}
            values = {
                name: c.outer(name, c.inner(name, own[name].value) + end * own[name].deviation)
                for name, end in ends.items()
            }
            rows[j] = c.with_values(row, values)
        return replace(guess, rows=rows)

    def errors_of(self, parts: Sequence[LoadedJoint], row: FloatArray) -> FloatArray:
        """Return simulated minus recorded positions of one joint [rad]."""
        error = np.concatenate([part.simulate(row) - part.position for part in parts])
        if not np.abs(error).max() <= _RUN_AWAY:
            error = np.nan_to_num(error, nan=_RUN_AWAY).clip(-_RUN_AWAY, _RUN_AWAY)
        return error if self.kept is None else error[self.kept]

    def loss(self, j: int, error: FloatArray) -> float:
        """Return what the errors of a joint cost [nat]."""
        scale = COARSE * self.weights.scale[j]
        ratio = np.hypot(1.0, error / scale) - 1.0
        return float(self.weights.many[j] * COARSE**2 * ratio.sum())

    def believed(self, guess: ArmGuess, j: int) -> float:
        """Return what the constants of a joint cost [nat], for being far from what is believed."""
        away = np.array(list(self.away(guess, j).values()))
        return float(COARSE**2 * (np.hypot(1.0, away / COARSE) - 1.0).sum())

    def cost(self, guess: ArmGuess, errors: Sequence[FloatArray], joints: Sequence[int]) -> float:
        """Return the whole cost of some joints [nat]."""
        total = sum(self.loss(j, errors[j]) + self.believed(guess, j) for j in joints)
        for name in guess.shared:
            if name in self.shared:
                prior = self.shared[name]
                total += 0.5 * ((guess.change.value(name) - prior.value) / prior.deviation) ** 2
        return total


@dataclass(frozen=True)
class ArmFit:
    """Fitted constants, their cost, and how sure they are."""

    problem: ArmProblem
    guess: ArmGuess
    cost: float  # [nat], of the joints that were fitted
    errors: tuple[FloatArray, ...]  # of each joint [rad]
    own: tuple[Mapping[str, float], ...] = ()  # deviations, by joint and constant
    shared: Mapping[str, float] = field(default_factory=dict)  # deviations of what is shared


def fit_arm(
    problem: ArmProblem,
    start: ArmGuess,
    steps: int,
    joints: Sequence[int] | None = None,
    errors: Sequence[FloatArray] | None = None,
    *,
    deviations: bool = False,
) -> ArmFit:
    """Fit constants of joints and what they share.

    Args:
        problem: What is fitted to.
        start: Where the fit begins.
        steps: At most.
        joints: That are fitted, 0-based; all if not given. What is shared needs all of them.
        errors: Of the start, if they are known.
        deviations: Whether to say how sure values are, which takes as long as a step.
    """
    own = tuple(range(problem.loads.n)) if joints is None else tuple(joints)
    fit, hessian = _descended(problem, start, steps, own, errors)
    if not deviations:
        return fit
    if hessian is None:
        hessian, _ = _normal(problem, fit.guess, fit.errors, own)
    deviation = iter(SymmetricSpectrum.of(hessian).deviation().tolist())
    by_joint = [
        {name: next(deviation) for name in names} if j in own else {}
        for j, names in enumerate(fit.guess.names)
    ]
    shared = {name: next(deviation) for name in fit.guess.shared}
    return replace(fit, own=tuple(by_joint), shared=shared)


def _descended(
    problem: ArmProblem,
    start: ArmGuess,
    steps: int,
    own: tuple[int, ...],
    errors: Sequence[FloatArray] | None,
) -> tuple[ArmFit, FloatArray | None]:
    """Return the fit, and the curvature that its last step was taken by if that hardly moved it."""
    guess = problem.kept_within(start)
    known = errors is not None and np.array_equal(guess.rows, start.rows)
    found = list(errors if errors is not None and known else problem.errors(guess))
    cost, damping = problem.cost(guess, found, own), FINE
    for _ in range(steps):
        hessian, gradient = _normal(problem, guess, found, own)
        before, movable = cost, _movable(problem, guess, gradient, own)
        while damping < _STUCK:
            step = _step(hessian, gradient, movable, damping)
            tried = problem.kept_within(guess.moved(step, own))
            after = _errors(problem, tried, own, found, all_of=bool(guess.shared))
            value = problem.cost(tried, after, own)
            if value < cost:
                guess, found, cost, damping = tried, after, value, damping / FAR
                break
            damping *= FAR
        if before - cost < _ENOUGH:
            return ArmFit(problem, guess, cost, tuple(found)), hessian
    return ArmFit(problem, guess, cost, tuple(found)), None


def _movable(
    problem: ArmProblem, guess: ArmGuess, gradient: FloatArray, own: Sequence[int]
) -> BoolArray:
    """Say which constants are not at the end of where they are kept, and pulled beyond it."""
    away = [problem.away(guess, j).get(name, 0.0) for j in own for name in guess.names[j]]
    far = np.array([*away, *[0.0] * len(guess.shared)])
    return (np.abs(far) < problem.within - _AT_END) | (far * gradient >= 0.0)


def _step(
    hessian: FloatArray, gradient: FloatArray, movable: BoolArray, damping: float
) -> FloatArray:
    """Return a damped step of those constants that can move."""
    heavy = hessian + damping * np.diag(np.diag(hessian) + 1e-9)
    step = np.zeros_like(gradient)
    step[movable] = np.linalg.solve(heavy[np.ix_(movable, movable)], -gradient[movable])
    return step.clip(-_STRETCH, _STRETCH)


def _errors(
    problem: ArmProblem,
    guess: ArmGuess,
    own: Sequence[int],
    known: Sequence[FloatArray],
    *,
    all_of: bool,
) -> list[FloatArray]:
    if all_of or len(own) == problem.loads.n:
        return problem.errors(guess)
    parts, found = problem.loads.parts(guess.change), list(known)
    for j in own:
        found[j] = problem.errors_of(parts[j], guess.rows[j])
    return found


def _normal(
    problem: ArmProblem, guess: ArmGuess, errors: Sequence[FloatArray], own: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return curvature and slope of the cost."""
    parts = problem.loads.parts(guess.change)
    over = problem.over
    moved = [
        problem.loads.parts(guess.change.with_value(name, guess.change.value(name) + over))
        for name in guess.shared
    ]

    def slopes(j: int) -> FloatArray:
        sides = [
            problem.errors_of(parts[j], c.stepped(guess.rows[j], {name: over}))
            for name in guess.names[j]
        ] + [problem.errors_of(other[j], guess.rows[j]) for other in moved]
        return (
            np.reshape([side - errors[j] for side in sides], (len(sides), errors[j].size)).T / over
        )

    with ThreadPoolExecutor() as pool:
        every = list(pool.map(slopes, own))
    many = [len(guess.names[j]) for j in own]
    size = sum(many) + len(guess.shared)
    hessian, gradient, at = np.zeros((size, size)), np.zeros(size), 0
    common = np.arange(sum(many), size)
    for j, slope, count in zip(own, every, many, strict=True):
        scale = problem.weights.scale[j]
        weight = problem.weights.many[j] / scale**2
        weight = weight / np.hypot(1.0, errors[j] / (COARSE * scale))
        place = np.concatenate([np.arange(at, at + count), common])
        hessian[np.ix_(place, place)] += slope.T @ (weight[:, None] * slope)
        gradient[place] += slope.T @ (weight * errors[j])
        for k, name in enumerate(guess.names[j]):
            prior = problem.priors[j].get(name)
            if prior is not None and (j, name) not in guess.free:
                here = c.inner(name, c.value_in(guess.rows[j], name)) - c.inner(name, prior.value)
                x = here / prior.deviation
                curve = 1.0 / (prior.deviation**2 * np.sqrt(1.0 + (x / COARSE) ** 2))
                hessian[at + k, at + k] += curve
                gradient[at + k] += curve * here
        at += count
    for k, name in zip(common.tolist(), guess.shared, strict=True):
        prior = problem.shared.get(name)
        if prior is not None:
            hessian[k, k] += prior.deviation**-2
            gradient[k] += (guess.change.value(name) - prior.value) / prior.deviation**2
    return hessian, gradient


def at_bound(name: str, value: float) -> bool:
    """Say whether a value that all joints share is at the end of what is possible."""
    return value in _SHARED_BOUNDS.get(name.partition("_")[0], ())
