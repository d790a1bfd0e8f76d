"""Plausibility: can the recorded torque be that of the recorded motion at all?

Each mistake of `mistakes` is undone in turn. If that turns torques which do not follow the motion
into torques that do, the recordings are refused with the name of the mistake. A misfit that no
mistake explains is left to the diagnosis, unless the torques have nothing to do with the arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.residuals.mistakes import (
    Mistake,
    RowSample,
    constant_joints,
    dry_and_viscous,
    mistakes,
    stuck,
    without_friction,
)
from estimators.diagnosis.residuals.noise import roughness
from estimators.diagnosis.residuals.observations import Observations
from estimators.diagnosis.residuals.torque_unit import other_unit
from estimators.diagnosis.settings.residuals import MISTAKES, PLAUSIBILITY, ROWS
from estimators.diagnosis.wording import listed, of_joints
from estimators.recordings import WEIGHTLESS
from estimators.rigid_body.dynamics.regressor import PER_LINK, RegressorChain
from limo_driver.errors import RecordingError
from limo_driver.physics import GravityDirection, Simulation
from limo_driver.recordings.bandwidth import lowered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


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
        observed = Observations.of(_simulation_of(model), recordings, bandwidth)
        _check_motion(observed)
    except RecordingError as error:  # too little to judge by may be enough to learn from
        return (f"signs, units and order of the columns cannot be checked: {error}",)
    return (*filter(None, _check_log(observed)), *_stuck_in(observed), *_weightless_in(observed))


def _simulation_of(model: RobotModel) -> Simulation:
    """Return a simulation of the bare arm as it hangs."""
    bare = Simulation(model.name, inertials=model.inertials)
    if bare.model.gravity == model.gravity:
        return bare
    x, y, z = model.gravity
    return replace(bare, effects=(GravityDirection(gravity=(x, y, z)),))


def _check_log(observed: Observations) -> tuple[str, str]:
    """Refuse mistakes of logs; say how else the arm is mounted, and what else is strange."""
    if unit := other_unit(observed):
        raise _refused(observed, unit)
    if len(observed.recordings) > 1:  # a mistake in one would be half hidden by the others
        for k in range(len(observed.recordings)):
            part = observed.part(k)
            if len(part.kept) >= ROWS.least and len(still(part)) < observed.n:
                _check_columns(part, RowSample.of(part))
    sample = RowSample.of(observed)
    if mounted := _check_columns(observed, sample):
        return f"{mounted}: turn its base there, or let a diagnosis find by how much", ""
    return "", _strange_load(observed, sample)  # of all: a light joint may show little in one


def _check_columns(observed: Observations, sample: RowSample) -> str:
    """Refuse mistakes of columns; say how else the arm is mounted, or nothing."""
    found = found_in(sample)
    wrong = [mistake.said for mistake in found if mistake.is_of_data]
    if wrong:
        more = (
            f"; and {len(wrong) - PLAUSIBILITY.said} more of the kind"
            if len(wrong) > PLAUSIBILITY.said
            else ""
        )
        raise _refused(
            observed, f"{'; '.join(wrong[: PLAUSIBILITY.said])}{more} (undone, torque fits motion)"
        )
    return "; ".join(mistake.said for mistake in found)


def still(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) that move too little for their friction to show."""
    return tuple(np.flatnonzero(observed.moving.sum(axis=0) < MISTAKES.least_moving).tolist())


def holds_still(observed: Observations) -> bool:
    """Say whether the arm stays where it is in all recordings, while its encoders tell of it."""
    farthest = max(float(np.ptp(item.position, axis=0).max()) for item in observed.recordings)
    alive = len(constant_joints(observed)) < observed.n
    return alive and farthest < PLAUSIBILITY.holding and len(still(observed)) == observed.n


def doubtful_encoders(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) that may move although their encoder gives one value.

    Nothing that the arm does moves the torque of a locked joint as far as this, and the mistake is
    not one that the torques of the others would show: they hardly depend on its position.
    """
    left = observed.measured - observed.filter(observed.load)
    left -= np.median(left, axis=0)
    torque = observed.measured - np.median(observed.measured, axis=0)
    rough = roughness(left, np.ones_like(observed.moving), observed.least_noise)
    strange = np.median(np.abs(left), axis=0)
    doubt = (strange > PLAUSIBILITY.alive * rough) & (
        strange > PLAUSIBILITY.own * np.median(np.abs(torque), axis=0)
    )
    return tuple(j for j in constant_joints(observed) if doubt[j])


def _stuck_in(observed: Observations) -> tuple[str, ...]:
    """Ask of each joint whose encoder may be stuck whether it is."""
    return tuple(
        f"position_{j + 1} is {observed.slow.position[0, j]:.4g} rad in all rows while torque_"
        f"{j + 1} varies by {np.ptp(observed.measured[:, j]):.3g} N m: is its encoder stuck?"
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
    if (slow := lowered(observed.recordings, observed.bandwidth)) is not None:
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
        values = listed([*dict.fromkeys(f"{observed.measured[0, j]:.4g}" for j in silent)])
        is_ = "is" if len(silent) == 1 else "are"
        warnings.append(
            f"{where} {is_} left out: no torque is measured there, {values} N m in all rows."
        )
    left_out = {*silent, *without_load(observed)}
    motionless = [j for j in still(observed) if j not in left_out]
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
    doubtful, _ = _by_load(sample)
    if doubtful.size > 1:  # fewer than would be beyond doubt another robot
        told = _not_the_load(observed, doubtful)
        parts = _parts_of_load(sample, doubtful)
        doubts.append(f"{told[0].upper()}{told[1:]}, or are their sensors off?{parts}")
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
            f"farthest, {ranges[joint]:.2g} rad, and is away from rest on {away[joint]} of "
            f"{len(observed.kept)} rows, expected {least}",
        )


def without_torque(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is one value in all rows."""
    return tuple(np.flatnonzero(np.ptp(observed.measured, axis=0) < PLAUSIBILITY.constant).tolist())


def without_load(observed: Observations, least: float = WEIGHTLESS) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is next to nothing of what their load asks for.

    Where the load hardly changes, as that of a lift, no scale and no unit shows in its course.

    Args:
        observed: The recordings beside a simulation.
        least: Part of the load that a torque has to be.
    """
    load, torque = _sizes(observed)
    light = np.flatnonzero(torque < least * load)
    silent = without_torque(observed)
    return tuple(j for j in light.tolist() if j not in silent)


def _sizes(observed: Observations) -> tuple[FloatArray, FloatArray]:
    """Return the root mean squares of load and torque of each joint, rest included, (n,) each."""
    load, torque = observed.load[observed.kept], observed.measured
    return np.sqrt(np.mean(load**2, axis=0)), np.sqrt(np.mean(torque**2, axis=0))


def _weightless_in(observed: Observations) -> list[str]:
    """Ask of each joint whose torque is small beside its load why, and say what becomes of it."""
    load, torque = _sizes(observed)
    slides, left_out = observed.simulation.model.sliding, without_load(observed)
    told: list[str] = []
    for j in without_load(observed, PLAUSIBILITY.light):
        question = (
            f"its torque is {torque[j]:.3g} {'N' if slides[j] else 'N m'} where its load asks for "
            f"{load[j]:.3g} (root mean squares). Is it in another unit, or does something balance "
            "the load?"
        )
        if j in left_out:
            told.append(f"Joint {j + 1} is left out: {question}")
        else:
            told.append(f"Joint {j + 1}: {question} Taken as it is, it bends the bodies.")
    return told


def _check_measured(observed: Observations) -> None:
    if len(without_torque(observed)) == observed.n:
        raise _refused(
            observed,
            f"the torques are {observed.measured[0].tolist()} N m in all rows; expected measured "
            "torque",
        )


def found_in(sample: RowSample) -> list[Mistake]:
    """Return the mistakes that together turn torques which do not fit into torques that do.

    Args:
        sample: Torque and motion as recorded.
    """
    known = [*mistakes(sample.torque.shape[1]), *stuck(sample)]
    found: list[Mistake] = []
    while len(found) < PLAUSIBILITY.most and sample.misfit.max() > PLAUSIBILITY.strange:
        undone = [(mistake, mistake.undo(sample)) for mistake in known]
        mistake, best = min(
            (pair for pair in undone if not _spoils(pair[0], sample, pair[1])),
            key=lambda pair: _change(sample, pair[1]),
        )
        if not _explains(sample, best):
            break
        if _change(sample, _without_payload(sample)) < _change(sample, best):
            break  # a load that nobody stated explains more
        found.append(mistake)
        sample = best
    return found


def _spoils(mistake: Mistake, before: RowSample, after: RowSample) -> bool:
    """Say whether a joint that fits speaks against a mistake that would be made at all of them.

    Of a gear that holds its load by friction gravity seems taken out; another joint shows it.
    """
    limit = np.maximum(PLAUSIBILITY.strange, PLAUSIBILITY.spoilt * before.misfit)
    spoilt = (before.misfit < PLAUSIBILITY.fits) & (after.misfit > limit)
    return mistake.is_of_all and bool(spoilt.any())


def _without_payload(sample: RowSample) -> RowSample:
    """Take out the torque of a load at the last link, as it explains most; none that lifts."""
    last = slice(-PER_LINK, None)
    load = _BodyFit.of(sample).change(last)
    if load[0] <= 0:
        return sample
    columns = RegressorChain.of(sample.body).regressor(sample.motion)[:, :, last]
    return replace(sample, torque=sample.torque - (columns @ load).T)


def _change(before: RowSample, after: RowSample) -> float:
    """Return the logarithm of what the misfits' product is multiplied by.

    A misfit that cannot matter counts alike, and a joint that is not judged before and after not
    at all: undoing a mistake may leave too few of its rows.
    """
    judged = before.judged & after.judged
    after_, before_ = (
        np.log(np.maximum(sample.misfit[judged], PLAUSIBILITY.negligible)).sum()
        for sample in (after, before)
    )
    return float(after_ - before_)


def _explains(before: RowSample, after: RowSample) -> bool:
    """Say whether undoing a mistake makes some strange joint fit, and the arm as a whole."""
    strange = after.judged & (before.misfit > PLAUSIBILITY.strange)
    mended = (
        strange
        & (after.misfit < PLAUSIBILITY.fits)
        & (PLAUSIBILITY.better * after.misfit < before.misfit)
    )
    return bool(mended.any()) and _change(before, after) < -np.log(PLAUSIBILITY.better)


def _strange_load(observed: Observations, sample: RowSample) -> str:
    """Say that most torques are not the load of this arm, with or without a payload."""
    foreign, following = _by_load(sample)
    if foreign.size < 2 or following.size > 1:  # noqa: PLR2004  # one of each may be by chance
        return ""
    return f"{_not_the_load(observed, foreign)}, or torque of another motion?"


def _by_load(sample: RowSample) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the joints (0-based) whose torque does not follow their load, and those that do.

    Joints whose load is small beside their torque are neither.
    """
    expected = np.std(sample.load, axis=0) > PLAUSIBILITY.expected * np.std(sample.torque, axis=0)
    foreign = _usual_misfit(_BodyFit.of(sample)) > PLAUSIBILITY.foreign
    return np.flatnonzero(foreign & expected), np.flatnonzero(~foreign & expected)


def _not_the_load(observed: Observations, joints: NDArray[np.int64]) -> str:
    named = ", ".join(str(j + 1) for j in joints.tolist())
    return (
        f"the torques of joints {named} are not the load of {observed.simulation.model.name} on "
        "this motion, with friction or a payload; is it another robot"
    )


def _parts_of_load(sample: RowSample, joints: NDArray[np.int64]) -> str:
    """Say how much of the load each joint (0-based) shows where that, with friction, is its torque.

    Sensors, currents or bodies that are off by a factor look like this, and the factor tells which.
    """
    parts: list[str] = []
    for joint in joints.tolist():
        use, torque = sample.moving[:, joint], _centred(sample, joint)
        friction = dry_and_viscous(sample.motion.velocity[use, joint])
        columns = np.column_stack([sample.load[use, joint], friction, np.ones(torque.size)])
        found = np.linalg.lstsq(columns, torque, rcond=None)[0]
        left = float(np.std(torque - columns @ found)) / max(float(np.std(torque)), MISTAKES.tiny)
        if left < PLAUSIBILITY.fits:
            parts.append(f"{found[0]:.2f} of it at joint {joint + 1}")
    if not parts:
        return ""
    return f" Beside friction they follow {' and '.join(parts)}."


def foreign_bodies(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) whose torque is that of an arm with bodies far from the given ones.

    Those of any rigid body fit, and those of the given one do not, with or without a payload. One
    link that is wrong, a mounting or a sensor does not do this on so many joints.
    """
    sample = RowSample.of(observed)
    fit = _BodyFit.of(sample)
    given, free = _usual_misfit(fit), fit.misfit(slice(None))
    for link, name in enumerate(sample.body.link_names):
        own = slice(PER_LINK * link, PER_LINK * (link + 1))
        if abs(fit.change(own)[0]) < sample.body.inertials[name].mass:
            given = np.minimum(given, fit.misfit(own))
    least = max(
        PLAUSIBILITY.apart, PLAUSIBILITY.apart_sigmas * observed.simulation.tolerances.inertia
    )
    joints = np.flatnonzero((given > least) & (PLAUSIBILITY.much_better * free < given))
    if joints.size < PLAUSIBILITY.many or found_in(sample):  # a mounting looks like negative masses
        return ()
    return tuple(joints.tolist())


def _usual_misfit(fit: _BodyFit) -> FloatArray:
    """Return what load, friction and payload leave of each joint's torque, (n,).

    A payload that lifts is none.
    """
    last = slice(-PER_LINK, None)
    bare = fit.misfit(slice(0))
    return np.minimum(bare, fit.misfit(last)) if fit.change(last)[0] > 0 else bare


@dataclass(frozen=True)
class _BodyFit:
    """Torques that are left beside load and friction, as a change of bodies may explain them."""

    n: int
    joints: tuple[int, ...]  # that move
    columns: tuple[FloatArray, ...]  # of each of those, (K_j, 10 n) beside any friction
    left: tuple[FloatArray, ...]  # (K_j,) [N m]
    size: tuple[float, ...]  # median of the torque [N m]

    @classmethod
    def of(cls, sample: RowSample) -> _BodyFit:
        moves = np.flatnonzero(sample.moving.sum(axis=0) >= MISTAKES.least_moving).tolist()
        Y = RegressorChain.of(sample.body).regressor(sample.motion)
        return cls(
            sample.torque.shape[1],
            tuple(moves),
            tuple(_beside_friction(sample, j, Y[j]) for j in moves),
            tuple(sample.rest(j) for j in moves),
            tuple(
                float(np.median(np.abs(_centred(sample, j)))) + PLAUSIBILITY.constant for j in moves
            ),
        )

    def change(self, which: slice) -> FloatArray:
        """Return the change of some body parameters that leaves least."""
        scale = zip(self.columns, self.left, self.size, strict=True)
        A, y = zip(*((columns[:, which] / s, left / s) for columns, left, s in scale), strict=True)
        return np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=PLAUSIBILITY.dependent)[
            0
        ]

    def misfit(self, which: slice) -> FloatArray:
        """Return the misfit of each joint's torque with some body parameters changed, (n,).

        Median over median, which a push does not change.
        """
        change, result = self.change(which), np.zeros(self.n)
        every = zip(self.joints, self.columns, self.left, self.size, strict=True)
        for joint, columns, left, size in every:
            result[joint] = float(np.median(np.abs(left - columns[:, which] @ change))) / size
        return result


def _centred(sample: RowSample, joint: int) -> FloatArray:
    torque = sample.torque[sample.moving[:, joint], joint]
    return torque - np.median(torque)


def _beside_friction(sample: RowSample, joint: int, columns: FloatArray) -> FloatArray:
    """Return what no friction of a joint explains of columns (K, p), on its moving rows."""
    use = sample.moving[:, joint]
    return without_friction(columns[use], sample.motion.velocity[use, joint])
