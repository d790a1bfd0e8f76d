"""Parquet in batches, however long the file is, of what can be numbers, names or times in it.

A few bytes of Parquet can say a value a million times, or that a row is as wide as an image. So
what a row takes is known before rows are read: images and other bytes are left aside, and rows come
as few at once as fit into memory.

The log of a recording that is being made: an Arrow stream whose batches are sealed.

Each batch carries a checksum (CRC 32) of its values, begun with that of the batch before it. So
what is read back says where bits have changed, where batches are missing, and that the end is. Any
program that reads Arrow streams reads the log; those without seals are read as they are.
"""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false
# pyarrow ships no stubs.

from __future__ import annotations

import re
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from limo_driver.errors import PlacedError, RecordingError
from limo_driver.recordings.files.batches import STRETCH, most_rows
from limo_driver.runtime.given_files import Spent, check_file
from limo_driver.types import FloatArray

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


_SEAL: Final = b"limo.seal"
_SEALED: Final = re.compile(rb"limo crc32 ([0-9a-f]{8}) ([0-9a-f]{8})")
_BEGIN: Final = b"\xff\xff\xff\xff"  # of every message of a stream
_END: Final = _BEGIN + bytes(4)
_STEP: Final = 8  # bytes, at whose multiples messages begin
_BLOCK: Final = 1 << 20  # bytes that are searched at once for what follows damage
_DAMAGE: Final = (pa.ArrowException, OSError, EOFError, ValueError, MemoryError)


class LogStream:
    """Writes the log, batch by batch.

    Args:
        file: That it is written to.
        schema: Columns of numbers, and the header in its metadata.
    """

    def __init__(self, file: BinaryIO, schema: pa.Schema) -> None:
        self._schema, self._sum = schema, _sum_of(schema)
        self._stream = pa.ipc.new_stream(file, schema)
        self._write(np.zeros((len(schema), 0)), self._sum)  # the header waits for a first batch

    def write(self, columns: FloatArray) -> None:
        """Write rows.

        Args:
            columns: (k, T); NaN where there is no value.
        """
        before, self._sum = self._sum, _sum(columns, self._sum)
        self._write(columns, before)

    def close(self) -> None:
        """Write its end."""
        self._stream.close()

    def _write(self, columns: FloatArray, before: int) -> None:
        arrays = [pa.array(values, mask=np.isnan(values)) for values in columns]
        batch = pa.record_batch(arrays, schema=self._schema)
        seal = f"limo crc32 {before:08x} {self._sum:08x}".encode()
        self._stream.write_batch(batch, custom_metadata={_SEAL: seal})


def _sum(columns: FloatArray, before: int) -> int:
    """Return the checksum of columns (k, T); values that are missing are all the same NaN."""
    return zlib.crc32(np.where(np.isnan(columns), np.nan, columns).tobytes(), before)


def _sum_of(schema: pa.Schema) -> int:
    about = sorted((schema.metadata or {}).items())
    return zlib.crc32(repr((schema.names, about)).encode())


class StoredLog:
    """A log that is read, also one that is cut off or damaged.

    Batches that are damaged are left out, those behind them are read.

    Args:
        path: Of the log.

    Raises:
        RecordingError: It is none, or ends before its header.
    """

    def __init__(self, path: Path) -> None:
        check_file(path, RecordingError)
        try:
            self._size = path.stat().st_size
            self._source = pa.OSFile(str(path))
            self.schema: pa.Schema = pa.ipc.read_schema(self._source)
        except FileNotFoundError as error:
            raise RecordingError(f"cannot be read: {error.strerror}", path=path) from None
        except _DAMAGE as error:
            reason = str(error).splitlines()[0] if str(error) else "it is empty"
            raise RecordingError(f"is no log of limo's: {reason}", path=path) from None
        self._spent = Spent(path, RecordingError)
        self._rows, self._ended = 0, False
        self._places = list[int]()  # bytes at which it is damaged

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield what can be read, once."""
        is_sealed, last = False, _sum_of(self.schema)
        for piece in self._spent.metered(self._pieces()):
            is_sealed |= piece.seal is not None
            is_next = last in {None, piece.before}
            last = piece.seal
            is_right = piece.batch is not None
            if piece.batch is not None and is_sealed:
                is_right = piece.seal == _sum(_values(piece.batch), piece.before or 0)
            if not is_right or (is_sealed and not is_next):
                self._places.append(piece.at)
            if is_right and piece.batch is not None:
                self._rows += piece.batch.num_rows
                yield piece.batch

    def describe_losses(self) -> str:
        """Say what is lost, once all is read; nothing for a log that is whole."""
        notes = list[str]()
        if places := self._places:
            many = "one place" if len(places) == 1 else f"{len(places)} places, first"
            notes.append(
                f"is damaged in {many} at byte {places[0]} of {self._size}, and the rows there are "
                "left out"
            )
        if not self._ended:
            notes.append(f"lacks its end: whatever came after its {self._rows} rows is lost")
        return "; it ".join(notes)

    def _pieces(self) -> Iterator[_Piece]:
        """Yield batches, one after the other; after damage, from the next one on."""
        at, source = self._source.tell(), self._source
        while 0 <= at < self._size:
            source.seek(at)
            if self._size - at == len(_END) and source.read(len(_END)) == _END:
                self._ended = True
                return
            source.seek(at)
            try:
                message = pa.ipc.read_message(source)
                batch = pa.ipc.read_record_batch(message, self.schema)
                batch.validate(full=True)
            except _DAMAGE:
                if (following := self._following(at)) >= 0:
                    yield _Piece(at)
                at = following
                continue
            self._spent.take(unpacked=max(batch.nbytes - message.body.size, 0))
            seal = _SEALED.search(message.metadata.to_pybytes())
            yield _Piece(at, batch, *(() if seal is None else (int(x, 16) for x in seal.groups())))
            at = source.tell()

    def _following(self, at: int) -> int:
        """Return where the next message may begin; -1 where there is none."""
        start = at + _STEP
        while start < self._size:
            self._source.seek(start)
            block, found = self._source.read(_BLOCK), -_STEP
            while (found := block.find(_BEGIN, found + _STEP)) >= 0:
                if found % _STEP == 0:
                    return start + found
                found -= found % _STEP
            start += _BLOCK
        return -1


class _Piece(NamedTuple):
    """What stands at a place of a log: a batch, or something that is none."""

    at: int  # byte
    batch: pa.RecordBatch | None = None
    before: int | None = None  # checksum of the batch before it
    seal: int | None = None  # its own


def _values(batch: pa.RecordBatch) -> FloatArray:
    """Return the values of a batch, (k, T); NaN where there are none."""
    columns = [column.to_numpy(zero_copy_only=False) for column in batch.columns]
    return np.array(columns, dtype=np.float64)
