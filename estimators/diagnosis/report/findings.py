"""The first screen of a report: the verdict, what to do with it, and errors before and after.

The arm of a report: errors and findings at its joints, and the recorded motion with ghosts.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.headline import (
    carrier_of,
    headline,
    is_of_bodies,
    named,
    names_of,
    quantity_of,
)
from estimators.diagnosis.held_out import reducible_removed
from estimators.diagnosis.quantities import heading_of, in_noise_floors, of_joints, rounded
from estimators.diagnosis.report import figures
from estimators.diagnosis.report.cards import cards, error_of
from estimators.diagnosis.result import WORSE, columns_of, coverage
from estimators.diagnosis.settings import LITTLE
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, IMPROVED, UNKNOWN, Finding, Fit, Verdict
from limo_driver.pages.arm import ArmView, Ghost, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.figures import DRAWN
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
from limo_driver.pages.motion import arm_section
from limo_driver.physics import Payload, Simulation, display_name
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.result import DiagnosisResult, Replay
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


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
    to_do = export_instructions(diagnosis.before, diagnosis.after, verdict) + _next(verdict)
    rest = [note for note in verdict.notes if note not in verdict.doubts]
    parts = (
        errors(verdict, charts)
        + cards(verdict, names, diagnosis.after.effects, charts)
        + notes(rest)
    )
    return f"{head}{doubted(verdict.doubts)}{to_do}{between}{parts}"


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


def export_instructions(before: Simulation, after: Simulation, verdict: Verdict) -> str:
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
    columns[_RATIO] = in_noise_floors(columns["improved"], verdict.fit).tolist()
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
    parts = (_by_tolerances(fit, findings=bool(verdict.findings)), counted)
    return f"<div>{''.join(map(paragraph, filter(None, parts)))}{key(meanings)}</div>"


def removed(verdict: Verdict) -> str:
    """Say in a sentence how much of the torque error the improved simulation removes."""
    fit = verdict.fit
    before, after = np.array(fit.heldout_rmse_before), np.array(fit.heldout_rmse_after)
    ratio = np.nan_to_num(in_noise_floors(fit.heldout_rmse_before, fit))
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
        f"error{_between(low, high)}, at joint {verdict.labels[j]} from {rounded(before[j])} "
        f"to {rounded(after[j])} {unit} RMSE (noise floor "
        f"{rounded(fit.noise_floor[j])} {unit})."
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


_RATIO = "improved, over the floor"
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
    if taken < LITTLE:
        return ""
    sentences = f"Moving values within their tolerances alone removes {percent(taken)} of the error"
    return sentences + ("; the findings are about what remains." if findings else ".")


GIVEN_ARM, IMPROVED_ARM = "given simulation", "improved simulation"


def arm(diagnosis: DiagnosisResult, charts: Charts) -> tuple[ArmView, str]:
    """Return the arm and its place in the page."""
    fit, traces = diagnosis.verdict.fit, diagnosis.traces
    recording = played(diagnosis)
    motion = _motion(diagnosis, recording)
    view = arm_view(
        diagnosis.before.model,
        motion.position[_worst(diagnosis, motion.time, recording)],
        errors=(
            (GIVEN_ARM, fit.heldout_rmse_before),
            (IMPROVED_ARM, fit.heldout_rmse_after),
            ("noise floor", fit.noise_floor),
        ),
        floor=fit.noise_floor,
        pins=pins(diagnosis.verdict),
        motion=motion,
    )
    j = int(np.argmax(np.nan_to_num(in_noise_floors(fit.heldout_rmse_before, fit))))
    caption = f"{heading_of(j + 1, diagnosis.verdict.names)}: recorded minus simulated torque"
    drawn = charts.place(
        figures.error_over_time(traces, j, recording),
        caption,
        "pale: near rest, not scored; click to move the arm there",
        follows=True,
    )
    lead = (
        "Drag to turn. The ring around each joint is coloured by the torque error there, in "
        "multiples of its noise floor: over the held-out motion, or at the moment of the slider, "
        "where its size shows it, too."
    )
    return view, arm_section(view, "Where on the arm", lead) + grid([drawn], "one")


def played(diagnosis: DiagnosisResult) -> int:
    """Return which recording is played, 0-based: one with pushes, else the one replayed."""
    found = [f for f in diagnosis.verdict.findings if f.effect == CONTACT]
    if pushed := [k for f in found for k in f.where.recording]:
        return pushed[0] - 1
    return diagnosis.replay[0].recording if diagnosis.replay else 0


def _motion(diagnosis: DiagnosisResult, recording: int) -> PlayedMotion:
    traces = diagnosis.traces
    rows = np.flatnonzero(traces.recording == recording)
    rows = rows[:: max(1, -(-len(rows) // DRAWN))]
    time, position = traces.time[rows], traces.position[rows]
    replay = next((item for item in diagnosis.replay if item.recording == recording), None)
    ghosts = (
        Ghost(GIVEN_ARM, figures.BEFORE, (traces.measured - traces.before)[rows],
              _ghost(replay, time, position, "position_before")),
        Ghost(IMPROVED_ARM, figures.AFTER, (traces.measured - traces.after)[rows],
              _ghost(replay, time, position, "position_after")),
    )  # fmt: skip
    name = names_of(diagnosis.recordings)[recording]
    texts = f"Solid: the recorded motion of {name}."
    if replay is not None:
        texts += (
            f" Translucent, from {replay.time[0]:.1f} to {replay.time[-1]:.1f} s: the simulated "
            "robot, told to follow that motion by its own drives; its distance from the recorded "
            "pose is enlarged as chosen above."
        )
    pushes = _pushes(diagnosis.verdict.findings, recording)
    if pushes:
        texts += " Pink arrow: the force at the flange that explains a push best."
    return PlayedMotion(time, position, ghosts, pushes, texts)


def _ghost(
    replay: Replay | None, time: FloatArray, position: FloatArray, which: str
) -> FloatArray | None:
    """Return where a simulated arm was at some times, (T, n) [rad]; NaN where it was not run."""
    if replay is None:
        return None
    apart = getattr(replay, which) - replay.position
    columns = [
        np.interp(time, replay.time, column, left=np.nan, right=np.nan) for column in apart.T
    ]
    return position + np.stack(columns, axis=1)


def _pushes(findings: Sequence[Finding], recording: int) -> tuple[PushArrow, ...]:
    found = next((item for item in findings if item.effect == CONTACT), None)
    known = found.parameters.get("wrench") if found else None
    if found is None or known is None or isinstance(known.value, (str, float, int)):
        return ()
    every = zip(found.where.time, found.where.recording, known.value, strict=True)
    return tuple(
        PushArrow(start, end, tuple(np.array(wrench, dtype=float)[:3].tolist()))
        for (start, end), of, wrench in every
        if of == recording + 1
    )


def _worst(diagnosis: DiagnosisResult, time: FloatArray, recording: int) -> int:
    """Return the row at which the given simulation is farthest off, in noise floors."""
    traces = diagnosis.traces
    error = in_noise_floors(
        np.abs(traces.measured - traces.before) * traces.moving, diagnosis.verdict.fit
    )
    own = traces.recording == recording
    for replay in diagnosis.replay:  # there the simulated arms can be seen beside the recorded one
        if replay.recording == recording:
            own &= (traces.time >= replay.time[0]) & (traces.time <= replay.time[-1])
    worst = traces.time[own][int(np.argmax(error[own].max(axis=1)))]
    return int(np.argmin(np.abs(time - worst)))


def pins(verdict: Verdict) -> tuple[Pin, ...]:
    """Return one text for each joint that has findings, and one for the flange."""
    at: dict[int | None, list[tuple[str, str, int]]] = {}
    for number, item in enumerate(verdict.findings, start=1):
        name = "something unknown" if item.effect == UNKNOWN else named(item)
        name = "pushes" if item.effect == CONTACT else name
        for place in _places(item, len(verdict.names)):
            at.setdefault(place, []).append((name, quantity_of(item), number))
    return tuple(
        Pin(_together(texts, joint, verdict.names), joint, f"#finding-{texts[0][2]}")
        for joint, texts in at.items()
    )


def _places(item: Finding, n: int) -> tuple[int | None, ...]:
    if (carrier := carrier_of(item, n)) is not None:
        return (carrier - 1,)
    if item.effect in {Payload.name, CONTACT}:
        return (None,)
    joints = item.joints[:1] if is_of_bodies(item.effect) else item.joints
    return tuple(j - 1 for j in joints) or (0,)


def _together(
    texts: Sequence[tuple[str, str, int]], joint: int | None, names: Sequence[str]
) -> str:
    where = "flange" if joint is None else of_joints((joint + 1,), names)
    if len(texts) == 1:
        name, value, _ = texts[0]
        return f"{where}: {name} {value}".rstrip()
    names = [name for name, _, _ in texts]
    return f"{where}: " + (
        ", ".join(names) if len(texts) < WORDING.listed else f"{len(texts)} findings"
    )
