"""What is written is told: a stated value that moved, and that no verdict tells of, is as given.

A pendulum of which the verdict was that it agrees would have had other masses, which were worse on
another recording; and a width of dry friction that took nothing away cost a motor a tenth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from estimators.diagnosis.comparison import BODIES, ComparedPart, parts_of
from estimators.diagnosis.from_torque.judgement.judgement import worse_at
from estimators.diagnosis.from_torque.judgement.writing import without
from estimators.diagnosis.headline import LINK_INERTIA
from limo_driver.physics import TorqueGain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.judgement.writing import Elsewhere, Written
    from estimators.diagnosis.verdict import Verdict


def as_told(found: Written, verdict: Verdict) -> Written:
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
        if not _is_told(part, verdict)
    ]
    gone = silent if verdict.states == ("agrees",) else list[str]()
    for name in silent if not gone else ():
        if not _errs_more(found, found.elsewhere, gone, name):
            gone.append(name)
    if not gone:
        return found
    proven, improved = (
        each.under(without(each.simulation, given, gone))
        for each in (found.judged.beside, found.improved)
    )
    return replace(found, judged=replace(found.judged, beside=proven), improved=improved)


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


def _is_told(part: ComparedPart, verdict: Verdict) -> bool:
    """Say whether a finding, an identified value, or a value that differs is of a part."""
    told = [x for x in verdict.values if x.reported]
    if any(not x.effect and (part.name == BODIES or {*part.joints} <= {*x.joints}) for x in told):
        return True
    if part.name == BODIES:
        return any(x.effect == LINK_INERTIA for x in verdict.findings)
    effect = part.place.partition(",")[0]
    every = (*told, *verdict.findings, *verdict.identified)
    return any(
        x.effect == effect and (not part.joints or {*part.joints} & {*x.joints}) for x in every
    )
