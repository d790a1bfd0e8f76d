"""Arrays of float64, read-only where they are shared, and dataclasses of them."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limo_driver.errors import ConfigError, ShapeError

FloatArray: TypeAlias = NDArray[np.float64]
_FLOAT64 = np.dtype(np.float64)


def readonly(values: ArrayLike) -> FloatArray:
    """Return a read-only float64 array of `values`; copies only where it has to."""
    array = np.asarray(values, dtype=np.float64)
    if array.flags.writeable:
        array = array.copy() if array is values or array.base is not None else array
        array.flags.writeable = False
    return array


def as_numbers(name: str, values: ArrayLike) -> FloatArray:
    """Return the array of an argument, as it is where it can be.

    Raises:
        ConfigError: It holds something else than numbers, or rows of different length.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} is no array of real numbers: {type(values).__name__}") from None


class ArrayFields:
    """Make every array field of a frozen dataclass a read-only float64 array of one length n."""

    def __post_init__(self) -> None:
        shape: tuple[int, ...] | None = None
        for name in _array_fields(type(self)):
            array = getattr(self, name)
            if not _is_settled(array):
                array = np.array(array, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
            if shape is None and array.ndim == 1:
                shape = array.shape
            if array.shape != shape:
                raise ShapeError(name, array.shape, "(n,)" if shape is None else f"{shape}")


def _is_settled(array: object) -> bool:
    """Say whether nobody can write to an array: it owns its values, and they are read-only."""
    return (
        type(array) is np.ndarray
        and array.base is None
        and not array.flags.writeable
        and array.dtype is _FLOAT64
    )


@cache
def _array_fields(owner: type) -> tuple[str, ...]:
    """Return the names of the array fields of a dataclass; states are made at 1 kHz."""
    return tuple(item.name for item in fields(owner) if item.type in {"FloatArray", FloatArray})


def settled_temperature(temperature: FloatArray | None, position: FloatArray) -> FloatArray | None:
    """Return a temperature, if there is one, read-only and checked to be of all joints.

    Raises:
        ShapeError: It has another shape than the position.
    """
    if temperature is None:
        return None
    kept = readonly(temperature)
    if kept.shape != position.shape:
        raise ShapeError("temperature", kept.shape, f"{position.shape}")
    return kept
