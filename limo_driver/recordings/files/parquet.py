"""Parquet in batches, however long the file is, of what can be numbers, names or times in it.

A few bytes of Parquet can say a value a million times, or that a row is as wide as an image. So
what a row takes is known before rows are read: images and other bytes are left aside, and rows come
as few at once as fit into memory.
"""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from limo_driver.errors import PlacedError, RecordingError
from limo_driver.recordings.files.batches import STRETCH, most_rows
from limo_driver.runtime.given_files import Spent

DAMAGE: Final = (OSError, pa.ArrowException, UnicodeDecodeError)  # of a file that is none
_WIDEST: Final = 1 << 15  # bytes of a column in one row: 4096 numbers; images have more
_MOST: Final = 4096  # columns
_FEW: Final = 64  # rows that are read at once before it is known how wide they are


@contextmanager
def reading_parquet(path: Path) -> Generator[None]:
    """Refuse as a recording what turns out to be no Parquet, or damaged.

    Raises:
        RecordingError: It is.
    """
    try:
        yield
    except DAMAGE as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(f"cannot be read as Parquet: {reason}", path=path) from None


class ParquetRows(NamedTuple):
    """The rows of a Parquet file."""

    batches: Iterator[pa.RecordBatch]
    schema: pa.Schema  # of the columns that are read
    width: int  # of a row at most, about [bytes]
    aside: dict[str, str]  # columns that are not read, and what they hold


def whole_table(path: Path, error: type[PlacedError | RecordingError]) -> pa.Table:
    """Return a Parquet file as a table, all of it in memory.

    Raises:
        OSError: It cannot be read; ArrowException likewise.
        error: It takes more than its budget.
    """
    rows, spent = parquet_rows(path, error), Spent(path, error)
    batches = list[pa.RecordBatch]()
    for batch in rows.batches:
        spent.take(unpacked=batch.nbytes)
        batches.append(batch)
    return pa.Table.from_batches(batches, rows.schema)


def parquet_rows(
    path: Path, error: type[PlacedError | RecordingError] = RecordingError
) -> ParquetRows:
    """Return the rows of a Parquet file and their schema.

    Raises:
        OSError: It cannot be read; ArrowException likewise, also while the rows come.
        error: It has more columns or rows than its budget, or takes longer.
    """
    spent = Spent(path, error)
    file = pq.ParquetFile(path, pre_buffer=False)  # not whole row groups at once
    about = file.metadata
    spent.take(rows=about.num_rows)
    if about.num_columns > _MOST:
        raise error(f"has {about.num_columns} columns, expected at most {_MOST}", path=path)
    leaves, texts, lists = _leaves(about)
    first = next(file.iter_batches(1, columns=leaves, use_threads=False), None)
    columns = [] if first is None else zip(first.schema.names, first.columns, strict=True)
    sizes = {name: row.nbytes for name, row in columns}
    for leaf in lists:  # the first of which need not be the longest
        name = leaf.split(".")[0]
        if sizes.get(name, 0) <= _WIDEST:
            sizes[name] = max(sizes.get(name, 0), _widest(path, leaf, spent))
    wide = {name for name, size in sizes.items() if size > _WIDEST}
    kept = [name for name in leaves if name not in wide and name.split(".")[0] not in wide]
    schema = file.read_row_groups([], columns=kept).schema
    width = sum(size for name, size in sizes.items() if name not in wide)
    width += sum(_longest(path, name, spent) for name in texts if name in kept)
    most = min(STRETCH, most_rows(width))
    every = file.schema_arrow
    aside = {each.name: str(each.type) for each in every if each.name not in schema.names}

    def batches() -> Iterator[pa.RecordBatch]:
        with file:
            rows = file.iter_batches(most, columns=kept, use_threads=not texts)
            for batch in spent.metered(rows, rows=0):
                batch.validate(full=True)  # texts of UTF-8, lists that end: nobody asks later
                yield batch

    return ParquetRows(batches(), schema, width, aside)


def _leaves(about: pq.FileMetaData) -> tuple[list[str], list[str], list[str]]:
    """Return columns that are no bytes, as of images, those that are texts, and those of lists.

    Nothing else of the metadata is looked at: what is said of row groups ends the process where it
    is damaged.
    """
    leaves, texts, lists = list[str](), list[str](), list[str]()
    for k in range(about.num_columns):
        column = about.schema.column(k)
        kind = column.logical_type.type
        if column.physical_type == "BYTE_ARRAY" and kind not in {"STRING", "DECIMAL"}:
            continue
        leaves.append(column.path)
        if kind == "STRING":
            texts.append(column.path)
        if column.max_repetition_level:
            lists.append(column.path)
    return leaves, texts, lists


def _widest(path: Path, name: str, spent: Spent) -> int:
    """Return how much a row of lists takes at most [bytes], of so few that they fit into memory.

    Reading ends where that is too much.
    """
    widest = 0
    with pq.ParquetFile(path, pre_buffer=False) as file:
        for few in file.iter_batches(_FEW, columns=[name], use_threads=False):
            widest = max(widest, -(-few.nbytes // few.num_rows))
            if widest > _WIDEST:
                break
            spent.check_time()
    return widest


def _longest(path: Path, name: str, spent: Spent) -> int:
    """Return the length of the longest text that a column may repeat [bytes].

    Texts that are said a million times stand once in a list, which is read with the first row.
    """
    longest = 0
    with pq.ParquetFile(path, read_dictionary=[name]) as file:
        for group in range(file.num_row_groups):
            first = next(file.iter_batches(1, row_groups=[group], columns=[name]), None)
            for known in () if first is None else _dictionaries(first.columns):
                longest = max(longest, *map(len, known.cast(pa.binary()).to_pylist()))
            spent.check_time()
    return longest


def _dictionaries(arrays: list[pa.Array]) -> Iterator[pa.Array]:
    for array in arrays:
        if pa.types.is_dictionary(array.type):
            yield array.dictionary
        elif pa.types.is_struct(array.type):
            yield from _dictionaries(array.flatten())
        elif hasattr(array, "values"):  # a list
            yield from _dictionaries([array.values])
