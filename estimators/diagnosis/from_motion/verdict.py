"""The verdict of an arm that tells no torque, with errors in rad."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.findings import (
    JointValues,
    findings_of,
    is_known,
    parameters_of,
    stated_values,
)
from estimators.diagnosis.from_motion.held_out import (
    LEAST,
    by_recording,
    resolution_of,
    rms_of_rows,
)
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import DRIFTS, most_torque, rows_of
from estimators.diagnosis.quantities import of_joints, to_interval
from estimators.diagnosis.settings import Z95
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import (
    Fit,
    Identified,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
)
from limo_driver.model.units import unit_of
from limo_driver.physics import DcMotor, Simulation
from limo_driver.recordings.channels import TORQUE, VELOCITY, drifting

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from estimators.diagnosis.from_motion.fitting.joint import JointFit
    from estimators.diagnosis.from_motion.held_out import DriveEvidence
    from estimators.diagnosis.from_motion.suspects import Suspect
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, IntArray

_POSES: Final = 2000  # tried for the one that loads a joint most
_WORTH: Final = 0.01  # [rad], sag below which nothing is said
_EXPLAINS: Final = {  # what explains the motion as well as a constant does
    "kp": "dry friction",
    "kv": "friction",
    "gain": "friction",
    "delay": "damping",
    "inertia": "damping",
}


def verdict_of(
    stated: Simulation,
    given: Simulation,
    evidence: DriveEvidence,
    before: FloatArray,
    after: FloatArray,
    notes: tuple[str, ...],
    hidden: Iterable[tuple[str, str]],
) -> Verdict:
    """Return the verdict.

    Args:
        stated: The simulation as it was given.
        given: The same with a servo at each joint.
        evidence: What was identified.
        before: Free-running errors of the held-out rows, as given, (K, n) [rad].
        after: The same with what was identified.
        notes: To be told.
        hidden: Effects that these recordings cannot show, and why.
    """
    final, recordings, unseen = evidence.final, evidence.recordings, evidence.unseen
    rmse_before, rmse_after = (np.sqrt(np.mean(e**2, axis=0)) for e in (before, after))
    step = np.array([resolution_of(recordings, j) for j in range(given.model.n)])
    floor = step / np.sqrt(12.0)  # what reading in steps errs by
    reducible = float(np.sum(np.maximum(rmse_before**2 - floor**2, 0.0)))
    removed = float(np.sum(rmse_before**2) - np.sum(rmse_after**2)) / max(reducible, LEAST)
    joints = JointValues.of_all(stated, given, evidence)
    findings = findings_of(given, evidence, joints, reducible)
    above, left = (_above(errors, unseen, step) for errors in (before, after))
    summary = "consistent" if not findings else "partly_explained" if left.size else "explained"
    if findings and removed <= 0.0:
        summary = "unexplained"
    rows = [len(r) for r in unseen]
    blocks = by_recording(before, after, rows, floor)
    as_given = loaded_joints(given.body, evidence.unseen)
    (step_before, torque_before), (step_after, torque_after) = (
        rms_of_rows(parts, constants)
        for parts, constants in (
            (as_given, list(rows_of(given))),
            (evidence.first.parts(given), [fit.row for fit in evidence.proof.fits]),
        )
    )
    return Verdict(
        verdict=summary,
        findings=findings,
        unexplained=Unexplained(
            tuple(int(j) + 1 for j in left),
            tuple(
                float(min(1.0, rmse_after[j] ** 2 / max(rmse_before[j] ** 2, LEAST))) for j in left
            ),
        ),
        not_observable=tuple(
            NotObservable(effect, reason)
            for effect, reason in (
                *undecided(final, min(r.rate for r in recordings)),
                *hidden,
            )
        ),
        next_motion=None,
        fit=Fit(
            tuple(rmse_before.tolist()),
            tuple(rmse_after.tolist()),
            tuple(floor.tolist()),
            removed,
            blocks,
            above_floor=tuple((above + 1).tolist()),
            still_above=tuple((left + 1).tolist()),
            unit=_unit(given),
            one_step_rmse_before=step_before,
            one_step_rmse_after=step_after,
            inverse_dynamics_rmse_before=torque_before,
            inverse_dynamics_rmse_after=torque_after,
        ),
        rows=RowCount(
            used=sum(map(len, recordings)),
            left_out={item.reason: len(item.rows) for r in recordings for item in r.left_out},
            total=sum(map(len, recordings)),
            held_out=sum(rows),
            judged=(sum(rows),) * given.model.n,
        ),
        notes=notes,
        identified=tuple(
            Identified(effect, joint, parameters_of(fit, kinds[effect]))
            for joint, fit in enumerate(final.fits, start=1)
            for kinds in [c.kinds_of(slides=given.model.sliding[joint - 1])]
            for effect in c.USUAL
            if is_known(fit, kinds[effect])
        ),
        values=stated_values(stated, evidence, joints, step),
        joint_names=given.model.joint_names,
        sliding=given.model.sliding,
    )


def _above(errors: FloatArray, recordings: Sequence[Recording], step: FloatArray) -> IntArray:
    """Return the joints (0-based) at which errors are more than a step of the encoder.

    Where a recording begins to be held out, the arm moves, at a speed that no free run knows. A
    joint whose positions never change tells no step of its encoder, and so no floor.

    Args:
        errors: Of all rows held out, (K, n) [rad].
        recordings: They are of.
        step: Of each encoder, (n,) [rad].
    """
    late = np.concatenate([r.time - r.time[0] > WORDING.from_start for r in recordings])
    rows = errors[late] if late.any() else errors
    size = np.sqrt(np.mean(rows**2, axis=0))
    return np.flatnonzero((step > 0.0) & (size > step))


def _unit(given: Simulation) -> str:
    """Return the unit of errors: of a whole run, or of as long as what drifts has."""
    joints = drifting(given.channels)
    unit = unit_of("rad", given.model.sliding)
    if not joints:
        return unit
    where = "" if len(joints) == given.model.n else f" at {of_joints(joints)}"
    return f"{unit} in {DRIFTS:g} s{where}"


def sags(found: DriveIdentification) -> tuple[str, ...]:
    """Say how far joints of a known gain sag under the arm's own weight, and what would help."""
    full, sliding = full_load(found.simulation.body), found.simulation.model.sliding
    sentences: list[str] = []
    for j, (fit, load) in enumerate(zip(found.fits, full.tolist(), strict=True), start=1):
        kp = c.value_in(c.geared(fit.row), "kp")
        shown = kp > 0.0 and found.scaled[j - 1] and found.moved[j - 1]
        if shown and is_known(fit, c.KINDS["position_servo"]) and load / kp > _WORTH:
            reach = float(np.exp(Z95 * fit.deviation["kp"]))
            sag, low, high = to_interval(load / kp, load / kp / reach, load / kp * reach)
            far, push, gain = (unit_of(u, sliding, j - 1) for u in ("rad", "N m", "N m/rad"))
            sentences.append(
                f"Joint {j} sags {sag} {far} (95 % interval {low} to {high} {far}) at full reach: "
                f"its P gain of {kp:.1f} {gain} is low for {load:.2f} {push}; with twice the gain "
                f"it would be {load / kp / 2:.3f} {far}."
            )
    return tuple(sentences)


def plays(fits: Iterable[JointFit], sliding: Sequence[bool] = ()) -> tuple[str, ...]:
    """Say how far joints can be moved by hand while their servos stand."""
    gaps = [c.value_in(c.geared(fit.row), "play") for fit in fits]
    return tuple(
        f"Joint {j} has {gap:.4f} {unit_of('rad', sliding, j - 1)} of play between motor and joint."
        for j, gap in enumerate(gaps, start=1)
        if gap > 0.0
    )


def full_load(body: RobotModel) -> FloatArray:
    """Return the largest gravity torque of each joint within its limits, (n,) [N m]."""
    limits = body.limits
    low, high = np.maximum(limits.position_min, -np.pi), np.minimum(limits.position_max, np.pi)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, body.n))
    return np.abs(body.gravity_torque(poses)).max(axis=0)


def undecided(found: DriveIdentification, rate: float) -> Iterator[tuple[str, str]]:
    """Yield effects and why these recordings do not show them."""
    for name, other in _EXPLAINS.items():
        if joints := [j for j, own in found.undecided if own == name]:
            yield (
                c.constant_of(name).effect,
                f"{name} of {of_joints(joints)} is not decidable at this rate ({rate:.0f} Hz): "
                f"{other} explains the motion as well",
            )
    for drive, light in _by_drive(found, _weightless(found)):
        yield (
            drive,
            f"gravity never loads {of_joints(light)}: {_gains(found, light)} is known there in "
            "ratio to friction, damping and inertia alone",
        )
    for drive, still in _by_drive(found, _still(found)):
        yield drive, f"no command moves {of_joints(still)}: its drive does not show"


def not_shown(given: Simulation, told: Sequence[int], *, stated: bool) -> Iterator[tuple[str, str]]:
    """Yield effects that no recording of this arm with these drives shows, and why.

    Args:
        given: With a servo for each joint.
        told: Joints whose sign gravity tells, 1-based.
        stated: Whether the drives are those that the arm has.
    """
    untold = [j for j in range(1, given.model.n + 1) if j not in told]
    if untold:
        yield (
            "joint_sign",
            f"gravity hardly loads {of_joints(untold)}: whether "
            "positions and commands count against the description is not decidable there",
        )
    if stated and drifting(given.channels):
        yield "supply_sag", "what drives draw from the supply is known of servos of position alone"
    elif stated and not np.isfinite(most_torque(rows_of(given))).all():
        yield (
            "supply_sag",
            "the drives state no `torque_limit`: how far the supply is loaded is not known",
        )


def about_drift(given: Simulation) -> tuple[str, ...]:
    """Say how errors are told where commands are velocities or torques.

    Args:
        given: With a drive for each joint.
    """
    channels = list(enumerate(given.channels, start=1))
    groups = {
        what: [j for j, name in channels if name == kind.name]
        for what, kind in (("Velocities", VELOCITY), ("Torques", TORQUE))
    }
    return tuple(
        f"{what} are commanded at {of_joints(joints)}, and where these lead drifts from "
        f"where the joint was: each {DRIFTS:g} s it is put back there, and its errors are of the "
        "position until then."
        for what, joints in groups.items()
        if joints
    )


def about_motors(stated: Simulation) -> tuple[str, ...]:
    """Say what motion shows of stated motors.

    Args:
        stated: As it was given.
    """
    joints = [drive.joint for drive in stated.drives if isinstance(drive, DcMotor)]
    if not joints:
        return ()
    return (
        f"Of the motor of {of_joints(joints)}, motion shows the torque at rest and the speed "
        "without load alone: kt, resistance, supply and gear are believed, fitted and told as far "
        "as these two go.",
    )


def about_counting(one: Suspect) -> str:
    """Say how recordings count against the description."""
    joint = (one.joint or 0) + 1
    if one.other is not None:
        return (
            f"Columns of joints {joint} and {one.other + 1} are exchanged, positions and commands; "
            "the improved simulation is of recordings in which they are not."
        )
    return (
        f"position_{joint} and command_{joint} count against the description; the improved "
        "simulation is of recordings in which both have the other sign."
    )


def about_scale(final: DriveIdentification, *, stated: bool) -> tuple[str, ...]:
    """Say at which joints only ratios are known, and of which nothing is.

    Args:
        final: What was identified.
        stated: Whether that began with the stated drives.
    """
    sentences = list[str]()
    if light := _weightless(final):
        scale = (
            "their scale is that of all that is stated"
            if stated
            else f"{_gains(final, light)} is taken from the other joints"
            if any(final.scaled)
            else f"{_gains(final, light)} is that of a usual servo, which nothing speaks for"
        )
        sentences.append(
            f"Gravity never loads {of_joints(light)}: of {_gains(final, light)}, friction, "
            f"damping and inertia only the ratios are known there; {scale}."
        )
    if still := _still(final):
        taken = "the stated values are kept" if stated else "the mean of the other joints is taken"
        sentences.append(
            f"No command moves {of_joints(still)}: nothing is known of the drives there, and "
            f"{taken}."
        )
    return tuple(sentences)


def _gains(found: DriveIdentification, joints: Sequence[int]) -> str:
    """Return the gains that servos of some joints have, 1-based."""
    return " or ".join(dict.fromkeys(c.gain_of(found.fits[j - 1].row) for j in joints))


def _by_drive(found: DriveIdentification, joints: Sequence[int]) -> Iterator[tuple[str, list[int]]]:
    """Yield each kind of drive that some joints have, 1-based, and which of them have it."""
    kinds = {j: c.constant_of(c.gain_of(found.fits[j - 1].row)).effect for j in joints}
    for kind in dict.fromkeys(kinds.values()):
        yield kind, [j for j in joints if kinds[j] == kind]


def _weightless(found: DriveIdentification) -> list[int]:
    """Return joints that move, and get no scale from gravity, 1-based."""
    every = enumerate(zip(found.scaled, found.moved, strict=True), start=1)
    return [j for j, (scaled, moved) in every if moved and not scaled]


def _still(found: DriveIdentification) -> list[int]:
    """Return joints that no command moves, 1-based."""
    return [j for j, moved in enumerate(found.moved, start=1) if not moved]
