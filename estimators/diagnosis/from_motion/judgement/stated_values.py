"""Stated values of drives and friction, and those that make the arm move as it was recorded.

A tolerance says how surprising it is that a value differs, never whether that is reported. It is
where it is sure, and where a tenth of the joint's reducible error goes with it on motion held out.
Where only several together take that much, the one that takes most is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from estimators.diagnosis.from_motion.fitting.joint import JointFit, errors
from estimators.diagnosis.from_motion.hypotheses.search import OFFSET
from estimators.diagnosis.from_motion.judgement.findings import (
    as_it_is_stated,
    is_known,
    is_wrong,
    lag_within,
)
from estimators.diagnosis.from_motion.judgement.held_out import CONFIDENT, LEAST, removes
from estimators.diagnosis.from_motion.simulation.constants import (
    DAMPING,
    KINDS,
    SIGNED,
    constant_of,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.settings.judgement import VALUES
from estimators.diagnosis.verdict import StatedValue
from limo_driver.physics import PositionServo, Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.diagnosis.from_motion.judgement.evidence import DriveEvidence
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray

SERVO: Final = PositionServo.name
_Change: TypeAlias = "Callable[[FloatArray], FloatArray]"  # of the constants of a joint


def stated_values(
    stated: Simulation, given: Simulation, evidence: DriveEvidence, floor: FloatArray
) -> tuple[StatedValue, ...]:
    """Return what is stated of drives and friction, and what fits, joint by joint.

    Args:
        stated: The simulation as it was given; of a joint without a drive, nothing is.
        given: The same with a drive at each joint.
        evidence: What was identified.
        floor: What the steps of the encoders make, (n,) [rad].
    """
    folds, final = evidence.folds, evidence.final
    parts = [fold.parts(given) for fold in folds]
    nominal, tolerances = rows_of(given), tolerances_of(given)
    period = max(1.0 / r.rate for r in evidence.recordings)
    found: list[StatedValue] = []
    for drive in stated.drives:
        j = drive.joint - 1
        if drive.channel is None or evidence.turned:
            continue
        motion = tuple(
            (own[j], fold.identified.fits[j].row) for own, fold in zip(parts, folds, strict=True)
        )
        joint = _Joint(
            j, stated, final.fits[j], nominal[j], tolerances[j], motion, float(floor[j]), period,
            frozenset(drive.tolerances), final.extras[j],
        )  # fmt: skip
        found += joint.values()
    return tuple(found)


@dataclass(frozen=True)
class _Joint:
    j: int  # 0-based
    stated: Simulation
    fit: JointFit
    nominal: FloatArray
    tolerance: FloatArray
    motion: tuple[tuple[Sequence[LoadedJoint], FloatArray], ...]  # held out, with what was proven
    floor: float  # [rad]
    period: float  # [s] of the recordings
    own: frozenset[str]  # tolerances that the drive states itself
    extras: tuple[str, ...]  # effects beyond what every joint has

    def values(self) -> list[StatedValue]:
        """Return the values of this joint that the motion shows."""
        squared, as_given = self._squares(lambda row: row), self._squares(lambda _: self.nominal)
        above = float(np.sqrt(as_given.mean())) > WORDING.at_step * self.floor
        reducible = max(float(as_given.mean()) - self.floor**2, LEAST)
        found, sure = list[StatedValue](), list[bool]()
        for value, differs, reverted in (*self._shown(), *self._damping()):
            without = self._squares(reverted)
            share = float(without.mean() - squared.mean()) / reducible
            surely = removes(squared, without, len(self.motion)) >= CONFIDENT
            sure.append(above and differs and surely)
            found.append(replace(value, share=min(max(share, 0.0), 1.0)))
        reported = [s and value.share >= VALUES.share for s, value in zip(sure, found, strict=True)]
        together = removes(squared, as_given, len(self.motion)) >= CONFIDENT
        if any(sure) and together and not any(reported):
            reported[max(range(len(found)), key=lambda k: (sure[k], found[k].share))] = True
        return [
            replace(value, reported=own, beyond=own and value.beyond)
            for value, own in zip(found, reported, strict=True)
        ]

    def _squares(self, changed: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return squared errors of all that is held out, with constants changed [rad²]."""
        return np.concatenate([errors(own, changed(row)) ** 2 for own, row in self.motion])

    def _shown(self) -> Iterator[tuple[StatedValue, bool, _Change]]:
        """Yield values that the motion shows, whether each surely differs, and its undoing."""
        for effect, units in KINDS.items():
            for name, unit in units.items():
                if effect in self.extras or not is_known(self.fit, {name: unit}):
                    continue
                wrong = is_wrong(self.fit, self.nominal, {name: unit}, self.tolerance, self.period)
                believed = self._believed(name)
                tolerance = value_in(self.tolerance, name) * believed
                value = self._value(
                    constant_of(name).parameter or name,
                    effect,
                    unit,
                    believed,
                    self.fit.value(name),
                )
                yield (
                    replace(
                        value,
                        ci95=self.fit.interval(name),
                        tolerance=(OFFSET if name == "offset" else tolerance) or None,
                        assumed=value.assumed and name not in self.own,
                        beyond=wrong,
                    ),
                    self._differs(name),
                    partial(
                        as_it_is_stated, nominal=self.nominal, effect=effect, units={name: unit}
                    ),
                )

    def _damping(self) -> Iterator[tuple[StatedValue, bool, _Change]]:
        """Yield the damping that a servo is stated to have within its torque limit."""
        stated, damping = value_in(self.nominal, "kd"), self.fit.value(DAMPING)
        within = value_in(self.fit.row, "inside")
        share = stated / max(self._believed(DAMPING), LEAST)
        if stated > 0.0 and within != share:
            value = self._value("kd", SERVO, KINDS["viscous_friction"][DAMPING], stated,
                                within * damping)  # fmt: skip
            yield value, True, partial(with_values, values={"inside": share})

    def _believed(self, name: str) -> float:
        servo = value_in(self.nominal, "kd") if name == DAMPING else 0.0
        return value_in(self.nominal, name) + servo

    def _differs(self, name: str) -> bool:
        """Say whether a fitted value surely differs from the stated one."""
        value, believed = self.fit.value(name), self._believed(name)
        if lag_within(name, value - believed, self.nominal, self.period):
            return False
        reach = VALUES.sure * self.fit.deviation[name]
        if name in SIGNED:
            return abs(value - believed) > reach
        return believed <= 0.0 or abs(np.log(max(value, LEAST) / believed)) > reach

    def _value(
        self, name: str, effect: str, unit: str, stated: float, fitted: float
    ) -> StatedValue:
        return StatedValue(
            name=name,
            effect=effect,
            joints=(self.j + 1,),
            joint_names=(self.stated.model.joint_names[self.j],),
            unit=unit,
            stated=stated,
            fitted=fitted,
            ci95=None,
            tolerance=None,
            assumed="drive" in self.stated.tolerances.assumed,
            beyond=False,
            reported=False,
            share=0.0,
        )
