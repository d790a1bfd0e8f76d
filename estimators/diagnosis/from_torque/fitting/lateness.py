"""Lateness: a lag or a delay of all that the torque of a joint is made of.

Torque is linear in how late it comes only while that is short beside what changes. The ripple of a
turning joint comes at another phase each way; what fits both best is too small, and seems to have
friction beside it that is not there. So every column of a joint is laid later, by some times, and
the set is taken up again around the lateness with which it explains most. A joint that is late in
the set already is asked again, without that: of a delay longer than half a period of its motion,
a lag is what a fit comes to from the start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_torque.fitting.problem import Solution, fitted
from estimators.diagnosis.from_torque.hypotheses.candidates import entered
from estimators.diagnosis.from_torque.hypotheses.catalogue import found_in
from estimators.diagnosis.settings.fitting import CANDIDATES, LATENESS
from estimators.regression.definite import inverse_root
from limo_driver.physics import TimeDelay
from limo_driver.physics.effects.delay import DELAYED, LAGGING
from limo_driver.types import FloatArray

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from limo_driver.physics import Hypothesis

TIMES: Final = (  # [s], that are tried: doubled to a step, and by steps from there
    *(LATENESS.shortest * 2.0 ** np.arange(np.log2(LATENESS.step / LATENESS.shortest))).tolist(),
    *np.arange(LATENESS.step, LATENESS.longest + LATENESS.step / 2, LATENESS.step).tolist(),
)
_LAWS: Final = {"lag": LAGGING, "delay": DELAYED}  # of the parameter
_IN_TIME: Final = TimeDelay(joint=1)


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


def with_torque_delay(solution: Solution, unknown: Collection[int]) -> Solution | None:
    """Return a set with the lag or delay in it that brings most, to be taken up again around it.

    Args:
        solution: A set without that lateness, or with another of that joint.
        unknown: Joints (0-based) that it leaves unexplained, which come first.

    Returns:
        The set, on a problem with that candidate; None where no lateness brings enough.
    """
    problem = solution.problem
    found = [
        _of_joint(solution, joint, long=joint in unknown) for joint in range(problem.observed.n)
    ]
    least = CANDIDATES.missing + np.log(len(found) * len(_LAWS) * len(TIMES))
    clear = [item for item in found if item is not None and item.gain >= least]
    best = max(clear, key=lambda item: (item.joint in unknown, item.gain), default=None)
    if best is None:
        return None
    hypothesis = TimeDelay.of_time(best.joint + 1, best.name, _LAWS[best.name], best.time)
    candidate = entered(hypothesis, problem.observed, problem.columns, problem.level)
    if candidate is None:
        return None
    problem = problem.with_candidates([*problem.candidates, candidate])
    rest = best.beside
    whole = fitted(problem, (*rest.members, len(problem.candidates) - 1), rest.noise)
    mean = np.append(rest.fitted.mean, 1.0)
    mean[best.changed] = best.coefficients
    return replace(whole, fitted=replace(whole.fitted, mean=mean))


def _of_joint(solution: Solution, joint: int, *, long: bool) -> _Late | None:
    """Return how late the torque of a joint (0-based) is taken to be, if later is better.

    All the times are tried of a joint that may be late by much (`long`). Elsewhere those do that
    begin to help, beside effects of the joint: without any, the lateness competed already.
    """
    problem = solution.problem
    members = [problem.candidates[member] for member in solution.members]
    rest = tuple(
        i
        for i, item in zip(solution.members, members, strict=True)
        if not (item.effect == TimeDelay.name and joint in item.joints)
    )
    if len(rest) == len(members):
        alone = _OneJoint.of(solution, joint)
        return _latest(alone, solution, _IN_TIME, long=long) if alone.own or long else None
    known = found_in(problem.under(solution).simulation, TimeDelay.name, (joint + 1,), missing=True)
    if not isinstance(known, TimeDelay):
        return None
    without = fitted(problem, rest, solution.noise)
    return _latest(_OneJoint.of(without, joint), without, known, long=True)


@dataclass(frozen=True)
class _Late:
    """How late one joint's torque is taken to be."""

    joint: int  # 0-based
    name: str  # parameter of `TimeDelay`
    time: float  # [s]
    gain: float  # in log evidence over what is known of it [nat]
    beside: Solution  # the set without lateness of that joint
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
    def of(cls, solution: Solution, joint: int) -> _OneJoint:
        problem = solution.problem
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

    def fit(self, late: TimeDelay) -> tuple[float, FloatArray]:
        """Return log evidence [nat] and coefficients (c,) with everything so much later."""
        both = np.column_stack([self.columns, self.simulated])
        both = np.concatenate([late.late(self.time[rows], both[rows]) for rows in self.segments])
        A, y = self.whiten(both[:, :-1]), self.whiten(self.measured - both[:, -1])
        root = inverse_root(A.T @ A + np.eye(A.shape[1]))
        part = root @ (A.T @ y)
        evidence = 0.5 * float(part @ part - y @ y) + float(np.log(np.diag(root)).sum())
        return evidence, (root.T @ part) * self.deviation


def _latest(alone: _OneJoint, beside: Solution, known: TimeDelay, *, long: bool) -> _Late | None:
    """Return how late the torque of a joint is taken to be, if another than known is better.

    Args:
        alone: Fit of that joint.
        beside: The set, without lateness of that joint.
        known: What a set has of it.
        long: Whether to try times that do not begin to help.
    """
    least, _ = alone.fit(known)
    best: _Late | None = None
    for name in _LAWS:
        own: _Late | None = None
        for k, time in enumerate(TIMES):
            if k > 1 and own is None and not long:
                break  # what does not begin to help is not there
            evidence, coefficients = alone.fit(TimeDelay(joint=alone.joint + 1, **{name: time}))
            gain = evidence - least
            if gain > (0.0 if own is None else own.gain):
                changed = [alone.place[c] for c in alone.own]
                values = coefficients[alone.own]
                own = _Late(alone.joint, name, time, gain, beside, changed, values)
        if own is not None and (best is None or own.gain > best.gain):
            best = own
    return best
