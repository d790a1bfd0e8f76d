"""Files of recordings: Parquet, CSV and limo's own log, read into columns and written."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

import json
import re
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from limo_driver.errors import RecordingError
from limo_driver.recordings.channels import CHANNELS, POSITION, Columns, recorded_channel, seconds
from limo_driver.recordings.files.batches import Kept, kept_of
from limo_driver.recordings.files.delimited import DelimitedText
from limo_driver.recordings.files.parquet import DAMAGE, parquet_rows
from limo_driver.runtime import written_by
from limo_driver.runtime.display import shortened
from limo_driver.runtime.given_files import check_file
from limo_driver.runtime.outputs import require_parquet, whole
from limo_driver.types import FloatArray

# a joint of four digits at most: no file has more columns
_JOINT_COLUMN = re.compile(r"(?P<quantity>[a-z_]*[a-z])_(?P<joint>[1-9]\d{0,3})")
LOG_SUFFIX = ".partial"


def read_columns(path: Path) -> Columns:
    """Read a file into columns, without judging the values.

    Raises:
        RecordingError: No such file, another format, or missing columns.
    """
    warnings: tuple[str, ...] = ()
    unfinished = path.with_name(path.name + LOG_SUFFIX)
    if not path.exists() and unfinished.exists():
        warnings = (f"{path.name} was never finished; read what {unfinished.name} holds",)
        path = unfinished
    elif unfinished.exists():
        warnings = (
            f"{unfinished.name} beside it is the log of a run that never finished, or is under "
            f"way; this is the finished recording {path.name}",
        )
    kept = _read_table(path)
    table = kept.table
    by_quantity = _joint_columns(table, path)
    n = len(by_quantity["position"])
    command, channels, told = _commands(table, n, path)
    arrays = {
        quantity: np.stack([_values(table, name, path) for name in names], axis=1)
        for quantity, names in by_quantity.items()
        if len(names) == n and quantity not in {"torque", *channels}
    }
    arrays |= told
    arrays["torque"] = _by_joint(table, "torque", n, path)
    partial = sorted(by_quantity.keys() - arrays.keys() - {*channels})
    if partial:
        warnings += (f"{', '.join(partial)}: not one column for each of {n} joints; not read",)
    header, unread = _header(table)
    if why := header.get("stopped"):
        warnings += (f"the run stopped before its motion ended: {why}",)
    time, taken = _time(table, path)
    return Columns(
        time=time,
        position=arrays.pop("position"),
        torque=arrays.pop("torque"),
        velocity=arrays.pop("velocity", None),
        command=command,
        channels=channels,
        spread=kept.spread,
        extras=arrays,
        warnings=warnings + taken + unread + ((kept.note,) if kept.note else ()),
        robot=str(header.get("robot") or ""),
        torque_resolution=_per_joint(header.get("torque_resolution"), n),
    )


def write_columns(columns: Columns, path: Path) -> None:
    """Write Parquet: time, position_j, torque_j and what else there is; 1-based joints.

    Args:
        columns: What to write; torques that are NaN throughout are not.
        path: To be written.

    Raises:
        ConfigError: It cannot be written, or its ending is that of another format.
    """
    with columns_writer(path) as write:
        write(columns)


@contextmanager
def columns_writer(
    path: Path, about: Mapping[str, Any] | None = None
) -> Generator[Callable[[Columns], None]]:
    """Give what writes columns, one block of rows after the other, as `write_columns` does.

    Args:
        path: To be written; the file is there once the context ends without an error.
        about: More for the header, which is that of the first block.

    Raises:
        ConfigError: It cannot be written, or its ending is that of another format.
    """
    import pyarrow.parquet as pq

    require_parquet(path)
    with whole(path) as draft, ExitStack() as opened:
        writers = list[pq.ParquetWriter]()

        def write(columns: Columns) -> None:
            table = _table_of(columns, about or {})
            if not writers:
                writer = pq.ParquetWriter(draft, table.schema, use_dictionary=False)
                writers.append(opened.enter_context(writer))
            writers[0].write_table(table)

        yield write


def _table_of(columns: Columns, about: Mapping[str, Any]) -> pa.Table:
    from limo_driver.recordings.files.recorder import METADATA_KEY

    def by_joint(quantity: str, values: FloatArray | None) -> dict[str, FloatArray]:
        if values is None:
            return {}
        return {f"{quantity}_{j}": own for j, own in enumerate(values.T, start=1)}

    table: dict[str, FloatArray] = {"time": columns.time}
    table |= by_joint("position", columns.position)
    if not np.isnan(columns.torque).all():
        table |= by_joint("torque", columns.torque)
    if columns.command is not None:
        pairs = zip(columns.led, columns.command.T, strict=True)
        table |= {f"{name}_{j}": own for j, (name, own) in enumerate(pairs, start=1)}
    for quantity, values in columns.extras.items():
        own = by_joint(quantity, values)
        if quantity in CHANNELS:  # of some joints alone, where others are told otherwise
            own = {name: each for name, each in own.items() if np.isfinite(each).any()}
        table |= own
    table |= by_joint("velocity", columns.velocity)
    header = {written_by.KEY: written_by.installed()} | dict(about)
    if columns.robot:
        header["robot"] = columns.robot
    if columns.torque_resolution is not None:
        header["torque_resolution"] = columns.torque_resolution.tolist()
    return pa.table(table).replace_schema_metadata({METADATA_KEY: json.dumps(header)})


def _header(table: pa.Table) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return what the header says, and a warning if there is a header but unreadable."""
    from limo_driver.recordings.files.recorder import read_header

    try:
        return read_header(table), ()
    except RecordingError as error:
        return {}, (str(error),)


def _per_joint(values: object, n: int) -> FloatArray | None:
    """Return what a header says of each of n joints; None if it says nothing that can be so."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return (
        array if array.shape == (n,) and np.isfinite(array).all() and (array >= 0).all() else None
    )


def _read_table(path: Path) -> Kept:
    check_file(path, RecordingError)
    if not path.is_file():
        raise RecordingError("is a folder" if path.is_dir() else "no such file", path=path)
    try:
        kept = _read_format(path)
        names = [name.strip() for name in kept.table.column_names]
    except DAMAGE as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(
            f"cannot be read as Parquet, CSV (.csv) or limo's own log: {reason}", path=path
        ) from None
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise RecordingError(f"has more than one column {shortened(repeated)}", path=path)
    table = kept.table.rename_columns(names).replace_schema_metadata(kept.table.schema.metadata)
    return replace(kept, table=table)


def _read_format(path: Path) -> Kept:
    if path.suffix == LOG_SUFFIX:
        from limo_driver.recordings.files.recorder import read_log

        notes = list[str]()
        table = read_log(path, notes.append)
        return Kept(table, note="; ".join(f"{path.name} {text}" for text in notes))
    if path.suffix.lower() in {".csv", ".txt"}:
        text = DelimitedText(path)
        kept = text.kept()
        return replace(kept, note="; ".join(filter(None, (kept.note, *text.notes()))))
    rows = parquet_rows(path)
    return kept_of(rows.batches, rows.schema, rows.width)


def _joint_columns(table: pa.Table, path: Path) -> dict[str, list[str]]:
    """Return the column names of each quantity in order of the joints."""
    joints: dict[str, set[int]] = {}
    for name in table.column_names:
        if match := _JOINT_COLUMN.fullmatch(name):
            joints.setdefault(match["quantity"], set()).add(int(match["joint"]))
    notes = [] if "torque" in joints else [name for name in CHANNELS if name in joints]
    needed = ("position", *(notes or ("torque",)))
    n = max((max(joints[quantity]) for quantity in needed if quantity in joints), default=1)
    expected = ["time", *(f"position_{j}" for j in range(1, n + 1))]
    for j in range(1, n + 1):
        if notes:
            expected.append(f"{recorded_channel(j, table.column_names) or notes[0]}_{j}")
        elif "torque" not in joints:  # some drives may tell no torque
            expected.append(f"torque_{j}")
    if missing := [name for name in expected if name not in table.column_names]:
        raise RecordingError(
            f"lacks {shortened(missing)}; a recording has time, position_1 … position_n and "
            "torque_1 … torque_n, or command_1 … command_n of drives that tell no torque; this "
            f"file has {shortened(table.column_names)}"
            + written_by.advice_to_update(_header(table)[0].get(written_by.KEY)),
            path=path,
        )
    return {
        quantity: [f"{quantity}_{j}" for j in sorted(numbers)]
        for quantity, numbers in joints.items()
        if numbers == set(range(1, max(numbers) + 1))
    }


def _commands(
    table: pa.Table, n: int, path: Path
) -> tuple[FloatArray | None, tuple[str, ...], dict[str, FloatArray]]:
    """Return what the drives were told (T, n), each joint's channel, and all that was beside it.

    None, if some were told nothing. Beside torques, which need no drive, set-points of positions
    alone are taken for commands.
    """
    columns = set(table.column_names)
    values = {name: _by_joint(table, name, n, path) for name in CHANNELS}
    numbers = {
        f"{name}_{j}"
        for name, own in values.items()
        for j in (1 + np.flatnonzero(np.isfinite(own).any(axis=0))).tolist()
    }
    found = [recorded_channel(j, numbers) or recorded_channel(j, columns) for j in range(1, n + 1)]
    channels = tuple(name for name in found if name is not None)
    torque = any(f"torque_{j}" in columns for j in range(1, n + 1))
    if len(channels) < n or (torque and set(channels) != {POSITION.name}):
        return None, (), {}
    command = np.stack([values[name][:, j] for j, name in enumerate(channels)], axis=1)
    beside = {
        name: own
        for name, own in values.items()
        if set(channels) != {name} and any(f"{name}_{j}" in numbers for j in range(1, n + 1))
    }
    return command, channels, beside


def _by_joint(table: pa.Table, quantity: str, n: int, path: Path) -> FloatArray:
    """Return a quantity of each joint, (T, n); NaN for those that have no column."""
    found = np.full((table.num_rows, n), np.nan)
    for j, values in enumerate(found.T, start=1):
        if f"{quantity}_{j}" in table.column_names:
            values[:] = _values(table, f"{quantity}_{j}", path)
    return found


def _time(table: pa.Table, path: Path) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the time (T,) [s], and a warning where the file has it in another unit."""
    column = table["time"]
    dated = pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type)
    if not (dated or pa.types.is_integer(column.type)):
        return _values(table, "time", path), ()
    known = column.is_valid().to_numpy().astype(bool)
    values = (column if dated else column.fill_null(0)).to_numpy()
    time, taken = seconds(values, known)
    return time, (taken,) if taken else ()


def _values(table: pa.Table, name: str, path: Path) -> FloatArray:
    """Return one column as float64; empty cells are NaN."""
    column = table[name]
    if pa.types.is_null(column.type):  # a CSV column without one value
        return np.full(len(column), np.nan)
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise RecordingError(
            f"column {name} holds {column.type}, expected numbers{_first_text(column)}", path=path
        )
    return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64)


def _first_text(column: pa.ChunkedArray) -> str:
    """Say where the first cell that is no number stands."""
    for row, value in enumerate(column.to_pylist()):
        try:
            float(value)
        except (TypeError, ValueError):
            return f"; row {row} is {value!r}"
    return ""
