"""Tables of pyarrow as tables of numbers: lists become columns, dates stay dates."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from limo_driver.errors import RecordingError
from limo_driver.foreign.columns.names import TIME, read_name
from limo_driver.foreign.formats.clock import clock_times, is_clock
from limo_driver.foreign.table import LogTable
from limo_driver.recordings.batches import FEW, Kept, kept_of, parquet_batches

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


def numbers_of(
    table: pa.Table, source: str, kind: str, names: Mapping[str, Sequence[str]] | None = None
) -> LogTable:
    """Return the columns of numbers.

    Args:
        table: Of pyarrow.
        source: File that it is from.
        kind: What that is, in words.
        names: Of the entries of columns of lists, by column.

    Raises:
        RecordingError: A column of numbers has text in a few of its cells: the file is damaged.
    """
    columns, unread = dict[str, "NDArray[Any]"](), dict[str, str]()
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind_of = column.type
        if pa.types.is_list(kind_of) or pa.types.is_large_list(kind_of) or _is_fixed(kind_of):
            found = _entries(column)
            if found is None:
                unread[name] = f"{kind_of} of different lengths"
                continue
            own = (names or {}).get(name, ())
            named = own if len(own) == found.shape[1] else range(found.shape[1])
            columns |= {
                (f"{name}.{each}" if isinstance(each, str) else f"{name}[{each}]"): found[:, k]
                for k, each in enumerate(named)
            }
        elif (values := _values(column)) is not None:
            columns[name] = values
        elif read_name(name).quantity == TIME and (times := clock_times(column)) is not None:
            columns[name] = times
        else:
            _refuse_few_texts(name, column, source)
            unread[name] = str(kind_of)
    return LogTable(columns, source, kind, unread)


def kept_numbers(kept: Kept, source: str, kind: str) -> LogTable:
    """Return the columns of numbers of the rows that are kept of a file."""
    table = numbers_of(kept.table, source, kind)
    return replace(table, spread=kept.spread, notes=(kept.note,) if kept.note else ())


def read_parquet(path: Path) -> Kept:
    """Read a Parquet file, or stretches of one that is long.

    Raises:
        RecordingError: It is none, or damaged.
    """
    try:
        return kept_of(*parquet_batches(path))
    except (OSError, pa.ArrowException) as error:
        raise RecordingError(
            f"cannot be read as Parquet: {str(error).splitlines()[0]}", path=path
        ) from None


def _is_fixed(kind: Any) -> bool:  # noqa: ANN401  # pyarrow has no types
    return bool(pa.types.is_fixed_size_list(kind))


def _values(column: pa.ChunkedArray) -> NDArray[Any] | None:
    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return column.to_numpy()
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy()  # whole numbers may be nanoseconds, of more digits than a float's
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind):
        return column.cast(pa.float64()).to_numpy().astype(np.float64)
    return None


def _entries(column: pa.ChunkedArray) -> NDArray[Any] | None:
    """Return lists of one length as a matrix (T, k); None where they are something else."""
    flat = pa.chunked_array([chunk.flatten() for chunk in column.chunks]).combine_chunks()
    if column.null_count or not len(column) or len(flat) % len(column):
        return None
    if not (pa.types.is_floating(flat.type) or pa.types.is_integer(flat.type)):
        return None
    if not _is_fixed(column.type):
        lengths = {len(item) for item in (column[0], column[len(column) // 2], column[-1])}
        if lengths != {len(flat) // len(column)}:
            return None
    return flat.cast(pa.float64()).to_numpy(zero_copy_only=False).reshape(len(column), -1)


def _refuse_few_texts(name: str, column: pa.ChunkedArray, source: str) -> None:
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return
    texts = [
        (row, cell)
        for row, cell in enumerate(column.to_pylist())
        if cell is not None and not (_is_number(cell) or is_clock(cell))
    ]
    if texts and len(texts) <= max(1, FEW * len(column)):
        row, cell = texts[0]
        raise RecordingError(
            f"column {name} holds text in {len(texts)} of {len(column)} cells; row {row} is "
            f"{cell!r}, expected a number",
            path=source,
            rows=[row for row, _ in texts],
        )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
