"""The first screen of a report: the verdict, what to do with it, and errors before and after."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.headline import headline, names_of
from estimators.diagnosis.held_out import reducible_removed
from estimators.diagnosis.quantities import rounded
from estimators.diagnosis.report import figures
from estimators.diagnosis.report.cards import cards, error_of
from estimators.diagnosis.result import WORSE, columns_of, coverage
from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.verdict import IMPROVED, Fit, Verdict
from limo_driver.pages.markup import (
    UNSAID,
    Charts,
    command,
    folded,
    grid,
    header,
    key,
    listed,
    paragraph,
    percent,
    table,
)
from limo_driver.physics import Simulation, display_name
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.result import DiagnosisResult
    from limo_driver.recordings.recording import Recording


def overview(diagnosis: DiagnosisResult, charts: Charts, between: str = "") -> str:
    """Return verdict, what to do with it, errors and findings.

    Args:
        diagnosis: What was found.
        charts: Of the page.
        between: What follows the verdict, before the errors.
    """
    verdict = diagnosis.verdict
    names = names_of(diagnosis.recordings)
    head = header(
        f"Diagnosis of a simulation of {PurePath(diagnosis.before.robot).stem}",
        headline(verdict),
        removed(verdict),
        f"{compared_with(diagnosis.recordings)} Motion and torque pass the same zero-phase filter "
        f"of {diagnosis.bandwidth:g} Hz.",
        badge=badge(verdict),
    )
    to_do = put(diagnosis.before, diagnosis.after, verdict) + _next(verdict)
    rest = [note for note in verdict.notes if note not in verdict.doubts]
    told = (
        errors(verdict, charts)
        + cards(verdict, names, diagnosis.after.effects, charts)
        + notes(rest)
    )
    return f"{head}{doubted(verdict.doubts)}{to_do}{between}{told}"


def badge(verdict: Verdict) -> tuple[str, str]:
    """Return the states that hold, and the class of their colour."""
    agrees = verdict.states == ("agrees",)
    coloured = "explained" if verdict.verdict == "consistent" and not agrees else verdict.verdict
    return "; ".join(verdict.states), coloured


def doubted(sentences: Sequence[str]) -> str:
    """Return what makes all of a diagnosis doubtful, above what to do with it."""
    if not sentences:
        return ""
    return f'<aside class="doubted"><h2>Is this right?</h2>{listed(sentences)}</aside>'


def errors(verdict: Verdict, charts: Charts) -> str:
    """Return the section of the errors before and after, with what they count."""
    of = "Torque" if verdict.is_of_torque else "Position"
    chart = charts.place(
        figures.summary(verdict.fit, verdict.names), f"{of} error of each joint on held-out motion"
    )
    beside = grid([chart, _meaning(verdict)])
    return f'<section id="errors">{beside}{_errors(verdict)}</section>'


def _next(verdict: Verdict) -> str:
    """Return the way to the motion to record next, if one would decide between explanations."""
    if verdict.next_motion is None:
        return ""
    pairs = "; ".join(
        f"{display_name(a)} or {display_name(b)}" for a, b in verdict.next_motion.separates
    )
    asked = f"To decide between {pairs}: " if pairs else "To know more: "
    return f'<p>{escape(asked)}<a href="#next">the motion to record next</a>.</p>'


def put(before: Simulation, after: Simulation, verdict: Verdict) -> str:
    """Return how to get what was found into a simulator; nothing where nothing changes."""
    values = after.changes_from(before)
    if not values:
        return ""
    if verdict.states == ("agrees",):
        sentences = "Nothing has to change in your simulation."
        return f'<aside class="put">{paragraph(sentences)}</aside>'
    kind = before.model.description.kind.lower()
    line = f"limo export {IMPROVED} --to {kind} --out improved/"
    where = "In the folder of this report; writes a copy of your own file with the values in it:"
    copied = folded(
        "The values, as they stand in sim.yaml", f'<pre id="values">{escape(values)}</pre>'
    )
    return (
        '<aside class="put"><h2>Put this into your simulation</h2>'
        f"{paragraph(where)}"
        f'<pre id="export">{command(line)}</pre>'
        '<button type="button" class="copy" data-of="export">copy command</button> '
        f'<button type="button" class="copy" data-of="values">copy values</button>{copied}</aside>'
    )


def notes(sentences: Sequence[str]) -> str:
    """Return what a reader has to know before trusting the figures."""
    if not sentences:
        return ""
    return f'<section id="notes"><h2>Before you use the values</h2>{listed(sentences)}</section>'


def compared_with(recordings: Sequence[Recording]) -> str:
    """Say which recordings a simulation was compared with."""
    sentences = [
        f"{name} ({item.duration:.0f} s at {item.rate:.0f} Hz)"
        for name, item in zip(names_of(recordings), recordings, strict=True)
    ]
    return f"Compared with {'; '.join(sentences)}."


def _errors(verdict: Verdict) -> str:
    """Return the errors of each joint, on the rows that count and on all rows."""
    worse = verdict.fit.worse_within_tolerances
    columns = columns_of(verdict)
    after, floor = np.array(columns["improved"]), np.array(columns["noise floor"])
    ratio = after / np.maximum(floor, 1e-12)
    columns[_RATIO] = ratio.tolist()
    rows = [
        [escape(called), *(_cell(x, value, marked=j in worse) for x, value in errors.items())]
        for j, (called, errors) in enumerate(
            zip(verdict.labels, _by_joint(columns), strict=True), start=1
        )
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
    counted = coverage(verdict) if verdict.rows.fitted else ""
    told = (_by_tolerances(fit, findings=bool(verdict.findings)), counted)
    return f"<div>{''.join(map(paragraph, filter(None, told)))}{key(meanings)}</div>"


def removed(verdict: Verdict) -> str:
    """Say in a sentence how much of the torque error the improved simulation removes."""
    fit = verdict.fit
    before, after = np.array(fit.heldout_rmse_before), np.array(fit.heldout_rmse_after)
    ratio = np.nan_to_num(before / np.maximum(np.array(fit.noise_floor), 1e-12))
    (low, high), part = fit.ci95, fit.reducible_error_removed
    if ratio.max(initial=0.0) <= WORDING.at_floor:
        return (
            "On held-out motion the given simulation is at the noise floor of every joint: there "
            "is no error that another one could remove."
        )
    if not np.isfinite(part):
        return "There is no reducible error to remove."
    j = int(np.argmax(ratio))
    unit = verdict.unit_at(j + 1)
    return (
        f"On held-out motion the improved simulation removes {percent(part)} of the reducible "
        f"error{_between(low, high)}, at joint {verdict.labels[j]} from {rounded(before[j], 3)} "
        f"to {rounded(after[j], 3)} {unit} RMSE (noise floor "
        f"{rounded(fit.noise_floor[j], 3)} {unit})."
    )


def _between(low: float, high: float) -> str:
    """Return an interval in brackets; nothing where both ends read the same."""
    ends = percent(low), percent(high)
    return "" if ends[0] == ends[1] else f" (95\N{NO-BREAK SPACE}% interval {' to '.join(ends)})"


def _by_joint(columns: Mapping[str, Sequence[float]]) -> Iterator[dict[str, float]]:
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(columns, values, strict=True))


def _of_floor(ratio: float) -> str:
    """Say how far above the noise floor an error is; at it, nothing can be told from noise."""
    return "at the floor" if ratio <= WORDING.at_floor else f"{ratio:.1f} times"


_RATIO = "improved, beside the floor"
_PLAIN = {"rows judged": percent, _RATIO: _of_floor}  # columns without a unit


def _cell(heading: str, value: float, *, marked: bool) -> str:
    if heading in _PLAIN:
        return _PLAIN[heading](value) if np.isfinite(value) else UNSAID
    return error_of(value) + (" *" if marked and heading == "within tolerances" else "")


def _by_tolerances(fit: Fit, *, findings: bool) -> str:
    """Say how much of the error goes without any finding, if that is worth a word."""
    errors = (fit.heldout_rmse_before, fit.heldout_rmse_tolerances, fit.noise_floor)
    if not fit.heldout_rmse_tolerances:
        return ""
    taken = reducible_removed(*map(np.array, errors))
    if taken < WORDING.by_tolerances:
        return ""
    sentences = f"Moving values within their tolerances alone removes {percent(taken)} of the error"
    return sentences + ("; the findings are about what remains." if findings else ".")
