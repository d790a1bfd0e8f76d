"""Conclusion: the verdict in the words and numbers of `verdict.json`.

Holding: the motion on which a verdict stands, and the values that it leaves as stated.

A friction slope learned from slow motion says little of fast motion. So a verdict has the range of
positions, speeds and loads of the rows that were fitted and judged, by joint. A stated value of
which these rows say next to nothing stays as it is, whatever else is found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import surely_better
from estimators.diagnosis.from_torque.fitting.problem import lost_by
from estimators.diagnosis.from_torque.judgement.findings import (
    findings_of,
    left_at,
    unknown_of,
    unnamed_note,
)
from estimators.diagnosis.from_torque.judgement.ordinary import to_identify
from estimators.diagnosis.from_torque.residuals import usable_joints
from estimators.diagnosis.from_torque.residuals.plausibility import doubts_on, notes_on
from estimators.diagnosis.held_out import bootstrap, reducible_removed, rmse, surely_positive
from estimators.diagnosis.quantities import listed, rounded
from estimators.diagnosis.result import CHOSEN, Explanation, Shift
from estimators.diagnosis.settings import NEARLY_ALL, TINY
from estimators.diagnosis.settings.fitting import CANDIDATES, CONTRIBUTION
from estimators.diagnosis.settings.judgement import OBSERVABLE, WORDING
from estimators.diagnosis.verdict import (
    TORQUE,
    UNKNOWN,
    Fit,
    Holds,
    Identified,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from estimators.regression.definite import best_first, ranked
from limo_driver.physics.catalogue import unusable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
    from estimators.diagnosis.verdict import Finding
    from limo_driver.types import BoolArray, FloatArray


def fit_of(
    problem: RegressionProblem, proven: FloatArray, alone: FloatArray, floor: FloatArray
) -> Fit:
    """Return the proof on held-out rows.

    Args:
        problem: What was compared.
        proven: Residual (K, n) of the improved simulation, not fitted to held-out rows [N m].
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        floor: Noise floor of each joint, (n,) [N m].
    """
    given, rows = problem.observed.residual, problem.split.held_out
    before, after = rmse(given, rows), rmse(proven, rows)
    every = problem.observed.measured_on(problem.split.apart)
    return Fit(
        tuple(before.tolist()),
        tuple(after.tolist()),
        tuple(floor.tolist()),
        reducible_removed(before, after, floor),
        bootstrap(given, proven, floor, problem.observed, rows),
        tuple(alone.tolist()),
        tuple(rmse(given, every).tolist()),
        tuple(rmse(proven, every).tolist()),
        tuple(j + 1 for j in above_floor(problem, given, floor)),
        tuple(j + 1 for j in above_floor(problem, proven, floor)),
        unit=problem.observed.unit(TORQUE),
    )


def above_floor(
    problem: RegressionProblem, residual: FloatArray, floor: FloatArray
) -> tuple[int, ...]:
    """Return the joints (0-based) at which a simulation surely errs by more than noise.

    Args:
        problem: What was compared.
        residual: Of the simulation, (K, n) [N m].
        floor: Noise floor of each joint, (n,) [N m].
    """
    observed, rows = problem.observed, problem.split.held_out
    excess = residual**2 - (WORDING.at_floor * floor) ** 2
    own = np.eye(observed.n, dtype=bool)
    return tuple(j for j in range(observed.n) if surely_positive(excess, observed, rows & own[j]))


def rows_of(problem: RegressionProblem) -> RowCount:
    """Count the samples used and left out, by reason, and the rows that were fitted and judged."""
    recordings, split = problem.observed.recordings, problem.split
    left_out: dict[str, int] = {}
    for recording in recordings:
        for item in recording.left_out:
            left_out[item.reason] = left_out.get(item.reason, 0) + len(item.rows)
    usable, fitted, judged = (
        tuple(rows.sum(axis=0).tolist())
        for rows in (problem.observed.moving, split.fitted, split.held_out)
    )
    held_out = int(split.apart.sum())
    total = len(problem.observed.kept)
    return RowCount(sum(map(len, recordings)), left_out, total, usable, fitted, held_out, judged)


def conclude(
    solution: Solution,
    remaining: RemainingResidual,
    named: Sequence[int],
    unknown: tuple[int, ...],
    proven: FloatArray,
    tolerances: FloatArray,
    contact: tuple[Finding, ...] = (),
) -> Verdict:
    """Put the verdict together.

    Args:
        solution: The set, fitted to the rows meant for it.
        remaining: Residual that remains.
        named: Members of the set that are findings or ordinary; the others only stand in for the
            unknown.
        unknown: Joints (0-based) on which something unknown acts.
        proven: Residual (K, n) of the improved simulation, not fitted to held-out rows [N m].
        tolerances: Residual (K, n) with values moved inside their tolerances and no effect [N m].
        contact: Pushes that were found.
    """
    problem = solution.problem
    alone = rmse(tolerances, problem.split.held_out)
    after = rmse(proven, problem.split.held_out)
    stand_ins = [  # of what passes, the improved simulation has nothing
        member
        for member in solution.members
        if member not in named and problem.candidates[member].persists
    ]
    values = to_identify(solution)
    plain = [member for member in named if member in values]
    unusual = [member for member in named if member not in values]
    found = (*contact, *findings_of(solution, unusual, remaining, alone, after))
    findings = (*found, *unknown_of(problem, stand_ins, remaining, unknown, alone, after))
    if not findings:
        summary = "consistent"
    elif not unknown:
        summary = "explained"
    else:
        summary = "partly_explained" if found else "unexplained"
    # of all rows, and beside the given simulation, as the recordings came in
    given = problem.observed.undisturbed(None).under(problem.observed.simulation)
    doubts = doubts_on(given)
    _, share = left_at(unknown, alone, after, remaining.floor)
    where = next((item.where for item in findings if item.effect == UNKNOWN), Where())
    return Verdict(
        verdict=summary,
        findings=findings,
        unexplained=Unexplained(tuple(j + 1 for j in unknown), share, where),
        not_observable=not_observable(solution, remaining),
        next_motion=None,
        fit=fit_of(problem, proven, alone, remaining.floor),
        rows=rows_of(problem),
        notes=(
            *notes_on(given, doubts),
            *unproven(problem),
            *usable_joints.notes(problem.observed, proven),
            *(
                [unnamed_note([problem.candidates[i] for i in stand_ins])]
                if stand_ins and not unknown
                else ()
            ),
            *(f"An effect was not tried: {error}." for error in unusable()),
        ),
        identified=identified_of(problem, plain),
        holds=held_by(solution),
        doubts=doubts,
        joint_names=problem.observed.simulation.model.joint_names,
        sliding=problem.observed.simulation.model.sliding,
    )


def unproven(problem: RegressionProblem) -> Iterator[str]:
    """Yield which joints move, and in no stretch that is held out; in one sentence."""
    moves, judged = (rows.any(axis=0) for rows in (problem.observed.moving, problem.split.held_out))
    if joints := [str(j + 1) for j in np.flatnonzero(moves & ~judged).tolist()]:
        some = f"joint{'s' * (len(joints) > 1)} {listed(joints)}"
        yield f"No motion of {some} is held out: what is said of it was proven on none."


def identified_of(problem: RegressionProblem, members: Sequence[int]) -> tuple[Identified, ...]:
    """Return ordinary members of a set as values to identify, joint by joint."""
    items = [problem.candidates[member] for member in members]
    found = (Identified(item.effect, item.joints[0] + 1) for item in items)
    return tuple(sorted(found, key=lambda item: (item.joint, item.effect)))


def not_observable(solution: Solution, remaining: RemainingResidual) -> tuple[NotObservable, ...]:
    """Name the effects that could be there at ten noise floors without showing.

    An effect that is in the set has shown at one joint, and is left out: where else it could be is
    no reason to say that these recordings do not excite it.
    """
    problem = solution.problem
    evidence = solution.search.evidence
    size = problem.columns.size()
    least: dict[str, tuple[float, int]] = {}
    moves = np.count_nonzero(problem.observed.moving, axis=0) > 0
    shown = {problem.candidates[member].effect for member in solution.members}
    for candidate in problem.candidates:
        if candidate.effect in shown:
            continue
        if not np.all(moves[list(candidate.joints)]):
            continue  # a note says so
        at = candidate.prior.index
        information = np.diag(evidence.gram)[at]
        joint = candidate.joints[0] if candidate.joints else 0
        torque = float(
            np.min(size[at] * np.sqrt(2 * CANDIDATES.missing / np.maximum(information, TINY)))
            / remaining.floor[joint]
        )
        known = least.get(candidate.effect)
        if known is None or torque > known[0]:
            least[candidate.effect] = (torque, joint)
    return tuple(
        NotObservable(
            effect,
            f"less than {rounded(torque * float(remaining.floor[joint]), 2)} "
            f"{problem.observed.unit('N m', joint)} RMS of it at "
            f"joint {joint + 1} could not be told from values that move within their tolerances",
        )
        for effect, (torque, joint) in sorted(least.items())
        if torque > OBSERVABLE.hidden
    )


def explanations_of(
    solution: Solution, floor: FloatArray, limit: int = WORDING.explanations
) -> tuple[Explanation, ...]:
    """Return the chosen set and the best others, best first.

    Args:
        solution: The chosen set, fitted to the rows meant for it.
        floor: Noise floor of each joint, (n,) [N m].
        limit: How many.
    """
    problem = solution.problem
    search, rows = solution.search, problem.split.held_out
    none = rmse(problem.left(search.evidence.posterior(search.prior(()))), rows)
    kept = rmse(problem.left(solution.fitted), rows)
    found: list[Explanation] = []
    for members in _ranked(solution, limit):
        left = rmse(problem.left(search.evidence.posterior(search.prior(members))), rows)
        gain, note = search.gain(members), ""
        if set(members) == set(solution.members):
            note = CHOSEN
        elif gain > solution.gain:
            note = _dropped(left / floor, kept / floor)
            if not note and gain > solution.gain + CONTRIBUTION.tellable:
                note = _not_chosen(solution, members)
        found.append(
            Explanation(
                tuple(problem.candidates[i].effect for i in members),
                tuple(tuple(j + 1 for j in problem.candidates[i].joints) for i in members),
                gain,
                reducible_removed(none, left, floor),
                note,
            )
        )
    return tuple(found)


def _dropped(left: FloatArray, kept: FloatArray) -> str:
    """Say why a set of more evidence was not chosen.

    Args:
        left: Its held-out RMSE, (n,) [noise floors].
        kept: That of the chosen set.
    """
    gained = kept**2 - left**2
    if gained.sum() <= 0:
        return "does not hold on motion held out"
    return "takes too little off motion held out" if gained.max() < CONTRIBUTION.material**2 else ""


def _not_chosen(solution: Solution, members: tuple[int, ...]) -> str:
    """Say why a set of more evidence was not chosen that leaves less on the rows held out."""
    lost = sum(lost_by(solution.having(members)).values())
    if solution.search.gain(members) - lost < solution.gain:
        return "needs a body that cannot be"
    everywhere = range(solution.problem.observed.n)
    if surely_better(solution, members, solution.members, everywhere):
        return "predicts better as a linear fit; no check made here speaks against it"
    return "predicts no better for sure, whichever motion is held out"


def _ranked(solution: Solution, limit: int) -> list[tuple[int, ...]]:
    """Return the best sets of members, one of each set of places; the chosen one is among them."""
    search, chosen = solution.search, tuple(sorted(solution.members))
    sets = {chosen}
    for member in chosen:
        rest = tuple(i for i in chosen if i != member)
        sets |= {item.members for item in search.ranked(rest, limit)} | {rest}
    sets |= {item.members for item in search.ranked((), limit)}
    best: dict[tuple[tuple[str, tuple[int, ...]], ...], tuple[int, ...]] = {}
    for members in [*reversed(ranked(sorted(sets), search.gain)), chosen]:
        best[tuple(sorted(solution.problem.candidates[i].place for i in members))] = members
    others = ranked(sorted(set(best.values()) - {chosen}), search.gain)[: limit - 1]
    return ranked([chosen, *others], search.gain)


def shifts_of(final: Solution) -> tuple[Shift, ...]:
    """Return how far each nuisance parameter moved, in its own tolerance, farthest first."""
    problem = final.problem
    count = problem.nuisance.prior.index.size
    mean = final.fitted.mean[:count]
    deviation = problem.nuisance.prior.deviation
    sigmas = np.divide(mean, deviation, out=np.zeros_like(mean), where=deviation > 0)
    left = np.ones_like(mean)
    known = final.fitted.deviation[:count]
    np.divide(known, deviation, out=left, where=deviation > 0)
    order = best_first(np.abs(sigmas))  # many did not move at all, or to their limits
    parameters = problem.nuisance.parameters
    return tuple(
        Shift(
            parameters[k].name,
            parameters[k].nominal,
            parameters[k].value(float(mean[k])),
            parameters[k].unit,
            float(sigmas[k]),
            float(left[k]),
        )
        for k in order.tolist()
    )


def held_by(solution: Solution) -> Holds:
    """Return the range of motion of the rows that count, and the friction that they do not show."""
    observed = solution.problem.observed
    rows = observed.moving
    return Holds(
        position=_ranges(observed.slow.position, rows),
        speed=_ranges(np.abs(observed.slow.velocity), rows),
        load=_ranges(observed.load[observed.kept], rows),
        as_stated=_as_stated(solution),
    )


def _ranges(values: FloatArray, rows: BoolArray) -> tuple[tuple[float, float], ...]:
    """Return least and largest of values (K, n) over the rows (K, n) of each joint."""
    some = [column[use] for column, use in zip(values.T, rows.T, strict=True)]
    return tuple((float(x.min()), float(x.max())) if x.size else (0.0, 0.0) for x in some)


def _as_stated(solution: Solution) -> tuple[str, ...]:
    """Name the stated sizes of friction of which the fit knows hardly more than was stated."""
    prior, fitted = solution.problem.nuisance.prior, solution.fitted
    known = fitted.deviation[: prior.index.size]
    at_limit = ~np.isnan(solution.search.evidence.at_limit(fitted))
    open_ = (known > NEARLY_ALL * prior.deviation) & (prior.deviation > 0) & ~at_limit
    return tuple(
        item.name
        for item, unseen in zip(solution.problem.nuisance.parameters, open_.tolist(), strict=True)
        if unseen and item.of_effect
    )
