"""NumPy's .npz, also of arrays that are longer than memory should hold: rows in a stream."""

from __future__ import annotations

import zipfile
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib import format as npy

from limo_driver.errors import RecordingError
from limo_driver.foreign.table import LogTable, table_of
from limo_driver.recordings.batches import BLOCK
from limo_driver.recordings.stretches import MOST, Stretches

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

_KIND: Final = "NumPy arrays"
_MATRIX: Final = 2  # axes
_DAMAGE: Final = (OSError, ValueError, zipfile.BadZipFile, EOFError)


def read_npz(path: Path) -> LogTable:
    """Read the arrays of a file, or stretches of those that are long.

    Raises:
        RecordingError: It is none, or damaged.
    """
    if rows_of_npz(path) <= MOST:
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files if archive[name].ndim}
        except _DAMAGE as error:
            raise _unreadable(path, error) from None
        return table_of(arrays, str(path), _KIND)
    stretches = Stretches[LogTable](LogTable.cut)
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
    try:
        with zipfile.ZipFile(path) as archive, ExitStack() as opened:
            members = [_Member(archive, name, opened) for name in archive.namelist()]
            return _usual_rows(members)
    except _DAMAGE as error:
        raise _unreadable(path, error) from None


def npz_blocks(path: Path) -> Iterator[LogTable]:
    """Yield the arrays of a file, block by block of their rows.

    Raises:
        RecordingError: It is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive, ExitStack() as opened:
            members = [_Member(archive, name, opened) for name in archive.namelist()]
            rows = _usual_rows(members)
            alike = [member for member in members if member.rows == rows]
            for start in range(0, rows, BLOCK):
                many = min(BLOCK, rows - start)
                arrays = {member.name: member.read(many) for member in alike}
                yield replace(table_of(arrays, str(path), _KIND), first_row=start)
    except _DAMAGE as error:
        raise _unreadable(path, error) from None


class _Member:
    """One array of an archive, read from its first row on."""

    def __init__(self, archive: zipfile.ZipFile, name: str, opened: ExitStack) -> None:
        self.name = name.removesuffix(".npy")
        self._file: IO[bytes] = opened.enter_context(archive.open(name))
        version = npy.read_magic(self._file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        self._shape, by_columns, self._kind = read(self._file)
        usable = len(self._shape) in {1, _MATRIX} and not self._kind.hasobject
        self.rows = self._shape[0] if usable else 0
        self._whole = None
        self._by_columns = by_columns and len(self._shape) == _MATRIX
        self._next = 0

    def read(self, rows: int) -> NDArray[Any]:
        if self._by_columns:  # no row of it is there before all of it is
            if self._whole is None:
                data = self._file.read()
                self._whole = np.frombuffer(data, self._kind).reshape(self._shape, order="F")
            self._next += rows
            return self._whole[self._next - rows : self._next]
        size = rows * int(np.prod(self._shape[1:])) * self._kind.itemsize
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError(f"{self.name} ends before its last row")
        return np.frombuffer(data, self._kind).reshape(rows, *self._shape[1:])


def _usual_rows(members: list[_Member]) -> int:
    lengths = [member.rows for member in members if member.rows]
    return max(lengths, key=lengths.count, default=0)


def _unreadable(path: Path, error: Exception) -> RecordingError:
    return RecordingError(f"cannot be read as .npz: {error}", path=path)
