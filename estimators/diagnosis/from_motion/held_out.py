"""Motion that is held out, errors there, and what a finding removes of them.

Errors that no feedback of the simulation adds to: of one step, and of inverse dynamics.

A free run from the commands alone adds up what is amiss. Here the joint is simulated from each
recorded row to the next, position and velocity as recorded; and the torque that its recorded
acceleration needs is compared with that of drive and friction there.

What was identified from a part of the recordings and from all, and what all joints feel.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.joint import errors
from estimators.diagnosis.from_motion.simulation.free_run import commands_of, restarted_run
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads, loaded_joints
from estimators.diagnosis.from_motion.simulation.one_joint import RowErrors
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.from_motion.suspects import COUNTED
from estimators.diagnosis.settings import LEVEL, MATTERS, TAIL, Z95
from estimators.diagnosis.settings.judgement import CONFIDENCE
from estimators.diagnosis.settings.residuals import ELSEWHERE, HELD_OUT
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where
from limo_driver.model.units import unit_of
from limo_driver.recordings.channels import TORQUE, VELOCITY, commanded_by

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from estimators.diagnosis.from_motion.stated import StatedArm
    from estimators.diagnosis.from_motion.suspects import Suspect
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

LEAST: Final = 1e-9
CONFIDENT: Final = LEVEL  # share of resampled held-out motion in which a finding has to remove it
_REST: Final = 0.1  # [s] before and after a cut, in which a joint moves little


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Return what is fitted to and what is held out: every other recording, or halves of few.

    Recordings go by the speed of their commands, and the fastest is fitted to: slow motion does not
    show what limits a servo's speed, and predicts none of a fast one. Few recordings may each be of
    another kind of motion, and what one of them alone shows would never be proven by the others:
    each is cut in two, where its joints are slowest around its middle.
    """
    if len(recordings) >= ELSEWHERE.turns:
        by_speed = sorted(recordings, key=_speed, reverse=True)
        return by_speed[0::2], by_speed[1::2]
    at = [_cut(recording) for recording in recordings]
    pairs = [(r[:middle], r[middle:]) for r, middle in zip(recordings, at, strict=True)]
    return [first for first, _ in pairs], [second for _, second in pairs]


def _cut(recording: Recording) -> int:
    """Return the row around the middle at which all joints are slowest."""
    third, half = len(recording) // 3, max(1, round(_REST * recording.rate))
    moved = np.abs(np.diff(recording.position, axis=0)).sum(axis=1)
    around = np.convolve(moved, np.ones(2 * half), mode="same")[third : 2 * third]
    return third + int(np.argmin(around)) if around.size else len(recording) // 2


def _speed(recording: Recording) -> float:
    """Return how fast commands move, as their root mean square [rad/s]; of torques, the joints."""
    pushed, command = commanded_by(TORQUE, recording.channels), commands_of(recording)
    moved = np.where(pushed, recording.position, command)
    change = np.diff(moved, axis=0) / np.diff(recording.time)[:, None]
    change = np.where(commanded_by(VELOCITY, recording.channels), command[:-1], change)
    return float(np.sqrt(np.mean(change**2)))


def position_errors(simulation: Simulation, recordings: Sequence[Recording]) -> FloatArray:
    """Return free-running position errors of all rows, (K, n) [rad].

    What is told no positions is put back where it was, as often as its drive asks for.
    """
    return np.concatenate([restarted_run(simulation, r) - r.position for r in recordings])


def rms_of_rows(
    parts: Sequence[Sequence[LoadedJoint]], rows: Sequence[FloatArray]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the RMS errors of one step (n,) [rad] and of inverse dynamics (n,) [N m].

    Args:
        parts: Held-out stretches of each joint.
        rows: Constants of each joint.
    """
    found = [row_errors(own, row) for own, row in zip(parts, rows, strict=True)]
    step, torque = (
        tuple(float(np.sqrt(np.mean(error**2))) for error in own)
        for own in ([x.step for x in found], [x.torque for x in found])
    )
    return step, torque


def removes(squared: FloatArray, without: FloatArray, folds: int = 1) -> float:
    """Return in which share of resampled motion a finding removes a tenth of the error, or more.

    Args:
        squared: Errors of the held-out rows with it, (K,) [rad²].
        without: The same without it.
        folds: Parts of the motion among the rows, that were held out in turn.
    """
    many, gain = 2 * HELD_OUT.blocks * folds, without - squared - MATTERS * without
    blocks = np.array([block.sum() for block in np.array_split(gain, many)])
    drawn = np.random.default_rng(0).integers(0, many, (HELD_OUT.resamples, many))
    return min(CONFIDENCE.highest, float(np.mean(blocks[drawn].sum(axis=1) > 0.0)))


def resolution_of(recordings: Sequence[Recording], j: int) -> float:
    """Return the step of an encoder [rad]; 0 if it has none that shows.

    The least by which positions change from row to row; of a joint that is told velocities, the
    least between any two of them: a wheel turns on, and by many steps of its encoder in each row.
    """
    rows = [
        np.sort(r.position[:, j]) if r.channels[j] == VELOCITY.name else r.position[:, j]
        for r in recordings
    ]
    steps = np.concatenate([np.abs(np.diff(values)) for values in rows])
    steps = steps[steps > LEAST]
    return float(np.percentile(steps, 1)) if steps.size else 0.0


def by_recording(
    before: FloatArray, after: FloatArray, rows: Sequence[int], floor: FloatArray
) -> tuple[float, float]:
    """Return the 95 % interval of what is removed, from resampled recordings held out."""
    bounds = np.cumsum([0, *rows])
    gain = np.add.reduceat((before**2 - after**2).sum(axis=1), bounds[:-1])
    reducible = np.add.reduceat((before**2 - floor**2).sum(axis=1), bounds[:-1])
    drawn = np.random.default_rng(0).integers(0, len(rows), (HELD_OUT.resamples, len(rows)))
    share = gain[drawn].sum(axis=1) / np.maximum(reducible[drawn].sum(axis=1), LEAST)
    low, high = np.quantile(share, (TAIL, 1 - TAIL))
    return float(low), float(high)


def row_errors(parts: Sequence[LoadedJoint], row: FloatArray) -> RowErrors:
    """Return the errors of a joint from each recorded row on.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint.
    """
    found = [part.errors_of_rows(row) for part in parts]
    return RowErrors(*(np.concatenate(own) for own in zip(*found, strict=True)))


_AXES: Final = "xyz"


@dataclass(frozen=True)
class Fold:
    """Motion that is held out, and what was identified from the rest."""

    identified: DriveIdentification
    unseen: tuple[Recording, ...]  # as the description counts
    arm: StatedArm | None = None  # what was identified, where drives are stated

    def parts(self, given: Simulation) -> list[list[LoadedJoint]]:
        """Return the held-out motion of each joint, loaded as was identified."""
        if self.arm is None:
            return loaded_joints(given.body, self.unseen)
        return self.loads(given).parts(self.arm.change)

    def loads(self, given: Simulation) -> ArmLoads:
        """Return the loads along the held-out motion."""
        return ArmLoads(given.body, self.unseen, rows_of(given))

    def squares(self, loads: ArmLoads, less: Suspect | None = None) -> list[FloatArray]:
        """Return squared errors of each joint along these loads [rad²], without one suspect."""
        change = ArmChange.none(loads.n) if self.arm is None else self.arm.change
        parts = loads.parts(change if less is None else without(change, less))
        rows = [fit.row for fit in self.identified.fits]
        return [errors(own, row) ** 2 for own, row in zip(parts, rows, strict=True)]


@dataclass(frozen=True)
class DriveEvidence:
    """What was identified, from which recordings, and what of it all joints feel."""

    proof: DriveIdentification  # from a part of the recordings
    final: DriveIdentification  # from all
    recordings: tuple[Recording, ...]  # as the description counts
    unseen: tuple[Recording, ...]
    turned: tuple[Suspect, ...] = ()  # joints that count against the description
    shared: tuple[StatedArm, StatedArm] | None = None  # of the same two, where drives are stated
    counted: DriveEvidence | None = None  # with joints turned, as they were recorded
    exchanged: tuple[Fold, ...] = ()  # parts of the motion, each held out in turn
    refitted: Mapping[tuple[int, str], FloatArray] = field(default_factory=dict)  # squared errors
    # there of a joint, 0-based, without an effect (K,) [rad²]
    zeros: tuple[float, ...] = ()  # stated ones, which recordings no longer have [rad]

    @property
    def first(self) -> Fold:
        """The motion that is held out of `proof`."""
        return Fold(self.proof, self.unseen, None if self.shared is None else self.shared[0])

    @property
    def folds(self) -> tuple[Fold, ...]:
        """The motion by which findings are judged: all of it, where each part is held out once.

        Half of a motion may hold a few rests of a joint alone, and says little of what acts there.
        """
        return self.exchanged or (self.first,)

    def of_the_arm(self, given: Simulation) -> Iterator[tuple[float, Finding]]:
        """Yield what all joints feel, with the squared held-out error that each removes."""
        if self.counted is not None:
            yield from self.counted.of_the_arm(given)
        if self.shared is None:
            return
        proof, final = self.shared
        folds = [(fold, fold.loads(given)) for fold in self.folds]

        def squares(one: Suspect | None) -> list[FloatArray]:
            """Return squared errors of each joint on all that is held out, without one suspect."""
            every = [fold.squares(loads, one) for fold, loads in folds]
            return [np.concatenate(own) for own in zip(*every, strict=True)]

        full = squares(None)
        noise = np.array([max(float(np.median(x)), LEAST) for x in full])
        for one in proof.suspects:
            if not one.shared or (self.turned and one.effect in COUNTED):
                continue
            less = squares(one)
            confidence = removes(
                np.concatenate([x / s for x, s in zip(full, noise, strict=True)]),
                np.concatenate([x / s for x, s in zip(less, noise, strict=True)]),
                len(folds),
            )
            if confidence < CONFIDENT:
                continue
            lost = sum(float(x.mean()) for x in less) - sum(float(x.mean()) for x in full)
            rmse = [tuple(float(np.sqrt(x.mean())) for x in own) for own in (less, full)]
            stated = self.zeros[one.joint] if self.zeros and one.joint is not None else 0.0
            yield lost, shared_finding(one, final, confidence, BeforeAfter(*rmse), stated)


def without(change: ArmChange, one: Suspect) -> ArmChange:
    """Return how an arm differs from its description, but for one suspect."""
    if one.effect in COUNTED:
        return one.counted(change)
    for name in one.names:
        change = change.with_value(name, 0.0)
    return change


def shared_finding(
    one: Suspect, arm: StatedArm, confidence: float, rmse: BeforeAfter, zero: float = 0.0
) -> Finding:
    """Return a finding of what all joints feel.

    Args:
        one: What it is.
        arm: The fit that has it.
        confidence: Share of resampled held-out motion in which it removes a tenth of the error.
        rmse: Held-out, of each joint [rad].
        zero: Stated one of its joint's encoder, to which another adds [rad].
    """
    other = one.effect == "encoder_offset" and zero != 0.0
    worst = max(range(len(rmse.after)), key=lambda j: rmse.before[j] - rmse.after[j])
    sliding = arm.identified.simulation.model.sliding
    far, own = unit_of("rad", sliding, worst), unit_of("rad", sliding, one.joint)
    compared = f"with an offset of {zero:.3g} {own}, as stated" if other else "without it"
    return Finding(
        effect=one.effect,
        kind="wrong_parameter" if other else "missing",
        joints=tuple(j + 1 for j in (one.joint, one.other, _carrying(one, arm)) if j is not None),
        equivalent=(),
        confidence=confidence,
        parameters=_parameters(one, arm, zero),
        where=Where(),
        share=0.0,
        heldout_rmse=rmse,
        evidence=(
            f"{compared}, the held-out error of joint {worst + 1} is {rmse.before[worst]:.4f} "
            f"{far}, with it {rmse.after[worst]:.4f} {far}"
        ),
    )


def _carrying(one: Suspect, arm: StatedArm) -> int | None:
    """Return the joint, 0-based, that moves what carries a body; None of the last link's."""
    own = arm.identified.simulation.model.linkage.own.tolist()
    return own.index(one.carrier) if one.carrier in own else None


def _parameters(one: Suspect, arm: StatedArm, zero: float) -> dict[str, Interval]:
    def of(name: str) -> tuple[float, tuple[float, float]]:
        value, reach = arm.change.value(name), Z95 * arm.shared[name]
        return value, (value - reach, value + reach)

    if one.effect == "payload":
        mass, interval = of("mass")
        centre = [of(f"com_{axis}") for axis in _AXES]
        return {
            "mass": Interval(mass, "kg", interval),
            "com": Interval(
                tuple(value for value, _ in centre), "m", tuple(own for _, own in centre)
            ),
        }
    if one.effect == "encoder_offset":
        offset, (low, high) = of(one.names[0])
        unit = unit_of("rad", arm.identified.simulation.model.sliding, one.joint)
        return {"offset": Interval(zero + offset, unit, (zero + low, zero + high), zero or None)}
    if one.effect == "supply_sag":
        sag, interval = of("sag")
        return {"sag": Interval(sag, "1", interval)}
    return {}
