"""A long log block by block: what is written of it anew has all of its rows, and none too many."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.columns import WRITTEN
from limo_driver.logs.readers.formats.arrays import npz_blocks, rows_of_npz
from limo_driver.logs.readers.formats.arrow import numbers_of
from limo_driver.logs.readers.formats.reading import ARRAYS, PARQUET, TEXTS, ending_of
from limo_driver.logs.readers.proposals.gravity import other_unit_from
from limo_driver.logs.readers.proposals.times import refuse_two_units
from limo_driver.recordings.files.batches import LONG_TEXT, MOST, blocks_of, is_packed
from limo_driver.recordings.files.delimited import DelimitedText
from limo_driver.recordings.files.parquet import parquet_rows, reading_parquet
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    import pyarrow as pa

    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.logs.readers.table import LogTable


def long_log(path: Path) -> Iterator[LogTable] | None:
    """Return the rows of a long log, block by block; None if it can as well be read at once.

    Args:
        path: Delimited text, Parquet or .npz; of anything else nothing is known here.

    Raises:
        RecordingError: It cannot be read, at once or while the rows come.
    """
    ending = ending_of(path)
    if ending in TEXTS and path.is_file() and (is_packed(path) or path.stat().st_size > LONG_TEXT):
        return _numbers(DelimitedText(path, WRITTEN).blocks(), path, "delimited text")
    if ending in PARQUET and _rows_of_parquet(path) > MOST:
        return _numbers(_parquet_tables(path), path, "Parquet")
    if ending in ARRAYS and rows_of_npz(path) > MOST:
        return npz_blocks(path)
    return None


def check_units(table: LogTable, before: LogTable | None, mapping: LogMapping) -> None:
    """Check that time and positions go on in the units in which they began.

    Args:
        table: A block.
        before: The one before it, if there is one.
        mapping: How they are read.

    Raises:
        RecordingError: They do not.
    """
    for name in mapping.time.columns:
        refuse_two_units(table, name)
    names = mapping.position.columns
    own = np.stack([table.column(name) for name in names], axis=1).astype(np.float64)
    if before is not None:
        last = [float(before.column(name)[-1]) for name in names]
        own = np.vstack([last, own])
    if (row := other_unit_from(own)) is not None:
        raise RecordingError(
            f"the positions {shortened(list(names))} jump by a factor of 57.3 at row "
            f"{table.first_row + row - (before is not None)}: degrees and radians in one column; "
            "expected one unit",
            path=table.source or None,
        )


def _numbers(tables: Iterable[pa.Table], path: Path, kind: str) -> Iterator[LogTable]:
    start = 0
    for table in tables:
        found = numbers_of(table, str(path), kind)
        yield replace(found, first_row=start)
        start += found.rows


def _rows_of_parquet(path: Path) -> int:
    import pyarrow.parquet as pq

    with reading_parquet(path):
        return pq.read_metadata(path).num_rows


def _parquet_tables(path: Path) -> Iterator[pa.Table]:
    with reading_parquet(path):
        rows = parquet_rows(path)
        yield from blocks_of(rows.batches, rows.schema)
