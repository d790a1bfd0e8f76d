"""Arrays by name, some inside others, as a table: what objects of JSON and of MATLAB hold."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from limo_driver.logs.readers.table import LogTable, table_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

_MATRIX: Final = 2  # axes
_DEEPEST: Final = 8  # objects one in the other


def table_of_tree(tree: Mapping[str, Any], source: str, kind: str) -> LogTable:
    """Make a table of arrays by name: `state.q` is the array `q` of the object `state`.

    A sample is a row: an array that has the samples as its columns is turned. Objects that hold all
    of the log, as a run of several does, are in no name.

    Args:
        tree: Numbers, lists and arrays of them, texts, or objects that hold such, by name.
        source: Where they are from, for messages.
        kind: What that is, in words.
    """
    arrays = dict(_leaves("", tree))
    rows = _samples(arrays)
    holders = [name.split(".")[:-1] for name, x in arrays.items() if rows in x.shape]
    shared = takewhile(lambda at: len(set(at)) == 1, zip(*holders, strict=False))
    around = "".join(f"{names[0]}." for names in shared)
    return table_of(
        {name.removeprefix(around): x.T if _lies(x, rows) else x for name, x in arrays.items()},
        source,
        kind,
    )


def _lies(values: NDArray[Any], rows: int) -> bool:
    """Say whether samples are columns."""
    return values.ndim == _MATRIX and values.shape[1] == rows != values.shape[0]


def _leaves(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        inside = cast("Mapping[str, object]", value) if depth < _DEEPEST else {}
        for key, each in inside.items():
            yield from _leaves(f"{name}.{key}" if name else key, each, depth + 1)
        return
    try:
        values = np.asarray(value)
    except ValueError:  # lists of different lengths
        values = np.asarray(value, dtype=object)
    if values.ndim > 1 and 1 in values.shape:  # MATLAB has no vectors
        values = values.squeeze()
    if values.ndim:
        yield name, values


def _samples(arrays: Mapping[str, NDArray[Any]]) -> int:
    """Return how many samples a log has: the length that most arrays have along an axis."""
    lengths = [
        length
        for values in arrays.values()
        if values.dtype.kind in "fiu" and values.ndim <= _MATRIX
        for length in {max(values.shape)}
    ]
    return max(lengths, key=lambda length: (lengths.count(length), length), default=0)
