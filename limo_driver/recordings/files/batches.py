"""Batches: rows of Parquet and of delimited text, a few at a time, however long the file is.

Stretches: of a log of any length, as many rows as fit into memory, spread over all of it.
"""

from __future__ import annotations

import gzip
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np
import pyarrow as pa
from pyarrow import csv

from limo_driver.errors import RecordingError
from limo_driver.runtime.given_files import Spent

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false


_PACKED: Final = ".gz"
BLOCK: Final = 250_000  # rows that are worked on at once
LONG_TEXT: Final = 1 << 26  # bytes of text that is not read at once
FEW: Final = 0.02  # of the cells, that hold a text where all others hold numbers
_NUMBER: Final = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?")
_EXACT: Final = 2**53  # whole numbers up to here are the same as float64


@dataclass(frozen=True)
class Kept:
    """Rows of a file that are kept in memory."""

    table: pa.Table
    spread: int = 0  # rows of which they are evenly spread stretches; 0 if they are all
    note: str = ""  # that says so
    aside: Mapping[str, str] = field(default_factory=dict)  # columns left aside, and what they hold


def kept_of(batches: Iterable[pa.RecordBatch], schema: pa.Schema, width: int = 0) -> Kept:
    """Return all rows, or as many as memory should hold, in stretches spread over all of them.

    Args:
        batches: The rows.
        schema: Of them.
        width: Of a row [bytes]; of a number in each column, if not given.
    """
    most = most_rows(width or 8 * len(schema))
    stretches = Stretches[pa.RecordBatch](_cut, most, min(STRETCH, most))
    for batch in batches:
        stretches.add(batch, batch.num_rows)
    table = pa.Table.from_batches(stretches.pieces(), schema)
    return Kept(table, stretches.spread, stretches.note())


def blocks_of(
    batches: Iterable[pa.RecordBatch], schema: pa.Schema, rows: int = BLOCK
) -> Iterator[pa.Table]:
    """Yield tables of so many rows; the last has up to twice as many, and none is a short rest."""
    waiting, many = list[pa.RecordBatch](), 0
    for batch in batches:
        waiting.append(batch)
        many += batch.num_rows
        while many >= 2 * rows:
            table = pa.Table.from_batches(waiting, schema)
            yield table.slice(0, rows)
            waiting, many = table.slice(rows).to_batches(), many - rows
    if many:
        yield pa.Table.from_batches(waiting, schema)


def text_batches(
    path: Path,
    read: csv.ReadOptions | None = None,
    parse: csv.ParseOptions | None = None,
    convert: csv.ConvertOptions | None = None,
    *,
    aligned: bool = False,
) -> tuple[Iterator[pa.RecordBatch], pa.Schema]:
    """Return the rows of delimited text, however long, and their schema.

    What a column holds is judged by the first rows: numbers are floats, so that whole ones may go
    on as others; only what counts on, as time does, stays whole.

    Args:
        path: Of the file.
        read: Options of pyarrow, likewise the others.
        parse: Of the cells.
        convert: Of the values.
        aligned: Whether several blanks may stand between two cells.

    Raises:
        OSError: It cannot be read; ArrowException likewise, also while the rows come.
    """
    with csv.open_csv(text_source(path, aligned=aligned), read, parse, convert) as file:
        first = next(iter(file), None)
        if first is None:
            return iter(()), file.schema
    types = {
        field.name: _lasting_type(field.type, column)
        for field, column in zip(first.schema, first.columns, strict=True)
    }
    lasting = convert or csv.ConvertOptions()
    lasting.column_types = types
    file = csv.open_csv(text_source(path, aligned=aligned), read, parse, lasting)

    def batches() -> Iterator[pa.RecordBatch]:
        with file:
            yield from file

    return batches(), file.schema


def is_packed(path: Path) -> bool:
    """Say whether a text is packed with gzip, by its ending."""
    return path.suffix.lower() == _PACKED


def text_source(path: Path, *, aligned: bool = False) -> Path | io.BufferedIOBase:
    """Return what a text is read from: the file, or one that unpacks it within its budget.

    Args:
        path: Of the file.
        aligned: Whether its cells stand below each other, with blanks between.
    """
    if aligned:
        return io.BufferedReader(_Aligned(_Unpacked(path) if is_packed(path) else path.open("rb")))
    return _Unpacked(path) if is_packed(path) else path


class _Aligned(io.RawIOBase):
    """A text with one blank where there were more, and none at either end of a line."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self._file, self._rest = file, b""

    def readable(self) -> bool:
        return True

    def readinto(self, into: Any) -> int:  # noqa: ANN401  # a buffer
        if not self._rest:
            lines = self._file.readlines(len(into))
            self._rest = b"".join(b" ".join(line.split()) + b"\n" for line in lines)
        part, self._rest = self._rest[: len(into)], self._rest[len(into) :]
        into[: len(part)] = part
        return len(part)

    def close(self) -> None:
        self._file.close()
        super().close()


class _Unpacked(gzip.GzipFile):
    """A packed text; refuses to unpack to far more than a log does."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        self._spent = Spent(path, RecordingError)

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        self._spent.take(unpacked=len(data))
        return data


def _cut(batch: pa.RecordBatch, start: int, stop: int) -> pa.RecordBatch:
    return batch.slice(start, stop - start)


def _lasting_type(kind: Any, first: pa.Array) -> Any:  # noqa: ANN401  # pyarrow has no types
    """Return the type of a column, of whose first values it could be narrower."""
    if pa.types.is_null(kind) or (pa.types.is_string(kind) and _are_numbers(first)):
        return pa.float64()  # of a text among numbers the reader then says where it stands
    if not pa.types.is_integer(kind):
        return kind
    values = first.drop_null().to_numpy()
    counts_on = values.size > 1 and bool((np.diff(values) >= 0).all()) and values[-1] > values[0]
    return kind if counts_on or np.abs(values).max(initial=0) > _EXACT else pa.float64()


def _are_numbers(cells: pa.Array) -> bool:
    """Say whether all but a few cells of text are numbers."""
    known = cells.drop_null().to_pylist()
    numbers = sum(bool(_NUMBER.fullmatch(cell.strip())) for cell in known)
    return numbers > (1 - FEW) * len(known)


Piece = TypeVar("Piece")

MOST: Final = 1_000_000  # rows that are kept; identification takes about 1 kB for each
STRETCH_SECONDS: Final = 25.0  # [s] of a stretch, long beside what a filter loses
STRETCH: Final = 25_000  # rows of one, where its rate is not known yet: that of 1 kHz


_MEMORY: Final = 1 << 30  # bytes that rows may take, however wide they are


def most_rows(width: int) -> int:
    """Return how many rows of so many bytes may be kept."""
    return min(MOST, max(_MEMORY // max(width, 1), 1))


class Stretches(Generic[Piece]):
    """Keep evenly spread stretches of rows that come piece by piece, however many they will be.

    All rows are kept until they are too many; then every second stretch goes, and of those that
    come only every second is kept, and so on.

    Args:
        cut: Returns rows `start` to `stop` of a piece.
        most: Rows that may be kept.
        rows: Of a stretch.
        stride: To begin with; where it is known how many rows will come.
    """

    def __init__(
        self,
        cut: Callable[[Piece, int, int], Piece],
        most: int = MOST,
        rows: int = STRETCH,
        stride: int = 1,
    ) -> None:
        self._cut, self._most, self._rows, self._stride = cut, most, rows, stride
        self._kept: dict[int, list[Piece]] = {}  # by number of the stretch
        self.total = 0  # rows that came

    def add(self, piece: Piece, rows: int) -> None:
        """Take what comes next, a piece of so many rows."""
        start = 0
        while start < rows:
            number, begun = divmod(self.total, self._rows)
            stop = min(rows, start + self._rows - begun)
            if number % self._stride == 0:
                self._kept.setdefault(number, []).append(self._cut(piece, start, stop))
            if len(self._kept) * self._rows > self._most:
                self._stride *= 2
                self._kept = {k: v for k, v in self._kept.items() if k % self._stride == 0}
            self.total += stop - start
            start = stop

    @property
    def spread(self) -> int:
        """Rows of which the kept ones are evenly spread stretches; 0 if all are kept."""
        return self.total if self._stride > 1 else 0

    def pieces(self) -> list[Piece]:
        """Return the pieces that are kept, in the order in which they came."""
        return [piece for pieces in self._kept.values() for piece in pieces]

    def note(self) -> str:
        """Say what was kept, where it is not all."""
        if not self.spread:
            return ""
        return (
            f"of {self.total} rows, {len(self._kept)} stretches of {self._rows} were read, evenly "
            "spread; what is said of rows counts these"
        )
