"""JSON as logs come in it: a list of records, records line by line, or arrays by name."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final, cast

import pyarrow as pa

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.arrow import numbers_of
from limo_driver.logs.readers.formats.trees import table_of_tree
from limo_driver.runtime.given_files import json_of, read_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from limo_driver.logs.readers.table import LogTable

_KIND: Final = "JSON"
_LARGEST: Final = 1 << 28  # bytes; what Python makes of one has ten times its size
_DEEPEST: Final = 4  # objects one in the other, in which records are looked for


def read_json(path: Path) -> LogTable:
    """Read the longest list of records that a file holds, else its arrays.

    A record is an object that has a number or a list of numbers by name.

    Raises:
        RecordingError: It is no JSON, holds neither, or is larger than is read at once.
    """
    whole = json_of(read_text(path, RecordingError, _LARGEST), path, RecordingError, _parsed)
    found = max(_records_in("", whole), key=lambda each: len(each[1]), default=("", []))
    if len(found[1]) > 1:
        return _of_records(*found, path)
    if not isinstance(whole, dict):
        raise RecordingError(
            "holds no records, expected a list of objects, an object a line, or arrays by name",
            path=path,
        )
    return table_of_tree(cast("Mapping[str, Any]", whole), str(path), _KIND)


def _parsed(text: str) -> object:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise
        return list(_lines(text))


def _lines(text: str) -> Iterator[object]:
    """Yield what each line holds that is not empty; an error tells the line of the file."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            try:
                yield json.loads(line)
            except json.JSONDecodeError as error:
                error.lineno = number
                raise


def _records_in(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, list[Any]]]:
    """Yield every list of objects, with the name of what holds it."""
    if isinstance(value, list):
        listed = cast("list[object]", value)
        if listed and all(isinstance(each, dict) for each in listed):
            yield name, listed
    elif isinstance(value, dict) and depth < _DEEPEST:
        for key, each in cast("dict[str, object]", value).items():
            yield from _records_in(key, each, depth + 1)


def _of_records(name: str, records: list[Any], path: Path) -> LogTable:
    try:
        batch = pa.RecordBatch.from_struct_array(pa.array(records))
    except pa.ArrowException as error:
        raise RecordingError(
            f"its {len(records)} records are not alike: {str(error).splitlines()[0]}", path=path
        ) from None
    kind = f"{_KIND}, the records of {name}" if name else f"{_KIND} records"
    return numbers_of(pa.Table.from_batches([batch]), str(path), kind)
