"""Sections below the verdict: residuals, explanations, doubts, next motion, replay."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimators.diagnosis.headline import is_of_bodies, likelier, names_of
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.quantities import (
    heading_of,
    in_noise_floors,
    placed,
    rounded,
    value_columns,
)
from estimators.diagnosis.report import figures
from estimators.diagnosis.report.binning import loop_stretch
from estimators.diagnosis.report.findings import played
from estimators.diagnosis.result import (
    CHOSEN,
    DiagnosisResult,
    Explanation,
    Replay,
    identified_columns,
)
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.settings.judgement import LOOPS, WORDING
from estimators.diagnosis.verdict import CONTACT, Finding, Verdict
from estimators.regression.evidence import REACH
from limo_driver.model.units import unit_of
from limo_driver.pages.markup import (
    UNSAID,
    Charts,
    folded,
    grid,
    key,
    meter,
    paragraph,
    percent,
    prose,
    section,
    table,
    typeset,
)
from limo_driver.physics import display_name
from limo_driver.quoting import in_html as escape

_TITLES = {
    "position": "over position",
    "velocity": "over velocity",
    "since_reversal": "over the distance since the last reversal",
    "load": "over load",
    "time": "over time",
}
_NOTES = {"since_reversal": "signed along the motion"}
_ASKED = {
    "Does the residual depend on the distance since the last reversal?": "distance since reversal",
    "Does it change with speed?": "speed",
    "Does it change with the load on the joint?": "load on the joint",
    "Does it change with the position of the joint?": "position of the joint",
    "Does it change with time, at the same position and speed?": "time, at the same motion",
}
_LEAD = (
    "The residual is recorded minus simulated torque. Near rest friction can take any value, so "
    "nothing is fitted or scored there: such rows are pale in the curves, and the bins leave them "
    "out."
)
_KEY = {
    "Orange": "the given simulation.",
    "Blue": "the improved simulation.",
    "Green": "the given simulation, with its values moved within their tolerances.",
    "Line, band, dots": "mean of a bin, one standard deviation to either side, noise floor.",
    "Torque curves": f"{LOOPS.duration:g} s in which the error is large and the joint moves "
    "little; the torque of the rigid body is taken off.",
}
_FEW = 2  # effects in which an explanation differs, that are named beside its bar


def where(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return maps, loops and traces of the joints, those that differ most first."""
    order = _by_excess(diagnosis)
    affected = _affected(diagnosis)
    shown = [j for j in order if j + 1 in affected][: WORDING.listed]
    closer = {*shown, *(j - 1 for j in diagnosis.verdict.unexplained.joints)}
    drawn = {
        j: _joint(diagnosis, charts, j) + (_beyond(diagnosis, charts, j) if j in closer else "")
        for j in (*shown, *(j for j in range(len(order)) if j not in shown))
    }
    opened = "".join(
        f'<div id="joint-{j + 1}"><h3>{escape(_called(diagnosis, j))}</h3>{drawn[j]}</div>'
        for j in shown
    )
    rest = "".join(
        f'<div id="joint-{j + 1}">{folded(_title(diagnosis, j), body)}</div>'
        for j, body in drawn.items()
        if j not in shown
    )
    return section("Where the difference is", key(_KEY) + opened + rest, "where", _LEAD)


def _joint(diagnosis: DiagnosisResult, charts: Charts, j: int) -> str:
    traces = diagnosis.traces
    averaged = _averaged(diagnosis, charts, j, _GIVEN, "Residual", "Mean residual")
    stretch = loop_stretch(traces, j, LOOPS.duration)
    note = _span(diagnosis, stretch.start, stretch.stop, stretch.recording)
    over_position, over_time = figures.loops(traces, j, stretch)
    follows = stretch.recording == played(diagnosis)
    drawn = [
        charts.place(over_position, "Torque over position", note),
        charts.place(over_time, "Torque over time", note, follows=follows),
    ]
    return grid(drawn) + averaged


_GIVEN = {"before": "given", "after": "improved"}  # simulations that are compared
_LEFT = {"tolerances": "within tolerances", "after": "improved"}


def _averaged(
    diagnosis: DiagnosisResult,
    charts: Charts,
    j: int,
    sides: Mapping[str, str],
    what: str,
    mean: str,
) -> str:
    """Return profiles and maps of what two simulations leave at a joint (0-based)."""
    traces, floor = diagnosis.traces, diagnosis.verdict.fit.noise_floor[j]
    profiles = [
        charts.place(
            figures.dependence(traces, j, name, floor, [*sides]),
            f"{what} {_TITLES[name]}",
            _NOTES.get(name, ""),
        )
        for name in _TITLES
    ]
    maps = [
        charts.place(figure, f"{mean} over position and velocity", which)
        for figure, which in zip(figures.maps(traces, j, [*sides]), sides.values(), strict=True)
    ]
    return grid(profiles, "three") + grid(maps)


def _beyond(diagnosis: DiagnosisResult, charts: Charts, j: int) -> str:
    """Return maps of what tolerances leave at a joint, on its own scale."""
    what = "Remaining residual"
    sentences = (
        "Green: the given simulation with its values moved within their tolerances, and no effect "
        "added. The findings are what explains the difference to blue, the improved simulation."
    )
    body = paragraph(sentences, "small") + _averaged(diagnosis, charts, j, _LEFT, what, what)
    title = f"{_called(diagnosis, j)}: what is left when values move within their tolerances"
    return f'<div id="beyond-{j + 1}">{folded(title, body)}</div>'


def _called(diagnosis: DiagnosisResult, j: int) -> str:
    """Return how a heading calls a joint (0-based): `Joint 3 (stick)`."""
    return heading_of(j + 1, diagnosis.verdict.names)


def _title(diagnosis: DiagnosisResult, j: int) -> str:
    fit, judged = diagnosis.verdict.fit, diagnosis.verdict.rows.part_judged()
    unit = diagnosis.verdict.unit_at(j + 1)
    return (
        f"{_called(diagnosis, j)}: held-out RMSE {rounded(fit.heldout_rmse_before[j])} → "
        f"{rounded(fit.heldout_rmse_after[j])} {unit}, noise floor "
        f"{rounded(fit.noise_floor[j])} {unit}"
        + (f", on {percent(judged[j])} of the rows held out" if judged else "")
    )


def _affected(diagnosis: DiagnosisResult) -> set[int]:
    """Return the joints that the verdict speaks of, 1-based; pushes have a section of their own."""
    verdict = diagnosis.verdict
    found = [item for item in verdict.findings if item.effect != CONTACT]
    named = {j for item in found for j in _shown_at(item)} | {*verdict.unexplained.joints}
    whole_arm = any(not item.joints for item in found)
    return set(range(1, len(verdict.fit.noise_floor) + 1)) if whole_arm else named


def _shown_at(item: Finding) -> tuple[int, ...]:
    """Return the joints at which a finding shows; a body is felt by others than it hangs on."""
    shows = item.where.figure.removeprefix("joint-")
    if is_of_bodies(item.effect) and shows.isdigit():
        return (int(shows),)
    return item.joints


def _by_excess(diagnosis: DiagnosisResult) -> list[int]:
    """Return the joints, 0-based, by what tolerances leave of their error, in noise floors."""
    fit = diagnosis.verdict.fit
    excess = in_noise_floors(fit.heldout_rmse_tolerances or fit.heldout_rmse_before, fit)
    return [int(j) for j in np.argsort(-np.nan_to_num(excess), kind="stable")]


def competing(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the explanations that competed with the chosen one."""
    best = diagnosis.explanations[: WORDING.explanations]
    if not best:
        return ""
    chosen = next((item for item in best if item.note == CHOSEN), best[0])
    top, body = chosen.log_evidence, ""
    twins = [item for item in best if _looks_like(item, chosen, diagnosis.verdict.findings)]
    if _tells_apart(best, chosen):
        names = [typeset(f"{k}. {_against(item, chosen)}") for k, item in enumerate(best, start=1)]
        drawn = figures.explanations(best, names, chosen, np.log10(WORDING.beyond_doubt))
        body = charts.place(drawn, "How much less likely others are: by what they differ", _BEYOND)
    rows = [
        [escape(typeset(_name(item, diagnosis.verdict.names))),
         _compared_to(item.log_evidence - top),
         meter(item.share) if item.share >= 0 else f"none, adds {percent(-item.share)}",
         escape(_note(item, top) or (_TWIN if item in twins else ""))]
        for item in diagnosis.explanations
    ]  # fmt: skip
    headings = ("explanation", "likelihood", "removes of what tolerances leave", "note")
    others = [item for item in best if item not in twins]
    listed = folded(f"All {len(rows)} explanations", table(headings, rows))
    lead = (
        f"Sets of effects that were tried. {_closest(others, chosen)}"
        "These recordings cannot tell apart what is within odds of "
        f"{np.exp(CONTRIBUTION.tellable):.0f} to 1."
    )
    return section("What else could explain it", body + listed, "competing", lead)


_TWIN = "looks the same; what is known of its values speaks against it"
_BEYOND = "bars at the end of the axis: beyond doubt"


def _tells_apart(tried: Sequence[Explanation], chosen: Explanation) -> bool:
    """Say whether bars show a difference: some explanation is in doubt, and not all are alike."""
    behind = [chosen.log_evidence - item.log_evidence for item in tried if item is not chosen]
    return bool(behind) and min(behind) < np.log(WORDING.beyond_doubt) and np.ptp(behind) > 1.0


def _looks_like(item: Explanation, chosen: Explanation, findings: Sequence[Finding]) -> bool:
    """Say whether one effect of the chosen is exchanged for one that cannot be told from it."""
    own, other = set(chosen.effects) - set(item.effects), set(item.effects) - set(chosen.effects)
    same = {e for finding in findings if finding.effect in own for e in finding.equivalent}
    return len(own) == len(other) == 1 and item.joints == chosen.joints and other <= same


def _closest(tried: Sequence[Explanation], chosen: Explanation) -> str:
    """Say which explanation comes closest to the chosen one."""
    others = [item for item in tried if item is not chosen]
    less = [item for item in others if item.log_evidence <= chosen.log_evidence]
    sentences = ""
    if less:
        best = max(less, key=lambda item: item.log_evidence)
        lead = _compared_to(best.log_evidence - chosen.log_evidence)
        sentences = f"The nearest of those less likely ({_against(best, chosen)}) is {lead}. "
    why = Counter(item.note for item in others if item.note and item not in less)
    if why:
        reasons = "; ".join(f"{note}: {many}" for note, many in why.items())
        sentences += f"Likelier, and not chosen for a reason, are {why.total()} ({reasons}). "
    return sentences


def _compared_to(lead: float) -> str:
    """Say how likely an explanation is beside the chosen one, from its lead [nat]."""
    if lead == 0.0:
        return "chosen"
    if abs(lead) < np.log(2.0):
        return "as likely"
    sentences = likelier(abs(lead)).rstrip(",")
    return sentences if lead > 0 else sentences.replace("likelier", "less likely")


def _name(item: Explanation, names: Sequence[str] = ()) -> str:
    joints = list(item.joints) + [()] * (len(item.effects) - len(item.joints))
    sentences = [placed(e, j, names) for e, j in zip(item.effects, joints, strict=False)]
    return " + ".join(sentences) or "no effect"


def _against(item: Explanation, chosen: Explanation) -> str:
    """Say in what an explanation differs from the chosen one: `spring 2, not gear ratio 2`.

    What all share would fill the room beside a bar, and tell none of them apart.
    """
    if item is chosen:
        return "chosen"
    own, best = _each(item), _each(chosen)
    more, less = [x for x in own if x not in best], [x for x in best if x not in own]
    parts = [_few(more) if less else f"also {_few(more)}"] if more else []
    if less:
        parts.append(f"{'not' if more else 'without'} {_few(less)}")
    return ", ".join(parts) or "another law of the same"


def _each(item: Explanation) -> list[str]:
    joints = list(item.joints) + [()] * (len(item.effects) - len(item.joints))
    pairs = zip(item.effects, joints, strict=False)
    return [f"{display_name(e)} {' '.join(map(str, j))}".strip() for e, j in pairs]


def _few(names: Sequence[str]) -> str:
    """Join names; of many, the first, and how many follow."""
    return " + ".join(names) if len(names) <= _FEW else f"{names[0]} + {len(names) - 1} more"


def _note(item: Explanation, top: float) -> str:
    if item.note:
        return item.note
    close = item.log_evidence != top and abs(top - item.log_evidence) < CONTRIBUTION.tellable
    return "cannot be told from the chosen" if close else ""


def tests(diagnosis: DiagnosisResult) -> str:
    """Return the tree of nested tests, joint by joint."""
    rows = [
        [str(item.joint), escape(_ASKED.get(item.question, item.question)), meter(item.share)]
        for item in sorted(diagnosis.tests, key=lambda item: item.joint)
        if item.yes
    ]
    headings = ("joint", "its error goes with", "explains of its reducible error, beside the above")
    return section(
        "What the error of each joint goes with",
        folded(f"Dependences found: {len(rows)}", table(headings, rows)) if rows else "",
        "tests",
        "Found joint by joint, before any effect was named: a joint is listed with a variable if "
        "knowing it predicts held-out error better. What is not listed is not denied: another "
        "variable of the list, or an effect of the whole arm, may already account for it.",
    )


def replay(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the free runs of the simulated robot beside the recording."""
    body = "".join(_replayed(diagnosis, item, charts) for item in diagnosis.replay)
    if diagnosis.replay_note:
        body += paragraph(diagnosis.replay_note)
    lead = (
        "A check in the other direction: a simulated robot with drives of its own follows the "
        "recorded motion, and its torque is compared with the recorded one. Its motion differs a "
        "little from the recorded one, which adds to the error, most of all where friction "
        "reverses. Near rest, where friction takes any value, curves are pale and not scored."
    )
    return section("Replay on the simulated robot", body, "replay", lead)


def _replayed(diagnosis: DiagnosisResult, item: Replay, charts: Charts) -> str:
    order = [j for j in _by_excess(diagnosis) if j + 1 in _affected(diagnosis)] or [0]
    span = _span(diagnosis, item.time[0], item.time[-1], item.recording)
    follows = item.recording == played(diagnosis)
    drawn = [
        charts.place(draw(item, j), f"{_called(diagnosis, j)}: {what}", span, follows=follows)
        for j in order[: WORDING.listed]
        for draw, what in ((figures.replayed, "torque"), (figures.replay_error, "difference"))
    ]
    before, after = (
        rmse(item.measured - torque, item.moving) for torque in (item.before, item.after)
    )
    errors = before, after, diagnosis.verdict.fit.noise_floor
    rows = [
        [escape(diagnosis.verdict.labels[j]),
         *(rounded(float(error[j])) if moves else UNSAID for error in errors),
         rounded(1e3 * float(item.tracking[j]), 2), percent(moves)]
        for j, moves in enumerate(float(column.mean()) for column in item.moving.T)
    ]  # fmt: skip
    push, far = (unit_of(unit, item.sliding) for unit in ("N m", "mrad"))
    headings = (
        "joint",
        *(f"{name} [{push}]" for name in ("RMSE given", "RMSE improved", "noise floor")),
        f"motion differs by [{far}]",
        "rows not near rest",
    )
    return grid(drawn) + table(headings, rows, numeric=1)


def _span(diagnosis: DiagnosisResult, start: float, stop: float, recording: int) -> str:
    names = names_of(diagnosis.recordings)
    return f"{start:.1f} to {stop:.1f} s" + f" of {names[recording]}" * (len(names) > 1)


def stated_values(verdict: Verdict) -> str:
    """Return the table of stated values that moved, with what fits; nothing where none did."""
    columns = value_columns(verdict)
    if not columns["value"]:
        return ""
    lead = (
        "What the given simulation states, and what fits the recordings, with "
        "95\N{NO-BREAK SPACE}% intervals. A tolerance says how surprising a change is, as one "
        f"standard deviation; beyond {REACH:g} of them a value is wrong. Where nobody has stated "
        "one in `tolerances`, it is limo's guess. Of a family of values, which are known together "
        "alone, the RMS torque that they make is compared."
    )
    body = (
        f'<div id="stated-table">{table(list(columns), _prose_rows(columns), numeric=2)}</div>'
        '<button type="button" class="copy" data-of="stated-table">copy table</button>'
    )
    return section("Stated, and what fits", body, "stated", lead)


def identified(verdict: Verdict, lead: str = "", title: str = "Identified friction") -> str:
    """Return the table of what is ordinary: friction that the given simulation did not state.

    Args:
        verdict: What was found.
        lead: What the table has, if it is not that.
        title: Of the section.
    """
    columns = identified_columns(verdict)
    if not verdict.identified:
        return ""
    lead = lead or (
        "What the given simulation does not state of these joints, or less precisely than the "
        "recordings tell, estimated together with everything else; with 95\N{NO-BREAK SPACE}% "
        "intervals. What most of them have is ordinary; what is unlike its siblings is a finding."
    )
    # "torque offset", and not "torque offset offset"
    headings = [typeset(" ".join(dict.fromkeys(" ".join(of).split()))) for of in columns]
    body = table(headings, _prose_rows(columns), numeric=1)
    return section(title, body, "identified", lead)


def _prose_rows(columns: Mapping[Any, Sequence[str]]) -> list[list[str]]:
    """Return columns of texts as the rows of a table."""
    rows = zip(*columns.values(), strict=True)
    return [[prose(cell) or UNSAID for cell in row] for row in rows]
