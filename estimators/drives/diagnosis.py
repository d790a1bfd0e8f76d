"""Diagnosis of an arm that tells no torque: its drives and friction, and what each of them removes.

The score is what users see: the position error of the closed loop simulated forward from the
commands alone, on motion that nothing was fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.stages import quiet
from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    Identified,
    Interval,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from estimators.drives.against_stated import (
    FOUND,
    StatedArm,
    is_stated,
    proven,
    stated_arm,
    with_intervals,
)
from estimators.drives.arm_findings import as_described, shared_finding, without
from estimators.drives.arm_loads import ArmLoads
from estimators.drives.checks import check_commands
from estimators.drives.conventions import conventions_of
from estimators.drives.fit import COULOMB, DAMPING, errors, value_in, with_values
from estimators.drives.forward import commands_of, free_run
from estimators.drives.identification import SURE, identify_drives, with_servos
from estimators.drives.one_joint import loaded_joints
from estimators.drives.plant import rows_of
from estimators.drives.result import DriveDiagnosis
from estimators.drives.suspects import COUNTED, OFFSET, leaving_out, search
from estimators.drives.timing import check_timing
from estimators.drives.wording import not_shown, sags, undecided
from estimators.recordings import check_different
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from estimators.diagnosis.stages import Progress
    from estimators.drives.fit import JointFit
    from estimators.drives.identification import DriveIdentification
    from estimators.drives.one_joint import LoadedJoint
    from estimators.drives.suspects import Suspect
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_SEEN: Final = 0.1  # of a joint's squared held-out error, that a finding has to remove at least
_CONFIDENT: Final = 0.95  # share of resampled held-out motion in which it has to
_BLOCKS, _DRAWN = 20, 1000  # of held-out motion, and resamples of them
_NEAR_FLOOR: Final = 3.0  # floors, below which nothing is left to be explained
_LEAST: Final = 1e-9
_TURNS: Final = 2  # findings of how joints count, after each of which all is looked for anew

# What is said of each: the effect, the constants that are its values, with their units.
_KINDS: Final[dict[str, dict[str, str]]] = {
    "position_servo": {"kp": "N m/rad"},
    "drive_delay": {"delay": "s"},
    "coulomb_friction": {COULOMB: "N m"},
    "viscous_friction": {DAMPING: "N m s/rad"},
    "armature": {"inertia": "kg m^2"},
    "torque_offset": {"offset": "N m"},
    "stribeck_friction": {"stribeck": "N m", "v_s": "rad/s"},
    "load_dependent_friction": {"by_load": "1"},
    "dead_band": {"dead_band": "rad"},
    "profile_speed": {"speed": "rad/s"},
    "spring_load": {"spring": "N m/rad"},
    "backlash": {"play": "rad"},
    "gear_ratio": {"gear": "1"},
    "integral_gain": {"ki": "N m/(rad s)"},
}
_NAMES: Final = {
    COULOMB: "tau_c",
    DAMPING: "f_v",
    "by_load": "coefficient",
    "stribeck": "tau_s",
    "spring": "stiffness",
    "play": "gap",
    "gear": "ratio",
}


def diagnose_drives(
    simulation: Simulation, recordings: Sequence[Recording], progress: Progress = quiet
) -> DriveDiagnosis:
    """Find which drives and which friction an arm has, from commands and positions alone.

    Args:
        simulation: The rigid body, and what is believed of the drives.
        recordings: One or more of that arm, with commands.
        progress: Told the stage and the part that is done.

    Returns:
        The verdict, and a simulation that can be run forward from commands.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: A recording is of another robot, given twice, or its commands are not
            set-points of its joints in rad.
    """
    progress("reading motion", 0.0)
    if not recordings:
        raise RecordingError("no recording to diagnose")
    for recording in recordings:
        recording.check_robot(simulation.model)
    check_different(recordings)
    odd = check_commands(recordings)
    given = with_servos(simulation)
    odd = (*odd, *check_timing(given, recordings))
    seen, unseen = split(recordings)
    progress("fitting drives and friction", 0.05)
    stated = is_stated(simulation, seen)
    evidence = (
        _beside_stated(given, seen, unseen, recordings, progress)
        if stated
        else _identified(given, seen, unseen, recordings, progress)
    )
    proof, final = evidence.proof, evidence.final
    before = _errors(given, unseen)
    after = _errors(proof.simulation, evidence.unseen)
    progress("comparing", 0.9)
    delay = float(np.median([fit.value("delay") for fit in final.fits]))
    conventions = conventions_of(given.body, evidence.recordings, delay)
    notes = (
        *odd,
        conventions.sentence(),
        *(_about_counting(one) for one in evidence.turned),
        *_about_scale(final),
        *sags(final),
    )
    hidden = not_shown(given, conventions.joints, stated=stated)
    verdict = _verdict(simulation, given, evidence, before, after, notes, hidden)
    progress("done", 1.0)
    return DriveDiagnosis(
        verdict,
        simulation,
        final.simulation,
        tuple(recordings),
        held_out_error=(
            tuple(np.abs(before).mean(axis=0).tolist()),
            tuple(np.abs(after).mean(axis=0).tolist()),
        ),
    )


@dataclass(frozen=True)
class _Evidence:
    """What was identified, from which recordings, and what of it all joints feel."""

    proof: DriveIdentification  # from a part of the recordings
    final: DriveIdentification  # from all
    recordings: tuple[Recording, ...]  # as the description counts
    unseen: tuple[Recording, ...]
    turned: tuple[Suspect, ...] = ()  # joints that count against the description
    shared: tuple[StatedArm, StatedArm] | None = None  # of the same two, where drives are stated
    counted: _Evidence | None = None  # with joints turned, as they were recorded

    def parts(self, given: Simulation) -> list[list[LoadedJoint]]:
        """Return the held-out motion of each joint, loaded as was proven."""
        if self.shared is None:
            return loaded_joints(given.body, self.unseen)
        loads = ArmLoads(given.body, self.unseen, rows_of(given))
        return loads.parts(self.shared[0].change)

    def of_the_arm(self, given: Simulation) -> Iterator[tuple[float, Finding]]:
        """Yield what all joints feel, with the squared held-out error that each removes."""
        if self.counted is not None:
            yield from self.counted.of_the_arm(given)
        if self.shared is None:
            return
        loads = ArmLoads(given.body, self.unseen, rows_of(given))
        proof, final = self.shared
        rows = [fit.row for fit in self.proof.fits]
        full = _squares(loads.parts(proof.change), rows)
        noise = np.array([max(float(np.median(x)), _LEAST) for x in full])
        for one in proof.suspects:
            if not one.shared or (self.turned and one.effect in COUNTED):
                continue
            less = _squares(loads.parts(without(proof.change, one)), rows)
            confidence = removes(
                np.concatenate([x / s for x, s in zip(full, noise, strict=True)]),
                np.concatenate([x / s for x, s in zip(less, noise, strict=True)]),
            )
            if confidence < _CONFIDENT:
                continue
            lost = sum(float(x.mean()) for x in less) - sum(float(x.mean()) for x in full)
            rmse = [tuple(float(np.sqrt(x.mean())) for x in squares) for squares in (less, full)]
            yield lost, shared_finding(one, final, confidence, BeforeAfter(*rmse))


def _squares(
    parts: Sequence[Sequence[LoadedJoint]], rows: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return squared errors of each joint [rad²]."""
    return [errors(own, row) ** 2 for own, row in zip(parts, rows, strict=True)]


def _identified(
    given: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress,
) -> _Evidence:
    """Identify drives of which nothing is believed, from a part of the recordings and from all."""
    proof = identify_drives(given, seen, intervals=False)
    progress("fitting to all motion", 0.5)
    final = identify_drives(given, recordings)
    return _Evidence(proof, final, tuple(recordings), tuple(unseen))


def _beside_stated(
    given: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress,
    turns: int = 0,
) -> _Evidence:
    """Look for what the arm has beyond what is stated, and prove it on a part of the recordings."""
    tick = max(_resolution(recordings, j) for j in range(given.model.n))
    loads = ArmLoads(given.body, recordings, rows_of(given))
    searched = search(loads, rows_of(given), given.tolerances.drive, tick)
    arm = stated_arm(given, searched, searched.fit)
    if (other := arm.counted_otherwise) and turns < _TURNS:
        as_recorded = tuple(unseen)
        seen, unseen, every = (
            [as_described(r, arm.change) for r in x] for x in (seen, unseen, recordings)
        )
        evidence = _beside_stated(given, seen, unseen, every, progress, turns + 1)
        counted = _Evidence(
            arm.identified,
            arm.identified,
            tuple(recordings),
            as_recorded,
            shared=(arm, arm),
            counted=evidence.counted,
        )
        return replace(evidence, turned=(*evidence.turned, *other), counted=counted)
    progress("proving on held-out motion", 0.6)
    final = with_intervals(given, searched)
    while (doubtful := final.doubtful) is not None:
        searched = leaving_out(searched, doubtful, tick)
        final = with_intervals(given, searched)
    proof = proven(given, seen, searched, tick)
    return _Evidence(
        proof.identified, final.identified, tuple(recordings), tuple(unseen), shared=(proof, final)
    )


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Return what is fitted to and what is held out: every other recording, or halves of one.

    Recordings go by the speed of their commands, and the fastest is fitted to: slow motion does not
    show what limits a servo's speed, and predicts none of a fast one.
    """
    if len(recordings) > 1:
        by_speed = sorted(recordings, key=_speed, reverse=True)
        return by_speed[0::2], by_speed[1::2]
    (one,) = recordings
    middle = len(one) // 2
    return [one[:middle]], [one[middle:]]


def _speed(recording: Recording) -> float:
    """Return how fast commands move, as their root mean square [rad/s]."""
    change = np.diff(commands_of(recording), axis=0) / np.diff(recording.time)[:, None]
    return float(np.sqrt(np.mean(change**2)))


def _errors(simulation: Simulation, recordings: Sequence[Recording]) -> FloatArray:
    """Return free-running position errors of all rows, (K, n) [rad]."""
    return np.concatenate([free_run(simulation, r) - r.position for r in recordings])


def _verdict(
    stated: Simulation,
    given: Simulation,
    evidence: _Evidence,
    before: FloatArray,
    after: FloatArray,
    notes: tuple[str, ...],
    hidden: Iterable[tuple[str, str]],
) -> Verdict:
    final, recordings, unseen = evidence.final, evidence.recordings, evidence.unseen
    rmse_before, rmse_after = (np.sqrt(np.mean(e**2, axis=0)) for e in (before, after))
    floor = np.array([_resolution(recordings, j) for j in range(given.model.n)]) / np.sqrt(12.0)
    reducible = float(np.sum(np.maximum(rmse_before**2 - floor**2, 0.0)))
    removed = float(np.sum(rmse_before**2) - np.sum(rmse_after**2)) / max(reducible, _LEAST)
    findings = _findings(stated, given, evidence, reducible)
    left = np.flatnonzero(rmse_after > _NEAR_FLOOR * floor)
    summary = "consistent" if not findings else "partly_explained" if left.size else "explained"
    if findings and removed <= 0.0:
        summary = "unexplained"
    rows = [len(r) for r in unseen]
    blocks = _by_recording(before, after, rows, floor)
    return Verdict(
        verdict=summary,
        findings=findings,
        unexplained=Unexplained(
            tuple(int(j) + 1 for j in left),
            tuple(
                float(min(1.0, rmse_after[j] ** 2 / max(rmse_before[j] ** 2, _LEAST))) for j in left
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
            unit="rad",
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
            Identified(effect, joint, _parameters(fit, _KINDS[effect]))
            for joint, fit in enumerate(final.fits, start=1)
            for effect in list(_KINDS)[:6]
            if _is_known(fit, _KINDS[effect])
        ),
    )


def _findings(
    stated: Simulation,
    given: Simulation,
    evidence: _Evidence,
    reducible: float,
) -> tuple[Finding, ...]:
    """Return what differs from what is stated, and what each takes of the held-out error."""
    proof, final = evidence.proof, evidence.final
    parts, nominal = evidence.parts(given), rows_of(given)
    served = {drive.joint for drive in stated.drives}
    period = max(1.0 / r.rate for r in evidence.recordings)
    found = [*evidence.of_the_arm(given)]
    for j, fit in enumerate(final.fits):
        best = proof.fits[j].row
        squared = errors(parts[j], best) ** 2
        full = float(squared.mean())
        for effect, units in _KINDS.items():
            extra = effect in final.extras[j]
            wrong = j + 1 in served and _is_wrong(fit, nominal[j], units, stated, period)
            size = next(iter(units))  # others give its shape, which matters less
            shown = effect in proof.extras[j] and _is_known(fit, {size: ""})
            if not (shown if extra else wrong):
                continue
            without = errors(parts[j], _without(best, nominal[j], effect, units)) ** 2
            lost = float(without.mean()) - full
            confidence = removes(squared, without)
            if confidence < _CONFIDENT:
                continue
            n = given.model.n
            rmse = np.zeros((2, n))
            rmse[:, j] = np.sqrt([full + lost, full])
            finding = Finding(
                effect=effect,
                kind="missing" if extra else "wrong_parameter",
                joints=(j + 1,),
                equivalent=("asymmetric_friction",) if effect == "torque_offset" else (),
                confidence=confidence,
                parameters=_parameters(fit, units),
                where=Where(),
                share=lost,
                heldout_rmse=BeforeAfter(tuple(rmse[0].tolist()), tuple(rmse[1].tolist())),
                evidence=(
                    f"without it, the held-out error of joint {j + 1} is "
                    f"{np.sqrt(full + lost):.4f} rad, with it {np.sqrt(full):.4f} rad"
                ),
            )
            found.append((lost, finding))
    total = max(sum(lost for lost, _ in found), reducible, _LEAST)
    ranked = sorted(found, key=lambda item: -item[0])
    return tuple(replace(finding, share=lost / total) for lost, finding in ranked)


def _is_wrong(
    fit: JointFit,
    nominal: FloatArray,
    units: dict[str, str],
    stated: Simulation,
    period: float,
) -> bool:
    """Say whether stated values are beyond their tolerance."""
    tolerance = stated.tolerances.drive
    for name in units:
        if not _is_known(fit, {name: ""}):
            return False
        value, believed = fit.value(name), value_in(nominal, name)
        if name == DAMPING:
            believed += value_in(nominal, "kd")
        if name == "delay" and abs(value - believed) < period:
            return False  # no recording tells delays within a sample
        if not np.isfinite(believed):  # stated to be without limit
            return True
        deviation = fit.deviation[name]
        if name == "offset":
            if abs(value - believed) > FOUND * float(np.hypot(deviation, OFFSET)):
                return True
        else:
            apart = abs(np.log(max(value, _LEAST) / max(believed, 1e-3 * value, _LEAST)))
            if apart > FOUND * float(np.hypot(deviation, tolerance)):
                return True
    return False


def _is_known(fit: JointFit, units: dict[str, str]) -> bool:
    """Say whether values were fitted, and the motion shows them."""
    return all(0.0 < fit.deviation.get(name, 0.0) < SURE for name in units)


def _without(
    row: FloatArray, nominal: FloatArray, effect: str, units: dict[str, str]
) -> FloatArray:
    """Return the constants with those of one effect as they are stated."""
    values = {name: value_in(nominal, name) for name in units}
    if effect == "viscous_friction":
        values[DAMPING] += value_in(nominal, "kd")
    if effect == "stribeck_friction":
        values["v_s"] = 1.0
    return with_values(row, values)


def removes(squared: FloatArray, without: FloatArray) -> float:
    """Return in which share of resampled motion a finding removes a tenth of the error, or more.

    Args:
        squared: Errors of the held-out rows with it, (K,) [rad²].
        without: The same without it.
    """
    gain = without - squared - _SEEN * without
    blocks = np.array([block.sum() for block in np.array_split(gain, _BLOCKS)])
    drawn = np.random.default_rng(0).integers(0, _BLOCKS, (_DRAWN, _BLOCKS))
    return min(0.99, float(np.mean(blocks[drawn].sum(axis=1) > 0.0)))


def _parameters(fit: JointFit, units: dict[str, str]) -> dict[str, Interval]:
    return {
        _NAMES.get(name, name): Interval(fit.value(name), unit, fit.interval(name))
        for name, unit in units.items()
    }


def _resolution(recordings: Sequence[Recording], j: int) -> float:
    """Return the step of an encoder [rad]; 0 if it has none that shows."""
    steps = np.concatenate([np.abs(np.diff(r.position[:, j])) for r in recordings])
    steps = steps[steps > _LEAST]
    return float(np.percentile(steps, 1)) if steps.size else 0.0


def _by_recording(
    before: FloatArray, after: FloatArray, rows: Sequence[int], floor: FloatArray
) -> tuple[float, float]:
    """Return the 95 % interval of what is removed, from resampled recordings held out."""
    bounds = np.cumsum([0, *rows])
    gain = np.add.reduceat((before**2 - after**2).sum(axis=1), bounds[:-1])
    reducible = np.add.reduceat((before**2 - floor**2).sum(axis=1), bounds[:-1])
    drawn = np.random.default_rng(0).integers(0, len(rows), (1000, len(rows)))
    share = gain[drawn].sum(axis=1) / np.maximum(reducible[drawn].sum(axis=1), _LEAST)
    low, high = np.percentile(share, (2.5, 97.5))
    return float(low), float(high)


def _about_counting(one: Suspect) -> str:
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


def _about_scale(final: DriveIdentification) -> tuple[str, ...]:
    joints = [j for j, scaled in enumerate(final.scaled, start=1) if not scaled]
    if not joints:
        return ()
    named = ", ".join(map(str, joints))
    return (
        f"Gravity never loads joint{'s' * (len(joints) > 1)} {named}: of kp, friction, damping and "
        "inertia only the ratios are known there; kp is taken from the other joints.",
    )
