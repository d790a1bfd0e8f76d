"""Read recordings of any format: with a mapping, or with the one that is proposed for the log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from limo_driver.app.library.inputs import expected, model_for, model_of, unexpected
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.columns import TIME, WRITTEN, read_name
from limo_driver.logs.readers.formats.reading import (
    ARRAYS,
    BAGS,
    OBJECTS,
    PARQUET,
    TEXTS,
    ending_of,
    read_table,
)
from limo_driver.logs.readers.mapping import LogMapping
from limo_driver.logs.readers.proposals.proposal import Proposal, propose
from limo_driver.logs.readers.proposals.recorded_joints import mapped_part
from limo_driver.logs.readers.table import LogTable, table_of
from limo_driver.model import RobotModel
from limo_driver.recordings.channels import CHANNELS, Columns
from limo_driver.recordings.commanded import Commanded
from limo_driver.recordings.files.recording_file import LOG_SUFFIX, read_columns
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import shortened

_T = TypeVar("_T")
_PARQUET: Final = b"PAR1"  # its first bytes
_FOREIGN = (*BAGS, *ARRAYS, *OBJECTS, *TEXTS[1:])  # endings that limo's own recordings never have


def read(
    log: Path | str | Mapping[str, Any],
    robot: RobotModel | Path | str | None = None,
    mapping: LogMapping | Path | str | None = None,
    *,
    topic: str | None = None,
    episode: int | None = None,
) -> Recording:
    """Read a recording of any format.

    Limo's own columns need neither robot nor mapping. Of any other log the columns are found by
    name, number, limits and gravity of the robot; where two readings fit, that is refused, and a
    mapping has to say which is meant: `limo.inspect` writes one.

    Args:
        log: A file or folder: delimited text, Parquet, NumPy's .npz, JSON, MATLAB's .mat, a ROS
            2 bag (MCAP or .db3), a LeRobotDataset; or arrays by name, (T,) or (T, k) each.
        robot: Whose log it is: a model, a built-in name, or the path of its description.
        mapping: Which columns are what, or the file that says so.
        topic: Of the joint states of a bag, where there are several.
        episode: Of a LeRobotDataset; all of them, with gaps between, if not given.

    Returns:
        The recording; its `warnings` say how the log was read. Of a log that names some joints of a
        robot, it is of those, and its `robot` says which and where the others are locked.

    Raises:
        ConfigError: A question is open, or the mapping is of other joints.
        RecordingError: The log cannot be used.

    Example:
        >>> q = np.sin(0.004 * np.arange(500))[:, None] * np.ones(7)
        >>> log = {"t_ms": 4.0 * np.arange(500), "q_rad": q, "tau_nm": np.cos(q)}
        >>> recording = limo.read(log, "iiwa14")
    """
    model = None if robot is None else model_of(robot)
    if mapping is None and model_is_enough(log):
        recording = Recording.load(Path(str(log)))
    else:
        columns, _, _ = columns_of(log, model, mapping, topic, episode)
        recording = _judged(Recording.from_columns, columns, log)
    if model is not None:
        recording.check_robot(model_for(model, (recording,)))
    return recording


def read_commanded(
    log: Path | str | Mapping[str, Any],
    robot: RobotModel | Path | str | None = None,
    mapping: LogMapping | Path | str | None = None,
) -> Commanded:
    """Read the commands of a log of any format, and the first position.

    Args:
        log: As for `read`.
        robot: Whose log it is.
        mapping: Which columns are what, or the file that says so.

    Raises:
        ConfigError: A question is open, or the mapping is of other joints.
        RecordingError: The log cannot be used.
    """
    if mapping is None and model_is_enough(log):
        columns = read_columns(Path(str(log)))
    else:
        model = None if robot is None else model_of(robot)
        columns, _, _ = columns_of(log, model, mapping)
    return _judged(Commanded.from_columns, columns, log)


def _judged(take: Callable[[Columns, str], _T], columns: Columns, log: object) -> _T:
    """Return what a class makes of columns; its errors name the log."""
    source = str(log) if isinstance(log, (str, Path)) else ""
    try:
        return take(columns, source)
    except RecordingError as error:
        if error.path is not None:
            raise
        raise RecordingError(str(error), path=source or None, rows=error.rows) from None


def table_of_log(
    log: Path | str | Mapping[str, Any],
    model: RobotModel | None = None,
    mapping: LogMapping | None = None,
    topic: str | None = None,
    episode: int | None = None,
) -> LogTable:
    """Return what a log holds, as columns of numbers.

    Raises:
        ConfigError: It is neither a path nor arrays by name.
        RecordingError: It cannot be read.
    """
    if isinstance(log, (str, Path)):
        if topic is None and mapping is not None and mapping.topic != "-":
            topic = mapping.topic
        joints = () if model is None else model.joint_names
        return read_table(Path(log), topic, episode, joints)
    if not hasattr(log, "items"):
        raise unexpected("log", log, "the path of a file or folder, or arrays by name")
    return table_of({**_index_of(log), **dict(log.items())})


def _index_of(log: Mapping[str, Any]) -> dict[str, Any]:
    """Return the index of a DataFrame, where it says the time: dates, durations, or by its name."""
    index = getattr(log, "index", None)
    if index is None or callable(index):
        return {}
    values, stated = np.asarray(index), getattr(index, "name", None)
    name = str(stated or "time")
    is_time = stated is not None and read_name(name).quantity == TIME
    return {name: values} if (is_time or values.dtype.kind in "mM") and name not in log else {}


def model_is_enough(log: object) -> bool:
    """Say whether a log has limo's own columns, or at least the ending of such a file."""
    if not isinstance(log, (str, Path)):
        return False
    path = Path(log)
    if path.is_dir() or ending_of(path) in _FOREIGN:
        return False
    if not path.is_file() or path.suffix == LOG_SUFFIX:
        return True  # as `Recording.load` knows it, or says what is wrong
    if path.suffix.lower() not in {*PARQUET, ".csv"}:
        with path.open("rb") as file:
            return file.read(len(_PARQUET)) == _PARQUET
    found = set(column_names(path))
    return {"time", "position_1"} <= found and not found.isdisjoint(
        {"torque_1", *(f"{name}_1" for name in CHANNELS)}
    )


def column_names(path: Path) -> list[str]:
    """Return the columns of a Parquet or CSV file in limo's own form; none of another form.

    Raises:
        RecordingError: It cannot be read.
    """
    if path.suffix.lower() == ".csv":
        from limo_driver.recordings.files.delimited import dialect_of

        found = dialect_of(path, WRITTEN)
        own = found.separator == "," and found.decimal == "." and not (found.told or found.units)
        return list(found.names) if own else []
    import pyarrow.parquet as pq

    from limo_driver.recordings.files.parquet import reading_parquet

    with reading_parquet(path):
        return [name.strip() for name in pq.read_schema(path).names]


def mapping_of(mapping: LogMapping | Path | str | None) -> LogMapping | None:
    """Return a mapping, or the one in this file; None if none is given.

    Raises:
        ConfigError: It cannot be read, or is none.
    """
    if mapping is None:
        return None
    if isinstance(mapping, (Path, str)):
        return LogMapping.load(mapping)
    return expected("mapping", mapping, LogMapping, "a LogMapping or the path of its file")


def columns_of(
    log: Path | str | Mapping[str, Any],
    model: RobotModel | None = None,
    mapping: LogMapping | Path | str | None = None,
    topic: str | None = None,
    episode: int | None = None,
) -> tuple[Columns, LogMapping, RobotModel | None]:
    """Return the columns of a log in SI units, unjudged, the mapping used, and the robot.

    The robot has the joints that the log is of.

    Raises:
        ConfigError: There is neither robot nor mapping, or a question is open.
        RecordingError: The log cannot be read, or lacks what a recording has.
    """
    used = mapping_of(mapping)
    table = table_of_log(log, model, used, topic, episode)
    if used is not None:
        part = None if model is None else mapped_part(used, model)
        return used.columns(table, part), used, part
    proposal = proposed(table, model)
    columns = proposal.mapping.columns(table, proposal.model)
    told = (said(proposal), *columns.warnings)
    return replace(columns, warnings=told), proposal.mapping, proposal.model


def proposed(table: LogTable, model: RobotModel | None) -> Proposal:
    """Return what is proposed for a table without a mapping.

    Raises:
        ConfigError: Nobody says what arm it is of.
    """
    if model is None:
        raise ConfigError(
            "its columns are not limo's own, so `robot` or `mapping` has to say what they are; "
            "`limo inspect` proposes a mapping",
            path=table.source or None,
        )
    return propose(table, model)


def said(proposal: Proposal) -> str:
    """Say in one line what was taken for what."""
    parts = [f"{t.quantity} {t.columns} [{t.unit}]" for t in proposal.taken if t.unit]
    left = proposal.mapping.left_out
    more = f"; left out: {shortened(left, 24)}" if left else ""
    locked = f"; {proposal.told}" if proposal.told else ""
    return f"read as {', '.join(parts)}{more}{locked}"
