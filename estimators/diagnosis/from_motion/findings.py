"""Findings of single joints: what differs from what is stated, or is there beyond it.

Stated values of drives and friction, and those that make the arm move as it was recorded.

A tolerance says how surprising it is that a value differs, never whether that is reported. It is
where it is sure, and where a tenth of the joint's reducible error goes with it on motion held out.
Where only several together take that much, the one that takes most is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from estimators.diagnosis.from_motion.fitting.identification import SURE
from estimators.diagnosis.from_motion.fitting.joint import JointFit, errors
from estimators.diagnosis.from_motion.held_out import CONFIDENT, LEAST, removes
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from estimators.diagnosis.from_motion.suspects import OFFSET
from estimators.diagnosis.settings import MATTERS
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, StatedValue, Where
from estimators.regression.evidence import REACH
from limo_driver.model.units import unit_of
from limo_driver.physics import PositionServo, Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from estimators.diagnosis.from_motion.held_out import DriveEvidence
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray


_Change: TypeAlias = "Callable[[FloatArray], FloatArray]"  # of the constants of a joint


def findings_of(
    given: Simulation, evidence: DriveEvidence, joints: Sequence[JointValues], reducible: float
) -> tuple[Finding, ...]:
    """Return what differs from what is stated, and what each takes of the held-out error."""
    found = [*evidence.of_the_arm(given), *(item for one in joints for item in one.findings())]
    total = max(sum(lost for lost, _ in found), reducible, LEAST)
    ranked = sorted(found, key=lambda item: -item[0])
    return tuple(replace(finding, share=lost / total) for lost, finding in ranked)


def stated_values(
    stated: Simulation, evidence: DriveEvidence, joints: Sequence[JointValues], step: FloatArray
) -> tuple[StatedValue, ...]:
    """Return what is stated of drives and friction, and what fits, joint by joint.

    Args:
        stated: The simulation as it was given.
        evidence: What was identified.
        joints: All of them.
        step: Of the encoders, (n,) [rad].
    """
    drives = () if evidence.turned else (x for x in stated.drives if x.channel is not None)
    return tuple(
        value
        for drive in drives
        for value in joints[drive.joint - 1].values(float(step[drive.joint - 1]), drive.tolerances)
    )


@dataclass(frozen=True)
class JointValues:
    """What is stated of one joint, what fits it, and its motion held out."""

    j: int  # 0-based
    stated: Simulation  # as it was given; of a joint without a drive, nothing is
    fit: JointFit
    nominal: FloatArray  # stated constants
    tolerance: FloatArray
    motion: tuple[tuple[Sequence[LoadedJoint], FloatArray], ...]  # held out, with what was proven
    period: float  # [s] of the recordings
    extras: tuple[str, ...]  # effects beyond what every joint has
    proven: tuple[str, ...]  # those of them that a part of the recordings shows
    refitted: dict[str, FloatArray]  # squared errors of that motion without an effect (K,) [rad²]

    @classmethod
    def of_all(
        cls, stated: Simulation, given: Simulation, evidence: DriveEvidence
    ) -> tuple[JointValues, ...]:
        """Take all joints; `given` is what is stated, with a drive at each joint."""
        folds, final, proof = evidence.folds, evidence.final, evidence.proof
        parts = [(fold.parts(given), fold.identified.fits) for fold in folds]
        period = max(1.0 / r.rate for r in evidence.recordings)
        every = zip(final.fits, rows_of(given), tolerances_of(given), strict=True)
        return tuple(
            cls(j, stated, fit, nominal, tolerance,
                tuple((own[j], fits[j].row) for own, fits in parts),
                period, final.extras[j], proof.extras[j],
                {effect: less for (k, effect), less in evidence.refitted.items() if k == j})
            for j, (fit, nominal, tolerance) in enumerate(every)
        )  # fmt: skip

    def findings(self) -> Iterator[tuple[float, Finding]]:
        """Yield what differs from what is stated, with the squared error that goes with it."""
        far = unit_of("rad", self.stated.model.sliding, self.j)
        n, served = self.stated.model.n, self.j + 1 in {x.joint for x in self.stated.drives}
        squared = self._squares(lambda row: row)
        full = float(squared.mean())
        for effect, units in self.kinds.items():
            extra = effect in self.extras
            size = next(iter(units))  # others give its shape, which matters less
            shown = effect in self.proven and is_known(self.fit, [size])
            if not (shown if extra else served and self._is_wrong(units)):
                continue
            without = self.refitted.get(effect)
            if without is None:
                undone = partial(as_it_is_stated, nominal=self.nominal, effect=effect, units=units)
                without = self._squares(undone)
            lost, confidence = float(without.mean()) - full, self._removes(squared, without)
            if confidence < CONFIDENT:
                continue
            rmse = np.zeros((2, n))
            rmse[:, self.j] = np.sqrt([full + lost, full])
            parameters = parameters_of(self.fit, units)
            stated = stated_value(effect, self.nominal, units, extra=extra)
            if stated is not None:
                first = next(iter(parameters))
                parameters[first] = replace(parameters[first], stated=stated)
            yield (
                lost,
                Finding(
                    effect=effect,
                    kind="missing" if extra else "wrong_parameter",
                    joints=(self.j + 1,),
                    equivalent=("asymmetric_friction",) if effect == "torque_offset" else (),
                    confidence=confidence,
                    parameters=parameters,
                    where=Where(),
                    share=lost,
                    heldout_rmse=BeforeAfter(tuple(rmse[0].tolist()), tuple(rmse[1].tolist())),
                    evidence=(
                        f"{as_stated(effect, self.nominal, units, extra=extra)}, the held-out "
                        f"error of joint {self.j + 1} is {np.sqrt(full + lost):.4f} {far}, "
                        f"with it {np.sqrt(full):.4f} {far}"
                    ),
                ),
            )

    def values(self, step: float, own: Collection[str]) -> list[StatedValue]:
        """Return the stated values, and what fits.

        Args:
            step: Of the encoder [rad].
            own: Constants whose tolerance the drive states itself.
        """
        squared, as_given = self._squares(lambda row: row), self._squares(lambda _: self.nominal)
        above = float(np.sqrt(as_given.mean())) > step
        reducible = max(float(as_given.mean()) - step**2 / 12.0, LEAST)
        found, sure = list[StatedValue](), list[bool]()
        for value, differs, reverted in (*self._shown(own), *self._damping()):
            without = self._squares(reverted)
            share = float(without.mean() - squared.mean()) / reducible
            sure.append(above and differs and self._removes(squared, without) >= CONFIDENT)
            found.append(replace(value, share=min(max(share, 0.0), 1.0)))
        reported = [s and value.share >= MATTERS for s, value in zip(sure, found, strict=True)]
        together = self._removes(squared, as_given) >= CONFIDENT
        if any(sure) and together and not any(reported):
            reported[max(range(len(found)), key=lambda k: (sure[k], found[k].share))] = True
        return [
            replace(value, reported=own, beyond=own and value.beyond)
            for value, own in zip(found, reported, strict=True)
        ]

    @property
    def kinds(self) -> dict[str, dict[str, str]]:
        """Effects with the units of their values here."""
        return c.kinds_of(slides=self.stated.model.sliding[self.j])

    def _squares(self, changed: _Change) -> FloatArray:
        """Return squared errors of all that is held out, with constants changed [rad²]."""
        return np.concatenate([errors(own, changed(row)) ** 2 for own, row in self.motion])

    def _removes(self, squared: FloatArray, without: FloatArray) -> float:
        return removes(squared, without, len(self.motion))

    def _shown(self, own: Collection[str]) -> Iterator[tuple[StatedValue, bool, _Change]]:
        """Yield values of the improved simulation, whether each surely differs, and its undoing.

        Those that the motion does not show, only where they moved beyond what tolerances allow.
        """
        for effect, units in self.kinds.items():
            for name, unit in units.items():
                if effect in self.extras:
                    continue
                believed, known = self._believed(name), is_known(self.fit, [name])
                tolerance = c.value_in(self.tolerance, name) * believed
                fitted, called = self.fit.value(name), c.constant_of(name).parameter or name
                value = self._value(called, effect, unit, believed, fitted)
                value = replace(
                    value,
                    ci95=self.fit.interval(name) if known else None,
                    tolerance=(OFFSET if name == "offset" else tolerance) or None,
                    assumed=value.assumed and name not in own,
                    beyond=self._is_wrong([name]),
                )
                undone = partial(as_it_is_stated, nominal=self.nominal, effect=effect, units=[name])
                if known or value.is_taken:
                    yield value, known and self._differs(name), undone

    def _damping(self) -> Iterator[tuple[StatedValue, bool, _Change]]:
        """Yield the damping that a servo is stated to have within its torque limit."""
        stated, damping = c.value_in(self.nominal, "kd"), self.fit.value(c.DAMPING)
        within = c.value_in(self.fit.row, "inside")
        share = stated / max(self._believed(c.DAMPING), LEAST)
        if stated > 0.0 and within != share:
            unit, fitted = self.kinds["viscous_friction"][c.DAMPING], within * damping
            value = self._value("kd", PositionServo.name, unit, stated, fitted)
            yield value, True, partial(c.with_values, values={"inside": share})

    def _value(
        self, name: str, effect: str, unit: str, stated: float, fitted: float
    ) -> StatedValue:
        names, assumed = self.stated.model.joint_names, "drive" in self.stated.tolerances.assumed
        joints = (self.j + 1,), (names[self.j],)
        return StatedValue(name, effect, *joints, unit, stated, fitted, assumed=assumed)

    def _believed(self, name: str) -> float:
        servo = c.value_in(self.nominal, "kd") if name == c.DAMPING else 0.0
        return c.value_in(self.nominal, name) + servo

    def _is_wrong(self, names: Iterable[str]) -> bool:
        """Say whether stated values are beyond their tolerance."""
        for name in names:
            if not is_known(self.fit, [name]):
                return False
            value, believed = self.fit.value(name), self._believed(name)
            if self._is_lag_within(name, value - believed):
                return False
            if not np.isfinite(believed):  # stated to be without limit
                return True
            signed = name == "offset"
            apart = (
                abs(value - believed)
                if signed
                else abs(np.log(max(value, LEAST) / max(believed, 1e-3 * value, LEAST)))
            )
            reach = OFFSET if signed else c.value_in(self.tolerance, name)
            if apart > REACH * float(np.hypot(self.fit.deviation[name], reach)):
                return True
        return False

    def _differs(self, name: str) -> bool:
        """Say whether a fitted value surely differs from the stated one."""
        value, believed = self.fit.value(name), self._believed(name)
        if self._is_lag_within(name, value - believed):
            return False
        reach = REACH * self.fit.deviation[name]
        if name in c.SIGNED:
            return abs(value - believed) > reach
        return believed <= 0.0 or abs(np.log(max(value, LEAST) / believed)) > reach

    def _is_lag_within(self, name: str, change: float) -> bool:
        """Say whether a constant changes a lag by less than a sample, which no recording tells."""
        lag = {
            "delay": 1.0,
            "inertia": c.value_in(self.nominal, "kv"),
        }  # that of servos of velocity
        return abs(change) < self.period * lag.get(name, 0.0)


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
    value = c.value_in(as_it_is_stated(nominal, nominal, effect, units), next(iter(units)))
    return None if extra or value == 0.0 or not np.isfinite(value) else value


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
    if name == c.DAMPING and all(own := [c.value_in(nominal, n) for n in ("kd", c.DAMPING)]):
        size += f" ({own[0]:.3g} of the servo, {own[1]:.3g} of the joint)"  # no file has their sum
    return f"with {c.constant_of(name).in_words} of {size}, as stated"


def is_known(fit: JointFit, names: Iterable[str]) -> bool:
    """Say whether values were fitted, and the motion shows them."""
    return all(0.0 < fit.deviation.get(name, 0.0) < SURE for name in names)


def as_it_is_stated(
    row: FloatArray, nominal: FloatArray, effect: str, units: Iterable[str]
) -> FloatArray:
    """Return the constants with those of one effect as they are stated."""
    values = {name: c.value_in(nominal, name) for name in units}
    if effect == "viscous_friction":
        values[c.DAMPING] += c.value_in(nominal, "kd")
    if effect == "stribeck_friction":
        values["v_s"] = 1.0
    return c.with_values(row, values)


def parameters_of(fit: JointFit, units: dict[str, str]) -> dict[str, Interval]:
    """Return fitted values with their intervals, as a verdict names them."""
    return {
        c.constant_of(name).parameter or name: Interval(fit.value(name), unit, fit.interval(name))
        for name, unit in units.items()
        if name in fit.deviation
    }
