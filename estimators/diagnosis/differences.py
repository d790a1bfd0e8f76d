"""Differences: stated values and what fits instead, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from estimators.diagnosis.quantities import listed, of_several, once, quantity, unit_of
from estimators.diagnosis.verdict import Interval, StatedValue, Verdict
from limo_driver.physics import display_name
from limo_driver.runtime.display import joint_called

AMOUNTS: Final = {  # of drives, the one value that is off, as roboticists call it
    "position_servo": "P gain",
    "velocity_servo": "velocity gain",
    "torque_drive": "torque gain",
    "integral_gain": "I gain",
    "drive_delay": "delay",
}
_MAIN: Final = frozenset({"kp", "kv", "gain", "ki", "delay"})  # by which a drive is called


def place_of_value(item: StatedValue) -> str:
    """Say at which joints a value acts, by number and by name."""
    joints = list(map(joint_called, item.joints, item.joint_names))
    return f"joint{'s' * (len(joints) > 1)} {listed(joints)}" if joints else "the arm"


def name_of_value(item: StatedValue) -> str:
    """Return what a value is, as roboticists call it: "tau_c (coulomb friction)", "P gain"."""
    if not item.effect:
        return f"{item.name} (RMS torque)"
    if (item.effect, item.name) == ("position_servo", "kd"):
        return "kd (damping within the torque limit)"
    amount = AMOUNTS.get(item.effect) if item.name in _MAIN else None
    return amount or f"{item.name} ({display_name(item.effect)})"


def fitted_of(item: StatedValue) -> str:
    """Return the value that fits, with its unit and interval."""
    return quantity(Interval(item.fitted, item.unit, item.ci95))


def from_to(group: Sequence[StatedValue]) -> str:
    """Say from what to what values of one kind differ."""
    first, name = group[0], name_of_value(group[0])
    if not first.effect:
        return (
            f"{first.name} make {fitted_of(first)} at {place_of_value(first)}, not the stated "
            f"{_alike(first.stated)}"
        )
    group = sorted(group, key=lambda item: item.joints)
    places = listed([x for item in group for x in map(joint_called, item.joints, item.joint_names)])
    of = f" of joint{'s' * (len(group) > 1)} {places}" if places else ""
    fits = once([f"{x.fitted:.3g}" for x in group])
    unit = unit_of(first.unit)
    one = len(group) == 1
    stated = once([_alike(x.stated) for x in group])
    against = "none is stated" if stated == ["0"] else f"not the stated {listed(stated)}"
    return f"{name}{of} is {fitted_of(first) if one else listed(fits) + unit}, {against}"


def differs(group: Sequence[StatedValue], names: Sequence[str]) -> str:
    """Say in few words that values of one kind differ.

    Args:
        group: These values.
        names: Of all joints of the arm.
    """
    joints = sorted({j for item in group for j in item.joints})
    name = name_of_value(group[0]) if group[0].effect else group[0].name
    return f"{name} of {of_several(joints, names)} is not as stated"


def _alike(value: float) -> str:
    return f"{value:.4g}"


def value_columns(verdict: Verdict) -> dict[str, list[str]]:
    """Return the stated values that moved, and what fits instead, those that are reported first."""
    moved = sorted((x for x in verdict.values if x.moved), key=lambda x: (not x.reported, -x.share))
    return {
        "value": [name_of_value(x) for x in moved],
        "joint": [place_of_value(x).partition(" ")[2] for x in moved],
        "stated": [f"{x.stated:.4g}" for x in moved],
        "fits": [fitted_of(x) for x in moved],
        "of the joint's error": [f"{100 * x.share:.0f} %" for x in moved],
        "tolerance": [tolerance_of(x) for x in moved],
    }


def tolerance_of(item: StatedValue) -> str:
    """Say whether a value is beyond its tolerance, how wide that is, and who says so."""
    side = "beyond" if item.beyond else "within"
    whose = "limo's guess" if item.assumed else "stated"
    if item.tolerance is None:
        return f"{side} ({whose})" if not item.effect else ""
    size = abs(item.tolerance / item.stated) if item.stated else None
    width = f"{item.tolerance:.2g} {item.unit}" if size is None else f"{100 * size:.3g} %"
    return f"{side} {width} ({whose})"
