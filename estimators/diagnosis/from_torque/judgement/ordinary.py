"""Ordinary: what the joints have that the description of a robot seldom states.

Every joint rubs, and every drive has inertia. Where a simulation gives a joint no friction at all,
Coulomb and viscous friction there are values to identify, and no finding. So is another law of
friction, or the inertia of drives, that more than half of these joints have: that is how the arm is
made. What one joint has and its siblings lack is unusual, and so is friction of a size far beyond
that of its siblings. Presliding that is over before any row is judged is plain friction. Of any
joint, a law of friction that predicts better, but little or not for sure, is no finding. Nor is
plain friction of a lower value beside a law that was missing: it stood for both before. Nor is what
adds next to nothing to an effect of the same name that is stated: it makes its law more precise.
Nor is stated friction that is but sharper, of a size that it may have: over which speeds a sign
turns is guessed.

Sizes are compared as parts of what a drive can do: friction over the limit of its torque, viscous
friction at the limit of its speed. One joint is unlike its siblings where that is several times the
largest of theirs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    change_of,
    changes_only_sign_width,
    coefficients,
    contribution,
    convincing,
)
from estimators.diagnosis.from_torque.hypotheses.candidates import BASE, without_friction
from estimators.diagnosis.from_torque.hypotheses.responses import responses
from estimators.diagnosis.from_torque.hypotheses.search import is_friction
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings import FAR, FEW
from estimators.diagnosis.settings.judgement import JUDGEMENT, ORDINARY
from estimators.diagnosis.settings.residuals import ROWS
from estimators.regression.definite import first_best
from limo_driver.physics import Armature, PreslidingHysteresis, ViscousFriction
from limo_driver.physics.effects.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.fitting.problem import Solution
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate


def ordinary(solution: Solution, members: Sequence[int]) -> tuple[int, ...]:
    """Return the members of a set that are ordinary at joints of unknown friction.

    Args:
        solution: The set, fitted.
        members: Of the set, as indices of its candidates; all or some.
    """
    bare = {(j,) for j in without_friction(solution.problem.observed.simulation)}
    of_drives = {
        member: candidate
        for member in members
        if (candidate := solution.problem.candidates[member]).joints in bare
        and (is_friction(candidate.effect) or candidate.effect == Armature.name)
    }
    effects = [candidate.effect for candidate in of_drives.values()]
    most = 0.5 * max(len(bare), FEW)
    usual = {*BASE, *(effect for effect in effects if effects.count(effect) > most)}
    far = beyond_siblings(solution)
    return tuple(
        member
        for member, item in of_drives.items()
        if (item.effect in usual or _slides_at_once(solution, member)) and member not in far
    )


def convinced(solution: Solution, members: Sequence[int]) -> tuple[int, ...]:
    """Return the members that remove enough error, and surely so, to be findings.

    Two laws of a joint's friction that can each stand for the other remove little by themselves,
    though what both explain is sure: then the likelier one does without the other.

    Args:
        solution: The set, fitted.
        members: Of the set, as indices of its candidates; all or some.
    """
    problem = solution.problem
    found = [i for i in members if convincing(solution, i)]
    unsure = [i for i in members if i not in found and is_friction(problem.candidates[i].effect)]
    for joints in dict.fromkeys(problem.candidates[i].joints for i in unsure):
        group = [i for i in unsure if problem.candidates[i].joints == joints]
        if len(group) == 1:
            continue
        others = {i: [other for other in group if other != i] for i in group}
        alone = {i: solution.having(problem.less(solution.members, others[i])) for i in group}
        best = first_best(group, lambda i: alone[i].gain)  # noqa: B023  # at once
        if convincing(alone[best], best):
            found.append(best)
    return tuple(found)


def to_identify(solution: Solution) -> tuple[int, ...]:
    """Return the members of a set that are values to identify, and no findings.

    Those that are ordinary, laws of friction that are but the likelier ones, and what only makes a
    stated law more precise, or sharper. A lower value beside a law that is missing is none by that
    law, whether that is named or not; one that is higher stood for nothing before.

    Args:
        solution: The set, fitted.
    """
    members, candidates = solution.members, solution.problem.candidates
    plain = ordinary(solution, members)
    laws = [i for i in members if i not in plain and is_friction(candidates[i].effect)]
    surely = convinced(solution, laws)
    lacking = {candidates[i].joints for i in surely if _is_missing(candidates[i])}
    findings = [
        i
        for i in surely
        if _is_missing(candidates[i])
        or candidates[i].joints not in lacking
        or _has_grown(solution, i)
    ]
    return tuple(
        i
        for i in members
        if i in plain
        or (i in laws and i not in findings)
        or _is_detail(solution, i)
        or changes_only_sign_width(solution, i)
    )


def _is_detail(solution: Solution, member: int) -> bool:
    """Say whether a member is a small part more of an effect that the simulation states already.

    Like lines of a ripple that are too faint to show before the others are stated. What acts on the
    whole arm, as gravity, is no law of a joint, and a finding however small.
    """
    problem = solution.problem
    candidate = problem.candidates[member]
    observed, joints = problem.observed, list(candidate.joints)
    stated = [
        effect
        for effect in observed.simulation.effects
        if effect.name == candidate.effect and effect.joints == tuple(j + 1 for j in joints)
    ]
    if candidate.kind != "missing" or not stated or not joints:
        return False
    whole = np.zeros_like(observed.residual)
    for added in responses(stated, observed):
        whole[:, list(added.joints)] += added.values.T
    least = (1.0 - JUDGEMENT.precise) * rmse(whole, problem.split.held_out) ** 2
    return bool((contribution(solution, member) < least)[joints].all())


def _is_missing(candidate: Candidate) -> bool:
    """Say whether a law of friction is stated nowhere, and more than another value of plain one."""
    return candidate.kind == "missing" or candidate.effect not in BASE


def _has_grown(solution: Solution, member: int) -> bool:
    """Say whether a stated value is higher than stated."""
    return float(change_of(solution, member).sum()) > 0.0


def _slides_at_once(solution: Solution, member: int) -> bool:
    """Say whether a law of presliding is Coulomb friction by another name.

    Rows slower than creep are not judged, and in one period of the filter's band a row that is
    passes over creep / bandwidth: friction that has built up within less slides on every such row.
    """
    hypothesis = solution.problem.candidates[member].hypothesis
    if hypothesis is None or hypothesis.effect != PreslidingHysteresis.name:
        return False
    effects = hypothesis.realise(coefficients(solution, member))
    stops = [stop for e in effects if isinstance(e, PreslidingHysteresis) for stop in e.stops()]
    way = sum(height * width for height, width in stops)  # [N m rad]
    least = 2 * ROWS.rest * SIGN_WIDTH / solution.problem.observed.bandwidth  # [rad]
    return way < least * sum(height for height, _ in stops)


def beyond_siblings(solution: Solution) -> dict[int, float]:
    """Return the plain friction that is far larger than that of the other joints.

    Args:
        solution: The set, fitted.

    Returns:
        Of each such member, how many times the largest of its siblings it is.
    """
    bare = {(j,) for j in without_friction(solution.problem.observed.simulation)}
    found: dict[int, float] = {}
    for effect in BASE:
        parts = {
            _of_the_drive(solution, member): member
            for member in solution.members
            if (candidate := solution.problem.candidates[member]).effect == effect
            and candidate.joints in bare
        }
        some = sorted(part for part in parts if part > 0)
        if len(some) >= ORDINARY.compared and some[-1] > FAR * some[-2]:
            found[parts[some[-1]]] = some[-1] / some[-2]
    return found


def _of_the_drive(solution: Solution, member: int) -> float:
    """Return plain friction as a part of what the drive can do; 0 where no limit is known."""
    candidate = solution.problem.candidates[member]
    if candidate.hypothesis is None:
        return 0.0
    limits = solution.problem.observed.simulation.model.limits
    (effect,) = candidate.hypothesis.realise(coefficients(solution, member))
    joint = candidate.joints[0]
    viscous = isinstance(effect, ViscousFriction)
    torque = effect.f_v * limits.velocity[joint] if viscous else getattr(effect, "tau_c", 0.0)
    can = float(limits.torque[joint])
    return float(torque or 0.0) / can if np.isfinite(can) and can > 0 else 0.0
