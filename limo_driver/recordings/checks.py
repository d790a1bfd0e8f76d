"""Checks of arrays that are to be a recording: numbers, shapes, finite values, order of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError, ShapeError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from limo_driver.types import FloatArray


def numbers(name: str, values: ArrayLike) -> FloatArray:
    """Return an array of real numbers.

    Raises:
        RecordingError: It holds something else.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordingError(f"{name} is no array of real numbers: {type(values)}") from None


def check_shapes(
    time: FloatArray, position: FloatArray, others: Mapping[str, FloatArray | None]
) -> None:
    """Check that positions are (T, n), all else by name likewise, and times (T,).

    Raises:
        ShapeError: One is not.
    """
    shape = np.shape(position)
    if len(shape) != 2 or not shape[1]:  # noqa: PLR2004  # (T, n)
        raise ShapeError("position", shape, "(T, n)")
    for name, values in others.items():
        if values is not None and np.shape(values) != shape:
            raise ShapeError(name, np.shape(values), f"{shape}")
    if np.shape(time) != shape[:1]:
        raise ShapeError("time", np.shape(time), f"({shape[0]},)")


def check_seconds(time: ArrayLike, source: str) -> None:
    """Check that times (T,) are real numbers: whole ones may count anything.

    Raises:
        RecordingError: They are not.
    """
    kind = np.asarray(time).dtype
    if kind.kind != "f":
        raise RecordingError(
            f"time holds {kind} values, expected seconds as real numbers; `Recording.from_arrays` "
            "takes dates and whole micro- and nanoseconds",
            path=source or None,
        )


def check_values(time: FloatArray, position: FloatArray, torque: FloatArray, source: str) -> None:
    """Check what every door checks: of the rest, filters and fits would make nonsense.

    Args:
        time: (T,) [s].
        position: (T, n) [rad].
        torque: (T, n) [N m].
        source: File that they are from, for messages.

    Raises:
        RecordingError: A value is not finite, or time does not increase.
    """
    bad = ~np.isfinite(time)
    for values in (position, torque):
        bad |= ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise RecordingError(
            f"time, position or torque is not finite in {bad.sum()} of {bad.size} rows; "
            "`Recording.from_arrays` leaves such rows out",
            path=source or None,
            rows=np.flatnonzero(bad).tolist(),
        )
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        row = int(back[0]) + 1
        raise RecordingError(
            f"time does not increase at row {row}, from {time[row - 1]:.9g} s to {time[row]:.9g} s;"
            " expected samples in order of time",
            path=source or None,
            rows=[row],
        )
