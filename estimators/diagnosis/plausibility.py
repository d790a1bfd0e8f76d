"""Plausibility: can the recorded torque be that of the recorded motion at all?

Each mistake of `mistakes` is undone in turn. If that turns torques which do not follow the motion
into torques that do, the recordings are refused with the name of the mistake. A misfit that no
mistake explains is left to the diagnosis, unless the torques have nothing to do with the arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.mistakes import (
    LEAST_MOVING,
    Mistake,
    Sample,
    constant_joints,
    mistakes,
    stuck,
)
from estimators.diagnosis.noise import roughness
from estimators.diagnosis.observations import LEAST_ROWS
from estimators.rigid_body.regressor import PER_LINK, Chain
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.observations import Observations
    from limo_driver.types import FloatArray

BETTER = 3.0  # times that undoing a mistake has to lower a joint's misfit
STRANGE = 0.1  # misfit above which a torque may belong to something else
FITS = 0.4  # misfit below which it belongs to its motion
SCALE, SCALE_OF_ALL = 12.0, 4.0  # times; no sensor of a joint, nor of all, is so wrong
ALIKE = 0.8  # correlation of two torques that differ in their scale
MOST_MISTAKES = 8
SAID = 3  # mistakes that a message names
FOREIGN = 0.5  # misfit on two joints that no arm of this kind has
EXPECTED = 0.25  # of the torque that the load should make, if its lack is to tell
ALIVE = 3.0  # [noise floors] of torque on a joint that does not move, beyond its load
OWN = 0.5  # part of that torque that is not load
_NEGLIGIBLE = 0.03  # misfit; smaller ones are all good
_CONSTANT = 1e-9  # [N m]


def check_plausible(observed: Observations) -> None:
    """Refuse recordings of which a diagnosis would only name physics that is not there.

    Raises:
        RecordingError: Nothing moves, a torque was not measured or has other units, columns are
            exchanged or have the other sign, or the arm is another one.
    """
    _check_motion(observed)
    _check_measured(observed)
    _check_scale(observed)
    if len(observed.recordings) > 1:  # a mistake in one would be half hidden by the others
        for k in range(len(observed.recordings)):
            part = observed.part(k)
            if len(part.kept) >= LEAST_ROWS and len(still(part)) < observed.n:
                _check_columns(part, Sample.of(part))
    sample = Sample.of(observed)
    if not _check_columns(observed, sample):
        _check_arm(observed, sample)  # of all together: a light joint may show little in one


def _check_columns(observed: Observations, sample: Sample) -> bool:
    """Refuse mistakes of columns; say whether something else, as a mounting, was found."""
    found = found_in(sample)
    wrong = [mistake.said for mistake in found if mistake.is_of_data]
    if wrong:
        more = f"; and {len(wrong) - SAID} more of the kind" if len(wrong) > SAID else ""
        raise _refused(observed, f"{'; '.join(wrong[:SAID])}{more} (undone, torque fits motion)")
    return bool(found)


def still(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) that move too little for their friction to show."""
    return tuple(np.flatnonzero(observed.moving.sum(axis=0) < LEAST_MOVING).tolist())


def doubtful_encoders(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) that may move although their encoder gives one value.

    Nothing that the arm does moves the torque of a locked joint as far as this, and the mistake is
    not one that the torques of the others would show: they hardly depend on its position.
    """
    left = observed.measured - observed.filter(observed.load)
    left -= np.median(left, axis=0)
    torque = observed.measured - np.median(observed.measured, axis=0)
    rough = roughness(left, np.ones_like(observed.moving))
    strange = np.median(np.abs(left), axis=0)
    doubt = (strange > ALIVE * rough) & (strange > OWN * np.median(np.abs(torque), axis=0))
    return tuple(j for j in constant_joints(observed) if doubt[j])


def notes_on(observed: Observations) -> tuple[str, ...]:
    """Return what a reader of the verdict should know of the recordings, one sentence each."""
    warnings = [
        f"{recording.source or 'A recording'}: {warning}."
        for recording in observed.recordings
        for warning in recording.warnings
    ]
    warnings += [
        f"position_{j + 1} is {observed.slow.position[0, j]:.4g} rad in all rows while torque_"
        f"{j + 1} varies by {np.ptp(observed.measured[:, j]):.3g} N m: is its encoder stuck? Then "
        "nothing said of other joints holds, either."
        for j in doubtful_encoders(observed)
    ]
    motionless = still(observed)
    if not motionless:
        return tuple(warnings)
    joints = ", ".join(str(j + 1) for j in motionless)
    return (
        *warnings,
        f"Nothing is said of the torque of joints that move too little to compare it: {joints}.",
    )


def _refused(observed: Observations, what: str) -> RecordingError:
    sources = [recording.source for recording in observed.recordings]
    return RecordingError(what, path=", ".join(filter(None, sources)) or None)


def _check_motion(observed: Observations) -> None:
    if len(still(observed)) == observed.n:
        farthest = float(np.ptp(observed.slow.position, axis=0).max())
        raise _refused(
            observed,
            f"no joint moves on {LEAST_MOVING} independent rows (the farthest by {farthest:.2g} "
            "rad), expected motion to learn from",
        )


def _check_measured(observed: Observations) -> None:
    for j in range(observed.n):
        use = observed.moving[:, j]
        if use.sum() >= LEAST_MOVING and np.ptp(observed.measured[use, j]) < _CONSTANT:
            raise _refused(
                observed,
                f"torque_{j + 1} is {observed.measured[0, j]:.4g} N m in all rows although joint "
                f"{j + 1} moves; expected measured torque",
            )


def _check_scale(observed: Observations) -> None:
    """Refuse torques of another unit: those that follow the motion, but by another order of size.

    All torques together are judged more strictly than one, since a sensor may be wrong, and a
    friction known badly.
    """
    scale = dict(_scales(observed))
    wrong = [j for j, factor in scale.items() if not 1 / SCALE < factor < SCALE]
    usual = float(np.exp(np.mean(np.log(list(scale.values()))))) if len(scale) > 1 else 1.0
    if not 1 / SCALE_OF_ALL < usual < SCALE_OF_ALL:
        raise _refused(
            observed,
            f"the torques are {usual:.3g} times what motion and arm make of them; expected N m; "
            "are they in N mm or A, or is it another robot?",
        )
    if wrong:
        j = wrong[0]
        raise _refused(
            observed,
            f"torque_{j + 1} is {scale[j]:.3g} times what its motion makes of it; expected N m; is "
            "it in N mm or A?",
        )


def _scales(observed: Observations) -> Iterator[tuple[int, float]]:
    """Yield joint (0-based) and recorded over simulated torque, where one is like the other."""
    for j in range(observed.n):
        use = observed.moving[:, j]
        if use.sum() < LEAST_MOVING:
            continue
        y, s = (values[use, j] - values[use, j].mean() for values in _torques(observed))
        product, energy = abs(float(y @ s)), float(s @ s)
        if product > ALIKE * np.sqrt(energy * float(y @ y)) > 0:
            yield j, product / energy


def _torques(observed: Observations) -> tuple[FloatArray, FloatArray]:
    return observed.measured, observed.simulated


def found_in(sample: Sample) -> list[Mistake]:
    """Return the mistakes that together turn torques which do not fit into torques that do.

    Args:
        sample: Torque and motion as recorded.
    """
    known = [*mistakes(sample.torque.shape[1]), *stuck(sample)]
    found: list[Mistake] = []
    while len(found) < MOST_MISTAKES and sample.misfit.max() > STRANGE:
        undone = [mistake.undo(sample) for mistake in known]
        best = min(range(len(known)), key=lambda k: _size(undone[k]))
        if not _explains(sample, undone[best]):
            break
        found.append(known[best])
        sample = undone[best]
    return found


def _size(sample: Sample) -> float:
    """Return the logarithm of the misfits' product; a misfit that cannot matter counts alike."""
    return float(np.log(np.maximum(sample.misfit, _NEGLIGIBLE)).sum())


def _explains(before: Sample, after: Sample) -> bool:
    """Say whether undoing a mistake makes some strange joint fit, and the arm as a whole."""
    strange = before.misfit > STRANGE
    mended = strange & (after.misfit < FITS) & (BETTER * after.misfit < before.misfit)
    return bool(mended.any()) and _size(after) < _size(before) - np.log(BETTER)


def _check_arm(observed: Observations, sample: Sample) -> None:
    """Refuse torques that are not the load of this arm, with or without a payload."""
    expected = np.std(sample.load, axis=0) > EXPECTED * np.std(sample.torque, axis=0)
    foreign = np.flatnonzero((_usual_misfit(sample) > FOREIGN) & expected)
    if foreign.size > 1:
        joints = ", ".join(str(j + 1) for j in foreign)
        raise _refused(
            observed,
            f"the torques of joints {joints} are not the load of {observed.simulation.model.name} "
            "on this motion, with friction or a payload; is it another robot, or torque of "
            "another motion?",
        )


def _usual_misfit(sample: Sample) -> FloatArray:
    """Return what load, friction and payload leave of each joint's torque, (n,).

    Median over median, which a push does not change. A payload that lifts is none.
    """
    n = sample.torque.shape[1]
    moves = np.flatnonzero(sample.moving.sum(axis=0) >= LEAST_MOVING).tolist()
    Y = Chain.of(sample.body).regressor(sample.motion)[:, :, -PER_LINK:]
    bare = {j: sample.rest(j) for j in moves}
    columns = {j: _beside_friction(sample, j, Y[j]) for j in moves}
    size = {j: float(np.median(np.abs(_centred(sample, j)))) + _CONSTANT for j in moves}
    A = np.concatenate([columns[j] / size[j] for j in moves])
    payload = np.linalg.lstsq(A, np.concatenate([bare[j] / size[j] for j in moves]))[0]
    result = np.zeros(n)
    for j in moves:
        left = [bare[j], bare[j] - columns[j] @ payload][: 1 + (payload[0] > 0)]
        result[j] = min(float(np.median(np.abs(values))) for values in left) / size[j]
    return result


def _centred(sample: Sample, joint: int) -> FloatArray:
    torque = sample.torque[sample.moving[:, joint], joint]
    return torque - np.median(torque)


def _beside_friction(sample: Sample, joint: int, columns: FloatArray) -> FloatArray:
    """Return what no friction of a joint explains of columns (K, p), on its moving rows."""
    use = sample.moving[:, joint]
    v = sample.motion.velocity[use, joint]
    friction = np.stack([np.ones(v.size), np.sign(v), v], axis=1)
    return columns[use] - friction @ np.linalg.lstsq(friction, columns[use])[0]
