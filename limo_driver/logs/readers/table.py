"""LogTable: what a log holds, as named columns of numbers, and where its time stands."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import ConfigError, ParameterError, RecordingError
from limo_driver.logs.readers.columns import SECONDS, WRITTEN, read_name
from limo_driver.recordings.channels import BEYOND, seconds
from limo_driver.runtime.display import shortened
from limo_driver.runtime.parameters import Declared, parameter, shown
from limo_driver.types import FloatArray

_MATRIX: Final = 2  # dimensions
_MOST_COLUMNS: Final = 4096  # of a log; images have more


@dataclass(frozen=True)
class LogTable:
    """Named columns of T rows.

    Args:
        columns: Numbers or dates, (T,) each, by name; NaN where a cell is empty.
        source: File or folder that they are from, for messages.
        kind: What it is, in words, such as `CSV`.
        unread: Columns that hold no numbers, by name, and what they hold.
        notes: What a user should know of how it was read.
        robot: Name of the robot, where the file says it.
        spread: Rows of a long log of which these are evenly spread stretches; 0 if they are all.
        first_row: Row of the log that is the first here, where it is read block by block.
        is_si: Whether its format is defined in SI units, which count where values fit others, too.
        clock: Unit of its times, where the format states it, such as `ns`.
        rate: Rows in a second [Hz], where the format states it; 0 where it does not.
        words: What else the file says of itself: comments, and single values with their names.
        received: Seconds by the clock of receipt that pass in one of the stamps; 0 where there is
            no such clock.
    """

    columns: Mapping[str, NDArray[Any]]
    source: str = ""
    kind: str = "arrays"
    unread: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    robot: str = ""
    spread: int = 0
    first_row: int = 0
    is_si: bool = False
    clock: str = ""
    rate: float = 0.0
    words: tuple[str, ...] = ()
    received: float = 0.0

    @property
    def rows(self) -> int:
        """Number of rows."""
        return next((values.size for values in self.columns.values()), 0)

    def __post_init__(self) -> None:
        sizes = {name: values.size for name, values in self.columns.items()}
        if len(sizes) > _MOST_COLUMNS:
            raise RecordingError(
                f"has {len(sizes)} columns, expected at most {_MOST_COLUMNS}",
                path=self.source or None,
            )
        if len(set(sizes.values())) > 1:
            usual = max(sizes.values(), key=list(sizes.values()).count)
            odd = next(name for name, size in sizes.items() if size != usual)
            raise RecordingError(
                f"{odd} has {sizes[odd]} rows, the others {usual}; expected columns of one length",
                path=self.source or None,
            )

        self._take_out_markers()

    def _take_out_markers(self) -> None:
        """Take numbers that nothing measures for none: the largest double, or broken bytes."""
        beyond = {
            name: np.isfinite(values) & (np.abs(values) > BEYOND)
            for name, values in self.columns.items()
            if values.dtype == np.float64
        }
        found = {name: marked for name, marked in beyond.items() if marked.any()}
        if found:
            kept = {name: np.where(found[name], np.nan, self.columns[name]) for name in found}
            more = (
                f"{name} has {np.count_nonzero(marked)} numbers beyond {BEYOND:g}, read as none"
                for name, marked in found.items()
            )
            object.__setattr__(self, "columns", {**self.columns, **kept})
            object.__setattr__(self, "notes", (*self.notes, *more))

    def first(self, rows: int) -> LogTable:
        """Return the first rows, which share their memory with this table."""
        return replace(self, columns={name: values[:rows] for name, values in self.columns.items()})

    def cut(self, start: int, stop: int) -> LogTable:
        """Return a copy of the rows from `start` to `stop`."""
        own = {name: values[start:stop].copy() for name, values in self.columns.items()}
        return replace(self, columns=own, first_row=self.first_row + start)

    def only(self, patterns: Sequence[str], beside: Collection[str] = ()) -> LogTable:
        """Return the table with the columns that match, and those beside them.

        Args:
            patterns: Such as `left_*`, of the whole name of a column or of a part between dots and
                brackets.
            beside: Names of columns that are kept in any case.

        Raises:
            RecordingError: No column matches one of them.
        """
        kept = set(beside)
        for pattern in patterns:
            found = {name for name in self.columns if _matches(name, pattern)}
            if not found:
                raise RecordingError(
                    f"`columns`: none matches {pattern!r}; it has {shortened(list(self.columns))}",
                    path=self.source or None,
                )
            kept |= found
        columns = {name: values for name, values in self.columns.items() if name in kept}
        return replace(self, columns=columns)

    def without_empty(self) -> LogTable:
        """Return the table without columns that have no number in any row; they are unread."""
        empty = [
            name
            for name, values in self.columns.items()
            if values.dtype.kind == "f" and values.size and not np.isfinite(values).any()
        ]
        kept = {name: values for name, values in self.columns.items() if name not in empty}
        unread = {**self.unread, **dict.fromkeys(empty, "no number")}
        return replace(self, columns=kept, unread=unread) if empty else self

    def lost(self, *quantities: str, joints: Sequence[str] = ()) -> list[str]:
        """Say what unread columns hold whose names say one of these quantities."""
        every = self.unread.items()
        return [
            f"{name} holds {held}"
            for name, held in every
            if read_name(name, joints).quantity in quantities
        ]

    def column(self, name: str) -> NDArray[Any]:
        """Return a column.

        Raises:
            RecordingError: There is none of this name that holds numbers.
        """
        if name in self.columns:
            return self.columns[name]
        what = f"has no column {name!r}; it has {shortened(list(self.columns))}"
        if name in self.unread:
            what = f"column {name} holds {self.unread[name]}, expected numbers"
        raise RecordingError(what, path=self.source or None)


def _matches(name: str, pattern: str) -> bool:
    return any(fnmatchcase(part, pattern) for part in (name, *re.split(r"[.\[\]]", name)))


def table_of(
    arrays: Mapping[str, Any], source: str = "", kind: str = "arrays", rows: int | None = None
) -> LogTable:
    """Make a table of arrays: (T,) is a column, (T, k) columns `name[0]` to `name[k-1]`.

    Where one array is of k texts, those name the k columns instead, as `name[elbow]`.

    Args:
        arrays: By name. What is no array of numbers, or has another number of rows than most, is
            named as unread.
        source: Where they are from, for messages.
        kind: What that is, in words.
        rows: That columns have; as many as most arrays if not given.
    """
    columns, unread, told = dict[str, "NDArray[Any]"](), dict[str, str](), dict[str, str]()
    given = {name: np.asarray(values) for name, values in arrays.items()}
    numbers = {name: values for name, values in given.items() if values.dtype.kind in "fiumM"}
    lengths = [len(values) for values in numbers.values() if values.ndim in {1, 2}]
    usual = rows or max(lengths, key=lengths.count, default=0)
    labels = {name: found for name, x in given.items() if (found := _labels(x))}
    for name, values in given.items():
        if name not in numbers:
            unread[name] = f"{values.dtype} values"
        elif values.ndim not in {1, 2} or len(values) != usual:
            unread[name] = said_of_shape(values.shape, usual)
        elif values.ndim == 1:
            columns[name] = values
        else:
            by, named = _names_of(values.shape[1], labels)
            told |= {by: name} if by else {}
            columns |= {f"{name}[{label}]": values[:, k] for k, label in enumerate(named)}
    unread = {name: held for name, held in unread.items() if name not in told}
    notes = tuple(f"{name} names the columns of arrays as wide" for name in told)
    return LogTable(columns, source, kind, unread, notes)


def said_of_shape(shape: tuple[int, ...], rows: int) -> str:
    """Say what an array is that has another number of rows than most."""
    if len(shape) == _MATRIX and shape[1] == rows:
        return f"an array of shape {shape}, expected {shape[::-1]}: a row is a sample"
    other = len(shape) in {1, _MATRIX} and shape[0] != rows
    return f"an array of shape {shape}" + (f" beside {rows} rows" if other else "")


def _labels(values: NDArray[Any]) -> tuple[str, ...]:
    """Return the texts of an array that may name columns; none of any other."""
    if values.ndim != 1 or values.dtype.kind not in "USO" or not 0 < values.size <= _MOST_COLUMNS:
        return ()
    texts = [x.decode(errors="replace") if isinstance(x, bytes) else x for x in values.tolist()]
    named = all(isinstance(x, str) and x.strip() for x in texts)
    return tuple(x.strip() for x in texts) if named and len(set(texts)) == len(texts) else ()


def _names_of(
    width: int, labels: Mapping[str, tuple[str, ...]]
) -> tuple[str, tuple[str | int, ...]]:
    """Return names of the columns of an array, and of the one array of texts that has them."""
    alike = [(name, texts) for name, texts in labels.items() if len(texts) == width]
    return alike[0] if len(alike) == 1 else ("", tuple(range(width)))


@dataclass(frozen=True, kw_only=True)
class TimeColumns(Declared):
    """Where the time stands: one column, or two that count seconds and the rest of them.

    Args:
        columns: Names of the columns.
        unit: Of each column.
        rate: Of rows that have no time.
        factor: Seconds that passed in one of the log.
    """

    columns: tuple[str, ...] = parameter("", default=())
    unit: tuple[str, ...] = parameter("", default=("s",))
    rate: float | None = parameter("Hz", lower=0.0, above=True, default=None)
    factor: float = parameter("1", lower=0.0, above=True, default=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "unit", units_of(self.unit, SECONDS))
        if not self.columns and self.rate is None:
            raise ConfigError("time: has neither `columns:` nor a `rate:`")
        if self.columns:
            self._same_length("columns", "unit")

    def origin(self, table: LogTable) -> tuple[Any, ...]:
        """Return what each column has where time is 0: its first value that is known."""
        return tuple(_first_known(table.column(name)) for name in self.columns)

    def read(
        self, table: LogTable, origin: tuple[Any, ...] | None = None
    ) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the time (T,) [s] since an origin, and what has to be said of it.

        Args:
            table: Of the log, or of a block of it.
            origin: Of the log; that of the table if not given.
        """
        if not self.columns:
            return (table.first_row + np.arange(table.rows)) / float(self.rate or 1.0), ()
        total, told = np.zeros(table.rows), list[str]()
        origin = self.origin(table) if origin is None else origin
        for name, unit, first in zip(self.columns, self.unit, origin, strict=True):
            values = table.column(name)
            if values.dtype.kind in "mM":
                shift = float((_first_known(values) - first) / np.timedelta64(1, "s"))
                since, said = seconds(values)
                since = since + shift
                told.append(said)
            elif values.dtype.kind in "iu":  # exact, before the digits of a date are lost
                since = (values - first).astype(np.int64) * SECONDS[unit]
            else:
                since = (values - first) * SECONDS[unit]
            total += since
        return self.factor * total, tuple(told)


def _first_known(values: NDArray[Any]) -> Any:  # noqa: ANN401  # a number or a date
    known = ~np.isnat(values) if values.dtype.kind in "mM" else np.isfinite(values)
    return values[known.argmax()] if known.any() else values.dtype.type(0)


def units_of(given: Iterable[str], known: Iterable[str]) -> tuple[str, ...]:
    """Return units as limo writes them: N m for Nm, N*m and N·m."""
    every, found = tuple(known), list[str]()
    for unit in given:
        own = unit if unit in every else WRITTEN.get(unit.lower(), unit)
        if own not in every:
            raise ParameterError("unit", shown(unit), f"one of {', '.join(every)}")
        found.append(own)
    return tuple(found)
