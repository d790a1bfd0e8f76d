"""Lateness: a lag or a delay of all that the torque of a joint is made of.

Torque is linear in how late it comes only while that is short beside what changes. The ripple of a
turning joint comes at another phase each way; what fits both best is too small, and seems to have
friction beside it that is not there. So every column of a joint is laid later, by some times, and
the set is taken up again around the lateness with which it explains most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.fitting.problem import fitted
from estimators.diagnosis.selection.candidates import entered
from estimators.diagnosis.settings.fitting import LATENESS
from estimators.diagnosis.settings.selection import CANDIDATES
from limo_driver.physics import TimeDelay
from limo_driver.physics.effects.delay import DELAYED, LAGGING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from estimators.diagnosis.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.selection.candidates import Candidate
    from limo_driver.physics import Hypothesis
    from limo_driver.types import FloatArray

_LAWS: Final = {"lag": LAGGING, "delay": DELAYED}  # of the parameter


def long_after(joints: int) -> Iterator[Hypothesis]:
    """Yield a lag and a delay at each of some joints, by which torque is not linear any more.

    They compete, but explain nothing of the noise: where rows are few, two columns more a joint
    make it seem smaller, and then chance has names.
    """
    for joint in range(1, joints + 1):
        for name, law in _LAWS.items():
            yield TimeDelay.of_time(joint, name, law, LATENESS.long)


def has_long(candidate: Candidate) -> bool:
    """Say whether a candidate is one of those."""
    hypothesis = candidate.hypothesis
    return (
        hypothesis is not None
        and hypothesis.effect == TimeDelay.name
        and hypothesis.settings == (LATENESS.long,)
    )


def made_late(
    problem: RegressionProblem, solution: Solution
) -> tuple[RegressionProblem, Solution] | None:
    """Return a set with the lag or delay in it that brings most, to be taken up again around it.

    Args:
        problem: What the set was found on.
        solution: A set without that lateness.

    Returns:
        The problem with that candidate, and the set; None where no lateness brings enough.
    """
    late = {
        joint
        for member in solution.members
        if problem.candidates[member].effect == TimeDelay.name
        for joint in problem.candidates[member].joints
    }
    found = [
        _latest(_OneJoint.of(problem, solution, joint))
        for joint in range(problem.observed.n)
        if joint not in late
    ]
    best = max((item for item in found if item is not None), key=lambda x: x.gain, default=None)
    if best is None or best.gain < CANDIDATES.missing + np.log(
        len(found) * 2 * len(LATENESS.times)
    ):
        return None
    hypothesis = TimeDelay.of_time(best.joint + 1, best.name, _LAWS[best.name], best.time)
    candidate = entered(hypothesis, problem.observed, problem.columns, problem.level)
    if candidate is None:
        return None
    problem = problem.with_candidates([*problem.candidates, candidate])
    whole = fitted(problem, (*solution.members, len(problem.candidates) - 1), solution.noise)
    mean = np.append(solution.fitted.mean, 1.0)
    mean[best.changed] = best.coefficients
    return problem, replace(whole, fitted=replace(whole.fitted, mean=mean))


@dataclass(frozen=True)
class _Late:
    """How late one joint's torque is taken to be."""

    joint: int  # 0-based
    name: str  # parameter of `TimeDelay`
    time: float  # [s]
    gain: float  # in log evidence over torque in time [nat]
    changed: list[int]  # coefficients of the set's fit that are others then
    coefficients: FloatArray


@dataclass(frozen=True)
class _OneJoint:
    """The fit of one joint alone, whose columns can be laid later."""

    joint: int
    time: FloatArray  # (K,) [s]
    segments: list[slice]
    columns: FloatArray  # (K, c), times their prior deviation
    deviation: FloatArray  # (c,)
    place: list[int]  # of each column in the coefficients of the set, (c,)
    own: list[int]  # columns of members that act on this joint alone
    simulated: FloatArray  # (K,) [N m]
    measured: FloatArray  # (K,) [N m]
    whiten: Callable[[FloatArray], FloatArray]  # (K, ...) -> rows that are fitted

    @classmethod
    def of(cls, problem: RegressionProblem, solution: Solution, joint: int) -> _OneJoint:
        members = [problem.candidates[member] for member in solution.members]
        priors = [problem.nuisance.prior, *(item.prior for item in members)]
        index = np.concatenate([prior.index for prior in priors])
        deviation = np.concatenate([prior.deviation for prior in priors])
        alone = np.concatenate(
            [
                np.zeros(priors[0].index.size, dtype=bool),
                *(np.full(item.prior.index.size, item.joints == (joint,)) for item in members),
            ]
        )
        values, at = problem.columns.of_joint(joint)
        column = {int(k): c for c, k in enumerate(at)}
        place = [i for i, k in enumerate(index) if int(k) in column and deviation[i] > 0]
        rows = problem.split.fitted[:, joint]
        measured = problem.observed.measured[:, joint]
        return cls(
            joint,
            problem.observed.slow.time,
            problem.observed.stretches,
            values[:, [column[int(index[i])] for i in place]] * deviation[place],
            deviation[place],
            place,
            [c for c, i in enumerate(place) if alone[i]],
            measured - problem.target[:, joint],
            measured,
            lambda values: solution.noise.whiten(values, joint, rows),
        )

    def fit(self, name: str, time: float) -> tuple[float, FloatArray]:
        """Return log evidence [nat] and coefficients (c,) with everything so much later."""
        both = np.column_stack([self.columns, self.simulated])
        if time > 0.0:
            both = np.concatenate(
                [self._later(both[rows], rows, name, time) for rows in self.segments]
            )
        A, y = self.whiten(both[:, :-1]), self.whiten(self.measured - both[:, -1])
        precision = A.T @ A + np.eye(A.shape[1])
        root = np.linalg.cholesky(precision)
        part = np.linalg.solve(root, A.T @ y)
        evidence = 0.5 * float(part @ part - y @ y) - float(np.log(np.diag(root)).sum())
        return evidence, np.linalg.solve(root.T, part) * self.deviation

    def _later(self, values: FloatArray, rows: slice, name: str, time: float) -> FloatArray:
        return TimeDelay(joint=self.joint + 1, **{name: time}).late(self.time[rows], values)


def _latest(alone: _OneJoint) -> _Late | None:
    """Return how late the torque of a joint is taken to be, if later is better at all."""
    if not alone.own:
        return None
    in_time, _ = alone.fit("lag", 0.0)
    best: _Late | None = None
    for name in _LAWS:
        for k, time in enumerate(LATENESS.times):
            evidence, coefficients = alone.fit(name, time)
            gain = evidence - in_time
            if k == LATENESS.asked and (best is None or best.name != name):
                break  # what does not begin to help is not there
            if gain > (0.0 if best is None else best.gain):
                changed = [alone.place[c] for c in alone.own]
                best = _Late(alone.joint, name, time, gain, changed, coefficients[alone.own])
    return best
