"""The pipeline: from recordings and a simulation to a diagnosis, one stage after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from estimators.diagnosis.base_friction import base_of, with_friction
from estimators.diagnosis.candidates import Candidate, candidates_of, entered
from estimators.diagnosis.columns import Columns, Products
from estimators.diagnosis.conclusion import conclude, explanations_of, shifts_of
from estimators.diagnosis.contact import contact_of
from estimators.diagnosis.diagnosis import Diagnosis, Traces
from estimators.diagnosis.evidence import Evidence, Posterior, Prior, joined
from estimators.diagnosis.improvement import Improvement
from estimators.diagnosis.intervals import with_parameters
from estimators.diagnosis.judgement import MATERIAL, abstained, harms, leftover, material, remarks
from estimators.diagnosis.laws import likeliest
from estimators.diagnosis.linearised import polished
from estimators.diagnosis.noise import Noise, roughness
from estimators.diagnosis.nuisance import Nuisance, nuisance_of
from estimators.diagnosis.observations import Observations
from estimators.diagnosis.plausibility import check_plausible
from estimators.diagnosis.proof import Split, rmse
from estimators.diagnosis.pushes import covered, pushes
from estimators.diagnosis.refinement import Setting, replaced
from estimators.diagnosis.scans import ripples
from estimators.diagnosis.search import Search
from estimators.diagnosis.shares import left_by_tolerances
from estimators.diagnosis.tree import tests_of
from limo_driver.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray

Progress: TypeAlias = Callable[[str, float], None]

BEYOND_DOUBT = 100.0  # [nat] for a push, which is an event and cannot be proven on other rows
_ROUNDS = 3  # of noise and search in turn
_CURVED = 0.4  # of the rest, by which a simulation may be off its linear fit


def quiet(_stage: str, _done: float) -> None:
    """Report no progress."""


@dataclass
class Bench:
    """What the stages share: observations, columns and who competes."""

    observed: Observations
    columns: Columns
    nuisance: Nuisance
    candidates: list[Candidate]
    split: Split
    target: FloatArray  # (K, n) what the columns have to sum up to [N m]
    level: FloatArray  # (n,) plausible RMS of a missing torque [N m]
    base: tuple[int, ...]  # candidates that the search starts with

    @classmethod
    def of(cls, observed: Observations, progress: Progress) -> Bench:
        """Lay out everything that could explain the residual."""
        progress("columns of what is known within tolerances", 0.1)
        if observed.around is None:
            observed = with_friction(observed)
        residual = observed.residual
        split = Split.of(observed)
        columns = Columns(*residual.shape)
        rough = roughness(residual, observed.moving)
        nuisance = nuisance_of(observed, columns, rough)
        progress("columns of every effect at every place", 0.2)
        level = np.maximum(rmse(residual, observed.moving), 3 * rough)
        candidates = candidates_of(observed, columns, level)
        base = base_of(candidates, observed.simulation)
        return cls(observed, columns, nuisance, candidates, split, residual, level, base)

    def left(self, fitted: Posterior) -> FloatArray:
        """Return what a fit leaves, (K, n) [N m]."""
        return self.target - self.columns.apply(fitted.index, fitted.mean)

    def again(self, candidate: Candidate, place: int) -> int:
        """Enter a candidate that has a place on another bench; return its place on this one."""
        if candidate.hypothesis is None:
            return place  # of the given simulation: the same on every bench
        own = entered(candidate.hypothesis, self.observed, self.columns, self.level)
        if own is None:
            raise AssertionError("what was found acts on the torque")
        self.candidates.append(replace(own, variants=candidate.variants))
        return len(self.candidates) - 1

    def beyond_base(self, members: tuple[int, ...]) -> int:
        """Count the members of a set that the search did not start with."""
        base = {self.candidates[i].place for i in self.base}
        return sum(self.candidates[i].place not in base for i in members)


@dataclass(frozen=True)
class Solution:
    """The chosen set and its fit."""

    members: tuple[int, ...]
    search: Search
    noise: Noise
    fitted: Posterior
    gain: float


def solve(bench: Bench, progress: Progress, near: tuple[int, ...] | None = None) -> Solution:
    """Find the set of effects, or the best one near a set; noise and set in turn until both stay.

    The first noise is what a fit of everything at once leaves. Taken from a residual that still
    has an effect in it, the noise would explain that effect, and hide it.
    """
    noise = _noise_of_everything(bench)
    solution = fitted(bench, bench.base, noise)
    if _scanned(bench, solution):
        solution = fitted(bench, bench.base, noise)
    for turn in range(_ROUNDS):
        progress("comparing explanations", 0.3 + 0.1 * turn)
        search = _search(bench, noise)
        found = search.best() if near is None else search.around(near)
        same = turn > 0 and set(found.members) == set(solution.members)
        posterior = search.evidence.posterior(search.prior(found.members))
        solution = Solution(found.members, search, noise, posterior, found.gain)
        if same:
            break
        if turn == 0:
            _scanned(bench, solution)  # of what the largest effects hid
        noise = Noise.of(bench.left(posterior), bench.split.fitted, bench.observed.segment)
    return solution


def _scanned(bench: Bench, solution: Solution) -> bool:
    """Add the candidates that have to be looked for in the residual; say whether there are any."""
    before = len(bench.candidates)
    for hypothesis in ripples(bench.observed, bench.left(solution.fitted)):
        candidate = entered(hypothesis, bench.observed, bench.columns, bench.level)
        if candidate is not None:
            bench.candidates.append(candidate)
    return len(bench.candidates) > before


def _noise_of_everything(bench: Bench) -> Noise:
    white = Noise.independent(roughness(bench.target, bench.observed.moving), bench.split.fitted)
    evidence = _search(bench, white).evidence
    everything = joined(*(candidate.prior for candidate in bench.candidates))
    free = Prior.free(everything.index, everything.deviation)
    left = bench.left(evidence.posterior(free))
    return Noise.of(left, bench.split.fitted, bench.observed.segment)


def fitted(
    bench: Bench, members: tuple[int, ...], noise: Noise, *, everything: bool = False
) -> Solution:
    """Fit a given set under given noise, to the rows meant for it or to all."""
    search = _search(bench, noise, everything=everything)
    posterior = search.evidence.posterior(search.prior(members))
    return Solution(members, search, noise, posterior, search.gain(members))


def _search(bench: Bench, noise: Noise, *, everything: bool = False) -> Search:
    rows = bench.observed.moving if everything else bench.split.fitted
    products = Products.of(bench.columns, bench.target, noise, rows)
    return Search(bench.candidates, Evidence(products, bench.nuisance.prior), bench.base)


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


def settled(bench: Bench, solution: Solution, progress: Progress) -> tuple[Bench, Solution]:
    """Prune and refine a set, and search again around it where the torque is not linear up to it.

    A gain acts on the friction that was found beside it, too, and an offset of an encoder on the
    load of a heavier link. Around the given simulation, what such a pair makes of one another looks
    like one effect more, or hides one.
    """
    solution = pruned(bench, refined(bench, pruned(bench, solution), progress))
    if len(solution.members) > 1 and _curved(bench, solution):
        bench, near = relinearised(bench, solution, progress)
        solution = solve(bench, progress, near)
        solution = pruned(bench, refined(bench, pruned(bench, solution), progress))
    return bench, solution


def _curved(bench: Bench, solution: Solution) -> bool:
    """Say whether a solution's simulation leaves clearly more or less than its linear fit says."""
    observed, fit = bench.observed, solution.fitted
    index = bench.nuisance.prior.index
    sensors = np.where(bench.nuisance.entered, 0.0, fit.mean[: index.size])
    linear = bench.left(fit) + bench.columns.apply(index, sensors)  # those are in no simulation
    left = observed.measured - observed.filter(observed.predict(improve(bench, solution)))
    off = rmse(left - linear, observed.moving) / rmse(linear, observed.moving)
    return bool(off.max() > _CURVED)


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
    new = Bench.of(replace(bench.observed, around=improved), progress)
    observed, mean = new.observed, solution.fitted.mean
    index = new.nuisance.prior.index
    torque = new.columns.apply(index, np.where(new.nuisance.entered, mean[: index.size], 0.0))
    members = tuple(new.again(bench.candidates[member], member) for member in solution.members)
    own = joined(*(new.candidates[member].prior for member in members)).index
    torque += new.columns.apply(own, mean[index.size :])
    left = observed.measured - observed.filter(observed.predict(improved))
    return replace(new, target=left + torque), members


def improve(bench: Bench, solution: Solution) -> Simulation:
    """Write nuisance shifts and findings into the simulation."""
    improvement = Improvement(bench.observed.simulation)
    count = bench.nuisance.prior.index.size
    bench.nuisance.enter(improvement, solution.fitted.mean[:count])
    at = count
    for i in solution.members:
        candidate = bench.candidates[i]
        size = candidate.prior.index.size
        try:
            candidate.enter(improvement, solution.fitted.mean[at : at + size])
        except ConfigError as error:  # a value that no such part has
            raise RecordingError(
                f"the best explanation is out of range: {error}; is it another robot, or are the "
                "torques of another motion?"
            ) from None
        at += size
    return improvement.simulation()


def _found(bench: Bench, solution: Solution) -> list[tuple[str, tuple[int, ...], bool]]:
    """Return effect, joints (1-based) and whether it was missing, of each member."""
    some = [bench.candidates[member] for member in solution.members]
    everywhere = range(bench.observed.n)
    return [
        (item.effect, tuple(j + 1 for j in item.joints or everywhere), item.kind == "missing")
        for item in some
    ]


def _proven(bench: Bench, solution: Solution) -> FloatArray:
    """Return the residual (K, n) of a simulation that was fitted to no row held out [N m]."""
    observed = bench.observed
    trial = polished(
        observed, improve(bench, solution), bench.split.fitted, _found(bench, solution)
    )
    return observed.measured - observed.filter(observed.predict(trial))


def observe(
    simulation: Simulation, recordings: Sequence[Recording], bandwidth: float
) -> Observations:
    """Check that the recordings can be of the simulation's robot, and filter them."""
    for recording in recordings:
        recording.check_robot(simulation.model)
    observed = Observations.of(simulation, recordings, bandwidth)
    check_plausible(observed)
    return observed


def diagnose(
    simulation: Simulation,
    recordings: Sequence[Recording],
    bandwidth: float = 10.0,
    progress: Progress = quiet,
) -> Diagnosis:
    """Say where a simulation and recordings differ, and what physics was left out.

    Args:
        simulation: What is believed of the arm, with its tolerances.
        recordings: One or more of that arm.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].
        progress: Told the stage and the part that is done.

    Raises:
        RecordingError: The recordings cannot be used, or are of another robot.
    """
    progress("reading motion", 0.0)
    observed = observe(simulation, recordings, bandwidth)
    bench = Bench.of(observed, progress)
    solution = solve(bench, progress)
    # Before the effects are out, they would look like pushes themselves.
    found = pushes(observed, bench.left(solution.fitted), solution.noise)
    pushed = tuple(push for push in found if push.evidence > BEYOND_DOUBT)
    if pushed:  # events: nothing is fitted to the rows that they cover
        observed = replace(observed, disturbed=covered(observed, pushed))
        bench = Bench.of(observed, progress)
        solution = solve(bench, progress)
    bench, solution = settled(bench, solution, progress)
    progress("proving on held-out motion", 0.8)
    proven = _proven(bench, solution)
    progress("looking for what is left", 0.9)
    rest = leftover(observed, proven)
    named, unknown = abstained(bench, solution, rest)
    if named != solution.members and harms(bench, proven, rest):
        solution = fitted(bench, named, solution.noise)  # without what only stands in
        proven = _proven(bench, solution)
        rest = leftover(observed, proven)
    harmful = harms(bench, proven, rest)
    if harmful:
        solution, proven, named = fitted(bench, (), solution.noise), observed.residual, ()
        rest = leftover(observed, proven)
        _, unknown = abstained(bench, solution, rest)
    progress("fitting to all rows", 0.95)
    final = fitted(bench, solution.members, solution.noise, everything=True)
    improved = simulation
    if not harmful:
        improved = polished(observed, improve(bench, final), observed.moving, _found(bench, final))
    after = observed.filter(observed.predict(improved))
    strange = len(unknown) > observed.n / 3  # where much is unknown, a push is a poor guess
    contact = contact_of(pushed, observed, proven, rest) if pushed and not strange else ()
    verdict = conclude(bench, solution, rest, named, unknown, proven, contact)
    shifts = shifts_of(bench, final)
    said = remarks(
        shifts,
        members=bench.beyond_base(solution.members),
        harmful=harmful,
        doubted=len(pushed) if strange else 0,
    )
    verdict = replace(
        verdict,
        findings=with_parameters(
            verdict.findings, replace(observed, simulation=improved, around=None)
        ),
        notes=(*verdict.notes, *said),
    )
    progress("done", 1.0)
    return Diagnosis(
        verdict=verdict,
        before=simulation,
        after=improved,
        recordings=tuple(recordings),
        traces=_traces(bench, solution, after),
        explanations=explanations_of(bench, solution, rest.floor),
        tests=tests_of(bench, solution),
        shifts=shifts,
        bandwidth=bandwidth,
    )


def _traces(bench: Bench, solution: Solution, after: FloatArray) -> Traces:
    observed = bench.observed
    slow, kept = observed.slow, observed.kept
    return Traces(
        time=slow.time,
        recording=observed.recording,
        position=slow.position,
        velocity=slow.velocity,
        load=observed.load[kept],
        since_reversal=observed.since_reversal[kept],
        measured=observed.measured,
        before=observed.simulated,
        tolerances=observed.measured - left_by_tolerances(bench, solution),
        after=after,
        held_out=np.asarray(bench.split.held_out.any(axis=1)),
        moving=replace(observed, disturbed=None).moving,
    )
