"""The time of a log: which columns, in which unit, read from names and from steps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.columns import (
    COMMANDED,
    SECONDS,
    TIME,
    read_name,
    says_time,
)
from limo_driver.logs.readers.mapping import TimeColumns
from limo_driver.recordings.channels import RATES, unit_of
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.logs.readers.table import LogTable

_SHORT: Final = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
_FIRST: Final = ("time", "t", "timestamp")  # names that stand before all others
_FASTEST: Final = 1e5  # [Hz]
_APART: Final = 0.01  # by which the lengths of two clocks differ where they are two clocks
_FEWEST = 2
_FEWEST_EVEN: Final = 20  # rows
_EVEN: Final = 0.05  # of a step, by which others differ
_OTHER_RATE: Final = 0.1  # of a rate, by which it is another
_SECOND: Final = 1e9  # [ns]
_MUCH_APART: Final = 0.2  # by which another clock differs from a column that is plainly the time
# a rate or a period as people write it: 500 Hz, fs = 500, dt: 2 ms
_HERTZ: Final = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)[ _]?(k?)hz(?![a-z])")
_NAMED_RATE: Final = re.compile(
    r"\b(?:fs|rate|freq|frequency|(?:sampl\w*|log\w*|record\w*)[ _-]?(?:rate|freq\w*))\b"
    r"[^\d\n]{0,12}?[:=]\s*(\d+(?:\.\d+)?(?:e[+-]?\d+)?)\s*(k?)(?:hz)?"
)
_NAMED_PERIOD: Final = re.compile(
    r"\b(?:dt|ts|period|(?:sampl\w*|log\w*|cycle)[ _-]?(?:time|period|step|interval))\b"
    r"[^\d\n]{0,12}?[:=]\s*(\d+(?:\.\d+)?(?:e[+-]?\d+)?)\s*(ms|us|ns|s|)(?![a-z])"
)
_NO_RATE: Final = re.compile(r"cut-?off|filter|low-?pass|bandwidth|motion|sine|chirp|control")
_APART_AS_ANY: Final = 1.0  # of squared steps over variance, from which on no motion leads on
COUNTS: Final = "time: does it count milliseconds, or rows?"
_NEARLY_ALL: Final = (0.01, 0.99)
_PIECES: Final = 20  # of a column, each with steps of its own
_OTHER_UNIT: Final = 100.0  # between steps of two pieces; units are 1000 apart, rates less


@dataclass(frozen=True)
class TimeFound:
    """The columns of the time, and how sure that is."""

    columns: TimeColumns
    why: str
    questions: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """The units, in words; none of a time that was not found."""
        return ", ".join(self.columns.unit) if self.columns.columns else ""


def time_columns(table: LogTable) -> TimeFound:
    """Find the time of a log.

    Args:
        table: What the log holds.

    Raises:
        RecordingError: A column goes on in another unit.
    """
    found = [read_name(name) for name in table.columns]
    names = [n for n in found if n.quantity == TIME and n.rank != COMMANDED]
    counters = {n.unit: n.column for n in names}
    if len(names) == _FEWEST and {"s", "ns"} <= set(counters):
        pair = TimeColumns(columns=(counters["s"], counters["ns"]), unit=("s", "ns"))
        rest = np.asarray(table.columns[counters["ns"]], dtype=np.float64)
        if np.nanmax(rest) < _SECOND:
            return TimeFound(pair, "seconds, and the nanoseconds of each")
    running = [n.column for n in names if says_time(n) and _runs(table.columns[n.column])]
    if not running:
        running = [n.column for n in names if _is_even(table.columns[n.column])]
    if not running:  # an index of dates, as pandas writes it, says what it is by its type
        dates = [name for name, values in table.columns.items() if values.dtype.kind in "mM"]
        running = dates if len(dates) == 1 else []
    if not running:
        lost = [
            f"{name} holds {what}"
            for name, what in table.unread.items()
            if read_name(name).quantity == TIME
        ]
        lost += [f"{n.column} does not go forward" for n in names]
        found_none = f"none was found ({'; '.join(lost)})" if lost else "none was found"
        guess = "".join(f"; it says {rate:g} Hz" for rate in stated_rates(table))
        if even := [name for name, values in table.columns.items() if _is_even(values)]:
            guess = f"; {shortened(even)} goes on in even steps"
        return TimeFound(
            TimeColumns(rate=next(iter(stated_rates(table)), 1.0)),
            "; ".join(lost) or "no column is named like a time",
            (f"time: {found_none}: state `columns:`, or the `rate:` of the rows in Hz{guess}",),
        )
    running.sort(key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    read = {name: _unit_in(table, name) for name in running}
    first = running[0]
    refuse_two_units(table, first)
    unit, why, question = read[first]
    questions = [question] if question else []
    questions += [*_disagreeing(table, first, read), *_at_other_rate(table, first, unit)]
    return TimeFound(TimeColumns(columns=(first,), unit=(unit,)), why, tuple(questions))


def time_in(table: LogTable, name: str) -> TimeFound:
    """Return the time in a column that is known to be it.

    Args:
        table: What the log holds.
        name: Of the column.

    Raises:
        RecordingError: It goes on in another unit.
    """
    refuse_two_units(table, name)
    unit, why, question = _unit_in(table, name)
    questions = (question,) if question else ()
    return TimeFound(TimeColumns(columns=(name,), unit=(unit,)), why, questions)


def refuse_two_units(table: LogTable, name: str) -> None:
    """Refuse a column whose steps become a hundred times another: no unit makes a time of it.

    Args:
        table: What the log holds.
        name: Of the column.

    Raises:
        RecordingError: They do.
    """
    values = table.columns[name]
    if values.dtype.kind in "mM":
        return
    pieces = np.array_split(np.diff(values.astype(np.float64)), _PIECES)
    usual = np.array([np.median(x[x > 0]) if (x > 0).any() else np.nan for x in pieces])
    apart = np.abs(np.log(usual / usual[0])) > np.log(_OTHER_UNIT)
    if apart.any():
        piece = int(apart.argmax())
        row = sum(len(x) for x in pieces[:piece])
        raise RecordingError(
            f"{name} goes in steps of {usual[0]:.3g} at first and of {usual[piece]:.3g} about row "
            f"{row}; expected a time in one unit",
            path=table.source or None,
        )


def _disagreeing(table: LogTable, first: str, read: dict[str, tuple[str, str, str]]) -> list[str]:
    """Return a question where two columns of time tell of different durations."""
    lengths = {name: _length(table.columns[name], unit) for name, (unit, _, _) in read.items()}
    for name, values in table.columns.items():
        if values.dtype.kind in "mM":
            lengths.setdefault(name, _length(values, "s"))
    own, apart = lengths[first], _MUCH_APART if first in _FIRST[:1] else _APART
    if table.received:
        lengths["the time of receipt"] = table.received * own
    other = [
        name
        for name, length in lengths.items()
        if abs(length - own) > (_MUCH_APART if name not in read else apart) * own
    ]
    if not other or not own:
        return []
    ratio = lengths[other[0]] / own
    return [
        f"time: {first} or {other[0]}? their lengths differ: the second runs {ratio:.4g} times as "
        f"far (`factor: {ratio:.4g}` under `time:` takes its speed)"
    ]


def _length(values: NDArray[Any], unit: str) -> float:
    """Return what nearly all of a column of time comes to [s]; single rows may be anywhere."""
    if values.dtype.kind in "mM":
        known = values[~np.isnat(values)]
        numbers = (known - known[:1]) / np.timedelta64(1, "s")
    else:
        numbers = _known(values) * SECONDS[unit]
    return float(np.diff(np.quantile(numbers, _NEARLY_ALL))[0]) if numbers.size else 0.0


def stated_rates(table: LogTable) -> tuple[float, ...]:
    """Return the rates [Hz] that the words of a file state: its comments, single values and name.

    Args:
        table: What the log holds.
    """
    found = list[float]()
    name = re.split(r"[\\/]", table.source)[-1].rpartition(".")[0].replace("_", " ")
    for text in (name, *table.words):
        line = text.lower()
        if _NO_RATE.search(line):
            continue
        for pattern in (_HERTZ, _NAMED_RATE):
            found += [float(x) * (1000.0 if kilo else 1.0) for x, kilo in pattern.findall(line)]
        found += [
            1.0 / (float(x) * SECONDS[unit or "s"])
            for x, unit in _NAMED_PERIOD.findall(line)
            if float(x) > 0
        ]
    return tuple(dict.fromkeys(rate for rate in found if 0 < rate < _FASTEST))


def _at_other_rate(table: LogTable, name: str, unit: str) -> list[str]:
    """Return a question where a format or its words state other rates than the steps make."""
    values = table.columns[name]
    steps = np.diff(_known(values)) if values.dtype.kind not in "mM" else np.zeros(0)
    stated = (table.rate,) if table.rate else stated_rates(table)
    if not stated or not (steps > 0).any():
        return []
    rate = 1.0 / (float(np.median(steps[steps > 0])) * SECONDS[unit])
    if any(abs(rate / each - 1.0) < _OTHER_RATE for each in stated):
        return []
    who = "the format has" if table.rate else "the file speaks of"
    return [
        f"time: {who} {stated[0]:g} rows in a second, and the steps of {name} make "
        f"{rate:.4g}: which is it (`factor: {rate / stated[0]:.4g}` under `time:` is the first)?"
    ]


def _runs(values: NDArray[Any]) -> bool:
    """Say whether most of the steps go forward."""
    if values.dtype.kind in "mM":
        return True
    known = _known(values)
    steps = np.diff(known)
    return bool(steps.size and np.mean(steps >= 0) > 0.5 and np.ptp(known) > 0)  # noqa: PLR2004


def _is_even(values: NDArray[Any]) -> bool:
    """Say whether a column goes on in steps that are all alike."""
    if values.dtype.kind not in "iuf" or values.size < _FEWEST_EVEN:
        return False
    steps = np.diff(values.astype(np.float64))
    return bool(steps[0] > 0 and np.allclose(steps, steps[0], rtol=_EVEN, atol=0.0))


def _known(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the numbers of a column, without those that are none."""
    numbers = values.astype(np.float64)
    return numbers[np.isfinite(numbers)]


def _unit_in(table: LogTable, name: str) -> tuple[str, str, str]:
    """Return unit, reason and question of a column of time, whose unit the format may state."""
    stated = read_name(name).unit
    unit, why, question = _unit(table.columns[name], stated)
    if unit == "ms" and stated not in SECONDS and _holds_poses(table, name):
        asked = (
            f"time: {why} in ms, but from row to row the columns jump as far as between any two "
            "rows, as poses do that are held one after the other: is it in s?"
        )
        return "s", "poses held one after the other", asked
    if not table.clock or question or unit == table.clock:
        return unit, why, question
    asked = f"time: the format has {table.clock}, but {why}: were they stamped at another speed?"
    return table.clock, why, asked


def _holds_poses(table: LogTable, time: str) -> bool:
    """Say whether most columns jump from row to row as far as between any two rows.

    By von Neumann's ratio of squared steps to variance: 2 of rows that have nothing in common, and
    next to nothing of those along a motion.
    """
    ratios = list[float]()
    for name, values in table.columns.items():
        known = _known(values) if name != time and values.dtype.kind == "f" else np.zeros(0)
        if known.size >= _FEWEST_EVEN and (variance := float(known.var())):
            ratios.append(float(np.mean(np.diff(known) ** 2)) / variance)
    return bool(ratios) and float(np.median(ratios)) > _APART_AS_ANY


def _unit(values: NDArray[Any], said: str) -> tuple[str, str, str]:
    """Return unit, reason and question of a column of time."""
    if values.dtype.kind in "mM":
        return "s", "dates", ""
    steps = np.diff(values.astype(np.float64) if values.dtype.kind == "f" else values)
    forward = steps[steps > 0]
    step = float(np.median(forward)) if forward.size else 0.0
    by_step = "s" if step and RATES[0] <= 1 / step <= RATES[1] else None
    by_step = by_step or _SHORT.get(unit_of(step) or "")
    rate = f"{1 / (step * SECONDS[by_step]):.4g} Hz" if by_step else ""
    if said in SECONDS:
        if by_step and by_step != said:
            return (
                by_step,
                f"steps of {step:.4g} are {rate} in {by_step}",
                f"time: the name says {said}, steps of {step:.4g} make {rate} in {by_step}: which?",
            )
        return said, f"the name says so; steps of {step:.4g}", ""
    if by_step is None:
        return "s", f"steps of {step:.4g}", f"time: steps of {step:.4g} are no rate of a log"
    if step == 1.0 and values.dtype.kind in "iu":
        return by_step, "steps of 1", COUNTS
    return by_step, f"steps of {step:.4g} are {rate}", ""
