"""The first screen of a report: the verdict, errors before and after, and each finding."""

from __future__ import annotations

from html import escape
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.report import figures
from estimators.diagnosis.report.markup import (
    UNSAID,
    Charts,
    folded,
    grid,
    meter,
    number,
    of_joints,
    paragraph,
    percent,
    table,
)
from estimators.diagnosis.verdict import UNKNOWN
from limo_driver.physics import spoken

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.diagnosis import Diagnosis
    from estimators.diagnosis.verdict import Finding, Fit, Interval, Value

VERDICTS = {
    "consistent": "consistent",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unexplained": "unexplained",
}
_KINDS = {
    "missing": "left out of the simulation",
    "wrong_parameter": "in the simulation with a wrong value",
}
_MOST = 3  # joints of a finding whose errors are shown; the table above has all
_LISTED = 6  # values of a parameter that are shown before they are folded


def overview(diagnosis: Diagnosis, charts: Charts) -> str:
    """Return verdict, errors and findings."""
    verdict = diagnosis.verdict
    head = (
        f'<header><p class="crumb">Diagnosis of a simulation of {escape(_robot(diagnosis))}</p>'
        f'<p><span class="badge {verdict.verdict}">{VERDICTS[verdict.verdict]}</span></p>'
        f"<h1>{escape(verdict.sentence())}</h1>{_sources(diagnosis)}</header>"
    )
    chart = charts.place(
        figures.summary(verdict.fit), "Error on motion that nothing was fitted to", "per joint"
    )
    errors = f'<section id="errors">{grid([chart, _errors(verdict.fit)])}</section>'
    cards = "".join(_card(item, verdict.fit) for item in verdict.findings)
    if not cards:
        return head + errors
    title = "Findings" if len(verdict.findings) > 1 else "Finding"
    return f'{head}{errors}<section id="findings"><h2>{title}</h2>{cards}</section>'


def _sources(diagnosis: Diagnosis) -> str:
    said = [
        f"{PurePath(item.source).name or f'recording {k + 1}'} "
        f"({item.duration:.0f} s at {item.rate:.0f} Hz)"
        for k, item in enumerate(diagnosis.recordings)
    ]
    text = (
        f"Compared with {'; '.join(said)}. Motion and torque pass the same zero-phase filter of "
        f"{diagnosis.bandwidth:g} Hz."
    )
    return paragraph(text, "sources")


def _robot(diagnosis: Diagnosis) -> str:
    return PurePath(diagnosis.before.robot).stem


def _errors(fit: Fit) -> str:
    rows = [
        [f"{j + 1}", _rmse(a), _rmse(b), _rmse(c), f"{b / c:.2f}" if c > 0 else UNSAID]
        for j, (a, b, c) in enumerate(
            zip(fit.heldout_rmse_before, fit.heldout_rmse_after, fit.noise_floor, strict=True)
        )
    ]
    headings = ("joint", "given [N m]", "improved [N m]", "noise floor [N m]", "improved / floor")
    low, high = fit.ci95
    removed = (
        f"The improved simulation removes {percent(fit.reducible_error_removed)} of the reducible "
        f"error (95 % interval {percent(low)} to {percent(high)})."
        if np.isfinite(fit.reducible_error_removed)
        else "There is no reducible error to remove."
    )
    meaning = (
        "Reducible is the mean squared error above the noise floor. Held-out: rows of the "
        "recordings that no parameter was fitted to."
    )
    return (
        f"<div>{table(headings, rows, numeric=1)}{paragraph(removed)}"
        f"{paragraph(meaning, 'small')}</div>"
    )


def _rmse(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else UNSAID


def _card(item: Finding, fit: Fit) -> str:
    unknown = item.effect == UNKNOWN
    name = "Something unknown" if unknown else spoken(item.effect).capitalize()
    kind = "nothing in the catalogue explains it" if unknown else _KINDS[item.kind]
    head = (
        f"<h3>{escape(name)} <span>{escape(of_joints(item.joints))}</span></h3>"
        f'<p class="kind">{escape(kind)}</p><p class="evidence">{escape(item.evidence)}</p>'
    )
    facts = [
        ("confidence", meter(item.confidence)),
        ("held-out RMSE", _drop(item)),
    ]
    if not unknown:
        facts.insert(1, ("removes", f"{meter(item.share)} of the reducible error"))
    if item.equivalent:
        names = ", ".join(spoken(e) for e in item.equivalent)
        facts.append(("cannot be told from", escape(names)))
    if where := _where(item, fit):
        facts.append(("where", where))
    listed = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in facts)
    return (
        f'<article class="card{" unknown" if unknown else ""}">{head}<dl>{listed}</dl>'
        f"{_parameters(item)}</article>"
    )


def _drop(item: Finding) -> str:
    pairs = item.heldout_rmse
    if not pairs.before:
        return UNSAID
    joints = [j for j in item.joints if j <= len(pairs.before)] or range(1, len(pairs.before) + 1)
    shown = sorted(joints, key=lambda j: pairs.after[j - 1] - pairs.before[j - 1])[:_MOST]
    return "; ".join(
        f"joint {j}: {_rmse(pairs.before[j - 1])} → {_rmse(pairs.after[j - 1])} N m" for j in shown
    )


def _where(item: Finding, fit: Fit) -> str:
    said = [escape(item.where.region)] if item.where.region else []
    if item.where.time:
        said.append("; ".join(f"{a:.1f} to {b:.1f} s" for a, b in item.where.time[:_LISTED]))
    joints = [j for j in item.joints if j <= len(fit.noise_floor)]
    links = ", ".join(f'<a href="#joint-{j}">joint {j}</a>' for j in joints)
    return ", ".join(said) + (f" (maps: {links})" if links else "")


def _parameters(item: Finding) -> str:
    rows = [
        [escape(name), _value(known.value), _unit(known.unit), _interval(known)]
        for name, known in item.parameters.items()
        if known.value != ()
    ]
    return table(("parameter", "value", "unit", "95 % interval"), rows) if rows else ""


def _unit(unit: str) -> str:
    return "" if unit == "text" else escape(unit.replace("^2", "\N{SUPERSCRIPT TWO}"))


def _value(value: Value) -> str:
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, (int, float)):
        return number(float(value), 4)
    return _listed([_value(item) for item in value])


def _interval(known: Interval) -> str:
    if not known.ci95:
        return UNSAID
    return _listed([_range(pair) for pair in _pairs(known.ci95)])


def _pairs(nested: tuple[Any, ...]) -> Iterator[tuple[float | None, float | None]]:
    """Yield the intervals of a number, of a list, or of a list of rows."""
    if isinstance(nested[0], (tuple, list)):
        for inner in nested:
            yield from _pairs(inner)
    else:
        yield nested[0], nested[1]


def _range(pair: tuple[float | None, ...]) -> str:
    low, high = (number(np.nan if v is None else float(v)) for v in pair)
    return f"{low} to {high}"


def _listed(texts: list[str]) -> str:
    if len(texts) <= _LISTED:
        return ", ".join(texts)
    return folded(f"{len(texts)} values", ", ".join(texts))
