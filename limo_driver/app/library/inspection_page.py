"""The page of an inspection: every column over time, what was read from it, and what it shows."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import LimoError, RecordingError
from limo_driver.logs.readers.columns import NO_COLUMN, UNITS, read_name, si_unit
from limo_driver.logs.readers.inspection import NO_MOTION, Inspection, ShownParameter
from limo_driver.logs.readers.mapping import QUANTITIES, Channels, TimeColumns, values_of
from limo_driver.logs.readers.proposals.times import time_columns
from limo_driver.pages import Page, arm_view
from limo_driver.pages.figures import JOINTS, Curve, Curves, LeftOutRows, curves_section
from limo_driver.pages.markup import (
    UNSAID,
    columns,
    folded,
    header,
    listed,
    paragraph,
    percent,
    section,
)
from limo_driver.pages.motion import lost_meshes, stage, still
from limo_driver.recordings.channels import CHANNELS, Columns, without_wraps
from limo_driver.recordings.gate.doubts import OneClock
from limo_driver.runtime.display import joint_called

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from limo_driver.logs.readers.table import LogTable
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, IntArray

_MOST: Final = 200  # columns that are drawn
_AT_FIRST: Final = 3  # axes of a log of which nothing is understood
_AXES: Final = {"command": "position", "command_velocity": "velocity", "command_torque": "torque",
                "estimate": "torque", "external_torque": "torque"}  # fmt: skip
_DRAWN: Final = ("position", "velocity", "torque", *CHANNELS)
_VERDICTS: Final = ("identifiable", "weak", "not from this motion")
_PLANS: Final = 3  # motions that are advised
_SHOWS: Final = (
    "Before anything is diagnosed: how well torques of this motion tell each base parameter, as "
    "one standard deviation over its size. Up to 10 % it is identifiable, up to 100 % weak. m is "
    "the mass of a link, mx, my, mz mass times centre, Ixx to Izz its inertia; of a joint, f_v is "
    "viscous, tau_c dry friction, inertia the drive's. For each that is not identifiable, simple "
    "motions were simulated; named is the simplest that shows it nearly as well as any of them. "
    "`limo excite` plans one that keeps to all limits."
)
_USE: Final = (
    "Drag over the curves or turn the wheel to zoom; with shift, the wheel moves along; a double "
    "click shows all. A click sets the cursor, which the arm follows; numbers at the names "
    "are the values there. Enter in the filter draws what it lists."
)


def inspection_page(found: Inspection) -> Page:
    """Return the page of what was found in a log of a robot."""
    table, recording, model = found.table, found.recording, found.proposal.model
    curves = _curves_of(found)
    arm = None
    if curves.pose and curves.rows.size:
        pose = np.array([curves.curves[k].values[curves.rows[0]] for k in curves.pose])
        arm = arm_view(model, np.where(np.isfinite(pose), pose, 0.0))
    name, log = PurePath(model.name).name, PurePath(table.source or "arrays").name
    title = f"{log}: {table.kind}, {table.rows} rows"
    if recording is not None and len(recording) > 1:
        title = f"{log}: {recording.duration:.4g} s of {name} at {recording.rate:.4g} Hz"
    many = len(found.questions)
    asked = folded(
        f"{many} question{'s' * (many > 1)} to be decided first", listed(found.questions)
    )
    body = (
        header("Inspection", title, _summary(found))
        + (f'<div class="doubted">{asked}</div>' if many else "")
        + curves_section(curves, stage(still(arm, "")) if arm else "")
        + (lost_meshes(arm) if arm else "")
        + paragraph(_USE, "small")
        + _shown(found)
        + section("What the recording is worth", listed(found.telemetry), "worth")
        + section("What was read", columns(found.figures(), 4) + listed(found.notes()), "read")
    )
    return Page(title, body, arm=arm, curves=curves, sliding=model.sliding)


def _summary(found: Inspection) -> str:
    """Say in a line how much of the log is used, what is open, and what its motion shows."""
    recording, questions = found.recording, len(found.questions)
    parts = ["not read as a recording" if recording is None else f"{len(recording)} samples"]
    if recording is not None and (out := recording.rows_total - len(recording)):
        parts.append(f"{out} rows left out")
    if questions:
        parts.append(f"{questions} question{'s' * (questions > 1)} open")
    many = Counter(item.verdict for item in found.parameters)
    shown = ", ".join(f"{many[verdict]} {verdict}" for verdict in _VERDICTS if many[verdict])
    parts += [f"{len(found.parameters)} parameters of the arm: {shown}"] if shown else []
    return "; ".join(parts)


def _shown(found: Inspection) -> str:
    """Return the section that says which parameters the motion shows, and what would show others.

    Those of the last verdict first, since they ask for another motion.
    """
    rows = sorted(found.parameters, key=lambda item: -_VERDICTS.index(item.verdict))
    if not rows:
        return ""
    wanted = Counter(item.remedy for item in rows if item.remedy not in {"", NO_MOTION})
    best = wanted.most_common(_PLANS)
    plans = [f"{motion}: shows {many} of these parameters" for motion, many in best]
    parts = {
        "that other motion would show": [item for item in rows if item.remedy],
        "that are identifiable": [item for item in rows if not item.remedy],
    }
    body = paragraph("What to record as well, moving:") if plans else ""
    body += listed(plans)
    for which, part in parts.items():
        body += folded(f"{len(part)} {which}", _parameters(part)) if part else ""
    return section("What this motion shows of the arm", body, "shows", _SHOWS)


def _parameters(rows: Sequence[ShownParameter]) -> str:
    table = {
        "parameter": [f"{item.name} [{item.unit}]" for item in rows],
        "known to": [
            f"{percent(item.known_to)}, {item.verdict}" if item.known_to <= 1 else item.verdict
            for item in rows
        ],
        "what would show it most": [item.remedy or UNSAID for item in rows],
    }
    return columns(table, len(rows))  # none is set as a number


def columns_page(table: LogTable, recording: Recording | None = None) -> Page:
    """Return the page of a log of which no robot is known.

    Args:
        table: What it holds.
        recording: The same, where it has limo's own columns.
    """
    if not table.rows:
        raise RecordingError("holds no rows of numbers", path=table.source or None)
    time = time_columns(table).columns
    axis, seconds = _seconds(time, table)
    drawn = list(_as_logged(table, time.columns, is_own=recording is not None))
    first = list(dict.fromkeys(curve.axis for curve in drawn))[:_AT_FIRST]
    curves = Curves(
        seconds,
        _forward(seconds) if recording is None else np.asarray(recording.rows),
        tuple(replace(curve, is_drawn=curve.axis in first) for curve in drawn[:_MOST]),
        _left_out(recording),
        axis=axis,
    )
    title = f"{PurePath(table.source).name}: {table.kind}, {table.rows} rows"
    why = "Columns as logged: `--robot` says what they mean, and shows the arm move with them."
    notes = (*table.notes, *(recording.warnings if recording else ()), *_not_drawn(table, drawn))
    body = header(table.kind, title, why) + curves_section(curves) + paragraph(_USE, "small")
    return Page(title, body + section("Notes", listed(notes), "notes"), curves=curves)


def _curves_of(found: Inspection) -> Curves:
    """Return the columns of a log as they would be read, and the others as they are."""
    table, mapping = found.table, found.mapping
    axis, time = _seconds(mapping.time, table)
    position = mapping.position.read(table, "position")
    raw = Columns(time, position, np.full_like(position, np.nan))
    clock = OneClock()
    read = clock.taken(without_wraps(raw)) if axis.endswith("[s]") else raw
    mapped = list(_mapped(found, read.position))
    used = {curve.column for curve in mapped} | set(mapping.time.columns)
    curves = [*mapped, *_as_logged(table, used)][:_MOST]
    return Curves(
        read.time,
        _forward(read.time) if found.recording is None else np.asarray(found.recording.rows),
        tuple(curves),
        _left_out(found.recording),
        tuple((step.row, str(step)) for step in clock.steps),
        tuple(range(position.shape[1])),
        axis,
    )


def _seconds(time: TimeColumns, table: LogTable) -> tuple[str, FloatArray]:
    """Return what the time axis says, and the time (T,) [s]; rows where the log has no time."""
    if not time.columns and time.rate in {None, 1.0}:
        return "row", np.arange(float(table.rows))
    seconds = time.read(table)[0]
    return "time [s]", seconds - seconds[np.isfinite(seconds)][:1].sum()


def _forward(time: FloatArray) -> IntArray:
    """Return the rows at which a time (T,) is further than ever before."""
    known = np.where(np.isfinite(time), time, -np.inf)
    before = np.maximum.accumulate(np.append(-np.inf, known))[:-1]
    return np.flatnonzero(known > before)


def _left_out(recording: Recording | None) -> tuple[LeftOutRows, ...]:
    left = () if recording is None else recording.left_out
    return tuple(LeftOutRows(item.reason, np.array(item.rows, np.int64)) for item in left)


def _mapped(found: Inspection, position: FloatArray) -> Iterator[Curve]:
    """Yield the columns that are read, in SI units; currents without a factor as they are."""
    for quantity in QUANTITIES:
        part: Channels | None = getattr(found.mapping, quantity)
        if part is None:
            continue
        try:
            values, known = part.read(found.table, quantity), True
        except LimoError:
            every = [values_of(found.table, name) for name in part.columns]
            values, known = np.stack(every, axis=1).astype(float), False
        values = position if quantity == "position" else values
        for j, name in enumerate(part.columns):
            if name != NO_COLUMN:
                yield _curve(found, quantity, j, values[:, j], is_si=known)


def _curve(found: Inspection, quantity: str, j: int, values: FloatArray, *, is_si: bool) -> Curve:
    part: Channels = getattr(found.mapping, quantity)
    kind = _AXES.get(quantity, quantity)
    stated = {key: np.resize(getattr(part, key), len(part.columns))[j] for key in
              ("unit", "sign", "zero", "factor")}  # fmt: skip
    unit = str(stated["unit"])
    if is_si:
        unit = si_unit(quantity, is_sliding=found.proposal.model.sliding[j])
    more = [f"{key} {stated[key]:g}" for key, usual in (("sign", 1), ("zero", 0), ("factor", 1))
            if stated[key] != usual]  # fmt: skip
    logged = [f"logged in {stated['unit']}"] if is_si and stated["unit"] != unit else []
    read = ", ".join([part.columns[j], *logged, *more])
    joint = f"joint {joint_called(j + 1, found.mapping.joints[j])}"
    return Curve(
        joint if kind == quantity else f"{joint}, {quantity.replace('_', ' ')}",
        part.columns[j],
        f"{kind if is_si else 'current'} [{unit}]",
        read if is_si else f"{read}: no factor says how many N m one makes",
        values,
        JOINTS[j % len(JOINTS)],
        "solid" if kind == quantity else "dash" if quantity in CHANNELS else "dot",
        quantity in _DRAWN,
    )


def _as_logged(table: LogTable, used: Iterable[str], *, is_own: bool = False) -> Iterator[Curve]:
    """Yield the columns that nothing is read from, with what their names say.

    Of limo's own columns (`is_own`) that is what they are.
    """
    others = [name for name in table.columns if name not in {*used}]
    for k, column in enumerate(others):
        values = table.columns[column]
        if values.dtype.kind in "mM":
            continue
        name = read_name(column)
        words = " ".join((*name.family, name.quantity)[: len(name.family) or 1])
        known = name.unit or (si_unit(name.quantity) if is_own and name.quantity in UNITS else "")
        unit = f" [{known}]" if known else ", unit unknown"
        read = f"named like a {name.quantity}, not read" if name.quantity else "not understood"
        read = "" if is_own and known else read
        number = name.joint if isinstance(name.joint, int) else k
        axis = f"{words or column}{'' if is_own else ', as logged'}{unit}"
        colour = JOINTS[(number - 1) % len(JOINTS)]
        yield Curve(column, column, axis, read, values.astype(float), colour)


def _not_drawn(table: LogTable, drawn: list[Curve]) -> Iterator[str]:
    yield from (f"not drawn: {name} holds {held}" for name, held in table.unread.items())
    if more := len(drawn[_MOST:]):
        yield f"not drawn: {more} more columns"
