"""Judgement: from the fitted set to findings, with equivalents and abstention."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    TINY,
    acts_seldom,
    contribution,
    contribution_of_all,
    error_removed,
    in_turn,
    left_by_tolerances,
    own_joints,
    surely_helps,
    surely_less,
    without,
)
from estimators.diagnosis.from_torque.judgement.ordinary import convinced, ordinary, to_identify
from estimators.diagnosis.from_torque.judgement.surrogate import predictable_part
from estimators.diagnosis.from_torque.residuals.noise import roughness
from estimators.diagnosis.headline import LINK_INERTIA, is_of_bodies
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.quantities import listed
from estimators.diagnosis.settings import FINE, MOST, Z95
from estimators.diagnosis.settings.fitting import CONTRIBUTION, SEARCH
from estimators.diagnosis.settings.judgement import JUDGEMENT
from estimators.diagnosis.settings.residuals import ROWS
from estimators.diagnosis.stages import Attempts
from estimators.regression.definite import is_more, ranked
from estimators.regression.evidence import REACH
from estimators.telemetry import MOTOR_SIDE, friction_share
from limo_driver.physics import display_name
from limo_driver.physics.catalogue import identical_to

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.result import Shift
    from estimators.diagnosis.stages import Failure
    from estimators.diagnosis.verdict import Finding
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray


@dataclass(frozen=True)
class RemainingResidual:
    """Residual that remains on each joint beside the chosen set."""

    floor: FloatArray  # (n,) RMS of what no black box can predict [N m]
    predictable: FloatArray  # (n,) RMS of what one can [N m]
    series: FloatArray  # (K, n) what one predicts; all that remains where that is smooth [N m]
    failures: tuple[Failure, ...] = ()  # of the black box, which then predicts nothing

    @property
    def clearly_predictable(self) -> BoolArray:
        """Mark the joints (n,) on which a black box predicts clearly more than noise."""
        return self.predictable > JUDGEMENT.predictable * self.floor


def remaining_residual(observed: Observations, left: FloatArray) -> RemainingResidual:
    """Split the remaining residual into a part that the motion predicts and noise.

    Some physics cannot be predicted from the motion (jumps, disturbances in time). It is slow where
    noise is rough: a residual far smoother on one joint than on the others counts, too.

    Args:
        observed: Recordings and simulation.
        left: Residual of the improved simulation, (K, n) [N m].
    """
    moving = observed.faster(2 * ROWS.rest)  # slower friction comes out wrong, unknown or not
    attempts = Attempts()
    series = attempts.at("search for what is unknown", lambda: _series(observed, left), 0.0 * left)
    whole, floor = rmse(left, moving), rmse(left - series, moving)
    rough, moves = roughness(left, moving, observed.least_noise), moving.any(axis=0)
    floor = np.where(moves, floor, rough)  # of a still joint nothing is known
    ratio = floor / rough
    usual = float(np.median(ratio[moves])) if moves.any() else 1.0
    smooth = ratio > np.maximum(JUDGEMENT.smoother * usual, JUDGEMENT.smooth)
    floor = np.where(smooth, usual * rough, floor)
    beyond = np.sqrt(np.maximum(whole**2 - floor**2, 0.0))
    return RemainingResidual(
        floor, beyond, np.where(smooth, left, series), tuple(attempts.failures)
    )


def _series(observed: Observations, left: FloatArray) -> FloatArray:
    """Return the part of a residual (K, n) that a black box predicts [N m]."""
    guesses = [predictable_part(observed, left[:, joint], joint) for joint in range(observed.n)]
    return np.stack(guesses, axis=1)


def equivalents(solution: Solution, member: int) -> tuple[Candidate, ...]:
    """Return the candidates that would do as well in a member's place, best first."""
    problem = solution.problem
    own = problem.candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    taken = {problem.candidates[i].place for i in rest}
    best: dict[tuple[str, tuple[int, ...]], tuple[float, Candidate]] = {}
    reference = solution.search.gain((*rest, member))
    for i, candidate in enumerate(problem.candidates):
        if candidate.place == own.place or candidate.place in taken:
            continue
        gain = solution.search.gain((*rest, i))
        if gain > reference - CONTRIBUTION.tellable:
            known = best.get(candidate.place)
            if known is None or is_more(gain, known[0]):
                best[candidate.place] = (gain, candidate)
    return tuple(item[1] for item in ranked(best.values(), lambda item: item[0]))


def identical(problem: RegressionProblem, member: int) -> tuple[str, ...]:
    """Return effects indistinguishable from a member; of links only the last carries a load."""
    candidate, last = problem.candidates[member], problem.observed.n - 1
    same = identical_to(candidate.effect)
    if LINK_INERTIA in {candidate.effect, *same} and candidate.joints != (last,):
        return ()
    return same


def other_links(solution: Solution, member: int) -> tuple[int, ...]:
    """Return the joints (0-based) whose links the motion hardly tells from a member, a body.

    Either such a link does as well in its place, or beside it explains a part of what it does.
    """
    own = solution.problem.candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    gain = solution.search.gain
    reference = gain((*rest, member))
    joints = (
        candidate.joints[0]
        for i, candidate in enumerate(solution.problem.candidates)
        if candidate.effect == LINK_INERTIA
        and i not in solution.members
        and candidate.joints != own.joints
        and (
            gain((*rest, i)) > reference - CONTRIBUTION.tellable
            or gain((*rest, member, i)) > reference + CONTRIBUTION.tellable
        )
    )
    return tuple(dict.fromkeys(joints))  # a link has a candidate of each size


def margin(solution: Solution, member: int, same: Sequence[Candidate]) -> float:
    """Return the evidence for a member over the best explanation that differs from it [nat]."""
    problem = solution.problem
    own = problem.candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    taken = {problem.candidates[i].place for i in rest} | {own.place} | {c.place for c in same}
    taken |= {(effect, own.joints) for effect in identical(problem, member)}
    other = max(
        (
            solution.search.gain((*rest, i))
            for i, candidate in enumerate(problem.candidates)
            if candidate.place not in taken
        ),
        default=0.0,
    )
    best = max(other, solution.search.gain(rest))
    return solution.search.gain((*rest, member)) - best


def abstained(
    solution: Solution, remaining: RemainingResidual
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Drop names that explain too little of a joint's error, and return the unknown joints.

    What helps elsewhere, or not for sure, stays in the set without a name. A wrong effect often
    explains part of an unknown one. The right one leaves nothing that a black box can predict.
    Ordinary friction that was not stated is no name, and explains nothing of what is beyond it.
    Nor is a name what only mends what values did that moved inside their tolerances: some joint
    that it acts on has to be surely better than as it was given.

    Returns:
        Members that stay, and joints (0-based) on which something unknown acts.
    """
    removed = contribution_of_all(solution)
    explained = removed / np.maximum(removed + remaining.predictable**2, TINY**2)
    unknown = np.flatnonzero(remaining.clearly_predictable & (explained < JUDGEMENT.precise))
    small = remaining.predictable < remaining.floor
    least = np.where(small, MOST, JUDGEMENT.dominant)
    doubtful = {int(j) for j in unknown if explained[j] < least[j]}
    plain = to_identify(solution)
    usual = ordinary(solution, solution.members)
    sure = convinced(solution, [i for i in solution.members if i not in usual])
    stay = tuple(
        member
        for member in solution.members
        if member in plain
        or (
            member in sure
            and _is_beyond(doubtful, solution, member, remaining)
            and not _is_part_of_more(solution, member, unknown.tolist())
            and _betters(solution, member)
        )
    )
    return stay, tuple(int(j) for j in unknown)


def _is_beyond(
    doubtful: Collection[int], solution: Solution, member: int, remaining: RemainingResidual
) -> bool:
    """Say whether a member is no stand-in for what is unknown at doubtful joints (0-based).

    It acts most elsewhere, or enough and surely: what acts on the whole arm shows at other joints,
    too, and something else may be unknown at the one where it is largest.
    """
    if acts_most(solution, member, remaining.floor) not in doubtful:
        return True
    rest = [joint for joint in own_joints(solution.problem, member) if joint not in doubtful]
    if not rest or error_removed(solution, member, rest) < CONTRIBUTION.material:
        return False
    return surely_helps(solution, member, rest)


def _is_part_of_more(solution: Solution, member: int, unknown: Sequence[int]) -> bool:
    """Say whether a member may be but a part of what nothing explains at other joints (0-based).

    What acts on several, as a wrong body does, looks like a slight effect of its own at one more.
    """
    others = {*unknown} - {*solution.problem.candidates[member].joints}
    return len(others) > 1 and error_removed(solution, member) < 1.0


def acts_most(solution: Solution, member: int, floor: FloatArray) -> int:
    """Return the joint (0-based) on which a member explains most, of those that it acts on."""
    own = own_joints(solution.problem, member)
    gained = contribution(solution, member)
    return own[int(np.argmax((gained / floor**2)[own]))]


def gains(solution: Solution, proven: FloatArray, remaining: RemainingResidual) -> bool:
    """Say whether held-out motion is surely predicted better than by the given simulation.

    Where that states no friction, ordinary friction is no gain: it has to be better than that.
    """
    given, rows = _residual_before(solution), solution.problem.split.held_out
    return surely_less(proven, given, remaining.floor, solution.problem.observed, rows)


def _betters(solution: Solution, member: int) -> bool:
    """Say whether a joint that a member acts on is surely better than `gains` counts from.

    On rows that are held out in turn; those that miss most of what it does cannot say. Friction
    that is itself among what gains are counted from, as of a joint that binds, counts from none.
    """
    problem = solution.problem
    observed = problem.observed
    given = observed.residual if member in problem.base else _residual_before(solution)
    (left,), rows = in_turn(solution, solution.members)
    scale = rmse(left, rows)[:, None]
    return acts_seldom(solution, member) or any(
        surely_less(left[:, [j]], given[:, [j]], scale[j], observed, rows[:, [j]])
        for j in own_joints(problem, member)
    )


def _residual_before(solution: Solution) -> FloatArray:
    """Return the residual (K, n) that a gain is counted from [N m]."""
    return (
        left_by_tolerances(solution)
        if solution.problem.base
        else solution.problem.observed.residual
    )


def harmed(
    problem: RegressionProblem, proven: FloatArray, remaining: RemainingResidual
) -> tuple[int, ...]:
    """Return the joints (0-based) of whose held-out motion more error is left than was given."""
    return worse_at(problem, proven, problem.observed.residual, remaining)


def least_harmful(solution: Solution, some: Sequence[int]) -> tuple[int, ...]:
    """Return the members without the one of some whose loss leaves least on motion held out."""
    problem = solution.problem
    rows, scale = problem.split.held_out, rmse(problem.observed.residual, problem.split.held_out)

    def left(member: int) -> float:
        error = rmse(problem.left(without(solution, member)), rows)
        return float(np.sum((error / np.maximum(scale, TINY)) ** 2))

    return problem.less(solution.members, (min(some, key=left),))


def worse_at(
    problem: RegressionProblem, proven: FloatArray, other: FloatArray, remaining: RemainingResidual
) -> tuple[int, ...]:
    """Return the joints (0-based) at which one residual (K, n) is clearly larger, held out."""
    rows = problem.split.held_out
    larger = rmse(proven, rows) > rmse(other, rows) + CONTRIBUTION.material * remaining.floor
    return tuple(np.flatnonzero(larger).tolist())


def trusted_gains(
    findings: Sequence[Finding], simulation: Simulation, recordings: Sequence[Recording]
) -> Iterator[str]:
    """Yield a note where bodies were found in torques of drives whose gains count as exact.

    Args:
        findings: Of a verdict.
        simulation: The improved one.
        recordings: That it was found in.
    """
    bodies = [item.effect for item in findings if is_of_bodies(item.effect)]
    if not bodies or simulation.tolerances.gain:
        return
    shares = [friction_share(simulation, recording) for recording in recordings]
    share = float(np.median([known for known in shares if not np.isnan(known)] or [0.0]))
    if share > MOTOR_SIDE:
        alike = listed([*dict.fromkeys(map(display_name, bodies))])
        yield (
            "The torques seem to be measured at the drives, friction included: it is "
            f"{100 * share:.1f} % of the effort limits. Gains of drives are seldom known better "
            f"than to 10 %, and a wrong gain looks like {alike}. With a tolerance of gains "
            "(`tolerances: {gain: 0.1}`) the two are told apart, as far as the motion allows."
        )


def _moved(shift: Shift) -> str:
    limit = " (its limit)" if abs(shift.sigmas) > REACH - FINE else ""
    return f"{shift.name} by {shift.sigmas:+.1f} standard deviations{limit}"


def remarks(
    shifts: Sequence[Shift],
    *,
    members: int,
    harmful: bool,
    passing: Sequence[str],
    recordings: int = 1,
) -> Iterator[str]:
    """Yield notes on the fit, one sentence each."""
    sensed = [shift for shift in shifts if " of sensor " in shift.name and abs(shift.sigmas) > Z95][
        :3
    ]
    if sensed and not harmful:
        yield (
            f"The fit also moved what sensors may be off by: {'; '.join(map(_moved, sensed))}. "
            "Lags of sensors are not written into the improved simulation, and offsets only where "
            "a note says so."
        )
    if members >= SEARCH.largest:
        yield (
            f"The search stopped at {SEARCH.largest} effects, and more may be missing: identify "
            "inertias and friction first (limo identify), or give wider tolerances."
        )
    if harmful:
        yield (
            "What was fitted predicts held-out motion no better than the given simulation does, so "
            "the written simulation is the given one."
            + " Do the recordings belong together?"
            * (recordings > 1)
        )
    if passing:
        yield (
            f"What passes is not written into the improved simulation ({', '.join(passing)}): "
            "another recording has another."
        )
