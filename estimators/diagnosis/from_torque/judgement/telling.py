"""What is written is told: a stated value that moved, and that no verdict tells of, is as given.

A pendulum of which the verdict was that it agrees would have had other masses, which were worse on
another recording; and a width of dry friction that took nothing away cost a motor a tenth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.comparison import BODIES, ComparedPart, parts_of, widths_of
from estimators.diagnosis.from_torque.fitting.contribution import TINY
from estimators.diagnosis.from_torque.judgement.judgement import worse_at
from estimators.diagnosis.from_torque.judgement.writing import mean_left, without
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import blocks, rmse, rmse_change
from estimators.diagnosis.settings import MATTERS
from limo_driver.physics import TorqueGain, TorqueOffset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.judgement.writing import Elsewhere, Written
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.types import BoolArray


def without_unreported(found: Written, verdict: Verdict) -> Written:
    """Return what is written less what moved of the given simulation and is not told.

    Where recordings and simulation agree, nothing changes. Else a value stays as fitted where a
    joint errs more without.

    Args:
        found: What would be written.
        verdict: On that, with its values.
    """
    elsewhere = found.elsewhere
    if elsewhere is None:
        return found
    given, fitted = elsewhere.given, found.improved.simulation
    known = [item.part for item in found.withheld]
    parts = [part for part in parts_of(fitted, given) if not _is_reported(part, verdict)]
    stated = {effect.place for effect in given.effects}
    # scales of torque move within their tolerance where none is stated, too
    silent = [
        part.name
        for part in parts
        if part.name == BODIES or part.place in stated or part.place.startswith(TorqueGain.name)
    ]
    if verdict.states == ("agrees",):
        gone = silent
    else:
        # one by one each may look needed, since one makes good what another does: a gain of 0.85
        # with friction a fifth higher; a law that was missing and has no name is such a part, too
        gone = _together(found, elsewhere, [part for part in parts if len(part.joints) == 1], known)
        for name in silent:
            if name not in gone and not _errs_more(found, elsewhere, gone, name):
                gone.append(name)
    # what moves a width is what rows near rest leave, where no law of the catalogue is exact; and
    # rows at rest, which are not fitted to, are what it acts on most
    widths = [
        part
        for part in widths_of(without(fitted, given, gone), given)
        if not any(
            x.reported and part.name.startswith(f"{x.name} of") and x.joints == part.joints
            for x in verdict.values
        )
    ]
    if widths:
        lost = elsewhere.change([*known, *gone, *(x.name for x in widths)], [*known, *gone])[1]
        gone += [part.name for part in widths if not lost[part.joints[0] - 1] > 0]
    if not gone:
        return found
    proven, improved = (
        each.under(without(each.simulation, given, gone))
        for each in (found.judged.beside, found.improved)
    )
    judged = replace(found.judged, beside=proven)
    return replace(found, judged=judged, improved=improved, silent=tuple(gone))


def _together(
    found: Written, elsewhere: Elsewhere, parts: Sequence[ComparedPart], known: Sequence[str]
) -> list[str]:
    """Return all of some parts at the joints that gain too little by them together.

    Motion of another kind has to show a tenth of the squared error, or some for sure. A fit without
    it knows less than the one that is written: where the two are as good there, motion of the same
    kind may show that tenth, for sure.

    Args:
        found: What would be written.
        elsewhere: Its proof.
        parts: Of one joint each.
        known: Names of parts that are as given already.
    """
    names = [part.name for part in parts]
    if not names:
        return []
    judged, given = found.judged, np.maximum(elsewhere.as_given, TINY)
    lost, surely, _ = elsewhere.change([*known, *names], known)
    much = (surely > 0) | (1.0 - (1.0 - lost / given) ** 2 >= MATTERS)
    proven, rows = judged.beside, judged.problem.split.held_out
    less = proven.under(without(proven.simulation, elsewhere.given, names)).residual
    there = rmse_change(proven.residual, less, blocks(proven), rows)[0] > 0
    there &= rmse(proven.residual, rows) ** 2 <= (1.0 - MATTERS) * rmse(less, rows) ** 2
    writes = much | (there & (lost > 0))
    return [part.name for part in parts if not writes[part.joints[0] - 1]]


def with_offsets(found: Written, verdict: Verdict) -> Written:
    """Return what is written with offsets of torques that surely help on motion of another kind.

    Sensors may be off by a little, which is no physics that is missing; where a joint keeps it from
    one motion to the other, and it is a tenth of the squares that are left, it is written, and a
    note has it. Where all agrees, nothing is.

    Args:
        found: What would be written.
        verdict: On that, with its values.
    """
    elsewhere = found.elsewhere
    if elsewhere is None or verdict.states == ("agrees",):
        return found
    parts = [*(item.part for item in found.withheld), *found.silent]
    simulation = found.improved.simulation
    has_one = {x.joints for x in simulation.effects if isinstance(x, TorqueOffset)}
    left = elsewhere.as_given + elsewhere.change(parts)[0]
    less = elsewhere.offset(parts)
    share = 1.0 - (1.0 + less[0] / np.maximum(left, TINY)) ** 2
    helps = (less[2] < 0) & (share >= MATTERS)
    joints = [j for j in np.flatnonzero(helps).tolist() if (j + 1,) not in has_one]
    if not joints:
        return found
    every = np.ones(len(found.improved.kept), dtype=bool)
    proven = _offset(found.judged.beside, ~found.judged.problem.split.apart, joints)
    improved = _offset(found.improved, every, joints)
    return replace(
        found,
        judged=replace(found.judged, beside=proven),
        improved=improved,
        offsets=tuple(
            (x.joint, x.offset)
            for x in improved.simulation.effects[-len(joints) :]
            if isinstance(x, TorqueOffset)
        ),
    )


def _offset(found: Observations, rows: BoolArray, joints: Sequence[int]) -> Observations:
    """Return recordings with offsets of joints (0-based) that rows (K,) leave in the mean."""
    mean, simulation = mean_left(found, rows), found.simulation
    added = (TorqueOffset(joint=j + 1, offset=float(mean[j])) for j in joints)
    return found.under(replace(simulation, effects=(*simulation.effects, *added)))


def _errs_more(found: Written, elsewhere: Elsewhere, gone: Sequence[str], name: str) -> bool:
    """Say whether a joint errs more, or clearly more on rows held out, if a part is as given, too.

    Args:
        found: What would be written.
        elsewhere: Its proof.
        gone: Names of the parts that are as given already.
        name: That of the part.
    """
    known = [item.part for item in found.withheld]
    if (elsewhere.change([*known, *gone, name], [*known, *gone])[0] > 0).any():
        return True
    judged, fit = found.judged, found.judged.beside
    left = fit.under(without(fit.simulation, elsewhere.given, [*gone, name])).residual
    return bool(worse_at(judged.problem, left, judged.proven, judged.remaining))


def _is_reported(part: ComparedPart, verdict: Verdict) -> bool:
    """Say whether a finding, an identified value, or a value that differs is of a part."""
    reported = [x for x in verdict.values if x.reported]
    if any(
        not x.effect and (part.name == BODIES or {*part.joints} <= {*x.joints}) for x in reported
    ):
        return True
    if part.name == BODIES:
        return any(x.effect == LINK_INERTIA for x in verdict.findings)
    effect = part.place.partition(",")[0]
    every = (*reported, *verdict.findings, *verdict.identified)
    return any(
        x.effect == effect and (not part.joints or {*part.joints} & {*x.joints}) for x in every
    )
