"""Solving: the set of effects that the recordings speak for, fitted, pruned and refined."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.contribution import MATERIAL, material
from estimators.diagnosis.fitting.laws import likeliest
from estimators.diagnosis.fitting.problem import (
    Bench,
    Progress,
    Solution,
    fitted,
    improve,
    search_on,
)
from estimators.diagnosis.fitting.refinement import Setting, replaced
from estimators.diagnosis.hypotheses.ripple import ripples
from estimators.diagnosis.residuals.held_out import rmse
from estimators.diagnosis.residuals.noise import Noise, roughness
from estimators.diagnosis.selection.candidates import entered
from estimators.regression.evidence import Prior, joined
from estimators.rigid_body.regressor import PER_LINK

if TYPE_CHECKING:
    from collections.abc import Collection

_ROUNDS = 2  # of noise and search in turn
_CURVED = 0.4  # of the rest, by which a simulation may be off its linear fit


def solve(bench: Bench, progress: Progress, near: tuple[int, ...] | None = None) -> Solution:
    """Find the set of effects, or the best one near a set; noise and set in turn until both stay.

    The first noise is what a fit of everything at once leaves. Taken from a residual that still
    has an effect in it, the noise would explain that effect, and hide it.

    While sets compete, tolerances are the deviations of normal priors, which thousands of rows
    outvote; fitted values stay inside them. So once more with those of bodies held that a fit has
    at their limit: what they would have explained beyond may be an effect, or a body that is wrong.
    """
    bench.held = None
    noise = _noise_of_everything(bench)
    _scan(bench, fitted(bench, bench.base, noise))
    solution = _sought(bench, noise, progress, near)
    _scan(bench, solution)  # of what the largest effects hid
    solution = _until_it_stays(bench, solution, progress, near)
    limits = solution.search.evidence.at_limit(solution.fitted)
    limits[PER_LINK * bench.observed.n :] = np.nan  # bodies come first
    if np.isnan(limits).all():
        return solution
    bench.held = limits
    more = _until_it_stays(bench, solution, progress, near)
    if set(more.members) != set(solution.members):
        return more
    bench.held = None
    return solution


def _until_it_stays(
    bench: Bench, solution: Solution, progress: Progress, near: tuple[int, ...] | None
) -> Solution:
    for _ in range(_ROUNDS):
        before = set(solution.members)
        noise = Noise.of(bench.left(solution.fitted), bench.split.fitted, bench.observed.segment)
        solution = _sought(bench, noise, progress, near)
        if set(solution.members) == before:
            break
    return solution


def _sought(
    bench: Bench, noise: Noise, progress: Progress, near: tuple[int, ...] | None
) -> Solution:
    progress("comparing explanations", 0.4)
    search = search_on(bench, noise)
    found = search.best() if near is None else search.around(near)
    posterior = search.evidence.posterior(search.prior(found.members))
    return Solution(found.members, search, noise, posterior, found.gain)


def _scan(bench: Bench, solution: Solution) -> None:
    """Add the candidates that have to be looked for in the residual."""
    for hypothesis in ripples(bench.observed, bench.left(solution.fitted)):
        candidate = entered(hypothesis, bench.observed, bench.columns, bench.level)
        if candidate is not None:
            bench.candidates.append(candidate)


def _noise_of_everything(bench: Bench) -> Noise:
    white = Noise.independent(roughness(bench.target, bench.observed.moving), bench.split.fitted)
    evidence = search_on(bench, white).evidence
    everything = joined(*(candidate.prior for candidate in bench.candidates))
    free = Prior.free(everything.index, everything.deviation)
    left = bench.left(evidence.posterior(free))
    return Noise.of(left, bench.split.fitted, bench.observed.segment)


def pruned(bench: Bench, solution: Solution) -> Solution:
    """Take out members that matter little or harm: precise, perhaps, but not physics to name."""
    while solution.members:
        size = {member: material(bench, solution, member) for member in solution.members}
        least = min(size, key=lambda member: size[member])
        if size[least] >= MATERIAL:
            break
        rest = tuple(member for member in solution.members if member != least)
        posterior = solution.search.evidence.posterior(solution.search.prior(rest))
        solution = replace(
            solution, members=rest, fitted=posterior, gain=solution.search.gain(rest)
        )
    return solution


def refined(bench: Bench, solution: Solution, progress: Progress) -> Solution:
    """Refine what is not linear in every member, one after the other."""
    members = list(solution.members)
    for place, member in enumerate(members):
        progress("refining parameters", 0.65 + 0.1 * place / len(members))
        candidate = bench.candidates[member]
        if candidate.hypothesis is None:
            continue
        others = solution.search.prior([m for m in members if m != member])
        around = Setting(
            bench.observed,
            bench.columns,
            bench.nuisance.prior,
            others,
            bench.target,
            solution.noise,
            bench.split.fitted,
            bench.level,
        )
        best, laws = likeliest(bench, solution, member, around)
        bench.candidates[member] = candidate = replace(candidate, laws=laws)
        if best is not candidate.hypothesis:
            new = replaced(candidate, best, around)
            if new is not None:
                bench.candidates.append(new)
                members[place] = len(bench.candidates) - 1
    if members == list(solution.members):
        return solution
    return fitted(bench, tuple(members), solution.noise)


def settled(bench: Bench, solution: Solution, progress: Progress) -> Solution:
    """Prune and refine a set."""
    return pruned(bench, refined(bench, pruned(bench, solution), progress))


def settled_around(bench: Bench, solution: Solution, progress: Progress) -> tuple[Bench, Solution]:
    """Search again around a set, and settle the one that is found there.

    A gain acts on the friction that was found beside it, too, and an offset of an encoder on the
    load of a heavier link. Around the given simulation, what such a pair makes of one another looks
    like one effect more, or hides one.
    """
    bench, near = relinearised(bench, solution, progress)
    return bench, settled(bench, solve(bench, progress, near), progress)


def suspects(
    bench: Bench, solution: Solution, joints: Collection[int]
) -> set[tuple[str, tuple[int, ...]]]:
    """Return the effects at some joints (0-based) of which a fit has a value at its limit."""
    limits = solution.search.evidence.at_limit(solution.fitted)
    there = {
        item.place
        for item, limit in zip(bench.nuisance.parameters, limits, strict=True)
        if item.of_effect and not np.isnan(limit)
    }
    return {place for place in there if not place[1] or set(place[1]) & set(joints)}


def curved(bench: Bench, solution: Solution) -> bool:
    """Say whether a solution's simulation leaves clearly more or less than its linear fit says."""
    fit, index = solution.fitted, bench.nuisance.prior.index
    sensors = np.where(bench.nuisance.entered, 0.0, fit.mean[: index.size])
    linear = bench.left(fit) + bench.columns.apply(index, sensors)  # those are in no simulation
    improved = bench.observed.beside(improve(bench, solution))
    moving = bench.observed.moving
    off, rest = rmse(improved.residual - linear, moving), rmse(linear, moving)
    return bool((off > _CURVED * rest).any())


def relinearised(
    bench: Bench, solution: Solution, progress: Progress
) -> tuple[Bench, tuple[int, ...]]:
    """Lay everything out again, with columns around the simulation of a solution.

    They hold near it, so that a set without what it has would be judged wrongly: beside a friction
    that is in, the gain of a sensor looks as that friction does.

    Returns:
        The bench, and the members of the solution on it.
    """
    improved = improve(bench, solution)
    new = Bench.of(bench.observed.beside(bench.observed.simulation, around=improved), progress)
    new = new.as_stated(bench.nuisance.prior.deviation == 0)
    observed, mean = new.observed, solution.fitted.mean
    index = new.nuisance.prior.index
    torque = new.columns.apply(index, np.where(new.nuisance.entered, mean[: index.size], 0.0))
    members = tuple(new.again(bench.candidates[member], member) for member in solution.members)
    own = joined(*(new.candidates[member].prior for member in members)).index
    torque += new.columns.apply(own, mean[index.size :])
    left = observed.measured - observed.filter(observed.predicted)
    return replace(new, target=left + torque, first=bench.first or bench), members
