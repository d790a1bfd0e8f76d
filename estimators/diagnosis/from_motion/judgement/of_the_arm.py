"""Findings of what all joints of an arm feel: a payload, zeros and signs of encoders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from estimators.diagnosis.from_motion.fitting.joint import NORMAL
from estimators.diagnosis.from_motion.hypotheses.suspects import COUNTED
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where

if TYPE_CHECKING:
    from estimators.diagnosis.from_motion.hypotheses.stated import StatedArm
    from estimators.diagnosis.from_motion.hypotheses.suspects import Suspect
    from estimators.diagnosis.from_motion.simulation.loads import ArmChange

_AXES: Final = "xyz"


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
        joints=tuple(j + 1 for j in (one.joint, one.other) if j is not None),
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
