"""Summary: a verdict as lines of text, the same on the terminal and where it prints itself."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from estimators.diagnosis.differences import value_columns
from estimators.diagnosis.headline import headline, named, place_of, values_of
from estimators.diagnosis.quantities import give_or_take, listed, rounded, several
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Verdict
from estimators.regression.evidence import REACH
from limo_driver.physics import display_name

ROWS_JUDGED: Final = "rows judged"  # heading of the only column that is no error
NOT_JUDGED = "near rest, at reversals, under a push or in a jolt"
_OF_A_JOINT = re.compile(r"(.+) of joint (\d+)( \(.+\))?")
WORSE = (
    "* Worse than given: without the effects that are missing, values move to make up for them on "
    "the rows fitted, and do harm on others. The improved simulation has values of its own."
)


def lines_of(verdict: Verdict) -> list[str]:
    """Return the verdict, what makes it doubtful, findings, errors of each joint, and notes."""
    findings = [line for item in verdict.findings for line in _say(item, verdict.names)]
    doubts = (f"doubtful: {doubt}" for doubt in verdict.doubts)
    notes = (f"note: {note}" for note in verdict.notes if note not in verdict.doubts)
    table = [*_table(verdict), *_seen(verdict)]
    values = [*_values(verdict), *_identified(verdict)]
    return [headline(verdict), *doubts, *findings, *values, *table, *notes]


def _values(verdict: Verdict) -> list[str]:
    """Return the table of stated values that moved; nothing where none did."""
    columns = value_columns(verdict)
    if not columns["value"]:
        return []
    cells = [[heading, *texts] for heading, texts in columns.items()]
    widths = [max(map(len, column)) for column in cells]
    rows = zip(*cells, strict=True)
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return ["", f"stated values that moved; beyond is more than {REACH:g} tolerances", *lines]


def identified_columns(verdict: Verdict) -> dict[tuple[str, str, str], list[str]]:
    """Return the joints whose ordinary friction was identified, and its values.

    A heading is effect, parameter and unit. A value stands beside half of its 95 % interval, values
    of one parameter (the elements of a law) alone; what a joint has none of is empty.
    """
    joints = sorted({item.joint for item in verdict.identified})
    called = dict(enumerate(verdict.labels, start=1))
    columns = {("", "", "joint"): [called.get(joint, str(joint)) for joint in joints]}
    for item in verdict.identified:
        for name, known in item.parameters.items():
            if known.ci95:
                one = isinstance(known.value, float)
                heading = (display_name(item.effect), name, f"[{known.unit}]")
                column = columns.setdefault(heading, [""] * len(joints))
                column[joints.index(item.joint)] = (give_or_take if one else several)(known)
    return columns


def columns_of(verdict: Verdict) -> dict[str, Sequence[float]]:
    """Return the errors of each joint by heading, [N m] but for the part of the rows that counts.

    A column that the verdict does not have is left out. A joint of which no row counts has no
    error: not a number.
    """
    fit = verdict.fit
    columns: dict[str, Sequence[float]] = {
        "given": fit.heldout_rmse_before,
        "within tolerances": fit.heldout_rmse_tolerances,
        "improved": fit.heldout_rmse_after,
        "noise floor": fit.noise_floor,
        ROWS_JUDGED: verdict.rows.part_judged(),
        "all rows, given": fit.heldout_rmse_before_all_rows,
        "all rows, improved": fit.heldout_rmse_after_all_rows,
    }
    counted = verdict.rows.judged or (1,) * len(fit.noise_floor)
    return {
        heading: values if heading == ROWS_JUDGED else _of_counted(values, counted)
        for heading, values in columns.items()
        if values
    }


def _of_counted(values: Sequence[float], counted: Sequence[int]) -> list[float]:
    return [x if rows else math.nan for x, rows in zip(values, counted, strict=True)]


def hardly_shown(verdict: Verdict) -> str:
    """Say which values the motion does not show; nothing where there are none."""
    if not verdict.hardly_shown:
        return ""
    return (
        f"The motion hardly shows {_together(verdict.hardly_shown)}: of these, what is stated "
        "is all that is known."
    )


def _together(names: Sequence[str]) -> str:
    """Say values of joints, such as "tau_c of joint 2 (coulomb friction)", those alike at once."""
    alike: dict[tuple[str, str], list[str]] = {}
    for name in names:
        known = _OF_A_JOINT.fullmatch(name)
        of, joints = ((known[1], known[3] or ""), [known[2]]) if known else ((name, ""), [])
        alike.setdefault(of, []).extend(joints)
    return listed(
        [
            f"{value} of joint{'s' * (len(on) > 1)} {listed(on)}{effect}" if on else value
            for (value, effect), on in alike.items()
        ]
    )


def _seen(verdict: Verdict) -> list[str]:
    """Say to which speeds a verdict has been seen to hold, and what was not seen at all."""
    if verdict.holds is None:
        return []
    fastest = (high for _, high in verdict.holds.speed)
    speeds = listed([rounded(speed, 2) if speed > 0 else "-" for speed in fastest])
    sentence = f"The joints moved at up to {speeds} rad/s; faster motion is extrapolated."
    return [sentence, *filter(None, [hardly_shown(verdict)])]


def coverage(verdict: Verdict) -> str:
    """Say which part of the rows held out the errors count; nothing where that is not known."""
    parts = verdict.rows.part_judged()
    if not parts:
        return ""
    low, high = min(filter(None, parts), default=0.0), max(parts)
    counted = dict.fromkeys(map(_percent, (low, high)))
    return (
        f"The errors are over {' to '.join(counted)} of the rows held out, by joint: rows "
        f"{NOT_JUDGED} are neither fitted nor judged. The columns of all rows include them."
    )


def _say(item: Finding, names: Sequence[str]) -> list[str]:
    """Return name and place, values, evidence and confidence of a finding."""
    name = "something unknown" if item.effect == UNKNOWN else named(item)
    values = values_of(item) if item.effect != CONTACT else ""
    same = ", ".join(display_name(other) for other in item.equivalent)
    sure = f"confidence {100 * item.confidence:.0f} %"
    return [
        f"{name} ({place_of(item, names)}){f': {values}' if values else ''}",
        f"  {item.evidence}",
        f"  {sure}{f'; cannot be told from {same}' if same else ''}",
    ]


def _identified(verdict: Verdict) -> list[str]:
    """Return what each joint's ordinary friction was identified as; none where all was stated.

    A line a joint: a table of all laws would be wider than a terminal.
    """
    if not verdict.identified:
        return []
    columns = identified_columns(verdict)
    joints = columns.pop(("", "", "joint"))
    lines = ["", "identified, with 95 % intervals"]
    for k, joint in enumerate(joints):
        laws: dict[str, list[str]] = {}
        for (effect, name, unit), values in columns.items():
            if values[k]:
                sentence = f"{name} {values[k]}" + f" {unit.strip('[]')}" * (unit != "[1]")
                laws.setdefault(effect, []).append(sentence)
        found = (f"{effect}: {', '.join(values)}" for effect, values in laws.items())
        lines.append(f"joint {joint}  {'; '.join(found)}")
    return lines


def _aligned(columns: Sequence[Sequence[str]]) -> list[str]:
    """Return columns of cells as lines of one width."""
    widths = [max(map(len, column)) for column in columns]
    rows = zip(*columns, strict=True)
    return ["  ".join(map(str.rjust, row, widths)).rstrip() for row in rows]


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %"


def _table(verdict: Verdict) -> list[str]:
    """Return the errors as lines of one width, and what has to be known to read them."""
    joints = verdict.labels
    worse = verdict.fit.worse_within_tolerances
    cells = [["", "joint", *joints]]
    for heading, values in columns_of(verdict).items():
        say = _percent if heading == ROWS_JUDGED else rounded
        texts = [say(value) if math.isfinite(value) else "-" for value in values]
        if worse and heading == "within tolerances":
            texts = [text + " *"[j in worse] for j, text in enumerate(texts, start=1)]
        first, _, second = heading.rpartition(" ")
        cells.append([first, second, *texts])
    sentence = (coverage(verdict) if verdict.rows.fitted else "", WORSE if worse else "")
    unit = verdict.fit.unit
    return ["", f"held-out RMSE [{unit}]", *_aligned(cells), *filter(None, sentence)]
