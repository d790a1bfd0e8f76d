"""NumPy's .npz, also of arrays that are longer than memory should hold: rows in a stream."""

from __future__ import annotations

import math
import sys
import zipfile
import zlib
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from tokenize import TokenError
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib import format as npy

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.table import LogTable, said_of_shape, table_of
from limo_driver.recordings.files.batches import BLOCK
from limo_driver.recordings.files.stretches import STRETCH, Stretches, most_rows
from limo_driver.runtime.given_files import Spent

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

_KIND: Final = "NumPy arrays"
_MATRIX: Final = 2  # axes
_WIDEST: Final = 1 << 15  # bytes of a row: 4096 numbers, as images have and no joints
_DAMAGE: Final = (
    OSError,
    ValueError,
    zipfile.BadZipFile,
    EOFError,
    TokenError,  # of a header that goes on
    SyntaxError,
    RecursionError,
    RuntimeError,  # packed with a password
    NotImplementedError,  # packed as few programs do
    TypeError,  # a type of numbers that is none
    zlib.error,
)


def read_npz(path: Path) -> LogTable:
    """Read the arrays of a file, or stretches of those that are long.

    Raises:
        RecordingError: It is none, or damaged.
    """
    with _opened(path) as members:
        rows = _usual_rows(members)
        most = most_rows(sum(member.width for member in members if member.rows == rows))
        if rows <= most:
            arrays = {member.name: member.read(rows) for member in members if member.rows == rows}
            labels = {member.name: member.labels() for member in members if member.is_labels}
            aside = {
                member.name: member.said(rows) if member.shape else ""
                for member in members
                if member.rows != rows and not member.is_labels
            }
            table = table_of({**arrays, **labels} if rows else {}, str(path), _KIND)
            return replace(table, unread={**table.unread, **{k: v for k, v in aside.items() if v}})
    stretches = Stretches[LogTable](LogTable.cut, most, min(STRETCH, most))
    first: LogTable | None = None
    for block in npz_blocks(path):
        first = first or block
        stretches.add(block, block.rows)
    assert first is not None  # noqa: S101  # it has more rows than none
    pieces = stretches.pieces()
    columns = {
        name: np.concatenate([piece.columns[name] for piece in pieces]) for name in first.columns
    }
    return replace(first, columns=columns, spread=stretches.spread, notes=(stretches.note(),))


def rows_of_npz(path: Path) -> int:
    """Return how many rows most of the arrays have.

    Raises:
        RecordingError: It is none, or damaged.
    """
    with _opened(path) as members:
        return _usual_rows(members)


def npz_blocks(path: Path) -> Iterator[LogTable]:
    """Yield the arrays of a file, block by block of their rows.

    Raises:
        RecordingError: It is damaged.
    """
    with _opened(path) as members:
        rows = _usual_rows(members)
        alike = [member for member in members if member.rows == rows]
        labels = {member.name: member.labels() for member in members if member.is_labels}
        for start in range(0, rows, BLOCK):
            many = min(BLOCK, rows - start)
            arrays = {member.name: member.read(many) for member in alike}
            yield replace(table_of({**arrays, **labels}, str(path), _KIND), first_row=start)


@contextmanager
def _opened(path: Path) -> Generator[list[_Member]]:
    """Open the arrays of a file; of each, its header is read.

    Raises:
        RecordingError: It is none, damaged, or unpacks to far more than a log does.
    """
    try:
        with zipfile.ZipFile(path) as archive, ExitStack() as opened:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            Spent(path, RecordingError).take(unpacked=unpacked)
            yield [_Member(archive, name, opened) for name in archive.namelist()]
    except RecordingError:  # which is a ValueError, too
        raise
    except _DAMAGE as error:
        raise RecordingError(f"cannot be read as .npz: {error}", path=path) from None


class _Member:
    """One array of an archive, read from its first row on."""

    def __init__(self, archive: zipfile.ZipFile, name: str, opened: ExitStack) -> None:
        self.name = name.removesuffix(".npy")
        self._file: IO[bytes] = opened.enter_context(archive.open(name))
        version = npy.read_magic(self._file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        self.shape, by_columns, self._kind = read(self._file)
        usable = len(self.shape) in {1, _MATRIX} and not self._kind.hasobject
        few = len(self.shape) == 1 and self._size(self.shape[0]) <= _WIDEST
        self.is_labels = few and self._kind.kind in "US"  # which may name columns, and are none
        usable = usable and self._kind.kind not in "US"
        self.width = self._size(1)  # of a row [bytes]
        self.rows = self.shape[0] if usable and 0 < self.width <= _WIDEST else 0
        self._whole = None
        self._by_columns = by_columns and len(self.shape) == _MATRIX
        self._next = 0

    def said(self, rows: int) -> str:
        """Say what it is instead of rows of numbers, as many as most have."""
        if self._kind.hasobject:
            return "objects of Python"
        if self._kind.kind in "US":
            return "texts"
        return said_of_shape(self.shape, rows)

    def labels(self) -> NDArray[Any]:
        texts = self._from_bytes(self.shape[0])
        if self._kind.kind == "U" and (texts.view(np.uint32) > sys.maxunicode).any():
            raise ValueError(f"{self.name} holds texts of characters that there are not")
        return texts

    def read(self, rows: int) -> NDArray[Any]:
        if self._by_columns:  # no row of it is there before all of it is
            if self._whole is None:
                data = self._file.read()
                self._whole = np.frombuffer(data, self._kind).reshape(self.shape, order="F")
            self._next += rows
            return self._whole[self._next - rows : self._next]
        return self._from_bytes(rows)

    def _from_bytes(self, rows: int) -> NDArray[Any]:
        size = self._size(rows)
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError(f"{self.name} ends before its last row")
        return np.frombuffer(data, self._kind).reshape(rows, *self.shape[1:])

    def _size(self, rows: int) -> int:
        return rows * math.prod(self.shape[1:]) * self._kind.itemsize


def _usual_rows(members: list[_Member]) -> int:
    lengths = [member.rows for member in members if member.rows]
    return max(lengths, key=lengths.count, default=0)
