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
from estimators.diagnosis.settings.judgement import VALUES
from limo_driver.physics import TorqueGain, TorqueOffset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.judgement.writing import Elsewhere, Written
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.verdict import Verdict


def without_unreported(found: Written, verdict: Verdict) -> Written:
    """Return what is written less what moved of the given simulation and is not told.

    Where recordings and simulation agree, nothing changes. Else a value stays as fitted where a
    joint errs more without.

    Args:
        found: What would be written.
        verdict: On that, with its values.
    """
    if found.elsewhere is None:
        return found
    given = found.elsewhere.given
    stated = {effect.place for effect in given.effects}
    # scales of torque move within their tolerance where none is stated, too
    silent = [
        part.name
        for part in parts_of(found.improved.simulation, given)
        if part.name == BODIES or part.place in stated or part.place.startswith(TorqueGain.name)
        if not _is_reported(part, verdict)
    ]
    gone = silent if verdict.states == ("agrees",) else list[str]()
    for name in silent if not gone else ():
        if not _errs_more(found, found.elsewhere, gone, name):
            gone.append(name)
    gone += _widths(found, found.elsewhere, gone, verdict)
    if not gone:
        return found
    proven, improved = (
        each.under(without(each.simulation, given, gone))
        for each in (found.judged.beside, found.improved)
    )
    judged = replace(found.judged, beside=proven)
    return replace(found, judged=judged, improved=improved, silent=tuple(gone))


def _widths(
    found: Written, elsewhere: Elsewhere, gone: Sequence[str], verdict: Verdict
) -> list[str]:
    """Return the widths of signs that moved, are not reported, and that nothing surely gains by.

    What moves them is what rows near rest leave, where no law of the catalogue is exact; and rows
    at rest, which are not fitted to, are what they act on most.

    Args:
        found: What would be written.
        elsewhere: Its proof.
        gone: Names of the parts that are as given already.
        verdict: With its values.
    """
    known = [*(item.part for item in found.withheld), *gone]
    now = without(found.improved.simulation, elsewhere.given, known)
    moved = [
        part
        for part in widths_of(now, elsewhere.given)
        if not any(
            x.reported and part.name.startswith(f"{x.name} of") and x.joints == part.joints
            for x in verdict.values
        )
    ]
    if not moved:
        return []
    names = [part.name for part in moved]
    lost = elsewhere.change([*known, *names], known)[1]
    return [part.name for part in moved if not lost[part.joints[0] - 1] > 0]


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
    helps = (less[2] < 0) & (share >= VALUES.share)
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


def _offset(found: Observations, rows: NDArray[np.bool_], joints: Sequence[int]) -> Observations:
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
    judged = found.judged
    less = without(judged.beside.simulation, elsewhere.given, [*gone, name])
    left = judged.beside.under(less).residual
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
