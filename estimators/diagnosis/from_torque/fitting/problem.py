"""RegressionProblem: data and columns that the stages of a diagnosis share, and its solution."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.bodies import (
    Rotation,
    lost_by_bodies,
    with_possible_bodies,
)
from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate, candidates_of, entered
from estimators.diagnosis.from_torque.hypotheses.nuisance import (
    Nuisance,
    nuisance_of,
    without_sensors,
)
from estimators.diagnosis.from_torque.hypotheses.responses import Improvement
from estimators.diagnosis.from_torque.hypotheses.search import (
    Search,
    base_of,
    is_friction,
    level_of,
    with_friction,
)
from estimators.diagnosis.from_torque.residuals.noise import (
    ColumnTable,
    Noise,
    normal_equations,
    roughness,
)
from estimators.diagnosis.held_out import Split, rmse
from estimators.diagnosis.settings import LITTLE, TINY
from estimators.regression.evidence import Evidence, Posterior, Prior
from limo_driver.errors import ConfigError
from limo_driver.physics import Tolerances

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.stages import Progress
    from estimators.regression.evidence import NormalEquations
    from limo_driver.physics import Simulation
    from limo_driver.types import BoolArray, FloatArray


@dataclass
class RegressionProblem:
    """Regression problem that the stages share: observations, columns and candidates."""

    observed: Observations
    columns: ColumnTable
    nuisance: Nuisance
    candidates: list[Candidate]
    split: Split
    target: FloatArray  # (K, n) what the columns have to sum up to [N m]
    level: FloatArray  # (n,) plausible RMS of a missing torque [N m]
    base: tuple[int, ...]  # candidates that the search starts with
    held: FloatArray | None = None  # coefficients of the nuisance that stay at a limit, NaN else
    first: RegressionProblem | None = (
        None  # around the given simulation and tolerances, where this one is not
    )
    _sums: list[tuple[Noise, NormalEquations]] = field(default_factory=list, init=False)
    _rotations: list[Rotation] = field(default_factory=list, init=False)
    _beside: list[tuple[Solution, Observations]] = field(default_factory=list, init=False)

    @classmethod
    def of(cls, observed: Observations, progress: Progress) -> RegressionProblem:
        """Lay out everything that could explain the residual."""
        progress("columns of what is known within tolerances", 0.1)
        if observed.around is None:
            observed = with_friction(observed)
        residual = observed.residual
        split = Split.of(observed)
        columns = ColumnTable(*residual.shape)
        rough = roughness(residual, observed.moving, observed.least_noise)
        nuisance = nuisance_of(observed, columns, rough)
        progress("columns of every effect at every place", 0.2)
        level = level_of(observed, rough)
        candidates = candidates_of(observed, columns, level)
        base = base_of(candidates, observed.simulation)
        return cls(observed, columns, nuisance, candidates, split, residual, level, base)

    def left(self, fitted: Posterior) -> FloatArray:
        """Return the residual of a fit, (K, n) [N m]."""
        return self.target - self.columns.apply(fitted.index, fitted.mean)

    def left_without_sensors(self, fitted: Posterior) -> FloatArray:
        """Return what a fit leaves that its simulation has: nothing of what sensors add, (K, n)."""
        return self.left(fitted) + self.sensed(fitted)

    def sensed(self, fitted: Posterior) -> FloatArray:
        """Return what a fit ascribes to lags and offsets of sensors, (K, n) [N m].

        They are within their tolerances, and in no simulation.
        """
        index = self.nuisance.prior.index
        own = np.where(self.nuisance.entered, 0.0, fitted.mean[: index.size])
        return self.columns.apply(index, own)

    def without_sensors(self, left: FloatArray, noise: Noise) -> FloatArray:
        """Take out of a residual (K, n) what lags and offsets of sensors explain of it [N m].

        Fitted to the residual itself, within their tolerances and to no row held out: beside
        another simulation than the one that a solution was linear around, they are others.
        """
        return without_sensors(left, noise, self.split.fitted, self.columns, self.nuisance)

    def inflation(self, fitted: Posterior, noise: Noise) -> FloatArray:
        """Return how much larger errors are than what a fit leaves of them, (n,).

        A fit of as many coefficients as rows leaves next to nothing, whatever the errors. What it
        leaves of the mean square of K errors is (K - dof) / K, with the trace of the matrix that
        takes errors to their fit as its degrees of freedom.

        Args:
            fitted: The coefficients and their covariance.
            noise: Under which they were fitted to the rows meant for it.

        Source: Hastie, Tibshirani and Friedman, "The Elements of Statistical Learning", 2009, 7.6.
        """
        place = np.full(self.columns.count, -1)
        place[fitted.index[::-1]] = np.arange(fitted.index.size)[::-1]
        factor = np.ones(self.columns.joints)
        for joint in range(self.columns.joints):
            values, at = self.columns.of_joint(joint)
            used, rows = place[at] >= 0, self.split.fitted[:, joint]
            own = place[at[used]]
            A = noise.whiten(values[:, used], joint, rows)
            freedom = float(np.sum((A @ fitted.covariance[np.ix_(own, own)]) * A))
            left = 1.0 - freedom / max(len(A), 1)
            factor[joint] = 1.0 / np.sqrt(max(left, LITTLE))
        return factor

    def torques(self, fitted: Posterior, prior: Prior) -> FloatArray:
        """Return products (m, m) of the torques of fitted coefficients, beside their prior.

        In squares of the error that the fit leaves at each joint, on all rows: where motion is
        slow, an error that hardly changes costs next to nothing under the noise of a fit.
        """
        left = np.maximum(rmse(self.left(fitted), self.observed.moving), TINY)
        columns = self.columns.only(fitted.index)
        total = np.diag(np.maximum(prior.deviation, TINY) ** -2.0)
        for joint in range(columns.joints):
            values, at = columns.of_joint(joint)
            A = values[self.split.fitted[:, joint]] / left[joint]
            total[np.ix_(at, at)] += A.T @ A
        return total

    def products(self, noise: Noise) -> NormalEquations:
        """Return sums over the rows meant for fits; what was summed last is kept."""
        of, known = self._sums[0] if self._sums else (noise, None)
        known = normal_equations(
            self.columns, self.target, noise, self.split.fitted, known if of is noise else None
        )
        self._sums[:] = [(noise, known)]
        return known

    def rotation(self, noise: Noise, members: Sequence[int]) -> Rotation:
        """Return fits with each block held out in turn; of sets of these members, or fewer.

        What was summed last is kept.
        """
        some = [self.candidates[i].prior.index for i in {*members, *self.base}]
        index = np.concatenate([np.zeros(0, dtype=np.int64), *some])
        if not (self._rotations and self._rotations[0].has(noise, index)):
            nuisance = self.nuisance.prior
            self._rotations[:] = [
                Rotation.of(self.observed, self.columns, self.target, noise, nuisance, index)
            ]
        return self._rotations[0]

    def under(self, solution: Solution) -> Observations:
        """Return the recordings beside the simulation of a fit; those of the last fit are kept.

        A set that stays is asked about by whoever prunes, judges or searches around it.
        """
        if not (self._beside and self._beside[0][0] is solution):
            self._beside[:] = [(solution, self.observed.under(improve(solution)))]
        return self._beside[0][1]

    def holding(self, limits: FloatArray | None) -> RegressionProblem:
        """Return the same, where some coefficients of the nuisance stay at a limit, NaN else."""
        return self._on_the_same_sums(replace(self, held=limits))

    def with_candidates(self, candidates: Sequence[Candidate]) -> RegressionProblem:
        """Return the same with candidates whose columns are all in its table."""
        return self._on_the_same_sums(replace(self, candidates=list(candidates)))

    def _on_the_same_sums(self, other: RegressionProblem) -> RegressionProblem:
        """Let a problem of the same columns and rows have the sums that are known of them."""
        other._sums, other._rotations = self._sums, self._rotations  # of one of this class
        return other

    def without_places(self, places: Collection[tuple[str, tuple[int, ...]]]) -> RegressionProblem:
        """Return the same, where no set has some effects at some joints (0-based)."""
        fewer = [
            replace(item, prior_penalty=np.inf) if item.place in places else item
            for item in self.candidates
        ]
        return self.with_candidates(fewer)

    def undisturbed(self, rows: BoolArray) -> RegressionProblem:
        """Return the same, where something pushed on some rows (K,): those count no more."""
        observed = self.observed.undisturbed(rows)
        return replace(self, observed=observed, split=Split.of(observed), held=None)

    def as_stated(self, some: BoolArray) -> RegressionProblem:
        """Return the same, with some of the nuisance's coefficients (c,) exactly as stated."""
        nuisance, candidates = self.nuisance.certain(some), list(self.candidates)
        first = self.first or self
        return replace(self, nuisance=nuisance, candidates=candidates, first=first, held=None)

    def with_stated_values(self) -> RegressionProblem:
        """Return the same, with bodies and effects of the simulation exactly as it states them."""
        return self._exactly(Tolerances(inertia=0.0, friction=0.0), self.nuisance.entered)

    def with_stated_bodies(self) -> RegressionProblem:
        """Return the same, with bodies exactly as stated; effects may move within tolerances."""
        tolerances = replace(self.observed.simulation.tolerances, inertia=0.0)
        of_effect = np.array([item.of_effect for item in self.nuisance.parameters], dtype=bool)
        return self._exactly(tolerances, self.nuisance.entered & ~of_effect)

    def _exactly(self, tolerances: Tolerances, some: BoolArray) -> RegressionProblem:
        """Return the same under other tolerances, with some coefficients (c,) as stated."""
        observed = self.observed
        exact = replace(observed.simulation, tolerances=tolerances)
        beside = observed.under(exact, observed.around)
        return replace(self.as_stated(some), observed=beside)

    def again(self, candidate: Candidate, place: int) -> int:
        """Enter a candidate that has a place on another problem; return its place on this one."""
        if candidate.hypothesis is None:
            return place  # of the given simulation: the same on every problem
        own = entered(candidate.hypothesis, self.observed, self.columns, self.level)
        if own is None:
            raise AssertionError("what was found acts on the torque")
        own = replace(own, variants=candidate.variants, prior_penalty=candidate.prior_penalty)
        self.candidates.append(own)
        return len(self.candidates) - 1

    def less(self, members: tuple[int, ...], some: Collection[int]) -> tuple[int, ...]:
        """Return a set without some of its members.

        Where a joint of unknown friction loses another law of it, it has plain friction again: no
        joint is without, and what a law is worth is what it does better than that.
        """
        kept = tuple(member for member in members if member not in some)
        base = {self.candidates[i].place for i in self.base}
        gone = [self.candidates[member] for member in some]
        joints = {
            item.joints for item in gone if item.place not in base and is_friction(item.effect)
        }
        taken = {self.candidates[member].slot for member in kept}
        plain = (i for i in self.base if self.candidates[i].joints in joints)
        return (*kept, *(i for i in plain if self.candidates[i].slot not in taken))

    def beyond_base(self, members: tuple[int, ...]) -> int:
        """Count the members of a set that the search did not start with."""
        base = {self.candidates[i].place for i in self.base}
        return sum(self.candidates[i].place not in base for i in members)


@dataclass(frozen=True)
class Solution:
    """The chosen set and its fit."""

    problem: RegressionProblem
    members: tuple[int, ...]
    search: Search
    noise: Noise
    fitted: Posterior
    gain: float

    def having(self, members: tuple[int, ...]) -> Solution:
        """Return other members of the same search, fitted under the same noise."""
        posterior = self.search.evidence.posterior(self.search.prior(members))
        return replace(self, members=members, fitted=posterior, gain=self.search.gain(members))


def fitted(problem: RegressionProblem, members: tuple[int, ...], noise: Noise) -> Solution:
    """Fit a given set under given noise, to the rows meant for it."""
    search = search_on(problem, noise)
    posterior = search.evidence.posterior(search.prior(members))
    return Solution(problem, members, search, noise, posterior, search.gain(members))


def search_on(problem: RegressionProblem, noise: Noise) -> Search:
    """Return the search under given noise, on the rows meant for fits."""
    products = problem.products(noise)
    evidence = Evidence(products, problem.nuisance.prior, problem.held)
    return Search(problem.candidates, evidence, problem.base)


def improve(solution: Solution) -> Simulation:
    """Write nuisance shifts and findings into the simulation, but for `impossible` members."""
    return _apply_members(solution)[0]


def simulated(solution: Solution) -> FloatArray:
    """Return what the simulation of a fit leaves, (K, n) [N m]."""
    return solution.problem.under(solution).residual


def lost_by(solution: Solution) -> dict[int, float]:
    """Return what members lose of the evidence where their bodies are ones that can be [nat]."""
    observed, search = solution.problem.observed, solution.search
    members = [solution.problem.candidates[member] for member in solution.members]
    found = search.evidence.coefficients(search.prior(solution.members))
    lost = lost_by_bodies(observed.simulation.model, observed.extents, members, found)
    return {solution.members[place]: nats for place, nats in lost.items()}


def impossible(solution: Solution) -> tuple[int, ...]:
    """Return the members whose fitted values no such effect can have, as a gain below -1."""
    return _apply_members(solution)[1]


def _apply_members(solution: Solution) -> tuple[Simulation, tuple[int, ...]]:
    problem = solution.problem
    observed = problem.observed
    improvement = Improvement(observed.simulation, observed.extents)
    members = [problem.candidates[member] for member in solution.members]
    mean = with_possible_bodies(
        observed.simulation.model,
        observed.extents,
        members,
        problem.nuisance.prior,
        solution.fitted,
        lambda prior: problem.torques(solution.fitted, prior),
    )
    at = problem.nuisance.prior.index.size
    problem.nuisance.enter(improvement, mean[:at])
    refused: list[int] = []
    for i, candidate in zip(solution.members, members, strict=True):
        size = candidate.prior.index.size
        try:
            candidate.enter(improvement, mean[at : at + size])
        except ConfigError:
            refused.append(i)
        at += size
    return improvement.simulation(), tuple(refused)
