"""Verdicts compared: with the truth where it is known, and with each other."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.headline import MOST, headline, place_of, quantity_of, values_of
from estimators.diagnosis.quantities import in_words, of_several, rounded
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Interval, Verdict
from limo_driver.errors import ConfigError
from limo_driver.pages import Charts, Page
from limo_driver.pages.arm import Pin, arm_view
from limo_driver.pages.markup import (
    UNSAID,
    columns,
    header,
    paragraph,
    percent,
    section,
    table,
    typeset,
)
from limo_driver.pages.motion import arm_section
from limo_driver.physics import Effect, Payload, display_name
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel

_LEAD = (
    "The arm had this in it, and the diagnosis was told of none of it. In brackets: the 95 % "
    "interval."
)


def recovered(
    concealed: Sequence[Effect], findings: Sequence[Finding], joints: Sequence[str]
) -> str:
    """Say in a sentence what was concealed in an arm, and what was found of it."""
    parts = "; ".join(_pair(effect, _found(effect, findings), joints) for effect in concealed)
    return f"{parts[:1].upper()}{parts[1:]}."


def beside_the_truth(
    concealed: Sequence[Effect], findings: Sequence[Finding], joints: Sequence[str]
) -> str:
    """Return the section of a page with what was concealed and what was found.

    Args:
        concealed: Effects of the arm that the diagnosis was not told of.
        findings: What it found.
        joints: Names of the joints of the arm.
    """
    found = [_found(effect, findings) for effect in concealed]
    others = [item for item in findings if not any(item is one for one in found)]
    nothing = "nothing" if others else ""
    rows: dict[str, list[object]] = {
        "concealed": [
            *(_concealed(effect, joints) for effect in concealed), *[nothing] * len(others)
        ],
        "found": [
            _values(item) if item else "not found" for item in (*found, *others)
        ],
        "confidence": [
            percent(item.confidence) if item else UNSAID for item in (*found, *others)
        ],
    }  # fmt: skip
    return section(
        "What was concealed, and what was found", columns(rows, numeric=2), "concealed", _LEAD
    )


def _pair(effect: Effect, found: Finding | None, joints: Sequence[str]) -> str:
    if found is None:
        return f"{_concealed(effect, joints)} was concealed and not found"
    value = quantity_of(found)
    return f"{_concealed(effect, joints)} was concealed, {value or 'it'} was found"


def _found(effect: Effect, findings: Sequence[Finding]) -> Finding | None:
    """Return the finding that is an effect: of its name, at its joints."""
    everywhere = isinstance(effect, Payload)  # at the flange, whichever joints feel it
    return next(
        (
            item
            for item in findings
            if item.effect == effect.name and (everywhere or item.joints == effect.joints)
        ),
        None,
    )


def _concealed(effect: Effect, joints: Sequence[str]) -> str:
    """Say what an effect is, how large, and where."""
    sizes = [
        f" of {value:g} {item.unit}"
        for item in effect.parameters()
        if item.is_size and (value := getattr(effect, item.name)) is not None
    ]
    value = sizes[0] if sizes else ""
    where = "the flange" if isinstance(effect, Payload) else of_several(effect.joints, joints)
    return f"{display_name(effect.name)}{value} at {where}"


def _values(item: Finding) -> str:
    law = item.parameters.get("law")  # whose values say little beside its loop, which is drawn
    values = display_name(str(law.value)) if law else quantity_of(item) or values_of(item)
    return f"{display_name(item.effect)}: {values or 'found'}"


def comparison(model: RobotModel, names: Sequence[str], verdicts: Sequence[Verdict]) -> Page:
    """Return the page of two diagnoses of one kind of arm.

    Args:
        model: The arm.
        names: Of the two diagnoses.
        verdicts: Of each.

    Raises:
        ConfigError: They are of arms with different numbers of joints.
    """
    n = [len(verdict.fit.noise_floor) for verdict in verdicts]
    if {*n} != {model.n}:
        raise ConfigError(f"diagnoses of {n[0]} and {n[1]} joints, expected both of {model.n}")
    pairs = _pairs(verdicts)
    changed = [key for key, pair in pairs.items() if _differs(*pair)]
    heads = "".join(
        f"<div><h2>{escape(name)}</h2>{paragraph(typeset(headline(verdict)))}</div>"
        for name, verdict in zip(names, verdicts, strict=True)
    )
    title = _title(names, pairs, changed, model.joint_names)
    view = arm_view(
        model,
        np.clip(0.5 * np.ones(model.n), model.limits.position_min, model.limits.position_max),
        errors=tuple(
            (name, verdict.fit.heldout_rmse_before)
            for name, verdict in zip(names, verdicts, strict=True)
        ),
        floor=tuple(max(pair) for pair in zip(*(v.fit.noise_floor for v in verdicts), strict=True)),
        pins=tuple(_pin(key, pairs[key], model.joint_names) for key in changed),
    )
    lead = "Rings: error of the given simulation in each diagnosis. Labels: what differs."
    body = (
        header(f"Two diagnoses of {PurePath(model.name).stem}", title)
        + f'<div class="grid two">{heads}</div>'
        + arm_section(view, "Where on the arm", lead)
        + section("Findings", _findings(pairs, names, model.joint_names), "findings", _FINDINGS)
        + section(
            "Errors", _errors(names, verdicts), "errors", _ERRORS.format(verdicts[0].fit.unit)
        )
    )
    return Page(title, body, Charts(), view)


_FINDINGS = (
    "A value differs where the 95 % intervals do not overlap; each interval is that of the fit to "
    "its own recordings."
)
_ERRORS = "RMSE [{}] of each joint on motion that nothing was fitted to."
_Pair = tuple["Finding | None", "Finding | None"]


def _pairs(verdicts: Sequence[Verdict]) -> dict[tuple[str, tuple[int, ...]], _Pair]:
    """Return what was found at each place, in the first and in the second diagnosis."""
    found = [
        {(f.effect, f.joints): f for f in verdict.findings if f.effect != CONTACT}
        for verdict in verdicts
    ]
    return {key: (found[0].get(key), found[1].get(key)) for key in {**found[0], **found[1]}}


def _differs(first: Finding | None, second: Finding | None) -> bool:
    if first is None or second is None:
        return True
    return any(_apart(known, second.parameters.get(k)) for k, known in first.parameters.items())


def _apart(first: Interval, second: Interval | None) -> bool:
    """Say whether two intervals of one number do not overlap."""
    if second is None or not _is_number(first) or not _is_number(second):
        return False
    (a, b), (c, d) = (map(float, known.ci95 or (0.0, 0.0)) for known in (first, second))
    return b < c or d < a


def _is_number(known: Interval) -> bool:
    return isinstance(known.value, (int, float)) and bool(known.ci95) and None not in known.ci95


def _title(
    names: Sequence[str],
    pairs: dict[tuple[str, tuple[int, ...]], _Pair],
    changed: Sequence[tuple[str, tuple[int, ...]]],
    joints: Sequence[str],
) -> str:
    if not changed:
        return f"{names[0]} and {names[1]} agree: the same findings, with intervals that overlap."
    parts: list[str] = []
    counted: list[str] = []
    for where, of in zip(
        (f"only in {names[0]}", f"only in {names[1]}", "changed"),
        ("gone", "new", "changed"),
        strict=True,
    ):
        own = [key for key in changed if _kind(pairs[key]) == of]
        named = [
            f"{_name(key[0])} {_at(_place(pairs[key], joints))}" for key in own[: WORDING.listed]
        ]
        more = f" and {len(own) - WORDING.listed} more" if len(own) > WORDING.listed else ""
        if own:
            parts.append(f"{', '.join(named)}{more} {where}")
            counted.append(f"{len(own)} finding{'s' * (len(own) > 1)} {where}")
    text = "; ".join(parts)
    if len(text) >= MOST:
        text = "; ".join(counted)
    return f"{text[:1].upper()}{text[1:]}."


def _kind(pair: _Pair) -> str:
    return "changed" if all(pair) else ("gone" if pair[0] else "new")


def _at(place: str) -> str:
    return place if place.startswith(("at ", "on ", "whole")) else f"at {place}"


def _name(effect: str) -> str:
    return "something unknown" if effect == UNKNOWN else display_name(effect)


def _place(pair: _Pair, joints: Sequence[str]) -> str:
    item = pair[0] or pair[1]
    return place_of(item, joints) if item else ""


def _pin(key: tuple[str, tuple[int, ...]], pair: _Pair, joints: Sequence[str]) -> Pin:
    effect, on = key
    what = _kind(pair)
    joint = None if effect == Payload.name or not on else on[0] - 1
    return Pin(f"{_place(pair, joints)}: {_name(effect)} {what}", joint, "#findings")


def _findings(
    pairs: dict[tuple[str, tuple[int, ...]], _Pair], names: Sequence[str], joints: Sequence[str]
) -> str:
    rows: list[list[str]] = []
    for (effect, _), pair in pairs.items():
        what = f"{_name(effect)}, {_place(pair, joints)}"
        keys = [
            key
            for item in pair
            if item
            for key, known in item.parameters.items()
            if _is_number(known)
        ]
        if not keys:
            texts = ["found" if item else UNSAID for item in pair]
            rows.append([escape(what), "", *texts, _change(pair, differs=False)])
        for key in dict.fromkeys(keys):
            known = [item.parameters.get(key) if item else None for item in pair]
            texts = [escape(typeset(in_words(k))) if k else UNSAID for k in known]
            differs = known[0] is None or known[1] is None or _apart(known[0], known[1])
            rows.append([escape(what), escape(key), *texts, _change(pair, differs=differs)])
    return table(("finding", "parameter", *names, "change"), rows)


def _change(pair: _Pair, *, differs: bool) -> str:
    """Say how a finding changed from the first diagnosis to the second."""
    if all(pair):
        return "<b>differs</b>" if differs else ""
    return "<b>gone</b>" if pair[0] else "<b>new</b>"


def _errors(names: Sequence[str], verdicts: Sequence[Verdict]) -> str:
    columns: list[Sequence[float]] = []
    headings = ["joint"]
    for name, verdict in zip(names, verdicts, strict=True):
        fit = verdict.fit
        columns += [fit.heldout_rmse_before, fit.heldout_rmse_after, fit.noise_floor]
        headings += [f"{name}: given", "improved", "noise floor"]
    rows = [
        [str(j), *(rounded(value) for value in row)]
        for j, row in enumerate(zip(*columns, strict=True), start=1)
    ]
    return table(headings, rows, numeric=1)
