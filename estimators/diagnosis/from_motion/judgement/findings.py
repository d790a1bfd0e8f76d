"""Findings of single joints: what differs from what is stated, or is there beyond it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_motion.fitting.identification import SURE
from estimators.diagnosis.from_motion.fitting.joint import errors
from estimators.diagnosis.from_motion.hypotheses.search import FOUND, OFFSET
from estimators.diagnosis.from_motion.judgement.held_out import CONFIDENT, LEAST, removes
from estimators.diagnosis.from_motion.simulation.constants import (
    DAMPING,
    KINDS,
    constant_of,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where

if TYPE_CHECKING:
    from estimators.diagnosis.from_motion.fitting.joint import JointFit
    from estimators.diagnosis.from_motion.judgement.evidence import DriveEvidence
    from limo_driver.physics import Simulation
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
        for effect, units in KINDS.items():
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
                    f"joint {j + 1} is {np.sqrt(full + lost):.4f} rad, with it "
                    f"{np.sqrt(full):.4f} rad"
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
