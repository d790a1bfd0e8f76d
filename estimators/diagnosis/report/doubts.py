"""The end of a report: what is unsure, which motion to record next, and what was used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.report import figures
from estimators.diagnosis.summary import coverage, kept_as_stated
from estimators.diagnosis.verdict import IMPROVED, NEXT_MOTION
from estimators.diagnosis.wording import rounded
from limo_driver.pages.figures import joint_motion
from limo_driver.pages.markup import (
    Charts,
    command,
    folded,
    grid,
    number,
    paragraph,
    percent,
    prose,
    section,
    table,
)
from limo_driver.physics import spoken

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.result import DiagnosisResult, Shift
    from estimators.diagnosis.verdict import Verdict

_SHIFTS = 14  # nuisance parameters drawn; the rest is in the table


def doubts(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return what could not be observed and how far nuisance parameters moved."""
    body = unobservable(diagnosis.verdict)
    if diagnosis.shifts:
        body += _moved(diagnosis.shifts, charts)
    return section("What is unsure", body, "unsure")


def unobservable(verdict: Verdict) -> str:
    """Return the table of effects that these recordings cannot show; empty if there are none."""
    unseen = [[prose(spoken(item.effect)), prose(item.reason)] for item in verdict.not_observable]
    title = "<h3>What these recordings cannot show</h3>"
    return title + table(("effect", "why"), unseen) if unseen else ""


def _moved(shifts: Sequence[Shift], charts: Charts) -> str:
    chart = charts.place(
        figures.shifts(shifts[:_SHIFTS]),
        "Values that moved most",
        "shaded: one standard deviation of the tolerance",
    )
    rows = [
        [prose(item.name), number(item.nominal, 4), number(item.fitted, 4), prose(item.unit),
         f"{item.sigmas:+.1f}"]
        for item in shifts
    ]  # fmt: skip
    listed = table(("parameter", "nominal", "fitted", "unit", "sigmas"), rows)
    said = (
        "Inertias, friction and sensor errors (nuisance parameters) are fitted beside every "
        "effect, within their stated tolerances, so that a slightly wrong value is not taken for "
        "missing physics."
    )
    return (
        "<h3>How far nominal values moved</h3>"
        + paragraph(said, "small")
        + chart
        + folded(f"All {len(rows)} values", listed)
    )


def next_motion(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the motion to record next, and what it would decide."""
    wanted = diagnosis.verdict.next_motion
    body = ""
    if said := diagnosis.next_motion_purpose or diagnosis.next_motion_note:
        body = paragraph(said)
    if diagnosis.next_motion is not None:
        file = wanted.file if wanted else NEXT_MOTION
        minutes = diagnosis.next_motion.duration / 60
        body += charts.place(
            joint_motion(diagnosis.next_motion), "Joint motion", f"{minutes:.1f} min"
        )
        line = (
            f"limo run --backend mujoco --trajectory {file} --sim {IMPROVED} --record next.parquet"
        )
        body += (
            f"<p>Move the recorded arm along it and diagnose again with that recording added. On a "
            f"simulated arm, in the folder of this report:</p><pre>{command(line)}</pre>"
        )
    return section("The motion to record next", body, "next")


def data(diagnosis: DiagnosisResult) -> str:
    """Return what was used of the recordings, and what was left out."""
    verdict = diagnosis.verdict
    rows = [["samples used", _count(verdict.rows.used)]]
    rows += [
        [f"samples left out: {prose(reason)}", _count(count)]
        for reason, count in verdict.rows.left_out.items()
    ]
    samples = table(("recordings", "number"), rows, numeric=1)
    return section("Data", grid([samples, _compared(verdict), _held(verdict)]), "data")


def _held(verdict: Verdict) -> str:
    """Return the motion on which the verdict stands, joint by joint."""
    if verdict.holds is None:
        return ""
    columns = (verdict.holds.position, verdict.holds.speed, verdict.holds.load)
    rows = [
        [str(j), *(f"{rounded(low, 2)} to {rounded(high, 2)}" for low, high in ranges)]
        for j, ranges in enumerate(zip(*columns, strict=True), start=1)
    ]
    said = (
        "What was found was seen on this motion. On faster motion, in other poses and under other "
        "loads the improved simulation extrapolates."
    )
    headings = ("joint", "position [rad]", "speed [rad/s]", "load [N m]")
    text = " ".join(filter(None, [said, kept_as_stated(verdict)]))
    return f"<div>{table(headings, rows, numeric=1)}{paragraph(text, 'small')}</div>"


def _compared(verdict: Verdict) -> str:
    """Return how many rows were compared, fitted, held out and judged, joint by joint."""
    count = verdict.rows
    columns = (count.usable, count.fitted, count.judged, count.part_judged())
    rows = [
        [str(j), _count(usable), _count(fitted), _count(judged), percent(part)]
        for j, (usable, fitted, judged, part) in enumerate(zip(*columns, strict=True), start=1)
    ]
    if not rows:
        return ""
    said = (
        f"All is compared on {_count(count.total)} rows, thinned behind the filter, of which "
        f"{_count(count.held_out)} lie in blocks of time that nothing was fitted to. "
        f"{coverage(verdict)}"
    )
    headings = ("joint", "usable rows", "fitted", "judged", "judged, of those held out")
    return f"<div>{table(headings, rows, numeric=1)}{paragraph(said, 'small')}</div>"


def _count(number: int) -> str:
    return f"{number:,}".replace(",", "\N{NO-BREAK SPACE}")
