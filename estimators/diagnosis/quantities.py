"""Quantities: numbers with units and intervals, joints and lists, in words.

Differences: stated values and what fits instead, in words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, cast

import numpy as np

from estimators.diagnosis.settings import TINY
from estimators.diagnosis.verdict import Fit, Interval, StatedValue, Verdict
from limo_driver.physics import display_name
from limo_driver.physics.described import SIGN_WIDTH
from limo_driver.runtime.display import joint_called
from limo_driver.types import FloatArray

UNNUMBERED: Final = frozenset({"text", "joint"})  # units of what is no quantity


def quantity(known: Interval) -> str:
    """Return a number with its unit and interval, to the digits that the interval leaves."""
    value = float(known.value)  # pyright: ignore[reportArgumentType]  # a number, see `_main`
    unit = unit_of(known.unit)
    if known.ci95 is None or None in known.ci95 or known.ci95[0] == known.ci95[1]:
        return f"{value:.3g}{unit}"
    shown, low, high = to_interval(value, *map(float, known.ci95))
    return f"{shown}{unit} [{low}, {high}]"


def to_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a value and the ends of its interval, to two digits of half that interval."""
    decimals = decimals_of((high - low) / 2)
    shown = [f"{each:z.{decimals}f}" for each in (value, low, high)]
    return shown[0], shown[1], shown[2]


def give_or_take(known: Interval) -> str:
    """Return a number with half of its 95 % interval, to the digits that the interval leaves.

    Args:
        known: A number with an interval.
    """
    low, high = cast("tuple[float, float]", known.ci95)
    half = (high - low) / 2
    decimals = decimals_of(half)
    return f"{known.value:z.{decimals}f} ± {half:.{decimals}f}"


def in_words(known: Interval) -> str:
    """Return a parameter: a number with its unit and interval, several, or a text."""
    if isinstance(known.value, str):
        return display_name(known.value)
    if isinstance(known.value, (int, float)):
        return quantity(known)
    return several(known.value) + unit_of(known.unit)


def decimals_of(half: float) -> int:
    """Return the decimals that show half of an interval to two digits."""
    return min(max(0, 1 - math.floor(math.log10(max(half, TINY)))), 9)


def several(values: object) -> str:
    """Return numbers of a parameter that has more than one."""
    if isinstance(values, (tuple, list)):
        return f"({', '.join(map(several, values))})"
    return f"{values * (abs(values) > TINY):.3g}" if isinstance(values, float) else str(values)


def unit_of(unit: str) -> str:
    """Return a unit as it follows a number; nothing where there is none."""
    return f" {unit}" if unit not in {"", "1", *UNNUMBERED} else ""


def of_joints(joints: Sequence[int], names: Sequence[str] = ()) -> str:
    """Return which joints (1-based), in words; none are the whole arm.

    Args:
        joints: Their numbers.
        names: Of all joints of the arm, where they are known.
    """
    if not joints:
        return "whole arm"
    return f"joint{'s' * (len(joints) > 1)} {', '.join(_called(joints, names))}"


def _called(joints: Sequence[int], names: Sequence[str]) -> list[str]:
    return [joint_called(j, names[j - 1] if j <= len(names) else "") for j in joints]


def placed(effect: str, joints: Sequence[int], names: Sequence[str] = ()) -> str:
    """Return an effect with its joints: "backlash at joint 2 (stick)"; of the arm, it stands alone.

    Args:
        effect: Identifier.
        joints: Where it acts, 1-based.
        names: Of all joints of the arm, where they are known.
    """
    return display_name(effect) + (f" at {of_joints(joints, names)}" if joints else "")


def heading_of(joint: int, names: Sequence[str]) -> str:
    """Return how a heading calls a joint (1-based): "Joint 3 (elbow)".

    Args:
        joint: Its number.
        names: Of all joints of the arm.
    """
    text = of_joints((joint,), names)
    return f"{text[:1].upper()}{text[1:]}"


def listed(texts: Sequence[str]) -> str:
    """Join phrases by commas, the last one by "and"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def rounded(error: float, digits: int = 3) -> str:
    """Return an error to a few digits, whatever the arm's scale: 2022, 65.21, 0.003392."""
    decimals = digits - 1 - (math.floor(math.log10(abs(error))) if abs(error) > 0 else 0)
    return f"{error:z.{max(0, decimals)}f}"


def in_noise_floors(errors: FloatArray | Sequence[float], fit: Fit) -> FloatArray:
    """Return errors of the joints (…, n) over the noise floor of each."""
    return np.array(errors) / np.maximum(np.array(fit.noise_floor), TINY)


def of_several(joints: Sequence[int], names: Sequence[str]) -> str:
    """Return joints in few words: "joints 1 (base) to 4 (wrist)", "all joints", "joint 3 (elbow)".

    Args:
        joints: Their numbers, 1-based.
        names: Of all joints of the arm; empty where they are not known.
    """
    known, n = sorted({*joints}), len(names)
    if not known or (known == list(range(1, n + 1)) and n > 1):
        return "all joints"
    if len(known) > 2 and known[-1] - known[0] == len(known) - 1:  # noqa: PLR2004  # a range
        return f"joints {' to '.join(_called((known[0], known[-1]), names))}"
    return of_joints(known, names)


def values_listed(values: Sequence[float], digits: int = 3) -> str:
    """List values of joints in their order; one alone where all are the same, the ends of many."""
    texts = [f"{value:.{digits}g}" for value in values]
    if len(set(texts)) == 1:
        return texts[0]
    if len(texts) > 3:  # noqa: PLR2004  # more than a sentence holds; tables have each
        return f"{min(values):.{digits}g} to {max(values):.{digits}g}"
    return listed(texts)


QUANTITIES: Final = {  # by effect and parameter, as roboticists call it: what wears or is off
    ("coulomb_friction", "tau_c"): "Coulomb friction",
    ("viscous_friction", "f_v"): "viscous friction",
    ("armature", "inertia"): "armature",
    ("joint_elasticity", "stiffness"): "joint stiffness",
    ("spring_load", "stiffness"): "stiffness of the spring",
    ("backlash", "gap"): "backlash",
    ("payload", "mass"): "payload",
    ("position_servo", "kp"): "P gain",
    ("velocity_servo", "kv"): "velocity gain",
    ("torque_drive", "gain"): "torque gain",
    ("integral_gain", "ki"): "I gain",
    ("drive_delay", "delay"): "delay",
}
_MAIN: Final = frozenset({"kp", "kv", "gain", "ki", "delay"})  # by which a drive is called
AMOUNTS: Final = {effect: called for (effect, name), called in QUANTITIES.items() if name in _MAIN}


def place_of_value(item: StatedValue) -> str:
    """Say at which joints a value acts, by number and by name."""
    joints = list(map(joint_called, item.joints, item.joint_names))
    return f"joint{'s' * (len(joints) > 1)} {listed(joints)}" if joints else "the arm"


def name_of_value(item: StatedValue) -> str:
    """Return what a value is, as roboticists call it: "v_eps (coulomb friction)", "P gain"."""
    if not item.effect:
        return f"{item.name} (RMS torque)"
    if (item.effect, item.name) == ("position_servo", "kd"):
        return "kd (damping within the torque limit)"
    called = QUANTITIES.get((item.effect, item.name))
    return called or f"{item.name} ({display_name(item.effect)})"


def fitted_of(item: StatedValue) -> str:
    """Return the value that fits, with its unit and interval, or that there is none."""
    text = quantity(Interval(item.fitted, item.unit, item.ci95))
    return f"{text} (not shown by this motion)" if item.is_taken else text


def by_error(verdict: Verdict) -> list[StatedValue]:
    """Return the stated values, those that take most of held-out errors first.

    As `findings` are, by the squared error, which is counted in noise floors of the joint.
    """
    squared = in_noise_floors(verdict.fit.heldout_rmse_before, verdict.fit) ** 2
    every = range(1, squared.size + 1)
    return sorted(
        verdict.values, key=lambda x: -x.share * max(squared[j - 1] for j in x.joints or every)
    )


def from_to(group: Sequence[StatedValue], names: Sequence[str]) -> str:
    """Say from what to what values of one kind differ.

    Args:
        group: These values.
        names: Of all joints of the arm.
    """
    first, name = group[0], name_of_value(group[0])
    if not first.effect:
        return (
            f"{first.name} make {fitted_of(first)} at {place_of_value(first)}, not the stated "
            f"{first.stated:.4g}"
        )
    group = sorted(group, key=lambda item: item.joints)
    joints = [j for item in group for j in item.joints]
    of = f" of {of_several(joints, names)}" if joints else ""
    fits = values_listed([x.fitted for x in group]) + unit_of(first.unit)
    stated = values_listed([x.stated for x in group], digits=4)
    against = "none is stated" if stated == "0" else f"not the stated {stated}"
    return f"{name}{of} is {fitted_of(first) if len(group) == 1 else fits}, {against}"


def differs(group: Sequence[StatedValue], names: Sequence[str]) -> str:
    """Say in few words that values of one kind differ.

    Args:
        group: These values.
        names: Of all joints of the arm.
    """
    joints = sorted({j for item in group for j in item.joints})
    where = of_several(joints, names)
    if not group[0].effect:
        return f"{group[0].name}, felt at {where}, are not as stated"
    return f"{name_of_value(group[0])} of {where} is not as stated"


def value_columns(verdict: Verdict) -> dict[str, list[str]]:
    """Return the stated values that moved, and what fits instead, those that are reported first."""
    moved = sorted((x for x in by_error(verdict) if x.moved), key=lambda x: not x.reported)
    return {
        "value": [name_of_value(x) for x in moved],
        "joint": [place_of_value(x).partition(" ")[2] for x in moved],
        "stated": [stated_of(x) for x in moved],
        "fits": [fitted_of(x) for x in moved],
        "of the joint's error": [f"{100 * x.share:.0f} %" for x in moved],
        "tolerance": [tolerance_of(x, in_ratio=not verdict.is_of_torque) for x in moved],
    }


def stated_of(item: StatedValue) -> str:
    """Return a stated value; how sharp a sign is need not be stated, and limo has a usual width."""
    usual = item.name == "v_eps" and item.stated == SIGN_WIDTH
    return f"{item.stated:.4g}" + " (limo's usual)" * usual


def tolerance_of(item: StatedValue, *, in_ratio: bool) -> str:
    """Say by how many of its tolerances a value moved, how wide one is, and who says so.

    Args:
        item: The value.
        in_ratio: Whether tolerances are of the logarithm, where a value has one.
    """
    if not item.tolerance:
        return ""  # only values together have moved: each has its own
    size = abs(item.tolerance / item.stated) if item.stated else None
    width = f"{item.tolerance:.2g} {item.unit}" if size is None else f"{100 * size:.3g} %"
    whose = "limo's guess" if item.assumed else "stated"
    off = abs(item.fitted - item.stated) / item.tolerance
    if in_ratio and size is not None and item.fitted * item.stated > 0.0:
        off = abs(np.log(item.fitted / item.stated)) / size
    return f"{rounded(off, 2)} tolerances of {width} ({whose})"
