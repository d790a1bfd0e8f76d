"""Times of day, such as 14:03:27.125, as durations since the midnight before the first."""

# pyarrow ships no type stubs, so its columns are unknown to the checker.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
from pyarrow import compute

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FORM: Final = r"^\s*(?P<h>\d{1,3}):(?P<m>[0-5]\d)(?::(?P<s>[0-5]?\d)(?:[.,](?P<f>\d{1,9}))?)?\s*$"
_SECONDS: Final = {"h": 3600, "m": 60, "s": 1}
_SECOND: Final = 1_000_000_000  # [ns]
_DAY: Final = 86_400 * _SECOND  # [ns]
_DIGITS: Final = 9  # of a fraction in nanoseconds


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
        since = column.cast(pa.time64("ns")).cast(pa.int64())
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


def _nanoseconds(parts: pa.StructArray) -> NDArray[np.int64]:
    total = np.zeros(len(parts), dtype=np.int64)
    for name, seconds in _SECONDS.items():
        total += seconds * _SECOND * _whole(parts.field(name))
    fraction = compute.utf8_rpad(parts.field("f").fill_null(""), width=_DIGITS, padding="0")
    return total + _whole(fraction)


def _whole(texts: pa.Array) -> NDArray[np.int64]:
    filled = compute.if_else(compute.equal(texts.fill_null(""), ""), "0", texts.fill_null("0"))
    return filled.cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.int64)
