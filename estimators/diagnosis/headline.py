"""Headline: a verdict in one sentence of two lines at most, grouped, with values and intervals."""

from __future__ import annotations

import math
import re
from pathlib import PurePath
from typing import TYPE_CHECKING, Final

from estimators.diagnosis.quantities import (
    AMOUNTS,
    UNNUMBERED,
    by_error,
    decimals_of,
    differs,
    from_to,
    in_words,
    of_joints,
    of_several,
    quantity,
    unit_of,
    values_listed,
)
from estimators.diagnosis.settings import HALF
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, LINK_INERTIA, UNKNOWN, Interval
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
    display_name,
)
from limo_driver.physics.catalogue import description_of, known_as

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.verdict import Finding, StatedValue, Verdict
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
_OTHERWISE = {
    LINK_INERTIA: "several joints err together, smoothly with the pose and without history",
}


def headline(verdict: Verdict) -> str:
    """Say what holds: what differs from what to what, what is missing, and what stays unexplained.

    Effects of one kind are said together; where all of it does not fit into two lines, values are
    left out first, and then what explains least, but each state that holds has a part.
    Names that are rather wrong than right are left to the list of findings, if there are others.
    """
    names = verdict.names
    if verdict.rows.usable and not any(verdict.rows.usable) and not verdict.findings:
        return "The arm holds still, and nothing pushes it; nothing else can be said."
    if verdict.states == ("agrees",):
        return (
            "Recording and simulation agree: the given simulation errs by no more than noise at "
            "any joint."
        )
    states = [_differing(verdict, names), _missing(verdict, names), _unknown(verdict, names)]
    parts = [part for state in states for part in state]
    firsts = [state[0] for state in states if state]
    order = [*firsts, *(part for part in parts if part not in firsts)]
    count = len(order)
    tried = [_chosen(parts, order[:k], order[k:]) for k in range(count, -1, -1)]
    fewer = range(count - 1, len(firsts) - 1, -1)
    tried += [_chosen(parts, long, order[:k]) for long in (states[0][:1], ()) for k in fewer]
    texts = [_sentence(each) for each in tried]
    return next((text for text in texts if len(text) <= MOST), texts[-1])


def _chosen(
    parts: Sequence[tuple[str, str]],
    long: Sequence[tuple[str, str]],
    short: Sequence[tuple[str, str]],
) -> list[str]:
    """Return some parts, long or short, and how many are left out, in their order."""
    texts = [own[0] if own in long else own[1] for own in parts if own in long or own in short]
    left = len(parts) - len(texts)
    return [*texts, *([f"{left} more below"] if left else [])]


def _differing(verdict: Verdict, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the stated values that differ, long and short, those that take most first."""
    groups: dict[tuple[str, str], list[StatedValue]] = {}
    for item in by_error(verdict):
        if item.reported:
            groups.setdefault((item.effect, item.name), []).append(item)
    texts = [(from_to(group, names), differs(group, names)) for group in groups.values()]
    others = [
        group
        for group in _groups(verdict)
        if group[0].kind == "wrong_parameter" and not any(map(verdict.values_of, group))
    ]
    return texts + [
        (_say(group, names, values=True), _say(group, names, values=False)) for group in others
    ]


def _missing(verdict: Verdict, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return what the simulation lacks, long and short; pushes last."""
    groups = [[item for item in group if verdict.is_missing(item)] for group in _groups(verdict)]
    texts = [
        (_say(group, names, values=True), _say(group, names, values=False))
        for group in groups
        if group
    ]
    if verdict.not_stated:
        joints = {*verdict.not_stated}
        effects = {item.effect for item in verdict.identified if item.joint in joints}
        what = "friction" if effects <= _FRICTION else "what is ordinary"
        text = f"{what} of {of_several(sorted(joints), names)} is not stated, and was identified"
        texts.append((text, text))
    return texts


def named(item: Finding) -> str:
    """Name what a finding is of: an effect, or the value of a drive that is off."""
    amount = AMOUNTS.get(item.effect) if item.kind == "wrong_parameter" else None
    return amount or display_name(item.effect)


def place_of(item: Finding, names: Sequence[str]) -> str:
    """Say where an effect acts; a payload is felt elsewhere than it is.

    Args:
        item: The finding.
        names: Of all joints of the arm.
    """
    if item.effect == Payload.name:
        carrier = carrier_of(item, len(names))
        return f"on the link of {of_joints((carrier,), names)}" if carrier else "at the flange"
    if item.effect == GravityDirection.name:
        return "whole arm"
    if item.effect == LINK_INERTIA:
        return f"link {', '.join(map(str, item.joints))}"
    return of_several(item.joints, names)


def carrier_of(item: Finding, n: int) -> int | None:
    """Return the joint, 1-based, whose link carries a payload; None where it is at the flange."""
    one = len(item.joints) == 1 and item.joints[0] < n
    return item.joints[0] if item.effect == Payload.name and one else None


def values_of(item: Finding) -> str:
    """Return the parameters of a finding with units and 95 % intervals, in one line.

    By the names that they have in a `sim.yaml`: most are symbols, which no space makes words.
    """
    parts = [
        f"{name} {in_words(known)}" for name, known in item.parameters.items() if known.value != ()
    ]
    return "; ".join(parts)


def quantity_of(item: Finding) -> str:
    """Return the value that matters most of a finding, if that is one number; else nothing."""
    known = _main(item)
    return quantity(known) if known else ""


def _groups(verdict: Verdict) -> list[list[Finding]]:
    """Return findings that are said together, in order of their first.

    What all joints feel comes before laws of single ones: it is what somebody can go and look at.
    Pushes come last.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    named = [item for item in verdict.findings if item.effect != UNKNOWN]
    sure = [item for item in named if item.confidence >= HALF]
    for item in sure or named:
        family = "friction" if _is_friction(item) else item.effect
        groups.setdefault((family, item.kind), []).append(item)
    return sorted(
        groups.values(),
        key=lambda group: (group[0].effect == CONTACT, not is_of_bodies(group[0].effect)),
    )


def _is_friction(item: Finding) -> bool:
    return item.kind == "missing" and item.effect in _FRICTION


def _say(group: Sequence[Finding], names: Sequence[str], *, values: bool) -> str:
    first = group[0]
    joints = sorted({j for item in group for j in item.joints})
    if first.effect == CONTACT:
        return _pushed(first)
    if _is_friction(first) and len({item.effect for item in group}) > 1:
        return f"friction of {of_several(joints, names)} was not in the simulation"
    name, is_wrong = named(first), first.kind == "wrong_parameter"
    if values and (differ := _against_stated(group, names)):
        return f"{name} of {differ}"
    if len(group) > 1:
        return f"{'wrong ' * is_wrong}{name} of {of_several(joints, names)}"
    place = place_of(first, names)
    at = place if first.effect == Payload.name else f"at {place}"
    if first.effect == LINK_INERTIA:
        name, at = "inertia", f"of {place}"
    known = _main(first) if values else None
    if is_wrong:
        should = f": {quantity(known)} fits" if known else ""
        return f"wrong {name} {at}{should}"
    return f"{name}{f' of {_size(known)}' if known else ''} {at}"


def _size(known: Interval) -> str:
    """Say how large something is; where it may be next to nothing, by what it is at most."""
    if known.ci95 is not None and known.ci95[0] == 0.0:  # the least that there can be
        high = float(known.ci95[1])
        return f"at most {high:.{decimals_of(high / 2)}f}{unit_of(known.unit)}"
    return quantity(known)


def _against_stated(group: Sequence[Finding], names: Sequence[str]) -> str:
    """Say which values fit joints, and which are stated; nothing where one is not known."""
    group = sorted(group, key=lambda item: item.joints)
    known = [main for item in group if (main := _main(item))]
    stated = [main.stated for main in known if main.stated is not None]
    joints = [j for item in group for j in item.joints]
    if not len(stated) == len(group) == len(joints):
        return ""
    values = [float(main.value) for main in known]  # pyright: ignore[reportArgumentType]  # `_main`
    fits = values_listed(values) + unit_of(known[0].unit)
    return (
        f"{of_several(joints, names)} is {quantity(known[0]) if len(group) == 1 else fits}, "
        f"not the stated {values_listed(stated, digits=4)}"
    )


def _main(item: Finding) -> Interval | None:
    """Return the first parameter that is one number with an interval."""
    for known in item.parameters.values():
        number = isinstance(known.value, (int, float)) and known.unit not in UNNUMBERED
        if number and known.ci95 is not None:
            return known
    return None


def _pushed(item: Finding) -> str:
    windows = item.where.time
    if not 0 < len(windows) <= WORDING.listed:
        return f"something pushed the arm {len(windows)} times"
    return f"something pushed the arm at {' and '.join(f'{a:.1f} s' for a, _ in windows)}"


def _unknown(verdict: Verdict, names: Sequence[str]) -> list[tuple[str, str]]:
    """Say where nothing in the catalogue explains what is left, how much, and in which motion."""
    items = [item for item in verdict.findings if item.effect == UNKNOWN]
    joints = verdict.unexplained_joints
    if not joints:
        return []
    region = (items[0].where.region if items else "") or verdict.unexplained.where.region
    # such a region reads: joint 4: at high speed (half of it above 0.4 rad/s), and so on
    half = re.search(r"\((half of it [^)]+)\)", region) if len(joints) == 1 else None
    short = f"{of_several(joints, names)}: something unknown"
    fit = verdict.fit
    pairs = [(fit.heldout_rmse_after[j - 1], fit.noise_floor[j - 1]) for j in joints]
    floors = max((error / floor for error, floor in pairs if floor > 0), default=0.0)
    size = f", {floors:.1f} noise floors" if floors > 1.0 else ""
    return [(short + size + (f", {half[1]}" if half else ""), short + size)]


def _sentence(parts: Sequence[str]) -> str:
    text = "; ".join(parts)
    symbol = "_" in text.partition(" ")[0]  # which is no word
    return (
        f"{text[:1] if symbol else text[:1].upper()}{text[1:]}." if text else "Nothing was found."
    )


def signature_of(effect: str) -> str:
    """Say how an effect shows; completes "At joint 3 …"."""
    shows = _OTHERWISE.get(effect) or description_of(effect).signature
    return shows or f"the error is what {display_name(effect)} makes"


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


def likelier(lead: float) -> str:
    """Say evidence [nat] as odds; completes "the recordings are …"."""
    if lead > math.log(WORDING.beyond_doubt):
        return "beyond doubt likelier"
    odds = math.exp(lead)
    digits = max(0, math.floor(math.log10(odds)) - 1)
    return f"{round(odds, -digits):,.0f} times likelier".replace(",", "\N{NO-BREAK SPACE}")
