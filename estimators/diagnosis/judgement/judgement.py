"""Judgement: from the fitted set to findings, with equivalents and abstention."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.contribution import MATERIAL, TELLABLE, contribution, taken_off
from estimators.diagnosis.judgement.surrogate import foretold
from estimators.diagnosis.residuals.held_out import rmse
from estimators.diagnosis.residuals.noise import roughness
from estimators.diagnosis.residuals.observations import CREEP
from estimators.diagnosis.selection.evidence import REACH
from estimators.diagnosis.selection.search import LARGEST
from estimators.diagnosis.wording import LINK_INERTIA
from limo_driver.physics.catalogue import identical_to

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.fitting.problem import Bench, Solution
    from estimators.diagnosis.residuals.observations import Observations
    from estimators.diagnosis.result import Shift
    from estimators.diagnosis.selection.candidates import Candidate
    from limo_driver.types import FloatArray

FORETOLD = 0.45  # [noise floors] of foretellable rest that counts as unknown physics
SMOOTHER, SMOOTH = 1.4, 1.9  # times the other joints', and least, ratio of a rest to its roughness
_AT_LIMIT = 0.01  # [sigma]
_WORTH_A_WORD = 1.5  # [sigma] that a value moved inside its tolerance
DOMINANT = 0.96  # part of a joint's foretellable error that its findings have to explain
PRECISE = 0.99  # part beyond which the rest is what no law of friction gets right, and no physics


@dataclass(frozen=True)
class Leftover:
    """What the chosen set leaves on each joint."""

    floor: FloatArray  # (n,) RMS of what no black box can foretell [N m]
    foretold: FloatArray  # (n,) RMS of what one can [N m]
    series: FloatArray  # (K, n) what one foretells; the whole rest where that is smooth [N m]

    @property
    def foretellable(self) -> NDArray[np.bool_]:
        """Mark the joints (n,) on which a black box foretells clearly more than noise."""
        return self.foretold > FORETOLD * self.floor


def leftover(observed: Observations, left: FloatArray) -> Leftover:
    """Split the rest into what could be foretold and what is noise.

    Some physics cannot be foretold from the motion (jumps, disturbances in time). It is slow where
    noise is rough: a rest that is far smoother on one joint than on the others counts, too.

    Args:
        observed: Recordings and simulation.
        left: Residual of the improved simulation, (K, n) [N m].
    """
    moving = observed.faster(CREEP)  # a simulation gets slower friction wrong, unknown or not
    guesses = [foretold(observed, left[:, joint], joint) for joint in range(observed.n)]
    series = np.stack(guesses, axis=1)
    whole, floor = rmse(left, moving), rmse(left - series, moving)
    rough, moves = roughness(left, moving), moving.any(axis=0)
    floor = np.where(moves, floor, rough)  # of a still joint nothing is known
    ratio = floor / rough
    usual = float(np.median(ratio[moves])) if moves.any() else 1.0
    smooth = (ratio > SMOOTHER * usual) & (ratio > SMOOTH)
    floor = np.where(smooth, usual * rough, floor)
    beyond = np.sqrt(np.maximum(whole**2 - floor**2, 0.0))
    return Leftover(floor, beyond, np.where(smooth, left, series))


def equivalents(bench: Bench, solution: Solution, member: int) -> tuple[Candidate, ...]:
    """Return the candidates that would do as well in a member's place, best first."""
    own = bench.candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    taken = {bench.candidates[i].place for i in rest}
    best: dict[tuple[str, tuple[int, ...]], tuple[float, Candidate]] = {}
    reference = solution.search.gain((*rest, member))
    for i, candidate in enumerate(bench.candidates):
        if candidate.place == own.place or candidate.place in taken:
            continue
        gain = solution.search.gain((*rest, i))
        if gain > reference - TELLABLE:
            known = best.get(candidate.place)
            if known is None or known[0] < gain:
                best[candidate.place] = (gain, candidate)
    return tuple(item[1] for item in sorted(best.values(), key=lambda item: -item[0]))


def identical(bench: Bench, member: int) -> tuple[str, ...]:
    """Return what no recording can tell from a member; of links only the last carries a load."""
    candidate, last = bench.candidates[member], bench.observed.n - 1
    same = identical_to(candidate.effect)
    if LINK_INERTIA in {candidate.effect, *same} and candidate.joints != (last,):
        return ()
    return same


def margin(bench: Bench, solution: Solution, member: int, same: Sequence[Candidate]) -> float:
    """Return the evidence for a member over the best other explanation in its place [nat]."""
    own = bench.candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    taken = {bench.candidates[i].place for i in rest} | {own.place} | {c.place for c in same}
    other = max(
        (
            solution.search.gain((*rest, i))
            for i, candidate in enumerate(bench.candidates)
            if candidate.place not in taken
        ),
        default=0.0,
    )
    best = max(other, solution.search.gain(rest))
    return solution.search.gain((*rest, member)) - best


def abstained(
    bench: Bench, solution: Solution, rest: Leftover
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Take back names that explain too little of a joint's error, and say what stays unknown.

    A wrong effect often explains part of an unknown one. The right one leaves nothing that a black
    box could foretell.

    Returns:
        Members that stay, and joints (0-based) on which something unknown acts.
    """
    search = solution.search
    none = search.evidence.posterior(search.prior(()))
    removed = taken_off(bench.left(solution.fitted), bench.left(none), bench.split.held_out)
    explained = removed / np.maximum(removed + rest.foretold**2, 1e-12)
    unknown = np.flatnonzero(rest.foretellable & (explained < PRECISE))
    doubtful = {int(j) for j in unknown if explained[j] < DOMINANT}
    stay = tuple(
        member
        for member in solution.members
        if int(np.argmax(contribution(bench, solution, member) / rest.floor**2)) not in doubtful
    )
    return stay, tuple(int(j) for j in unknown)


def harms(bench: Bench, proven: FloatArray, rest: Leftover) -> bool:
    """Say whether held-out motion of some joint is foretold clearly worse than before."""
    return worse(bench, proven, bench.observed.residual, rest)


def worse(bench: Bench, proven: FloatArray, other: FloatArray, rest: Leftover) -> bool:
    """Say whether one residual (K, n) is clearly larger than another on held-out motion."""
    rows = bench.split.held_out
    return bool((rmse(proven, rows) > rmse(other, rows) + MATERIAL * rest.floor).any())


def _moved(shift: Shift) -> str:
    limit = " (as far as it may)" if abs(shift.sigmas) > REACH - _AT_LIMIT else ""
    return f"{shift.name} by {shift.sigmas:+.1f} sigma{limit}"


def remarks(shifts: Sequence[Shift], *, members: int, harmful: bool, doubted: int) -> Iterator[str]:
    """Yield what a reader should know of the fit, one sentence each."""
    moved = [shift for shift in shifts if abs(shift.sigmas) > _WORTH_A_WORD][:3]
    if moved and not harmful:
        said = "; ".join(map(_moved, moved))
        sensed = any(" of sensor " in shift.name for shift in moved)
        yield f"Values moved inside their tolerances, too, and the fit has both: {said}." + (
            " What a sensor adds is written into no simulation." if sensed else ""
        )
    if members >= LARGEST:
        yield (
            f"The search stopped at {LARGEST} effects, and more may be missing: identify inertias "
            "and friction first (limo identify), or give wider tolerances."
        )
    if harmful:
        yield (
            "What was found foretells motion held out worse than the given simulation does, so "
            "the written simulation is the given one. Do the recordings belong together?"
        )
    if doubted:
        yield (
            f"{doubted} short stretches that look like pushes were left out, but too much else is "
            "unknown to call them contact."
        )
