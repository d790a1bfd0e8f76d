"""A judged set: effects with their proof on motion held out, what they leave, and their names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    TINY,
    left_by_base,
    own_joints,
    surely_less,
)
from estimators.diagnosis.from_torque.fitting.linearised import polished
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution, fitted
from estimators.diagnosis.from_torque.judgement.judgement import (
    RemainingResidual,
    abstained,
    gains,
    harmed,
    least_harmful,
    remaining_residual,
    worse_at,
)
from estimators.diagnosis.from_torque.judgement.ordinary import beyond_siblings, to_identify
from estimators.diagnosis.from_torque.judgement.surrogate import swings
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings import ROUNDING
from estimators.diagnosis.settings.fitting import CONTRIBUTION

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class JudgedSet:
    """A set with its proof, what is left, and which of it is named."""

    solution: Solution
    beside: Observations  # the recordings, beside a simulation that was fitted to no row held out
    remaining: RemainingResidual
    named: tuple[int, ...]
    unknown: tuple[int, ...]  # joints, 0-based

    @classmethod
    def of(cls, solution: Solution) -> JudgedSet:
        """Prove and judge a set."""
        return cls.judge(solution, _fitted(solution))

    @classmethod
    def judge(cls, solution: Solution, beside: Observations) -> JudgedSet:
        """Judge a set beside a simulation that has it, fitted to no row held out."""
        problem = solution.problem
        # what sensors may add within their tolerances is in no simulation, and nothing unknown
        left = problem.without_sensors(beside.residual, solution.noise)
        remaining = remaining_residual(problem.observed, left)
        named, unknown = abstained(solution, remaining)
        if not gains(solution, beside.residual, remaining):
            # friction far beyond its siblings' is in what the gain is counted from, and as sure
            stay = {*to_identify(solution), *beyond_siblings(solution)}
            named = tuple(member for member in named if member in stay)
        return cls(solution, beside, remaining, named, unknown)

    @property
    def problem(self) -> RegressionProblem:
        """What the set is a solution of."""
        return self.solution.problem

    @property
    def proven(self) -> FloatArray:
        """Residual (K, n) of a simulation that was fitted to no row held out [N m]."""
        return self.beside.residual

    @cached_property
    def unexplained(self) -> frozenset[int]:
        """Joints (0-based) on which something unknown acts, or whose errors swing."""
        observed = self.problem.observed
        swinging = swings(self.proven, observed.moving, observed.segment)
        return frozenset((*self.unknown, *np.flatnonzero(swinging).tolist()))

    @property
    def findings(self) -> tuple[int, ...]:
        """Members that are findings: named, and no values that are just identified."""
        plain = to_identify(self.solution)
        return tuple(member for member in self.named if member not in plain)

    def places(self, members: Sequence[int]) -> set[tuple[str, tuple[int, ...]]]:
        """Return effect and joints (0-based) of some candidates."""
        return {self.problem.candidates[member].place for member in members}

    @property
    def improves_held_out(self) -> bool:
        """Say whether the arm is surely predicted better than given, and no joint clearly worse."""
        return self._surely_better and not self._harmed

    def or_better(self, other: JudgedSet) -> JudgedSet:
        """Return another set in place of this, where that predicts no joint clearly worse.

        Where this does not serve, and would be taken apart for that, the other just has to serve:
        a fit that follows one joint further than the arm allows is no measure of that joint.
        """
        if other.improves_held_out and not self.improves_held_out:
            return other
        worse = worse_at(other.problem, other.proven, self.proven, self.remaining)
        return self if worse else other

    def without_harmful_members(self) -> tuple[JudgedSet, bool]:
        """Return this without what makes motion held out worse.

        First what acts on the harmed joints alone, then bodies and then all values that moved
        inside their tolerances, then members one by one. A set that makes one joint somewhat worse
        and the arm surely better is the lesser harm where what is left then brings less than half
        as much.

        Returns:
            What is left, and whether that is nothing since all of it harms.
        """
        judged = self._spared
        tried: list[JudgedSet] = [self]
        problem, noise = judged.problem, judged.solution.noise
        if judged._harmed and problem.observed.simulation.tolerances.inertia:
            # a body that moved inside its tolerance acts on joints that it is not fitted for
            tried.append(judged)
            some = problem.with_stated_bodies()
            judged = JudgedSet.of(fitted(some, self.solution.members, noise))._spared
        if judged._harmed:
            # values moved inside their tolerances may be what harms: few rows outvote no statement
            tried.append(judged)
            problem = problem.with_stated_values()
            judged = JudgedSet.of(fitted(problem, self.solution.members, noise))
        exact = judged.problem is problem and problem is not self.problem
        while judged._harmed and judged.solution.members:
            tried.append(judged)
            fewer = least_harmful(judged.solution, judged.solution.members)
            judged = JudgedSet.of(fitted(problem, fewer, judged.solution.noise))
        some = [one for one in tried if one._is_sure]
        best = max(some, key=JudgedSet._gain, default=judged)
        moved = judged.solution.members or not exact
        # what harmed somewhere before and has no name has to bring more than chance does
        worth = judged is self or judged._is_sure or judged._gain() > CONTRIBUTION.material**2
        if moved and worth and not judged._harmed:
            return (judged if 2 * judged._gain() >= best._gain() else best), False
        if some:
            return best, False
        given, nothing = problem.observed, fitted(problem, (), judged.solution.noise)
        remaining = remaining_residual(given, given.residual)
        return JudgedSet(nothing, given, remaining, *abstained(nothing, remaining)), True

    def with_plain_friction(self, some: Collection[int]) -> JudgedSet:
        """Return this with plain friction for those of some members that joints have instead."""
        problem, members = self.problem, self.solution.members
        laws = [i for i in some if len(problem.less(members, (i,))) >= len(members)]
        if not laws:
            return self
        fewer = problem.less(members, laws)
        return JudgedSet.of(fitted(problem, fewer, self.solution.noise))

    def beyond_ordinary(self) -> JudgedSet:
        """Return this without what predicts motion held out worse than ordinary friction does.

        Where the simulation states no friction, the least that a diagnosis has to reach is not the
        given simulation, but one with Coulomb and viscous friction: a law that was chosen instead
        may fit better, and hold on nothing else. Members that act where it is worse go one by one,
        the least missed first; ordinary friction takes the place of laws that go.
        """
        problem, noise = self.problem, self.solution.noise
        first = problem.first or problem
        if not first.base or not self._worse_at(left_by_base(self.solution)):
            return self
        ordinary = JudgedSet.of(fitted(first, first.base, noise))
        judged, tried = self, [ordinary, self]
        while found := judged._worse_at(ordinary.proven):
            acting = judged._beyond_base(found)
            if not acting:
                return max(tried, key=JudgedSet._gain)
            fewer = least_harmful(judged.solution, acting)
            judged = JudgedSet.of(fitted(problem, fewer, noise))
            tried.append(judged)
        return judged

    @property
    def _spared(self) -> JudgedSet:
        """This, with all that acts on harmed joints alone as it is stated."""
        return self._stated_at(self._harmed) if self._harmed else self

    @property
    def _is_sure(self) -> bool:
        """Say whether names are in this, or the arm is surely better predicted without any."""
        return bool(self.named) or self._surely_better

    @cached_property
    def _surely_better(self) -> bool:
        """Say whether the arm's motion held out is surely predicted better than before."""
        return gains(self.solution, self.proven, self.remaining)

    def _worse_at(self, other: FloatArray) -> tuple[int, ...]:
        return worse_at(self.problem, self.proven, other, self.remaining)

    def _beyond_base(self, joints: Collection[int]) -> list[int]:
        """Return the members that act on some joints (0-based), and are no ordinary friction."""
        problem = self.problem
        base = {problem.candidates[i].place for i in problem.base}
        return [
            member
            for member in self.solution.members
            if problem.candidates[member].place not in base
            and {*own_joints(problem, member)} & {*joints}
        ]

    def to_the_end(self) -> Observations:
        """Return the recordings beside a simulation that was fitted to all rows.

        From the proven one on: rows that no law of the catalogue holds on (a joint that begins to
        move) may weigh more among all rows than among those of the proof, and a step has to make no
        joint's error larger.
        """
        observed, places = self.problem.observed, places_of(self.solution)
        start = self.beside.under(self.beside.simulation)
        return polished(start, observed.simulation, observed.moving, places)

    @cached_property
    def _harmed(self) -> tuple[int, ...]:
        """Joints (0-based) whose motion held out is predicted clearly worse than before.

        Where all of it is surely predicted worse, those at which it is worse at all.
        """
        problem, rows = self.problem, self.problem.split.held_out
        clearly = harmed(problem, self.proven, self.remaining)
        given, floor = problem.observed.residual, self.remaining.floor
        if clearly or not surely_less(given, self.proven, floor, problem.observed, rows):
            return clearly
        worse = rmse(self.proven, rows) > (1.0 + ROUNDING) * rmse(given, rows)
        return tuple(np.flatnonzero(worse).tolist())

    def _gain(self) -> float:
        """Return the parts of the squared errors on motion held out that are gone, summed up."""
        rows = self.problem.split.held_out
        given = np.maximum(rmse(self.problem.observed.residual, rows), TINY)
        return float(np.sum(1.0 - (rmse(self.proven, rows) / given) ** 2))

    def _stated_at(self, joints: Collection[int]) -> JudgedSet:
        """Return this with all that acts on some joints (0-based) alone as it is stated."""
        problem, solution = self.problem, self.solution

        def alone(acts_on: Sequence[int]) -> bool:
            return bool(acts_on) and {*acts_on} <= {*joints}

        def known(effect: Effect) -> bool:
            return alone([joint - 1 for joint in effect.joints])

        given, found = problem.observed.simulation, self.beside.simulation
        effects = (
            *filter(known, given.effects),
            *(effect for effect in found.effects if not known(effect)),
        )
        members = tuple(
            member for member in solution.members if not alone(own_joints(problem, member))
        )
        beside = problem.observed.under(replace(found, effects=effects), problem.observed.around)
        return JudgedSet.judge(solution.having(members), beside)


def places_of(solution: Solution) -> list[tuple[str, tuple[int, ...], bool]]:
    """Return effect, joints (1-based) and whether it was missing, of each member."""
    some = [solution.problem.candidates[member] for member in solution.members]
    everywhere = range(solution.problem.observed.n)
    return [
        (item.effect, tuple(j + 1 for j in item.joints or everywhere), item.kind == "missing")
        for item in some
    ]


def _fitted(solution: Solution) -> Observations:
    """Return the recordings with a simulation that was fitted to no row held out."""
    problem = solution.problem
    start, given = problem.under(solution), problem.observed.simulation
    return polished(start, given, problem.split.fitted, places_of(solution))
