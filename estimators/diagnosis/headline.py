"""Headline: a verdict in one sentence of two lines at most, grouped, with values and intervals."""

from __future__ import annotations

import math
import re
from pathlib import PurePath
from typing import TYPE_CHECKING, Final, cast

from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.verdict import CONTACT, UNKNOWN
from limo_driver.physics import (
    AsymmetricFriction,
    BodyEffect,
    CoulombFriction,
    GravityDirection,
    LoadDependentFriction,
    Payload,
    PositionDependentFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
    spoken,
)
from limo_driver.physics.catalogue import description_of, known_as

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.verdict import Finding, Interval, Verdict
    from limo_driver.recordings.recording import Recording

MOST: Final = 190  # characters: two lines of a page or a wide terminal
_FRICTION: Final = frozenset(
    effect.name
    for effect in (
        CoulombFriction,
        ViscousFriction,
        AsymmetricFriction,
        StribeckFriction,
        QuadraticDrag,
        LoadDependentFriction,
        PositionDependentFriction,
    )
)
_UNNUMBERED: Final = frozenset({"text", "joint"})  # units of what is no quantity
_SMALLEST: Final = 1e-12  # half width of an interval below which it has none

_AMOUNTS: Final = {  # of drives, the one value that is off, as roboticists call it
    "position_servo": "P gain",
    "velocity_servo": "velocity gain",
    "torque_drive": "torque gain",
    "integral_gain": "I gain",
    "drive_delay": "delay",
}
LINK_INERTIA = "link_inertia"  # what a body of the simulation has wrong; no effect of its own
_OTHERWISE = {
    LINK_INERTIA: "several joints err together, smoothly with the pose and without history",
}


def headline(verdict: Verdict) -> str:
    """Say what was found, where, how much, and how sure the values are.

    Effects of one kind are said together; where all of it does not fit into two lines, values are
    left out first, and then what explains least. Names that are rather wrong than right are left to
    the list of findings, if there are others.
    """
    n = len(verdict.fit.noise_floor)
    if verdict.verdict == "consistent":
        if verdict.rows.usable and not any(verdict.rows.usable):
            return "The arm holds still, and nothing pushes it; nothing else can be said."
        joints = sorted({item.joint for item in verdict.identified})
        beside = f", beside the friction identified at {of_several(joints, n)}" if joints else ""
        return f"Recording and simulation agree within tolerances and noise{beside}."
    groups = _groups(verdict)
    long = [_said(group, n, values=True) for group in groups]
    short = [_said(group, n, values=False) for group in groups]
    unknown = _unknown(verdict, n)
    count = len(groups)
    tried = [[*long[:k], *short[k:], *unknown] for k in range(count, -1, -1)]
    tried += [[*short[:k], f"{count - k} more below", *unknown] for k in range(count - 1, 0, -1)]
    texts = [_sentence(parts) for parts in tried]
    return next((text for text in texts if len(text) <= MOST), texts[-1])


def named(item: Finding) -> str:
    """Name what a finding is of: an effect, or the value of a drive that is off."""
    amount = _AMOUNTS.get(item.effect) if item.kind == "wrong_parameter" else None
    return amount or spoken(item.effect)


def place_of(item: Finding, n: int) -> str:
    """Say where an effect acts on an arm of n joints; a payload is felt elsewhere than it is."""
    if item.effect == Payload.name:
        return "at the flange"
    if item.effect == GravityDirection.name:
        return "whole arm"
    if item.effect == LINK_INERTIA:
        return f"link {', '.join(map(str, item.joints))}"
    return of_several(item.joints, n)


def values_of(item: Finding) -> str:
    """Return the parameters of a finding with units and 95 % intervals, in one line.

    By the names that they have in a `sim.yaml`: most are symbols, which no space makes words.
    """
    said = [
        f"{name} {_value(known)}" for name, known in item.parameters.items() if known.value != ()
    ]
    return "; ".join(said)


def quantity_of(item: Finding) -> str:
    """Return the value that matters most of a finding, if that is one number; else nothing."""
    known = _main(item)
    return quantity(known) if known else ""


def quantity(known: Interval) -> str:
    """Return a number with its unit and interval, to the digits that the interval leaves."""
    value = float(known.value)  # pyright: ignore[reportArgumentType]  # a number, see `_main`
    unit = _unit(known.unit)
    if known.ci95 is None or None in known.ci95:
        return f"{value:.3g}{unit}"
    said, low, high = to_interval(value, *map(float, known.ci95))
    return f"{said}{unit} [{low}, {high}]"


def to_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a value and the ends of its interval, to two digits of half that interval."""
    decimals = _decimals((high - low) / 2)
    said = [f"{each:.{decimals}f}" for each in (value, low, high)]
    return said[0], said[1], said[2]


def give_or_take(known: Interval) -> str:
    """Return a number beside half of its 95 % interval, to the digits that the interval leaves.

    Args:
        known: A number with an interval.
    """
    low, high = cast("tuple[float, float]", known.ci95)
    half = (high - low) / 2
    decimals = _decimals(half)
    return f"{known.value:.{decimals}f} ± {half:.{decimals}f}"


def several(known: Interval) -> str:
    """Return the numbers of a parameter that has more than one."""
    return _nested(known.value)


def _decimals(half: float) -> int:
    """Return the decimals that show half of an interval to two digits."""
    return min(max(0, 1 - math.floor(math.log10(max(half, _SMALLEST)))), 9)


def _value(known: Interval) -> str:
    if isinstance(known.value, str):
        return spoken(known.value)
    if isinstance(known.value, (int, float)):
        return quantity(known)
    return _nested(known.value) + _unit(known.unit)


def _nested(values: object) -> str:
    if isinstance(values, (tuple, list)):
        return f"({', '.join(map(_nested, values))})"
    return f"{values:.3g}" if isinstance(values, float) else str(values)


def _unit(unit: str) -> str:
    return f" {unit}" if unit not in {"", "1", *_UNNUMBERED} else ""


def _groups(verdict: Verdict) -> list[list[Finding]]:
    """Return findings that are said together, in order of their first; pushes last."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    named = [item for item in verdict.findings if item.effect != UNKNOWN]
    sure = [item for item in named if item.confidence >= WORDING.sure]
    for item in sure or named:
        family = "friction" if _is_friction(item) else item.effect
        groups.setdefault((family, item.kind), []).append(item)
    return sorted(groups.values(), key=lambda group: group[0].effect == CONTACT)


def _is_friction(item: Finding) -> bool:
    return item.kind == "missing" and item.effect in _FRICTION


def _said(group: Sequence[Finding], n: int, *, values: bool) -> str:
    first = group[0]
    joints = sorted({j for item in group for j in item.joints})
    if first.effect == CONTACT:
        return _pushed(first)
    if _is_friction(first) and len({item.effect for item in group}) > 1:
        return f"friction of {of_several(joints, n)} was not in the simulation"
    name = named(first)
    if values and (differ := _against_stated(group, n)):
        return f"{name} of {differ}"
    if len(group) > 1:
        return f"{_wrong(first)}{name} of {of_several(joints, n)}"
    place = place_of(first, n)
    at = place if first.effect == Payload.name else f"at {place}"
    if first.effect == LINK_INERTIA:
        name, at = "inertia", f"of {place}"
    known = _main(first) if values else None
    if first.kind == "wrong_parameter":
        should = f": {quantity(known)} fits" if known else ""
        return f"wrong {name} {at}{should}"
    return f"{name}{f' of {_size(known)}' if known else ''} {at}"


def _size(known: Interval) -> str:
    """Say how large something is; where it may be next to nothing, by what it is at most."""
    if known.ci95 is not None and known.ci95[0] == 0.0:  # the least that there can be
        high = float(known.ci95[1])
        return f"at most {high:.{_decimals(high / 2)}f}{_unit(known.unit)}"
    return quantity(known)


def _against_stated(group: Sequence[Finding], n: int) -> str:
    """Say which values fit joints, and which are stated; nothing where one is not known."""
    pairs = [(known, known.stated) for item in group if (known := _main(item))]
    stated = [f"{value:.4g}" for _, value in pairs if value is not None]
    joints = [j for item in group for j in item.joints]
    if not len(stated) == len(group) == len(joints):
        return ""
    if len(group) == 1:
        fits = quantity(pairs[0][0])
    else:
        values = listed([f"{known.value:.3g}" for known, _ in pairs])
        fits = values + _unit(pairs[0][0].unit)
    same = list(dict.fromkeys(stated))
    of = of_several(joints, n) if joints == sorted(joints) else of_joints(joints)
    return f"{of} is {fits}, not the stated {listed(same if len(same) == 1 else stated)}"


def _wrong(item: Finding) -> str:
    return "wrong " if item.kind == "wrong_parameter" else ""


def _main(item: Finding) -> Interval | None:
    """Return the first parameter that is one number with an interval."""
    for known in item.parameters.values():
        number = isinstance(known.value, (int, float)) and known.unit not in _UNNUMBERED
        if number and known.ci95 is not None:
            return known
    return None


def _pushed(item: Finding) -> str:
    windows = item.where.time
    if not 0 < len(windows) <= WORDING.pushes:
        return f"something pushed the arm {len(windows)} times"
    return f"something pushed the arm at {' and '.join(f'{a:.1f} s' for a, _ in windows)}"


def _unknown(verdict: Verdict, n: int) -> list[str]:
    """Say where nothing in the catalogue explains what is left, and in which motion."""
    items = [item for item in verdict.findings if item.effect == UNKNOWN]
    joints = sorted({j for item in items for j in item.joints} | {*verdict.unexplained.joints})
    if not joints:
        return []
    region = (items[0].where.region if items else "") or verdict.unexplained.where.region
    # such a region reads: joint 4: at high speed (half of it above 0.4 rad/s), and so on
    half = re.search(r"\((half of it [^)]+)\)", region) if len(joints) == 1 else None
    return [f"{of_several(joints, n)}: something unknown" + (f", {half[1]}" if half else "")]


def _sentence(parts: Sequence[str]) -> str:
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else "Nothing was found."


def signature_of(effect: str) -> str:
    """Say how an effect shows; completes "At joint 3 …"."""
    said = _OTHERWISE.get(effect) or description_of(effect).signature
    return said or f"the error is what {spoken(effect)} makes"


def is_of_bodies(effect: str) -> bool:
    """Say whether an effect is of a body, and so felt by all joints below it."""
    known = known_as(effect)
    return effect == LINK_INERTIA or (known is not None and issubclass(known, BodyEffect))


def names_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the file names of recordings, and numbers for those that have none of their own."""
    files = [PurePath(recording.source).name for recording in recordings]
    return tuple(
        name if name and files.count(name) == 1 else f"recording {k}"
        for k, name in enumerate(files, start=1)
    )


def of_joints(joints: Sequence[int]) -> str:
    """Return which joints (1-based), in words; none are the whole arm."""
    if not joints:
        return "whole arm"
    return f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"


def listed(texts: Sequence[str]) -> str:
    """Join phrases by commas, the last one by "and"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def likelier(lead: float) -> str:
    """Say evidence [nat] as odds; completes "the recordings are …"."""
    if lead > math.log(WORDING.beyond_doubt):
        return "beyond doubt likelier"
    odds = math.exp(lead)
    digits = max(0, math.floor(math.log10(odds)) - 1)
    return f"{round(odds, -digits):,.0f} times likelier".replace(",", "\N{NO-BREAK SPACE}")


def rounded(error: float, digits: int = 4) -> str:
    """Return an error to a few digits, whatever the arm's scale: 2022, 65.21, 0.003392."""
    decimals = digits - 1 - math.floor(math.log10(error)) if error > 0 else digits - 1
    return f"{error:.{max(0, decimals)}f}"


def of_several(joints: Sequence[int], n: int) -> str:
    """Return joints (1-based) of an arm of n in few words: "joints 1 to 4", "all joints"."""
    known = sorted({*joints})
    if not known or (known == list(range(1, n + 1)) and n > 1):
        return "all joints"
    if len(known) > 2 and known[-1] - known[0] == len(known) - 1:  # noqa: PLR2004  # a range
        return f"joints {known[0]} to {known[-1]}"
    return of_joints(known)
