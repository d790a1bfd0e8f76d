"""The first screen of a report: the verdict, errors before and after, and each finding."""

from __future__ import annotations

from html import escape
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.headline import headline, place_of, to_interval
from estimators.diagnosis.report import figures
from estimators.diagnosis.residuals.held_out import reducible_removed
from estimators.diagnosis.summary import WORSE, columns_of, coverage
from estimators.diagnosis.verdict import CONTACT, IMPROVED, TORQUE, UNKNOWN, Interval
from estimators.diagnosis.wording import is_of_bodies, names_of, rounded
from limo_driver.pages.markup import (
    UNSAID,
    Charts,
    folded,
    grid,
    header,
    listed,
    meter,
    number,
    paragraph,
    percent,
    prose,
    table,
)
from limo_driver.physics import spoken

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.result import Diagnosis
    from estimators.diagnosis.verdict import Finding, Fit, Value, Verdict
    from limo_driver.physics import Simulation

VERDICTS = {
    "consistent": "simulation and recording agree",
    "explained": "the difference is explained",
    "partly_explained": "the difference is explained in part",
    "unexplained": "the difference is not explained",
}
_KINDS = {
    "missing": "left out of the simulation",
    "wrong_parameter": "in the simulation with a wrong value",
}
_NO_EFFECT_OF_THE_ARM = {
    UNKNOWN: "nothing in the catalogue explains it",
    CONTACT: "an event, not a property of the arm; the improved simulation leaves it out",
}
_MOST = 3  # joints of a finding whose errors are shown; the table above has all
_LISTED = 6  # values of a parameter that are shown before they are folded
_FLOOR = 1.15  # noise floors up to which an error is at the floor: that is an estimate itself
_WORTH_SAYING = 0.05  # part of the reducible error
_AXES = {"com": ("x", "y", "z"), "inertia": ("xx", "xy", "xz", "yy", "yz", "zz")}  # of bodies


def overview(diagnosis: Diagnosis, charts: Charts, between: str = "") -> str:
    """Return verdict, what to do with it, errors and findings.

    Args:
        diagnosis: What was found.
        charts: Of the page.
        between: What follows the verdict, before the errors.
    """
    verdict = diagnosis.verdict
    names = names_of(diagnosis.recordings)
    head = header(
        f"Diagnosis of a simulation of {_robot(diagnosis)}",
        headline(verdict),
        removed(verdict.fit),
        _sources(diagnosis, names),
        badge=(VERDICTS[verdict.verdict], verdict.verdict),
    )
    to_do = put(diagnosis.before, diagnosis.after, verdict) + _next(verdict)
    told = errors(verdict, charts) + cards(verdict, names) + notes(verdict.notes)
    return f"{head}{to_do}{between}{told}"


def errors(verdict: Verdict, charts: Charts) -> str:
    """Return the section of the errors before and after, with what they count."""
    of = "Torque" if verdict.fit.unit == TORQUE else "Position"
    chart = charts.place(
        figures.summary(verdict.fit), f"{of} error of each joint on held-out motion"
    )
    beside = grid([chart, _meaning(verdict)])
    return f'<section id="errors">{beside}{_errors(verdict)}</section>'


def cards(verdict: Verdict, names: Sequence[str]) -> str:
    """Return the section of the findings; empty if there are none.

    Args:
        verdict: What was found.
        names: Of the recordings.
    """
    items = "".join(
        _card(number, item, verdict.fit, names)
        for number, item in enumerate(verdict.findings, start=1)
    )
    title = "Findings" if len(verdict.findings) > 1 else "Finding"
    return f'<section id="findings"><h2>{title}</h2>{items}</section>' if items else ""


def _next(verdict: Verdict) -> str:
    """Return the way to the motion to record next, if one would decide between explanations."""
    if verdict.next_motion is None:
        return ""
    pairs = "; ".join(f"{spoken(a)} or {spoken(b)}" for a, b in verdict.next_motion.separates)
    asked = f"To decide between {pairs}: " if pairs else "To know more: "
    return f'<p>{escape(asked)}<a href="#next">the motion to record next</a>.</p>'


def put(before: Simulation, after: Simulation, verdict: Verdict) -> str:
    """Return how to get what was found into a simulator; nothing where nothing changes."""
    values = after.changes_from(before)
    if not values:
        return ""
    if not verdict.findings and not verdict.identified:
        said = "Nothing has to change in your simulation."
        return f'<aside class="put">{paragraph(said)}</aside>'
    kind = before.model.description.kind.lower()
    command = f"limo export {IMPROVED} --to {kind} --out improved/"
    where = "In the folder of this report; writes a copy of your own file with the values in it:"
    copied = folded(
        "The values, as they stand in sim.yaml", f'<pre id="values">{escape(values)}</pre>'
    )
    return (
        '<aside class="put"><h2>Put this into your simulation</h2>'
        f"{paragraph(where)}"
        f'<pre id="export">{escape(command)}</pre>'
        '<button type="button" class="copy" data-of="export">copy command</button> '
        f'<button type="button" class="copy" data-of="values">copy values</button>{copied}</aside>'
    )


def notes(said: Sequence[str]) -> str:
    """Return what a reader has to know before trusting the figures."""
    if not said:
        return ""
    return f'<section id="notes"><h2>Before you use the values</h2>{listed(said)}</section>'


def _sources(diagnosis: Diagnosis, names: Sequence[str]) -> str:
    said = [
        f"{name} ({item.duration:.0f} s at {item.rate:.0f} Hz)"
        for name, item in zip(names, diagnosis.recordings, strict=True)
    ]
    return (
        f"Compared with {'; '.join(said)}. Motion and torque pass the same zero-phase filter of "
        f"{diagnosis.bandwidth:g} Hz."
    )


def _robot(diagnosis: Diagnosis) -> str:
    return PurePath(diagnosis.before.robot).stem


def _errors(verdict: Verdict) -> str:
    """Return the errors of each joint, on the rows that count and on all rows."""
    fit, worse = verdict.fit, verdict.fit.worse_within_tolerances
    columns = columns_of(verdict)
    ratio = np.array(fit.heldout_rmse_after) / np.maximum(np.array(fit.noise_floor), 1e-12)
    columns[_RATIO] = ratio.tolist()
    rows = [
        [str(j), *(_cell(name, value, marked=j in worse) for name, value in errors.items())]
        for j, errors in enumerate(_by_joint(columns), start=1)
    ]
    headings = (
        "joint",
        *(name if name in _PLAIN else f"{name} [{verdict.fit.unit}]" for name in columns),
    )
    return table(headings, rows, numeric=1) + (paragraph(WORSE, "small") if worse else "")


def _meaning(verdict: Verdict) -> str:
    """Say what the errors count."""
    fit = verdict.fit
    meanings = {
        "Held-out": "parts of the recordings that no parameter was fitted to.",
        "Noise floor": "an estimate of the error that stays whatever the model. An error near it, "
        "or below, cannot be told from noise.",
        "Reducible error": "the mean square of the error above the noise floor.",
    }
    if fit.heldout_rmse_tolerances:
        meanings["Within tolerances"] = (
            "the given simulation with its values moved as far as they may be wrong, and no effect "
            "added."
        )
    said = "".join(f"<dt>{name}</dt><dd>{prose(text)}</dd>" for name, text in meanings.items())
    counted = coverage(verdict) if verdict.rows.fitted else ""
    told = (_by_tolerances(fit, findings=bool(verdict.findings)), counted)
    return f'<div>{"".join(map(paragraph, filter(None, told)))}<dl class="small">{said}</dl></div>'


def removed(fit: Fit) -> str:
    """Say in a sentence how much of the torque error the improved simulation removes."""
    before, after = np.array(fit.heldout_rmse_before), np.array(fit.heldout_rmse_after)
    ratio = np.nan_to_num(before / np.maximum(np.array(fit.noise_floor), 1e-12))
    (low, high), part = fit.ci95, fit.reducible_error_removed
    if ratio.max(initial=0.0) <= _FLOOR:
        return (
            "On held-out motion the given simulation is at the noise floor of every joint: there "
            "is no error that another one could remove."
        )
    if not np.isfinite(part):
        return "There is no reducible error to remove."
    j = int(np.argmax(ratio))
    return (
        f"On held-out motion the improved simulation removes {percent(part)} of the reducible "
        f"error (95\N{NO-BREAK SPACE}% interval {percent(low)} to {percent(high)}), at joint "
        f"{j + 1} from {rounded(before[j], 3)} to {rounded(after[j], 3)} {fit.unit} RMSE (noise "
        f"floor {rounded(fit.noise_floor[j], 3)} {fit.unit})."
    )


def _by_joint(columns: Mapping[str, Sequence[float]]) -> Iterator[dict[str, float]]:
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(columns, values, strict=True))


def _of_floor(ratio: float) -> str:
    """Say how far above the noise floor an error is; at it, nothing can be told from noise."""
    return "at the floor" if ratio <= _FLOOR else f"{ratio:.1f} times"


_RATIO = "improved, beside the floor"
_PLAIN = {"rows judged": percent, _RATIO: _of_floor}  # columns without a unit


def _cell(heading: str, value: float, *, marked: bool) -> str:
    if heading in _PLAIN:
        return _PLAIN[heading](value) if np.isfinite(value) else UNSAID
    return _rmse(value) + (" *" if marked and heading == "within tolerances" else "")


def _by_tolerances(fit: Fit, *, findings: bool) -> str:
    """Say how much of the error goes without any finding, if that is worth a word."""
    errors = (fit.heldout_rmse_before, fit.heldout_rmse_tolerances, fit.noise_floor)
    if not fit.heldout_rmse_tolerances:
        return ""
    taken = reducible_removed(*map(np.array, errors))
    if taken < _WORTH_SAYING:
        return ""
    said = f"Moving values within their tolerances alone removes {percent(taken)} of the error"
    return said + ("; the findings are about what remains." if findings else ".")


def _rmse(value: float) -> str:
    return rounded(value) if np.isfinite(value) else UNSAID


def _card(order: int, item: Finding, fit: Fit, recordings: Sequence[str]) -> str:
    unknown = item.effect == UNKNOWN
    name = "Something unknown" if unknown else spoken(item.effect).capitalize()
    means = _NO_EFFECT_OF_THE_ARM.get(item.effect) or _KINDS[item.kind]
    head = (
        f"<h3>{escape(name)} <span>{escape(_title_place(item, fit))}</span></h3>"
        f'<p class="kind">{escape(means)}</p>{paragraph(_sentence(item.evidence), "evidence")}'
    )
    facts = [
        ("confidence", meter(item.confidence)),
    ]
    if drop := _drop(item, fit.unit):
        facts.append(("held-out RMSE, fitted without → with it", drop))
    beside = " that tolerances leave" if fit.heldout_rmse_tolerances else ""
    if item.share > 0:  # of a push nothing is: its rows are not scored
        does = "leaves" if unknown else "removes"
        facts.insert(1, (does, f"{meter(item.share)} of the error{beside}"))
    if item.equivalent:
        names = ", ".join(spoken(e) for e in item.equivalent)
        facts.append(("cannot be told from", escape(names)))
    if where := _where(item, fit, recordings):
        facts.append(("where", where))
    listed = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in facts)
    kind = "card unknown" if unknown else "card"
    return (
        f'<article id="finding-{order}" class="{kind}">{head}<dl>{listed}</dl>'
        f"{_parameters(item) if item.effect != CONTACT else ''}</article>"
    )


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""


def _title_place(item: Finding, fit: Fit) -> str:
    """Say where an effect is, and at which joint it shows where that is another one."""
    place = place_of(item, len(fit.noise_floor))
    shows = item.where.figure.removeprefix("joint-")
    if not shows.isdigit() or (int(shows),) == item.joints:
        return place
    return f"{place}, most of all at joint {shows}" if item.effect != CONTACT else place


def _drop(item: Finding, unit: str) -> str:
    pairs = item.heldout_rmse
    if pairs.before == pairs.after:  # nothing is taken off
        return ""
    everywhere = range(1, len(pairs.before) + 1)
    own = () if is_of_bodies(item.effect) else item.joints
    joints = [j for j in own if j in everywhere] or everywhere
    shown = sorted(joints, key=lambda j: pairs.after[j - 1] - pairs.before[j - 1])[:_MOST]
    return "; ".join(
        f"joint {j}: {_rmse(pairs.before[j - 1])} → {_rmse(pairs.after[j - 1])} {unit}"
        for j in shown
    )


def _where(item: Finding, fit: Fit, recordings: Sequence[str]) -> str:
    said = [item.where.region] if item.where.region else []
    of = [f" of {recordings[k - 1]}" for k in item.where.recording if len(recordings) > 1]
    stretches = [f"{a:.1f} to {b:.1f} s" for a, b in item.where.time[:_LISTED]]
    said += [text + (of[k] if of else "") for k, text in enumerate(stretches)]
    if item.effect == CONTACT:
        return escape("; ".join(said)) + ' (<a href="#pushes">courses</a>)'
    shows = item.where.figure.removeprefix("joint-")
    joints = (int(shows),) if is_of_bodies(item.effect) and shows.isdigit() else item.joints
    joints = [j for j in joints if j <= len(fit.noise_floor)]
    links = ", ".join(f'<a href="#joint-{j}">joint {j}</a>' for j in joints)
    if not said:
        return links
    return escape("; ".join(said)) + (f" (maps: {links})" if links else "")


def _parameters(item: Finding) -> str:
    rows = [
        [escape(part), *_value_and_interval(one, _unit(one.unit))]
        for name, known in item.parameters.items()
        if known.value != () and not _is_left_out(known)
        for part, one in _components(name, known)
    ]
    return table(("parameter", "value", "unit", "95 % interval"), rows) if rows else ""


def _is_left_out(known: Interval) -> bool:
    """Say whether a parameter is a part of the law that the data did not ask for."""
    return known.value == 0 and not known.ci95


def _components(name: str, known: Interval) -> list[tuple[str, Interval]]:
    """Return a vector as its components; anything else as it is."""
    axes, values, ends = _AXES.get(name), known.value, known.ci95 or ()
    if axes is None or not isinstance(values, tuple) or not len(axes) == len(values) == len(ends):
        return [(name, known)]
    parts = zip(axes, values, ends, strict=True)
    return [(f"{name} {axis}", Interval(one, known.unit, pair)) for axis, one, pair in parts]


def _value_and_interval(known: Interval, unit: str) -> tuple[str, str, str]:
    """Return value, unit and interval, to the digits that the interval leaves."""
    values = list(_numbers(known.value))
    pairs = list(_pairs(known.ci95)) if known.ci95 else []
    ends = [(low, high) for low, high in pairs if low is not None and high is not None]
    if not values or len(values) != len(ends):
        return _value(known.value), unit, _interval(known)
    said = [to_interval(value, *pair) for value, pair in zip(values, ends, strict=True)]
    ranges = [f"{low} to {high}" for _, low, high in said]
    return _listed([value for value, _, _ in said]), unit, _listed(ranges)


def _numbers(value: Value) -> Iterator[float]:
    """Yield the numbers of a value, of a list, or of a list of rows; none of a text."""
    if isinstance(value, (int, float)):
        yield float(value)
    elif not isinstance(value, str):
        for inner in value:
            yield from _numbers(inner)


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
