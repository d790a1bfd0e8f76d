"""Findings: what was found, with place, confidence and evidence.

Confidence: how sure a name is, from the error that it removes over what is left, and from how long
the motion is.

The weights are those of a logistic regression on names in real recordings, in some with something
hidden in them, and in concealed plants (`benchmarks/diagnosis/diagnosis_calibration.py`, which
leaves out one source after the other to measure how well they hold). The evidence over the next
explanation says nothing more: errors of real recordings are alike in time, which makes it large for
wrong names, too.

Shares: the error that remains within tolerances, divided among the findings; at most 1 in all.

Moving values within their tolerances may remove most of the given simulation's error. Shares are of
the error that then remains on held-out motion: its mean square beyond that of the noise floor,
summed over joints. The set of effects explains a part of it. Effects overlap: the losses without
each of them may add up to more or less than the loss without all, so the part of the set is divided
among its members in proportion to the loss without each.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    TINY,
    coefficients,
    contribution,
    error_removed,
)
from estimators.diagnosis.from_torque.fitting.laws import sentence_of
from estimators.diagnosis.from_torque.fitting.problem import lost_by
from estimators.diagnosis.from_torque.judgement.judgement import (
    acts_most,
    equivalents,
    identical,
    margin,
    other_links,
)
from estimators.diagnosis.from_torque.judgement.ordinary import beyond_siblings, to_identify
from estimators.diagnosis.from_torque.judgement.surrogate import where_of
from estimators.diagnosis.headline import LINK_INERTIA, is_of_bodies, likelier, signature_of
from estimators.diagnosis.held_out import reducible_removed
from estimators.diagnosis.quantities import listed, placed, rounded
from estimators.diagnosis.settings.judgement import CONFIDENCE
from estimators.diagnosis.verdict import UNKNOWN, BeforeAfter, Finding, Where
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


def findings_of(
    solution: Solution,
    named: Sequence[int],
    remaining: RemainingResidual,
    alone: FloatArray,
    after: FloatArray,
) -> tuple[Finding, ...]:
    """Return the findings of named members, the largest share first.

    Args:
        solution: The set, fitted to the rows meant for it.
        named: Members of the set.
        remaining: Residual that remains on each joint.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
    """
    problem = solution.problem
    shares = shares_of(solution, alone, after, remaining.floor)
    far = beyond_siblings(solution)
    lost = lost_by(solution)
    time, stretches = problem.observed.slow.time, problem.observed.stretches
    duration = sum(float(np.ptp(time[rows])) for rows in stretches)
    found: list[Finding] = []
    for member in named:
        candidate = problem.candidates[member]
        same = equivalents(solution, member)
        gained = contribution(solution, member)
        joint = acts_most(solution, member, remaining.floor)
        lead = margin(solution, member, same) - lost.get(member, 0.0)
        before = np.sqrt(np.maximum(after**2 + gained, 0.0))
        signs = Signs(
            lead=lead,
            material=error_removed(solution, member),
            duration=duration,
        )
        found.append(
            Finding(
                effect=candidate.effect,
                kind=candidate.kind,
                joints=tuple(j + 1 for j in candidate.joints or range(problem.observed.n)),
                equivalent=tuple(
                    dict.fromkeys(
                        effect
                        for effect in (*identical(problem, member), *(c.effect for c in same))
                        if effect != candidate.effect
                    )
                ),
                confidence=confidence_of(signs),
                parameters={},  # `with_parameters` reads them off the improved simulation
                where=_where(solution, member, joint),
                share=shares[member],
                heldout_rmse=BeforeAfter(tuple(before.tolist()), tuple(after.tolist())),
                evidence=_sentence(
                    candidate,
                    joint,
                    problem.observed.unit("N m", joint),
                    float(before[joint]),
                    float(after[joint]),
                    float(remaining.floor[joint]),
                    lead,
                    " that is distinct in these recordings" if same else "",
                )
                + _identical_sentence(problem, member)
                + _links_sentence(solution, member)
                + sentence_of(candidate.laws)
                + _siblings_sentence(far.get(member)),
                signs=asdict(signs),
            )
        )
    return tuple(sorted(found, key=lambda item: -item.share))


def _sentence(
    candidate: Candidate,
    joint: int,
    unit: str,
    before: float,
    after: float,
    floor: float,
    lead: float,
    apart: str,
) -> str:
    signature = signature_of(candidate.effect)
    if is_of_bodies(candidate.effect):
        where = f"{signature[:1].upper()}{signature[1:]}, most of all at joint {joint + 1}"
    else:
        where = f"At joint {joint + 1} {signature}"
    return (
        f"{where}; on held-out motion it reduces the "
        f"RMSE there from {rounded(before)} to {rounded(after)} {unit} "
        f"(noise floor {rounded(floor)} {unit}), and "
        + (
            f"is {likelier(lead)} than the next explanation{apart}."
            if lead > 0
            else "the next explanation does as well."
        )
    )


def _identical_sentence(problem: RegressionProblem, member: int) -> str:
    """Say what would look the same in any motion; nothing where nothing does."""
    own = problem.candidates[member]
    if own.effect == Payload.name:
        name = problem.observed.simulation.model.link_names[-1]
        return f" A wrong mass, centre or inertia of {name} would look the same."
    if identical(problem, member) and own.effect == LINK_INERTIA:
        return " A load at the flange would look the same, but none has these values."
    return ""


def _links_sentence(solution: Solution, member: int) -> str:
    """Say which other links may have changed instead, or as well; nothing where none may."""
    if solution.problem.candidates[member].effect not in {LINK_INERTIA, Payload.name}:
        return ""
    model = solution.problem.observed.simulation.model
    own = model.linkage.own
    names = [model.link_names[own[joint]] for joint in other_links(solution, member)]
    if not names:
        return ""
    return f" The motion hardly tells all of it from changes of {listed(names)}."


def _siblings_sentence(times: float | None) -> str:
    """Say how far friction is beyond that of the other joints; nothing where it is like them."""
    if times is None:
        return ""
    return f" For what its drive can do, it is {times:.0f} times that of any other joint."


def _where(solution: Solution, member: int, joint: int) -> Where:
    problem = solution.problem
    mean = coefficients(solution, member)
    torque = problem.columns.apply(problem.candidates[member].prior.index, mean)
    return where_of(problem.observed, torque[:, joint], joint)


def unknown_of(
    problem: RegressionProblem,
    stand_ins: Sequence[int],
    remaining: RemainingResidual,
    joints: tuple[int, ...],
    alone: FloatArray,
    after: FloatArray,
) -> tuple[Finding, ...]:
    """Return the finding of what nothing explains, if there is something.

    Args:
        problem: What was compared.
        stand_ins: Members that improve the prediction, and explain too little to be named.
        remaining: Residual that remains on each joint.
        joints: Where something unknown acts, 0-based.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
    """
    if not joints:
        return ()
    ranked = sorted(joints, key=lambda j: -remaining.predictable[j] / remaining.floor[j])
    values = tuple(after.tolist())
    where = _together([where_of(problem.observed, remaining.series[:, j], j) for j in ranked])
    share, _ = left_at(joints, alone, after, remaining.floor)
    return (
        Finding(
            effect=UNKNOWN,
            kind="missing",
            joints=tuple(j + 1 for j in joints),
            equivalent=(),
            confidence=CONFIDENCE.of_unknown,
            parameters={},
            where=where,
            share=share,
            heldout_rmse=BeforeAfter(values, values),
            evidence=_unknown_sentence(problem.observed, remaining, ranked)
            + _stand_in_sentence([problem.candidates[member] for member in stand_ins]),
        ),
    )


def _together(places: Sequence[Where]) -> Where:
    """Return one place for what shows at several joints, the one of the first joint drawn."""
    stretches = sorted(
        {pair for place in places for pair in zip(place.recording, place.time, strict=True)}
    )
    return Where(
        time=tuple(time for _, time in stretches),
        recording=tuple(recording for recording, _ in stretches),
        region="; ".join(place.region for place in places),
        figure=places[0].figure,
    )


def _unknown_sentence(
    observed: Observations, remaining: RemainingResidual, joints: Sequence[int]
) -> str:
    """Say what a black box predicts at each joint (0-based)."""
    figures = [
        f"{rounded(remaining.predictable[j])} {unit} RMS at joint {j + 1} "
        f"(noise floor {rounded(remaining.floor[j])} {unit})"
        for j in joints
        for unit in [observed.unit("N m", j)]
    ]
    return (
        "No effect of the catalogue explains a part of the remaining residual that a black box "
        f"predicts from the motion: {listed(figures)}."
    )


def _stand_in_sentence(stand_ins: Sequence[Candidate]) -> str:
    """Say which effects stand in for what is unknown, and where; nothing if none does."""
    names = _placed(stand_ins)
    if not names:
        return ""
    return (
        f" Until it is understood, the improved simulation has {listed(names)} in place of a part "
        "of it, which does not mean that this is what acts."
    )


def unnamed_note(stand_ins: Sequence[Candidate]) -> str:
    """Say what the improved simulation has beside what is named, where nothing is unknown."""
    return (
        f"The improved simulation predicts better with {listed(_placed(stand_ins))}, too, but at "
        "the joints in question too little, or too seldom, for a finding."
    )


def _placed(items: Sequence[Candidate]) -> list[str]:
    """Return effects with their joints, each effect once."""
    at: dict[str, list[int]] = {}
    for item in items:
        at.setdefault(item.effect, []).extend(j + 1 for j in item.joints)
    return [placed(effect, sorted({*on})) for effect, on in at.items()]


@dataclass(frozen=True)
class Signs:
    """How a name stands: confidence comes from what it removes."""

    lead: float  # evidence over the next explanation [nat]
    material: float  # error that it removes [errors left]
    duration: float  # of the motion that was recorded [s]


def features(signs: Signs) -> tuple[float, float, float]:
    """Return the features of the logistic regression; the first is 1."""
    return 1.0, math.log(max(signs.material, TINY)), math.log(max(signs.duration, TINY))


def confidence_of(signs: Signs) -> float:
    """Return the probability that a finding names the right effect at the right joint."""
    score = sum(
        weight * value for weight, value in zip(CONFIDENCE.weights, features(signs), strict=True)
    )
    return min(CONFIDENCE.highest, 1.0 / (1.0 + math.exp(-score)))


def shares_of(
    solution: Solution, alone: FloatArray, after: FloatArray, floor: FloatArray
) -> dict[int, float]:
    """Return the share that goes with each member of the set that is not ordinary.

    Args:
        solution: The set, fitted to the rows meant for it.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
        floor: Noise floor, (n,) [N m].
    """
    taken = max(reducible_removed(alone, after, floor), 0.0)
    plain = to_identify(solution)
    lost = {
        member: max(float(contribution(solution, member).sum()), 0.0)
        for member in solution.members
        if member not in plain
    }
    total = max(sum(lost.values()), TINY**2)
    return {member: taken * part / total for member, part in lost.items()}


def left_at(
    joints: Sequence[int], alone: FloatArray, after: FloatArray, floor: FloatArray
) -> tuple[float, tuple[float, ...]]:
    """Return the share that stays at some joints.

    Args:
        joints: Which, 0-based.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
        floor: Noise floor, (n,) [N m].

    Returns:
        Of the arm's error, and of each of those joints' own.
    """
    left = np.maximum(after**2 - floor**2, 0.0)
    whole = np.maximum(np.maximum(alone**2 - floor**2, left), TINY**2)  # nothing leaves no 0 / 0
    own = tuple(float(left[j] / whole[j]) for j in joints)
    return float(left[list(joints)].sum() / whole.sum()), own
