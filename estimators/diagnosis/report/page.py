"""The page of a report: its sections in the order in which they are read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.headline import headline, names_of
from estimators.diagnosis.quantities import rounded
from estimators.diagnosis.report import figures, sections
from estimators.diagnosis.report.findings import arm, overview
from estimators.diagnosis.report.truth import beside_the_truth
from estimators.diagnosis.result import coverage, hardly_shown
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, IMPROVED, NEXT_MOTION, Finding, Verdict
from estimators.telemetry import telemetry_in
from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import joint_motion
from limo_driver.pages.markup import (
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
from limo_driver.physics import Effect, display_name
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from estimators.diagnosis.result import DiagnosisResult, Shift

_FOOTER = (
    "Positive torque acts along the joint axis. The same content for programs: "
    "<code>verdict.json</code>; the improved simulation: <code>sim.yaml</code>."
)
_AXES = ("Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]")
_ANCHOR = "telemetry"
_SHOWN = 2  # recordings in the line near the head
_SHIFTS = 14  # nuisance parameters drawn; the rest is in the table


def write_report(
    diagnosis: DiagnosisResult, path: Path, concealed: Sequence[Effect] | None = None
) -> None:
    """Write a diagnosis as one HTML file that needs no network.

    Args:
        diagnosis: What was found.
        path: File to write.
        concealed: What is known to be in the arm, where that was made up.

    Raises:
        ConfigError: The file cannot be written.
    """
    report(diagnosis, concealed).save(path)


def render(diagnosis: DiagnosisResult) -> str:
    """Return the page as HTML."""
    return report(diagnosis).html()


def report(diagnosis: DiagnosisResult, concealed: Sequence[Effect] | None = None) -> Page:
    """Return the page of a diagnosis, as `write_report` writes it."""
    charts, names = Charts(), diagnosis.before.model.joint_names
    known = beside_the_truth(concealed, diagnosis.verdict.findings, names) if concealed else ""
    view, on_the_arm = arm(diagnosis, charts)
    worth, worth_in_full = telemetry(diagnosis)
    body = (
        overview(diagnosis, charts, known + worth + on_the_arm)
        + sections.stated_values(diagnosis.verdict)
        + sections.identified(diagnosis.verdict)
        + worth_in_full
        + pushed(diagnosis, charts)
        + sections.where(diagnosis, charts)
        + sections.competing(diagnosis, charts)
        + sections.tests(diagnosis)
        + sections.replay(diagnosis, charts)
        + next_motion(diagnosis, charts)
        + doubts(diagnosis, charts)
        + data(diagnosis)
    )
    return Page(
        headline(diagnosis.verdict),
        body,
        charts,
        view,
        footer=_FOOTER,
        sliding=diagnosis.verdict.sliding,
    )


def pushed(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the pushes, each with what all joints felt."""
    found = next((f for f in diagnosis.verdict.findings if f.effect == CONTACT), None)
    if found is None:
        return ""
    names = names_of(diagnosis.recordings)
    of = [names[k - 1] for k in found.where.recording]
    drawn = [
        charts.place(
            figures.push(diagnosis.traces, recording - 1, window, diagnosis.verdict.names),
            f"Push {k}",
            f"{window[0]:.1f} to {window[1]:.1f} s of {name}",
        )
        for k, (window, recording, name) in enumerate(
            zip(found.where.time[: WORDING.listed], found.where.recording, of, strict=False),
            start=1,
        )
    ]
    lead = (
        "Recorded torque less that of the improved simulation, which leaves pushes out; shaded: "
        "the push. No row of it is fitted or scored. Force and moment on the flange, in axes of "
        "the base, where it is strongest."
    )
    return section("What pushed", grid(drawn) + _wrenches(found, of), "pushes", lead)


def _wrenches(found: Finding, of: list[str]) -> str:
    """Return a table of wrenches with the half width of their intervals."""
    known = found.parameters.get("wrench")
    if known is None or known.ci95 is None:
        return ""
    values, limits = np.array(known.value, dtype=float), np.array(known.ci95, dtype=float)
    half = (limits[..., 1] - limits[..., 0]) / 2
    rows = [
        [f"{a:.2f} to {b:.2f} s", escape(name),
         *(f"{number(v)} ± {number(h, 2)}" for v, h in zip(*pair, strict=True))]
        for (a, b), name, *pair in zip(found.where.time, of, values, half, strict=True)
    ]  # fmt: skip
    return table(("window", "recording", *_AXES), rows, numeric=2)


def telemetry(diagnosis: DiagnosisResult) -> tuple[str, str]:
    """Return what to know of the recordings before any finding is believed.

    Args:
        diagnosis: What was found.

    Returns:
        A line that leads to the details, and the section that holds them.
    """
    sentences = {
        recording.source or f"recording {number}": telemetry_in(diagnosis.after, recording)
        for number, recording in enumerate(diagnosis.recordings, start=1)
    }
    items = "".join(
        f"<li>{prose(f'{name}: ' + '; '.join(lines))}.</li>" for name, lines in sentences.items()
    )
    return _line(sentences), section("What the recordings are worth", f"<ul>{items}</ul>", _ANCHOR)


def _line(sentences: Mapping[str, Sequence[str]]) -> str:
    """Return the first sentence of the first recordings, and the way to the others."""
    first = "; ".join(dict.fromkeys(lines[0] for lines in list(sentences.values())[:_SHOWN]))
    many = "Recordings" if len(sentences) > 1 else "Recording"
    return (
        f'<p class="lead">{many}: {prose(first)}. '
        f'<a href="#{_ANCHOR}">What the data are worth</a></p>'
    )


def doubts(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return what could not be observed and how far nuisance parameters moved."""
    body = unobservable(diagnosis.verdict)
    if diagnosis.shifts:
        body += _moved(diagnosis.shifts, charts)
    return section("What is unsure", body, "unsure")


def unobservable(verdict: Verdict) -> str:
    """Return the table of effects that these recordings cannot show; empty if there are none."""
    unseen = [
        [prose(display_name(item.effect)), prose(item.reason)] for item in verdict.not_observable
    ]
    title = "<h3>What these recordings cannot show</h3>"
    return title + table(("effect", "why"), unseen) if unseen else ""


def _moved(shifts: Sequence[Shift], charts: Charts) -> str:
    chart = charts.place(
        figures.shifts(shifts[:_SHIFTS]),
        "Values that moved most",
        "shaded: one standard deviation of the tolerance",
    )
    rows = [
        [prose(item.name), number(item.nominal), number(item.fitted), prose(item.unit),
         f"{item.sigmas:+.1f}"]
        for item in shifts
    ]  # fmt: skip
    listed = table(("parameter", "nominal", "fitted", "unit", "sigmas"), rows)
    sentences = (
        "Inertias, friction and sensor errors (nuisance parameters) are fitted beside every "
        "effect, within their stated tolerances, so that a slightly wrong value is not taken for "
        "missing physics."
    )
    return (
        "<h3>How far nominal values moved</h3>"
        + paragraph(sentences, "small")
        + chart
        + folded(f"All {len(rows)} values", listed)
    )


def next_motion(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the motion to record next, and what it would decide."""
    wanted = diagnosis.verdict.next_motion
    body = ""
    if sentences := diagnosis.next_motion_purpose or diagnosis.next_motion_note:
        body = paragraph(sentences)
    if diagnosis.next_motion is not None:
        file = wanted.file if wanted else NEXT_MOTION
        minutes = diagnosis.next_motion.duration / 60
        body += charts.place(
            joint_motion(diagnosis.next_motion, diagnosis.verdict.names, diagnosis.verdict.sliding),
            "Joint motion",
            f"{minutes:.1f} min",
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
    return section("Data", samples + grid([_compared(verdict), _held(verdict)]), "data")


def _held(verdict: Verdict) -> str:
    """Return the motion on which the verdict stands, joint by joint."""
    if verdict.holds is None:
        return ""
    columns = (verdict.holds.position, verdict.holds.speed, verdict.holds.load)
    rows = [
        [escape(joint), *(f"{rounded(low, 2)} to {rounded(high, 2)}" for low, high in ranges)]
        for joint, *ranges in zip(verdict.labels, *columns, strict=True)
    ]
    sentences = (
        "What was found was seen on this motion. On faster motion, in other poses and under other "
        "loads the improved simulation extrapolates."
    )
    ranges = {"position": "rad", "speed": "rad/s", "load": "N m"}
    units = (f"{name} [{unit_of(unit, verdict.sliding)}]" for name, unit in ranges.items())
    headings = ("joint", *units)
    text = " ".join(filter(None, [sentences, hardly_shown(verdict)]))
    return f"<div>{table(headings, rows, numeric=1)}{paragraph(text, 'small')}</div>"


def _compared(verdict: Verdict) -> str:
    """Return how many rows were compared, fitted, held out and judged, joint by joint."""
    count = verdict.rows
    columns = (count.usable, count.fitted, count.judged, count.part_judged())
    rows = [
        [escape(label), _count(usable), _count(fitted), _count(judged), percent(part)]
        for label, (usable, fitted, judged, part) in zip(
            verdict.labels, zip(*columns, strict=True), strict=False
        )
    ]
    if not rows:
        return ""
    sentences = (
        f"All is compared on {_count(count.total)} rows, thinned behind the filter, of which "
        f"{_count(count.held_out)} lie in blocks of time that nothing was fitted to. "
        f"{coverage(verdict)}"
    )
    headings = ("joint", "usable rows", "fitted", "judged", "judged, of those held out")
    return f"<div>{table(headings, rows, numeric=1)}{paragraph(sentences, 'small')}</div>"


def _count(number: int) -> str:
    return f"{number:,}".replace(",", "\N{NO-BREAK SPACE}")
