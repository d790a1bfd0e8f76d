"""Inspect a log: what is there, how it is to be read, and what is still to be decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from limo_driver.app.library.inputs import model_of
from limo_driver.app.library.reading import mapping_of, model_is_enough, table_of_log
from limo_driver.errors import ConfigError, LimoError
from limo_driver.logs.readers.columns import NO_COLUMN, TIME, read_name, si_unit
from limo_driver.logs.readers.inspection import Inspection, ShownParameter
from limo_driver.logs.readers.mapping import QUANTITIES, Channels, LogMapping
from limo_driver.logs.readers.proposals.proposal import Proposal, Taken, propose, without_questions
from limo_driver.logs.readers.proposals.recorded_joints import mapped_part
from limo_driver.logs.readers.table import LogTable, TimeColumns
from limo_driver.model import RobotModel
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import spanned

_OWN: Final = "limo's own columns"


def inspect(
    log: Path | str | Mapping[str, Any],
    robot: RobotModel | Path | str,
    *,
    topic: str | None = None,
    episode: int | None = None,
    columns: str | None = None,
    mapping: LogMapping | Path | str | None = None,
) -> Inspection:
    """Say what a log of a robot holds, and propose how to read it.

    Args:
        log: A file or folder: delimited text, Parquet, NumPy's .npz, JSON, MATLAB's .mat, a ROS
            2 bag (MCAP or .db3), a LeRobotDataset; or arrays by name, (T,) or (T, k) each.
        robot: Whose log it is: a model, a built-in name, or the path of its description.
        topic: Of the joint states of a bag, where there are several.
        episode: Of a LeRobotDataset; all of them, with gaps between, if not given.
        columns: Patterns of the columns that count beside the time, with commas between: of two
            arms in one log, `left_*` are those of one.
        mapping: How it is read, or the file that says so; one is proposed if not given.

    Returns:
        What was found; its `mapping` can be saved, changed and given to `limo.read`, once its
        `questions` are answered.

    Raises:
        ConfigError: The mapping cannot be read, or is of other joints.
        RecordingError: The log cannot be read, or has no positions of the robot's joints, or no
            column that is chosen or mapped.

    Example:
        >>> q = np.sin(0.004 * np.arange(500))[:, None] * np.ones(7)
        >>> log = {"t_ms": 4.0 * np.arange(500), "q": q, "tau_nm": np.cos(q)}
        >>> print(limo.inspect(log, "iiwa14"))
    """
    model = model_of(robot)
    used = mapping_of(mapping)
    if used is not None and columns is not None:
        raise ConfigError("`columns` and `mapping` are both given, and a mapping names its columns")
    table = table_of_log(log, model, used, topic, episode)
    if used is not None:
        proposal = _stated(model, used)
    else:
        own = _own(table, model) if columns is None and model_is_enough(log) else None
        proposal = own or _proposed(table, model, columns)
    model = proposal.model
    if topic is not None:
        proposal = replace(proposal, mapping=replace(proposal.mapping, topic=topic))
    recording, refused = None, ""
    try:
        if used is not None or proposal.mapping.time.columns:  # else rows have no rate to judge by
            read = without_questions(proposal).columns(table, model)
            recording = Recording.from_columns(read, table.source)
            recording.check_robot(model)
    except LimoError as error:
        if used is not None:
            raise
        refused = str(error).removeprefix(f"{table.source}: ")
    told, shown = tuple[str, ...](), tuple["ShownParameter", ...]()
    said = (proposal.told,) if proposal.told else ()
    if recording is not None and not model.massless:
        told, refused, shown = _judged(recording, model)
        if refused:
            proposal = _asking(proposal, refused)
    return Inspection(table, proposal, recording, refused, told, (*said, *model.notes), shown)


def save_page(found: Inspection, path: Path) -> None:
    """Write the page of an inspection: every column over time, and what the motion shows.

    Args:
        found: The inspection.
        path: Of the page.

    Raises:
        ConfigError: It cannot be written.
    """
    from limo_driver.app.library.inspection_page import inspection_page

    inspection_page(found).save(path)


def save_columns(
    log: Path, path: Path, *, topic: str | None = None, episode: int | None = None
) -> None:
    """Write the page of a log of which no robot is known.

    Args:
        log: As for `inspect`.
        path: Of the page.
        topic: Of the joint states of a bag, where there are several.
        episode: Of a LeRobotDataset; all of them if not given.

    Raises:
        ConfigError: The page cannot be written.
        RecordingError: The log cannot be read, or holds no row.
    """
    from limo_driver.app.library.inspection_page import columns_page

    table = table_of_log(log, None, None, topic, episode)
    recording = Recording.load(log) if model_is_enough(log) else None
    columns_page(table, recording).save(path)


def _proposed(table: LogTable, model: RobotModel, columns: str | None) -> Proposal:
    if columns is None:
        return propose(table, model)
    times = [name for name in table.columns if read_name(name).quantity == TIME]
    patterns = [pattern.strip() for pattern in columns.split(",") if pattern.strip()]
    chosen = table.only(patterns, times)
    found = propose(chosen, model)
    left = (name for name in table.columns if name not in chosen.columns)
    mapping = replace(found.mapping, left_out=(*found.mapping.left_out, *left))
    return replace(found, mapping=mapping)


def _own(table: LogTable, model: RobotModel) -> Proposal | None:
    """Return how limo's own columns are read by every command; None if they cannot be so."""
    parts, rows = dict[str, Any](), [Taken("time", "time", "s", _OWN)]
    for quantity in QUANTITIES:
        names = [f"{quantity}_{j}" for j in range(1, model.n + 1)]
        if set(names) & set(table.columns):
            kept = tuple(name if name in table.columns else NO_COLUMN for name in names)
            units = [si_unit(quantity, is_sliding=slides) for slides in model.sliding]
            parts[quantity] = Channels(columns=kept, unit=tuple(units))
            rows.append(Taken(quantity, spanned(kept), ", ".join(dict.fromkeys(units)), _OWN))
    used = {"time", *(name for part in parts.values() for name in part.columns)}
    try:
        mapping = LogMapping(
            joints=model.joint_names,
            time=TimeColumns(columns=("time",)),
            robot=model.name,
            left_out=tuple(name for name in table.columns if name not in used),
            **parts,
        )
        Recording.from_columns(mapping.columns(table, model)).check_robot(model)
    except LimoError:
        return None
    return Proposal(mapping, tuple(rows), model)


def _stated(model: RobotModel, mapping: LogMapping) -> Proposal:
    """Return what a mapping says as if it had been proposed."""
    why = "the mapping says so"
    time = mapping.time
    rows = [Taken("time", spanned(time.columns), ", ".join(time.unit) if time.columns else "", why)]
    for quantity in QUANTITIES:
        if (part := getattr(mapping, quantity)) is not None:
            unit = ", ".join(dict.fromkeys(part.unit))
            rows.append(Taken(quantity, spanned(part.columns), unit, why))
    return Proposal(mapping, tuple(rows), mapped_part(mapping, model))


def _asking(proposal: Proposal, refused: str) -> Proposal:
    """Return a proposal that cannot be used before it is said what is meant instead."""
    question = (
        f"read as proposed it is refused: {refused}: which columns, signs or units are meant?"
    )
    undecided = (*proposal.mapping.undecided, question)
    return replace(proposal, mapping=replace(proposal.mapping, undecided=undecided))


def _judged(
    recording: Recording, model: RobotModel
) -> tuple[tuple[str, ...], str, tuple[ShownParameter, ...]]:
    """Return what a recording is worth, why a fit would refuse it, and what its motion shows."""
    from estimators.diagnosis.from_motion.checks.commands import check_commands
    from estimators.diagnosis.from_torque.residuals.plausibility import doubts_about
    from estimators.telemetry import telemetry_of

    try:
        if not recording.has_torque:  # by which signs and order of the columns are checked
            doubts = check_commands([recording], model.sliding)
        else:
            doubts = doubts_about(model, [recording], bandwidth_for([recording]))
        found = telemetry_of(recording, model)
    except LimoError as error:
        return (), str(error).removeprefix(f"{recording.source}: "), ()
    return (*found.lines(), *doubts), "", found.parameters
