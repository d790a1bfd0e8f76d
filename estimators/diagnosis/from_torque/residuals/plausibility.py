"""Plausibility: can the recorded torque be that of the recorded motion at all?

Each mistake of `mistakes` is undone in turn. If that turns torques which do not follow the motion
into torques that do, the recordings are refused with the name of the mistake. A misfit that no
mistake explains is left to the diagnosis, unless the torques have nothing to do with the arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.body_fit import (
    BodyFit,
    as_mounted,
    by_load,
    not_the_load,
    other_unit,
    parts_of_load,
    strange_load,
    usual_misfit,
    without_payload,
)
from estimators.diagnosis.from_torque.residuals.mistakes import (
    Mistake,
    RowSample,
    mistakes,
    mounted_otherwise,
    stuck,
)
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.usable_joints import (
    doubtful_encoders,
    holds_still,
    left_out,
    sizes,
    still,
    without_load,
    without_torque,
)
from estimators.diagnosis.quantities import listed, of_joints
from estimators.diagnosis.settings import CLEARLY, FAR, FEW, HALF, LITTLE, MATTERS, SOME
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.settings.residuals import MISTAKES, ROWS
from estimators.regression.evidence import REACH
from estimators.rigid_body.regressor import PER_LINK
from estimators.rigid_body.tolerances import bare
from limo_driver.errors import RecordingError
from limo_driver.recordings.bandwidth import about_lower_bandwidth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray


def check_plausible(observed: Observations) -> None:
    """Refuse recordings of which a diagnosis would only name physics that is not there.

    Raises:
        RecordingError: Too little moves of an arm that does not hold still, a torque was not
            measured or has other units, columns are exchanged or have the other sign, or the arm
            is another one.
    """
    _check_measured(observed)
    if holds_still(observed):
        return  # friction holds any torque: pushes alone are looked for
    _check_motion(observed)
    _, strange = _check_log(observed)  # how an arm is mounted is physics, and found
    if strange:
        raise _refused(observed, strange)


def doubts_about(
    model: RobotModel, recordings: Sequence[Recording], bandwidth: float
) -> tuple[str, ...]:
    """Refuse mistakes of logs as a diagnosis does, and return what else makes one doubt them.

    An identification finds bodies: that they are not those of the description is no mistake, and
    refusing would leave nothing that could find them.

    Args:
        model: The arm with its nominal inertias.
        recordings: Of that arm, one or more.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].

    Returns:
        One sentence each, without a full stop.

    Raises:
        RecordingError: A torque was not measured or has other units, or columns are exchanged or
            have the other sign.
    """
    try:
        observed = Observations.of(bare(model), recordings, bandwidth)
    except RecordingError as error:
        return (_unchecked(error),)
    return _doubts_in(observed)


def as_it_hangs(
    model: RobotModel, recordings: Sequence[Recording], bandwidth: float
) -> tuple[RobotModel, tuple[str, ...]]:
    """Return a robot under the gravity that its torques say, and what makes one doubt the log then.

    That is its own gravity, unless it is turned far. Arguments and errors as of `doubts_about`.
    """
    try:
        observed = Observations.of(bare(model), recordings, bandwidth)
    except RecordingError as error:
        return model, (_unchecked(error),)
    gravity = as_mounted(observed).simulation.body.gravity
    if gravity == model.gravity:
        return model, _doubts_in(observed)
    hung = model.with_gravity(gravity)
    return hung, doubts_about(hung, recordings, bandwidth)


def turned(stated: RobotModel, hung: RobotModel) -> tuple[str, ...]:
    """Say how an arm hangs that hangs otherwise than its description says."""
    if hung is stated:
        return ()
    stated_, found = (", ".join(f"{x:.3g}" for x in model.gravity) for model in (stated, hung))
    return (
        f"{mounted_otherwise(np.array(hung.gravity))}: gravity is ({found}) m/s² in the frame of "
        f"its base, not ({stated_}); the simulation states it so",
    )


def _unchecked(error: RecordingError) -> str:
    """Say that too little is there to judge by, which may be enough to learn from."""
    return f"signs, units and order of the columns cannot be checked: {error}"


def _doubts_in(observed: Observations) -> tuple[str, ...]:
    """Refuse mistakes of logs beside a bare arm, and return what else makes one doubt them."""
    try:
        _check_motion(observed)
    except RecordingError as error:
        return (_unchecked(error),)
    return (*filter(None, _check_log(observed)), *_stuck_in(observed), *_weightless_in(observed))


def _check_log(observed: Observations) -> tuple[str, str]:
    """Refuse mistakes of logs; say how else the arm is mounted, and what else is strange."""
    unit = other_unit(observed)
    if unit is not None and not _is_load(RowSample.of(observed), unit):
        raise _refused(observed, unit.message)
    if len(observed.recordings) > 1:  # a mistake in one would be half hidden by the others
        for k in range(len(observed.recordings)):
            part = observed.part(k)
            if len(part.kept) >= ROWS.least and len(still(part)) < observed.n:
                _check_columns(part, RowSample.of(part))
    sample = RowSample.of(observed)
    if mounted := _check_columns(observed, sample):
        return f"{mounted}; identification and diagnosis find by how much", ""
    return "", strange_load(observed, sample)  # of all: a light joint may show little in one


def _check_columns(observed: Observations, sample: RowSample) -> str:
    """Refuse mistakes of columns; say how else the arm is mounted, or nothing."""
    found = found_in(sample)
    wrong = [mistake.message for mistake in found if mistake.is_of_data]
    if wrong:
        more = (
            f"; and {len(wrong) - WORDING.listed} more of the kind"
            if len(wrong) > WORDING.listed
            else ""
        )
        raise _refused(
            observed,
            f"{'; '.join(wrong[: WORDING.listed])}{more} (undone, torque fits motion)",
        )
    return "; ".join(mistake.message for mistake in found)


def _stuck_in(observed: Observations) -> tuple[str, ...]:
    """Ask of each joint whose encoder may be stuck whether it is."""
    return tuple(
        f"position_{j + 1} is {observed.slow.position[0, j]:.4g} {observed.unit('rad', j)} in "
        f"all rows while torque_{j + 1} varies by {np.ptp(observed.measured[:, j]):.3g} "
        f"{observed.unit('N m', j)}: is its encoder stuck?"
        for j in doubtful_encoders(observed)
    )


def notes_on(observed: Observations, doubts: Sequence[str] | None = None) -> tuple[str, ...]:
    """Return notes on the recordings for the verdict, one sentence each; those of `doubts_on`, too.

    A joint that moves too little, has no torque, or was recorded too slowly is no doubt.

    Args:
        observed: The recordings beside the given simulation.
        doubts: What `doubts_on` says of them, where that is known: it takes a fit of all bodies.
    """
    warnings = [
        f"{recording.source or 'A recording'}: {warning}."
        for recording in observed.recordings
        for warning in recording.warnings
    ]
    if (slow := about_lower_bandwidth(observed.recordings, observed.bandwidth)) is not None:
        warnings.append(slow)
    warnings += doubts_on(observed) if doubts is None else doubts
    if holds_still(observed):
        warnings.append(
            "The arm holds still in all rows, where friction holds any torque: pushes alone are "
            "looked for, and nothing else is said of it."
        )
        return tuple(warnings)
    silent = without_torque(observed)
    if silent:
        where = of_joints([j + 1 for j in silent]).capitalize()
        values = [f"{observed.measured[0, j]:.4g} {observed.unit('N m', j)}" for j in silent]
        is_ = "is" if len(silent) == 1 else "are"
        warnings.append(
            f"{where} {is_} left out: no torque is measured there, "
            f"{listed([*dict.fromkeys(values)])} in all rows."
        )
    without = {*silent, *left_out(observed)}
    motionless = [j for j in still(observed) if j not in without]
    if not motionless:
        return tuple(warnings)
    joints = ", ".join(str(j + 1) for j in motionless)
    return (
        *warnings,
        f"Nothing is said of the torque of joints that move too little to compare it: {joints}.",
    )


def doubts_on(observed: Observations) -> tuple[str, ...]:
    """Return what makes all of a diagnosis doubtful, one sentence each."""
    doubts = [
        f"{doubt} Then nothing said of other joints holds, either." for doubt in _stuck_in(observed)
    ]
    if holds_still(observed):
        return tuple(doubts)
    doubts += _weightless_in(observed)
    if foreign := foreign_bodies(observed):
        joints = ", ".join(str(j + 1) for j in foreign)
        doubts.append(
            f"The torques of joints {joints} are those of a rigid body, but several bodies of it "
            f"are far from those of {observed.simulation.model.name}, payload or not. Is it "
            "another arm? Then no finding holds, and limo identify makes a simulation of its own."
        )
    sample = RowSample.of(observed)
    doubtful, _ = by_load(sample)
    if doubtful.size > 1:  # fewer than would be beyond doubt another robot
        asked = not_the_load(observed, doubtful)
        parts = parts_of_load(sample, doubtful)
        doubts.append(f"{asked[0].upper()}{asked[1:]}, or are their sensors off?{parts}")
    return tuple(doubts)


def _refused(observed: Observations, what: str) -> RecordingError:
    sources = [recording.source for recording in observed.recordings]
    return RecordingError(what, path=", ".join(filter(None, sources)) or None)


def _check_motion(observed: Observations) -> None:
    if len(still(observed)) == observed.n:
        ranges = np.ptp(observed.slow.position, axis=0)
        joint, least = int(np.argmax(ranges)), MISTAKES.least_moving
        away = observed.faster(ROWS.rest).sum(axis=0)
        raise _refused(
            observed,
            f"no joint keeps moving for long enough to learn from: joint {joint + 1} goes the "
            f"farthest, {ranges[joint]:.2g} {observed.unit('rad', joint)}, and is away from "
            f"rest on {away[joint]} of {len(observed.kept)} rows, expected {least}",
        )


def _weightless_in(observed: Observations) -> list[str]:
    """Ask of each joint whose torque is small beside its load why, and say what becomes of it."""
    load, torque = sizes(observed)
    without = left_out(observed)
    asked: list[str] = []
    for j in without_load(observed, SOME):
        question = (
            f"its torque is {torque[j]:.3g} {observed.unit('N m', j)} where its load asks for "
            f"{load[j]:.3g} (root mean squares). Is it in another unit, does something balance the "
            "load, or has the drive no power?"
        )
        if j in without:
            asked.append(f"Joint {j + 1} is left out: {question}")
        else:
            asked.append(f"Joint {j + 1}: {question} Taken as it is, it bends the bodies.")
    return asked


def _check_measured(observed: Observations) -> None:
    if len(without_torque(observed)) == observed.n:
        raise _refused(
            observed,
            f"the torques are {observed.measured[0].tolist()} {observed.unit('N m')} in all rows; "
            "expected measured torque",
        )


def found_in(sample: RowSample) -> list[Mistake]:
    """Return the mistakes that together turn torques which do not fit into torques that do.

    Args:
        sample: Torque and motion as recorded.
    """
    known = [*mistakes(sample.body.sliding), *stuck(sample)]
    found: list[Mistake] = []
    while sample.misfit.max() > MATTERS:
        undone = [(mistake, mistake.undo(sample)) for mistake in known]
        mistake, best = min(
            (pair for pair in undone if not _spoils(pair[0], sample, pair[1])),
            key=lambda pair: round(_change(sample, pair[1]), 2),
        )
        better = _change(sample, best) < -np.log(FAR)
        if not (better and _mended(sample, best).any()):
            break
        loaded = without_payload(sample)  # a load that nobody stated may explain more, if it does
        if _change(sample, loaded) < _change(sample, best) and _lightens(sample, loaded, best):
            break
        found.append(mistake)
        sample = best
    return found


def _spoils(mistake: Mistake, before: RowSample, after: RowSample) -> bool:
    """Say whether a joint that fits speaks against a mistake that would be made at all of them.

    Of a gear that holds its load by friction gravity seems taken out; another joint shows it.
    """
    limit = np.maximum(MATTERS, CLEARLY * before.misfit)
    spoilt = (before.misfit < HALF) & (after.misfit > limit)
    return mistake.is_of_all and bool(spoilt.any())


def _change(before: RowSample, after: RowSample) -> float:
    """Return the logarithm of what the misfits' product is multiplied by.

    A misfit that cannot matter counts alike, and a joint that is not judged before and after not
    at all: undoing a mistake may leave too few of its rows.
    """
    judged = before.judged & after.judged
    after_, before_ = (
        np.log(np.maximum(sample.misfit[judged], LITTLE)).sum() for sample in (after, before)
    )
    return float(after_ - before_)


def _mended(before: RowSample, after: RowSample) -> BoolArray:
    """Mark the strange joints that undoing a mistake makes fit, (n,)."""
    strange = after.judged & (before.misfit > MATTERS)
    better = FAR * after.misfit < before.misfit
    return strange & better & (after.misfit < HALF)


def _is_load(sample: RowSample, unit: Mistake) -> bool:
    """Say whether a load that nobody stated explains torques as well without another unit.

    A load at the flange may well make ten times of the torque of a wrist.
    """
    loaded, undone = (without_payload(item) for item in (sample, unit.undo(sample)))
    return _change(sample, loaded) < min(_change(sample, undone), 0.0)


def _lightens(before: RowSample, loaded: RowSample, after: RowSample) -> bool:
    """Say whether a load explains any of a joint that undoing a mistake makes fit.

    Of a joint that no load acts on, as of a flange that turns about the centre of what it carries,
    the load that mends others says nothing.
    """
    gained = before.misfit - loaded.misfit > LITTLE
    return bool((gained & _mended(before, after)).any())


def foreign_bodies(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) whose torque is that of an arm with bodies far from the given ones.

    Those of any rigid body fit, and those of the given one do not, with or without a payload. One
    link that is wrong, a mounting or a sensor does not do this on so many joints.
    """
    sample = RowSample.of(observed)
    fit = BodyFit.of(sample)
    given, free = usual_misfit(fit), fit.misfit(slice(None))
    for link, name in enumerate(sample.body.link_names):
        own = slice(PER_LINK * link, PER_LINK * (link + 1))
        if abs(fit.change(own)[0]) < sample.body.inertials[name].mass:
            given = np.minimum(given, fit.misfit(own))
    least = max(LITTLE, REACH * observed.simulation.tolerances.inertia)
    joints = np.flatnonzero((given > least) & (FAR * free < given))
    if joints.size < FEW or found_in(sample):  # a mounting looks like negative masses
        return ()
    return tuple(joints.tolist())
