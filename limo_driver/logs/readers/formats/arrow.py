"""Tables of pyarrow as tables of numbers: lists become columns, dates stay dates."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.columns import TIME, WRITTEN, read_name, words_of
from limo_driver.logs.readers.table import LogTable
from limo_driver.recordings.files.batches import FEW, Kept, kept_of
from limo_driver.recordings.files.delimited import DelimitedText, tables_in
from limo_driver.recordings.files.parquet import parquet_rows, reading_parquet
from limo_driver.types import IntArray

# pyarrow ships no type stubs, so its columns are unknown to the checker.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
_FORM: Final = r"^\s*(?P<h>\d{1,3}):(?P<m>[0-5]\d)(?::(?P<s>[0-5]?\d)(?:[.,](?P<f>\d{1,9}))?)?\s*$"
# as `rostopic echo -p` writes them: field.name0, field.position0
_NAMED: Final = re.compile(r"(?P<of>.*?)name\[?(?P<number>\d+)\]?")
_NUMBERED: Final = re.compile(r"(?P<of>.*?)(?P<what>[A-Za-z_]+)\[?(?P<number>\d+)\]?")
_NAMES: Final = (("name",), ("names",))
_SECONDS: Final = {"h": 3600, "m": 60, "s": 1}
_SECOND: Final = 1_000_000_000  # [ns]
_DAY: Final = 86_400 * _SECOND  # [ns]
_DIGITS: Final = 9  # of a fraction in nanoseconds


def numbers_of(
    table: pa.Table, source: str, kind: str, names: Mapping[str, Sequence[str]] | None = None
) -> LogTable:
    """Return the columns of numbers; `state.position` is the field of a structure.

    Args:
        table: Of pyarrow. Lists of texts name the entries of lists of numbers as long beside them,
            in the order of each row, and texts numbered `name0` the columns with their number.
        source: File that it is from.
        kind: What that is, in words.
        names: Of the entries of columns of lists, by column.

    Raises:
        RecordingError: A column of numbers has text in a few of its cells: the file is damaged. Or
            names of columns become others.
    """
    columns, unread = dict[str, "NDArray[Any]"](), dict[str, str]()
    table = _without_structures(table)
    labels = _labels_in(table)
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind_of = column.type
        if name in labels.columns:
            continue
        if _is_list(kind_of):
            found = _entries(column)
            if found is None:
                unread[name] = _said_of_list(column)
                continue
            place = (name.rpartition(".")[0], found.shape[1])
            own = (names or {}).get(name) or labels.entries.get(place, ())
            named = own if len(own) == found.shape[1] else range(found.shape[1])
            if name not in (names or {}) and (order := labels.orders.get(place)) is not None:
                if isinstance(order, str):
                    raise RecordingError(order, path=source)
                found = np.take_along_axis(found, order, axis=1)
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
    texts = {name: table.column(name) for name in unread if _NAMED.fullmatch(name)}
    if labelled := _by_number(texts, source):
        columns = {_labelled(name, labelled): values for name, values in columns.items()}
        unread = {name: held for name, held in unread.items() if name not in texts}
    return LogTable(columns, source, kind, unread)


def kept_numbers(kept: Kept, source: str, kind: str) -> LogTable:
    """Return the columns of numbers of the rows that are kept of a file."""
    table = numbers_of(kept.table, source, kind)
    notes, unread = (kept.note,) if kept.note else (), {**table.unread, **kept.aside}
    return replace(table, spread=kept.spread, notes=notes, unread=unread)


def read_delimited(path: Path) -> LogTable:
    """Read delimited text, or stretches of one that is long.

    Raises:
        RecordingError: It cannot be read, is no such text, or holds several tables.
    """
    text = DelimitedText(path, WRITTEN)
    try:
        found = kept_numbers(text.kept(), str(path), "delimited text")
    except RecordingError:
        if len(tables := tables_in(path, WRITTEN)) > 1:
            listed = "; ".join(f"one of {names} from line {line} on" for line, names in tables)
            raise RecordingError(
                f"holds {len(tables)} tables: {listed}; expected one, so give each a file of its "
                "own, or join their columns",
                path=path,
            ) from None
        raise
    return replace(found, notes=(*text.notes(), *found.notes), words=text.dialect.above)


def read_parquet(path: Path) -> Kept:
    """Read a Parquet file, or stretches of one that is long.

    Raises:
        RecordingError: It is none, or damaged.
    """
    with reading_parquet(path):
        rows = parquet_rows(path)
        return replace(kept_of(rows.batches, rows.schema, rows.width), aside=rows.aside)


def _is_fixed(kind: Any) -> bool:  # noqa: ANN401  # pyarrow has no types
    return bool(pa.types.is_fixed_size_list(kind))


def _is_list(kind: Any) -> bool:  # noqa: ANN401
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or _is_fixed(kind))


def _without_structures(table: pa.Table) -> pa.Table:
    """Return the fields of structures as columns, and lists of structures as lists of fields."""
    while True:
        if any(pa.types.is_struct(kind) for kind in table.schema.types):
            table = table.flatten()
            continue
        kinds = zip(table.column_names, table.schema.types, strict=True)
        listed = [n for n, kind in kinds if _is_list(kind) and pa.types.is_struct(kind.value_type)]
        if not listed:
            return table
        for name in listed:
            index = table.column_names.index(name)
            column = table.column(index).combine_chunks()
            ends = np.cumsum(np.append(0, column.value_lengths().fill_null(0).to_numpy()))
            inner = column.flatten()
            table = table.remove_column(index)
            for k, field in enumerate(inner.type):  # two of which may share a name
                own = pa.LargeListArray.from_arrays(ends.astype(np.int64), inner.field(k))
                table = table.append_column(f"{name}.{field.name}", own)


class _Labels(NamedTuple):
    """Texts that name the entries of lists, and the columns that hold them."""

    columns: frozenset[str]
    entries: dict[tuple[str, int], tuple[str, ...]]  # by what they are fields of, and their number
    orders: dict[tuple[str, int], IntArray | str]  # (T, k), where rows have others; or why


def _labels_in(table: pa.Table) -> _Labels:
    """Return the texts of lists that are the same in each row; none where two are as long."""
    columns, entries = set[str](), dict[tuple[str, int], tuple[str, ...]]()
    orders = dict[tuple[str, int], "IntArray | str"]()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if not (_is_list(column.type) and pa.types.is_string(column.type.value_type)):
            continue
        first = (column[0].as_py() if len(column) else None) or []
        if not first or len(set(first)) < len(first) or not all(first):
            continue
        flat = pa.chunked_array([chunk.flatten() for chunk in column.chunks]).combine_chunks()
        codes = flat.dictionary_encode().indices.fill_null(-1).to_numpy().astype(np.int64)
        place, every = (name.rpartition(".")[0], len(first)), np.arange(len(first))
        if codes.size != len(column) * len(first):
            continue
        codes = codes.reshape(-1, len(first))
        same = (codes == every).all(axis=1)
        if same.all():
            entries[place] = () if place in entries else tuple(first)
            columns.add(name)
        elif words_of(name)[-1:] in _NAMES:
            orders[place] = (
                f"{name} names other joints from row {int(same.argmin())} on; expected the same"
            )
            if (np.sort(codes, axis=1) == every).all():  # in another order
                orders[place] = np.argsort(codes, axis=1)
                entries[place] = tuple(first)
                columns.add(name)
    return _Labels(frozenset(columns), entries, orders)


def _by_number(texts: Mapping[str, pa.ChunkedArray], source: str) -> dict[tuple[str, str], str]:
    """Return the labels that texts such as `name0` hold, by what stands before that and number.

    Raises:
        RecordingError: They are not the same in all rows.
    """
    labels = dict[tuple[str, str], str]()
    for name, column in texts.items():
        held = compute.unique(column.drop_null()).to_pylist()
        if len(held) > 1:
            row = column.to_pylist().index(held[1])
            raise RecordingError(
                f"{name} is {held[0]!r} at first and {held[1]!r} in row {row}; expected one order "
                "of the joints",
                path=source,
            )
        found = _NAMED.fullmatch(name)
        if found and held:
            labels[found["of"], found["number"]] = str(held[0])
    return labels if 1 < len({*labels.values()}) == len(texts) else {}


def _labelled(name: str, labels: Mapping[tuple[str, str], str]) -> str:
    """Return the name of a column with a label for its number."""
    found = _NUMBERED.fullmatch(name)
    label = labels.get((found["of"], found["number"])) if found else None
    return f"{found['of']}{found['what']}.{label}" if found and label else name


def _said_of_list(column: pa.ChunkedArray) -> str:
    """Say what lists hold that are no numbers of one length."""
    if not any(len(chunk.flatten()) for chunk in column.chunks):
        return "empty lists"
    numbers = pa.types.is_floating(column.type.value_type) or pa.types.is_integer(
        column.type.value_type
    )
    return f"{column.type} of different lengths" if numbers else f"{column.type}, not one each row"


def _values(column: pa.ChunkedArray) -> NDArray[Any] | None:
    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return column.to_numpy()
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy()  # whole numbers may be nanoseconds, of more digits than a float's
    plain = (pa.types.is_integer, pa.types.is_floating, pa.types.is_null, pa.types.is_decimal)
    texts = (pa.types.is_string, pa.types.is_large_string)  # of numbers, it may be
    if not any(of_kind(kind) for of_kind in (*plain, *texts)):
        return None
    try:
        return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64)
    except pa.ArrowInvalid:
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
    values = flat.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return values.reshape(len(column), -1)


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


def is_clock(cell: str) -> bool:
    """Say whether a text is a time of day."""
    return re.fullmatch(_FORM, cell) is not None


def clock_times(column: pa.ChunkedArray) -> NDArray[Any] | None:
    """Return a column of times of day as durations [ns]; None if it holds something else.

    A time that is half a day before the one above it is of the next day. Empty cells are no time.

    Args:
        column: Of texts, or of what pyarrow knows as times.
    """
    if pa.types.is_time(column.type):
        since = column.cast(pa.time64("ns"), safe=False).cast(pa.int64())
        known = since.is_valid().to_numpy()
        ns = since.fill_null(0).to_numpy().astype(np.int64)
    elif pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        known = column.is_valid().to_numpy()
        parts = compute.extract_regex(column, pattern=_FORM).combine_chunks()
        if not known.any() or parts.null_count != column.null_count:
            return None
        ns = _nanoseconds(parts)
    else:
        return None
    steps = np.diff(ns[known])
    days = np.cumsum(np.append(0, (steps < -_DAY // 2).astype(np.int64)))
    ns[known] += _DAY * days
    return np.where(known, ns, np.iinfo(np.int64).min).astype("timedelta64[ns]")


def _nanoseconds(parts: pa.StructArray) -> IntArray:
    total = np.zeros(len(parts), dtype=np.int64)
    for name, seconds in _SECONDS.items():
        total += seconds * _SECOND * _whole(parts.field(name))
    fraction = compute.utf8_rpad(parts.field("f").fill_null(""), width=_DIGITS, padding="0")
    return total + _whole(fraction)


def _whole(texts: pa.Array) -> IntArray:
    filled = compute.if_else(compute.equal(texts.fill_null(""), ""), "0", texts.fill_null("0"))
    return filled.cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.int64)
