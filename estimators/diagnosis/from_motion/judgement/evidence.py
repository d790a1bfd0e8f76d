"""What was identified from a part of the recordings and from all, and what all joints feel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.joint import NORMAL, errors
from estimators.diagnosis.from_motion.hypotheses.suspects import COUNTED
from estimators.diagnosis.from_motion.judgement.held_out import CONFIDENT, LEAST, removes
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads, loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from estimators.diagnosis.from_motion.hypotheses.stated import StatedArm
    from estimators.diagnosis.from_motion.hypotheses.suspects import Suspect
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

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
            every = [_squares(fold, loads, one) for fold, loads in folds]
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


def _squares(fold: Fold, loads: ArmLoads, less: Suspect | None) -> list[FloatArray]:
    """Return squared errors of each joint on held-out motion [rad²], without one suspect."""
    change = ArmChange.none(loads.n) if fold.arm is None else fold.arm.change
    parts = loads.parts(change if less is None else without(change, less))
    rows = [fit.row for fit in fold.identified.fits]
    return [errors(own, row) ** 2 for own, row in zip(parts, rows, strict=True)]


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
    compared = f"with an offset of {zero:.3g} rad, as stated" if other else "without it"
    worst = max(range(len(rmse.after)), key=lambda j: rmse.before[j] - rmse.after[j])
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
            f"{compared}, the held-out error of joint {worst + 1} is {rmse.before[worst]:.4f} rad, "
            f"with it {rmse.after[worst]:.4f} rad"
        ),
    )


def _carrying(one: Suspect, arm: StatedArm) -> int | None:
    """Return the joint, 0-based, that moves what carries a body; None of the last link's."""
    own = arm.identified.simulation.model.linkage.own.tolist()
    return own.index(one.carrier) if one.carrier in own else None


def _parameters(one: Suspect, arm: StatedArm, zero: float) -> dict[str, Interval]:
    def of(name: str) -> tuple[float, tuple[float, float]]:
        value, reach = arm.change.value(name), NORMAL * arm.shared[name]
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
        return {"offset": Interval(zero + offset, "rad", (zero + low, zero + high), zero or None)}
    if one.effect == "supply_sag":
        sag, interval = of("sag")
        return {"sag": Interval(sag, "1", interval)}
    return {}
