"""Findings of single joints: what differs from what is stated, or is there beyond it.

Stated values of drives and friction, and those that make the arm move as it was recorded.

A tolerance says how surprising it is that a value differs, never whether that is reported. It is
where it is sure, and where a tenth of the joint's reducible error goes with it on motion held out.
Where only several together take that much, the one that takes most is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from estimators.diagnosis.from_motion.fitting.identification import SURE
from estimators.diagnosis.from_motion.fitting.joint import JointFit, errors
from estimators.diagnosis.from_motion.held_out import CONFIDENT, LEAST, removes
from estimators.diagnosis.from_motion.search import FOUND, OFFSET
from estimators.diagnosis.from_motion.simulation.constants import (
    DAMPING,
    SIGNED,
    constant_of,
    kinds_of,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.settings.judgement import VALUES
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, StatedValue, Where
from limo_driver.model.units import unit_of
from limo_driver.physics import PositionServo, Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.diagnosis.from_motion.held_out import DriveEvidence
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray


def findings_of(
    stated: Simulation,
    given: Simulation,
    evidence: DriveEvidence,
    reducible: float,
) -> tuple[Finding, ...]:
    """Return what differs from what is stated, and what each takes of the held-out error."""
    proof, final = evidence.proof, evidence.final
    folds, nominal, tolerances = evidence.folds, rows_of(given), tolerances_of(given)
    parts = [fold.parts(given) for fold in folds]
    served = {drive.joint for drive in stated.drives}
    period = max(1.0 / r.rate for r in evidence.recordings)
    found = [*evidence.of_the_arm(given)]
    for j, fit in enumerate(final.fits):
        held_out = [
            (own[j], fold.identified.fits[j].row) for own, fold in zip(parts, folds, strict=True)
        ]
        squared = np.concatenate([errors(own, row) ** 2 for own, row in held_out])
        full = float(squared.mean())
        far = unit_of("rad", given.model.sliding, j)
        for effect, units in kinds_of(slides=given.model.sliding[j]).items():
            extra = effect in final.extras[j]
            wrong = j + 1 in served and is_wrong(fit, nominal[j], units, tolerances[j], period)
            size = next(iter(units))  # others give its shape, which matters less
            shown = effect in proof.extras[j] and is_known(fit, {size: ""})
            if not (shown if extra else wrong):
                continue
            less = [(own, as_it_is_stated(row, nominal[j], effect, units)) for own, row in held_out]
            without = np.concatenate([errors(own, row) ** 2 for own, row in less])
            lost = float(without.mean()) - full
            confidence = removes(squared, without, len(folds))
            if confidence < CONFIDENT:
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
                parameters=_beside_stated(
                    parameters_of(fit, units), stated_value(effect, nominal[j], units, extra=extra)
                ),
                where=Where(),
                share=lost,
                heldout_rmse=BeforeAfter(tuple(rmse[0].tolist()), tuple(rmse[1].tolist())),
                evidence=(
                    f"{as_stated(effect, nominal[j], units, extra=extra)}, the held-out error of "
                    f"joint {j + 1} is {np.sqrt(full + lost):.4f} {far}, with it "
                    f"{np.sqrt(full):.4f} {far}"
                ),
            )
            found.append((lost, finding))
    total = max(sum(lost for lost, _ in found), reducible, LEAST)
    ranked = sorted(found, key=lambda item: -item[0])
    return tuple(replace(finding, share=lost / total) for lost, finding in ranked)


def is_wrong(
    fit: JointFit,
    nominal: FloatArray,
    units: dict[str, str],
    tolerance: FloatArray,
    period: float,
) -> bool:
    """Say whether stated values are beyond their tolerance."""
    for name in units:
        if not is_known(fit, {name: ""}):
            return False
        value, believed = fit.value(name), value_in(nominal, name)
        if name == DAMPING:
            believed += value_in(nominal, "kd")
        if lag_within(name, value - believed, nominal, period):
            return False
        if not np.isfinite(believed):  # stated to be without limit
            return True
        deviation = fit.deviation[name]
        if name == "offset":
            if abs(value - believed) > FOUND * float(np.hypot(deviation, OFFSET)):
                return True
        else:
            apart = abs(np.log(max(value, LEAST) / max(believed, 1e-3 * value, LEAST)))
            if apart > FOUND * float(np.hypot(deviation, value_in(tolerance, name))):
                return True
    return False


def lag_within(name: str, change: float, nominal: FloatArray, period: float) -> bool:
    """Say whether a constant changes a lag by less than a sample, which no recording tells.

    Args:
        name: Of the constant.
        change: Of it.
        nominal: The stated constants of its joint.
        period: Between samples [s].
    """
    lag = {"delay": 1.0, "inertia": value_in(nominal, "kv")}  # that of servos of velocity
    return abs(change) < period * lag.get(name, 0.0)


def stated_value(
    effect: str, nominal: FloatArray, units: dict[str, str], *, extra: bool
) -> float | None:
    """Return what is stated of the first of an effect's values; None where nobody has stated one.

    Args:
        effect: Its name.
        nominal: The stated constants of its joint.
        units: Of the constants that are its values.
        extra: Whether it is beyond what every joint has.
    """
    value = value_in(as_it_is_stated(nominal, nominal, effect, units), next(iter(units)))
    return None if extra or value == 0.0 or not np.isfinite(value) else value


def _beside_stated(known: dict[str, Interval], stated: float | None) -> dict[str, Interval]:
    """Return values of an effect with what is stated of the first."""
    if stated is None:
        return known
    first = next(iter(known))
    return known | {first: replace(known[first], stated=stated)}


def as_stated(effect: str, nominal: FloatArray, units: dict[str, str], *, extra: bool) -> str:
    """Say what a finding is compared with; nobody has stated what is none.

    Args:
        effect: Its name.
        nominal: The stated constants of its joint.
        units: Of the constants that are its values.
        extra: Whether it is beyond what every joint has.
    """
    name, unit = next(iter(units.items()))
    value = stated_value(effect, nominal, units, extra=extra)
    if value is None:
        return "without it"
    size = f"{value:.3g}" if unit == "1" else f"{value:.3g} {unit}"
    return f"with {constant_of(name).in_words} of {size}{_parts(nominal, name)}, as stated"


def _parts(nominal: FloatArray, name: str) -> str:
    """Say which part of a stated damping is the servo's: no file has their sum."""
    servo, joint = value_in(nominal, "kd"), value_in(nominal, DAMPING)
    if name != DAMPING or not (servo and joint):
        return ""
    return f" ({servo:.3g} of the servo, {joint:.3g} of the joint)"


def is_known(fit: JointFit, units: dict[str, str]) -> bool:
    """Say whether values were fitted, and the motion shows them."""
    return all(0.0 < fit.deviation.get(name, 0.0) < SURE for name in units)


def as_it_is_stated(
    row: FloatArray, nominal: FloatArray, effect: str, units: dict[str, str]
) -> FloatArray:
    """Return the constants with those of one effect as they are stated."""
    values = {name: value_in(nominal, name) for name in units}
    if effect == "viscous_friction":
        values[DAMPING] += value_in(nominal, "kd")
    if effect == "stribeck_friction":
        values["v_s"] = 1.0
    return with_values(row, values)


def parameters_of(fit: JointFit, units: dict[str, str]) -> dict[str, Interval]:
    """Return fitted values with their intervals, as a verdict names them."""
    return {
        constant_of(name).parameter or name: Interval(fit.value(name), unit, fit.interval(name))
        for name, unit in units.items()
        if name in fit.deviation
    }


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
        for effect, units in self.kinds.items():
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
            value = self._value("kd", SERVO, self.kinds["viscous_friction"][DAMPING], stated,
                                within * damping)  # fmt: skip
            yield value, True, partial(with_values, values={"inside": share})

    @property
    def kinds(self) -> dict[str, dict[str, str]]:
        """Effects with the units of their values here."""
        return kinds_of(slides=self.stated.model.sliding[self.j])

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
