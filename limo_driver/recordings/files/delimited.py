"""Delimited text with any separator: the dialect is read off its first lines, rows in a stream."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

import gzip
import math
import re
import zlib
from codecs import getincrementaldecoder
from collections.abc import Collection, Iterator
from csv import reader
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
from pyarrow import csv

from limo_driver.errors import RecordingError
from limo_driver.recordings.files.batches import (
    LONG_TEXT,
    Kept,
    blocks_of,
    is_packed,
    kept_of,
    text_batches,
    text_source,
)
from limo_driver.runtime.display import shortened

_HEAD = 65536  # bytes that are looked at
_LINES = 20
_SELDOM = 50  # rows of which one may have another number of cells
_FEW = 1000  # such rows that are counted for sure
_TITLES = 200  # lines among which the rows begin
_SEPARATORS = (",", ";", "\t", "|", " ")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|nan|inf|-inf", re.IGNORECASE)
_CLOCK = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?|\d{4}-\d\d-\d\d[T ]\d\d:.*")
_USUAL, _WINDOWS = "utf-8-sig", "cp1252"
_MARKED = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # by the first bytes
_UNWRITTEN = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")  # what no text has
# cells without a value; Python writes None
_EMPTY = (*csv.ConvertOptions().null_values, "None", " ")
_DAMAGE = (OSError, EOFError, zlib.error, pa.ArrowException, UnicodeDecodeError)
_COMMAS = "; decimal commas need quotes, or another separator"
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


class Dialect(NamedTuple):
    """How a file of delimited text is written."""

    separator: str
    skipped: int  # lines before the names: comments, empty ones
    names: tuple[str, ...]  # of the columns; made up where the file has none
    named: bool  # whether the first line has the names
    decimal: str  # point or comma
    encoding: str  # of the text, as Python names it
    told: int = 0  # lines of words above the names
    units: bool = False  # whether a line of units stands below the names
    above: tuple[str, ...] = ()  # lines above the names
    aligned: bool = False  # whether several blanks stand between cells, or some before the first


def tables_in(path: Path, units: Collection[str] = ()) -> list[tuple[int, str]]:
    """Return the line and the names of each table in a text that is not long.

    Args:
        path: The file.
        units: As they are written, in lower case.

    Raises:
        RecordingError: No file, no text, or nothing in it.
    """
    dialect = dialect_of(path, units)
    if is_packed(path) or path.stat().st_size > LONG_TEXT:
        return []
    lines = path.read_text(dialect.encoding, errors="replace").splitlines()
    found, above = list[tuple[int, str]](), (0, [""])
    for number, line in enumerate(lines, 1):
        cells = _cells(line, dialect.separator)
        if _is_row(cells) and len(above[1]) > 1 and not any(map(_is_value, above[1])):
            found.append((above[0], shortened([cell for cell in above[1] if cell])))
        if line.strip() and not _is_of_units(cells, units):
            above = (number, cells)
    return found


class DelimitedText:
    """A file of delimited text, whose rows are read once.

    Args:
        path: The file.
        units: As a line of them below the names may write them, in lower case.

    Raises:
        RecordingError: No file, no text, or nothing in it.
    """

    def __init__(self, path: Path, units: Collection[str] = ()) -> None:
        self._path, self.dialect = path, dialect_of(path, units)
        self._rows, self._cut, self._widest = 0, list[str](), 0
        # More rows of another length than are left out of as many as there can be.
        rows = path.stat().st_size // (2 * len(self.dialect.names))
        self._most = math.inf if is_packed(path) else max(_FEW, rows // _SELDOM)

    def kept(self) -> Kept:
        """Return all rows, or stretches of them where they are many.

        Raises:
            RecordingError: They cannot be read, or many have another number of cells.
        """
        try:
            if is_packed(self._path) or self._path.stat().st_size > LONG_TEXT:
                kept = kept_of(*self._batches())
            else:
                source = text_source(self._path, aligned=self.dialect.aligned)
                kept = Kept(csv.read_csv(source, *self._options()))
        except _DAMAGE as error:
            raise self._unreadable(error) from None
        self._rows = kept.spread or kept.table.num_rows
        self._check_cut()
        return kept

    def blocks(self) -> Iterator[pa.Table]:
        """Yield all rows, block by block.

        Raises:
            RecordingError: They cannot be read, or many have another number of cells.
        """
        try:
            for table in blocks_of(*self._batches()):
                self._rows += table.num_rows
                yield table
        except _DAMAGE as error:
            raise self._unreadable(error) from None
        self._check_cut()

    def notes(self) -> tuple[str, ...]:
        """Say what has to be said of the rows that were read."""
        notes = list[str]()
        if told := self.dialect.told:
            notes.append(f"{told} line{'s' * (told > 1)} above the names left aside")
        if self.dialect.units:
            notes.append("the line below the names has their units")
        if not self.dialect.named:
            notes.append("it has no line of names; columns are counted from 1")
        if self.dialect.encoding == _WINDOWS:
            notes.append("it is not UTF-8; its text is taken for that of Windows (cp1252)")
        if cut := self._cut:
            rows = "1 row" if len(cut) == 1 else f"{len(cut)} rows"
            notes.append(
                f"{rows} left out: another number of cells than the {len(self.dialect.names)} of "
                f"the first line{cut[0]}"
            )
        return tuple(notes)

    def _batches(self) -> tuple[Iterator[pa.RecordBatch], pa.Schema]:
        batches = text_batches(self._path, *self._options(), aligned=self.dialect.aligned)
        self._cut.clear()  # of the look at the first rows
        return batches

    def _options(self) -> tuple[csv.ReadOptions, csv.ParseOptions, csv.ConvertOptions]:
        dialect = self.dialect
        return (
            csv.ReadOptions(
                column_names=list(dialect.names),
                skip_rows=dialect.skipped + dialect.named + dialect.units,
                encoding=dialect.encoding,
            ),
            csv.ParseOptions(
                delimiter=dialect.separator,
                ignore_empty_lines=True,
                invalid_row_handler=self._leave_out,
            ),
            csv.ConvertOptions(
                decimal_point=dialect.decimal, strings_can_be_null=True, null_values=_EMPTY
            ),
        )

    def _leave_out(self, row: Any) -> str:  # noqa: ANN401  # pyarrow has no types
        # pyarrow counts no rows where it reads in parallel
        self._widest = max(self._widest, row.actual_columns)
        self._cut.append("" if row.number is None else f" (row {row.number})")
        return "error" if len(self._cut) > self._most else "skip"

    def _check_cut(self) -> None:
        if len(self._cut) > max(1, self._rows // _SELDOM):
            raise self._ragged()

    def _ragged(self) -> RecordingError:
        expected = len(self.dialect.names)
        return RecordingError(
            f"has {len(self._cut)} rows with another number of cells, expected {expected} as "
            f"in its first line{_COMMAS if self._widest >= 2 * expected - 1 else ''}",
            path=self._path,
        )

    def _unreadable(self, error: Exception) -> RecordingError:
        if len(self._cut) > self._most:
            return self._ragged()
        reason = str(error).splitlines()[0]
        if reason.startswith("Could not skip initial"):  # the names, which pyarrow is told
            reason = "it ends in its first line"
        return RecordingError(f"cannot be read as delimited text: {reason}", path=self._path)


def dialect_of(path: Path, units: Collection[str] = ()) -> Dialect:
    """Read off the first lines how a file is written.

    Args:
        path: The file.
        units: As a line of them below the names may write them, in lower case.

    Raises:
        RecordingError: No file, no text, or nothing in it.
    """
    text, encoding = _first_lines(path)
    lines = text.splitlines()[:_TITLES]
    skipped = 0
    while skipped < len(lines) and _is_comment(lines, skipped):
        skipped += 1
    told = _lines_above(lines[skipped:], units)
    skipped += told
    above = tuple(line.strip() for line in lines[:skipped] if line.strip())
    lines = [line for line in lines[skipped:] if line.strip()][: _LINES + 5]
    if not lines:
        raise RecordingError("holds no rows", path=path)
    lines[0] = lines[0].lstrip("#%/ ")  # names may stand in a comment
    separator = _separator_of(lines)
    first = _cells(lines[0], separator)
    named = not all(map(_is_number, filter(None, first)))
    stated = _units_below(lines, separator, units) if named else ()
    rows = lines[1 + bool(stated) :] or lines
    below = [_cells(row, separator) for row in rows]
    decimal = "," if any(_DECIMAL_COMMA.fullmatch(x) for row in below for x in row) else "."
    if all(_is_as_wide(row, first) and len(row) > len(first) for row in below):
        first = [*first, ""]  # rows end in a separator; what stands behind it may yet be a value
    elif below and not first[-1] and all(len(row) == len(first) - 1 for row in below):
        first = first[:-1]  # the names alone end in a separator
    names = first if named else [""] * len(first)
    names = [name or f"column_{k + 1}" for k, name in enumerate(names)]
    if stated:
        pairs = zip(names, stated, strict=False)
        named_units = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
        names = [*named_units, *names[len(named_units) :]]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise RecordingError(
            f"has more than one column {shortened(repeated)}; expected names that differ, in one "
            "line, without blanks where these separate the cells",
            path=path,
        )
    aligned = separator == " " and any("  " in line or line[:1].isspace() for line in lines)
    return Dialect(
        *(separator, skipped, tuple(names), named, decimal, encoding, told, bool(stated)),
        *(above, aligned),
    )


def _separator_of(lines: list[str]) -> str:
    rows = lines[1:] or lines
    return max(_SEPARATORS, key=lambda each: _regularity(each, lines[0], rows))


def _lines_above(lines: list[str], units: Collection[str]) -> int:
    """Return how many lines of words stand above the names, empty ones among them.

    There are some where rows of numbers begin farther down, behind a line of names with as many
    cells as they have.
    """
    filled = [k for k, line in enumerate(lines) if line.strip()]
    for separator in _SEPARATORS:
        cells = {k: _cells(lines[k], separator) for k in filled}
        is_row = [len(cells[k]) > 1 and _is_row(cells[k]) for k in filled]
        if True not in is_row[: len(is_row) // 2 + 1]:
            continue
        first = is_row.index(True)
        rows = [len(cells[k]) for k in filled[first:]]
        row = cells[filled[first]]
        names_of = (k for k in filled[:first] if _is_as_wide(row, cells[k]))
        above = [k for k in names_of if not _is_row(cells[k])]
        if not above or rows.count(len(row)) <= len(rows) // 2:
            continue
        names = above[0]
        if len(above) > 1 and not _is_of_units(cells[above[1]], units):  # a title of as many cells
            names = above[-1]
        return names
    return 0


def _is_row(cells: list[str]) -> bool:
    """Say whether most of the cells that are filled hold numbers."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and sum(map(_is_value, filled)) > len(filled) / 2


def _is_value(cell: str) -> bool:
    return _is_number(cell) or bool(_CLOCK.fullmatch(cell))


def _units_below(lines: list[str], separator: str, units: Collection[str]) -> tuple[str, ...]:
    """Return what a line of units below the names says of each column; nothing if there is none."""
    below = _cells(lines[1], separator) if len(lines) > 1 else []
    if not _is_as_wide(below, _cells(lines[0], separator)) or not _is_of_units(below, units):
        return ()
    return tuple(_bare(cell) for cell in below)


def _is_as_wide(row: list[str], names: list[str]) -> bool:
    """Say whether a row has a cell for each name; it may end in a separator that they lack."""
    return len(row) == len(names) or (len(row) == len(names) + 1 and not row[-1])


def _is_of_units(cells: list[str], units: Collection[str]) -> bool:
    """Say whether all cells are no numbers, and most of those that are filled are units."""
    filled = [_bare(cell) for cell in cells if _bare(cell)]
    known = sum(cell.lower() in units for cell in filled)
    return bool(filled) and not any(map(_is_value, filled)) and known > len(filled) / 2


def _bare(cell: str) -> str:
    """Return a unit without brackets; nothing for a sign that there is none."""
    bare = cell.strip("[](){}<> ")
    return "" if bare in {"-", "--", "1", "none"} else bare


def _first_lines(path: Path) -> tuple[str, str]:
    """Return the first lines of a text, and its encoding.

    Raises:
        RecordingError: It cannot be read, or is no text.
    """
    try:
        with gzip.open(path) if is_packed(path) else path.open("rb") as file:
            head = file.read(_HEAD)
            more = bool(file.read(1))
    except _DAMAGE as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(f"cannot be read: {reason}", path=path) from None
    if more and b"\n" not in head:
        raise RecordingError(f"has a first line of more than {_HEAD} bytes", path=path)
    by_mark = next((name for mark, name in _MARKED.items() if head.startswith(mark)), None)
    for encoding in (by_mark,) if by_mark else (_USUAL, _WINDOWS):
        try:
            text = getincrementaldecoder(encoding)().decode(head, final=not more)
        except UnicodeDecodeError:
            continue
        if not _UNWRITTEN.search(text):
            return (text[: text.rfind("\n") + 1] if more else text), encoding
    raise RecordingError("is no text", path=path)


def _is_comment(lines: list[str], k: int) -> bool:
    """Say whether a line is a comment; the last one before numbers may be the names."""
    line = lines[k].strip()
    if not line:
        return True
    if not line.startswith(("#", "%", "//")):
        return False
    after = lines[k + 1].strip() if k + 1 < len(lines) else ""
    words = line.lstrip("#%/ ")
    is_names = any(
        len(_cells(words, each)) == len(_cells(after, each)) > 1
        and not any(map(_is_value, _cells(words, each)))
        and sum(map(_is_number, _cells(after, each))) > len(_cells(after, each)) / 2
        for each in _SEPARATORS
    )
    return not is_names


def _regularity(separator: str, first: str, rows: list[str]) -> tuple[int, int]:
    """Return how many lines a separator cuts into as many cells, and how many cells those are."""
    names = _cells(first, separator)
    alike = sum(_is_as_wide(_cells(row, separator), names) for row in rows)
    return (alike if len(names) > 1 else -1, len(names))


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = " ".join(line.split())
    if '"' in line:
        (cells,) = reader([line.strip()], delimiter=separator, skipinitialspace=True)
    else:
        cells = line.rstrip("\r\n").split(separator)
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell) or _DECIMAL_COMMA.fullmatch(cell))
