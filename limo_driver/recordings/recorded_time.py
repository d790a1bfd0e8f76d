"""The time of a recording that comes as whole numbers or as dates: in seconds, and said so."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

RATES: Final = (9.0, 5500.0)  # [Hz], 10 Hz to 5 kHz with a tenth of margin
_PER_SECOND: Final = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_SINCE: Final = "taken as seconds since the first row"
_TAKEN: Final = ("microseconds", "nanoseconds")  # small steps of whole numbers could count rows


def unit_of(step: float) -> str | None:
    """Return the unit in which a step of time makes the rate of a recording; None if none does.

    No step does in two units: they are a factor of 1000 apart, and the rates one of 611.
    """
    for unit, per_second in _PER_SECOND.items():
        if step > 0 and RATES[0] <= per_second / step <= RATES[1]:
            return unit
    return None


def seconds(values: NDArray[Any], known: NDArray[np.bool_] | None = None) -> tuple[FloatArray, str]:
    """Return times in seconds, and how they were taken where that has to be said.

    Whole numbers are counted from the first, where their steps can only be micro- or nanoseconds;
    so are dates and durations. The difference is exact: a date in nanoseconds has more digits than
    a float. All other numbers stay what they are.

    Args:
        values: Numbers, dates or durations, (T,).
        known: (T,), false where a whole number stands for an empty cell.

    Returns:
        Time (T,) [s], NaN where it is not known; and a sentence, or nothing.
    """
    if not values.size:
        return np.zeros(0), ""
    if values.dtype.kind in "mM":
        since = values - values[(~np.isnat(values)).argmax()]
        return since / np.timedelta64(1, "s"), f"time holds {values.dtype} values: {_SINCE}"
    if values.dtype.kind not in "iu":
        return np.asarray(values, dtype=np.float64), ""
    known = np.ones(values.shape, dtype=bool) if known is None else known
    since = (values - values[known.argmax()]).astype(np.int64)  # modulo 2**64, so exact
    forward = np.diff(since[known])
    forward = forward[forward > 0]
    step = int(np.median(forward)) if forward.size else 0
    unit = unit_of(step)
    if unit not in _TAKEN:
        return np.where(known, values, np.nan), ""
    told = f"time holds whole numbers with steps of {step}, which are {unit}: {_SINCE}"
    return np.where(known, since / _PER_SECOND[unit], np.nan), told
