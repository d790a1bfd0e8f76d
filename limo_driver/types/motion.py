"""Motion of all joints: one sample, and many in order of time; arrays that are read-only."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limo_driver.errors import ConfigError, PathError, ShapeError
from limo_driver.runtime.display import Displayed

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]
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
            if not (
                type(array) is np.ndarray
                and array.base is None
                and not array.flags.writeable
                and array.dtype is _FLOAT64
            ):
                array = np.array(array, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
            if shape is None and array.ndim == 1:
                shape = array.shape
            if array.shape != shape:
                raise ShapeError(name, array.shape, "(n,)" if shape is None else f"{shape}")


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


@dataclass(frozen=True)
class JointSample(ArrayFields):
    """Motion of all joints at one instant, the input of a one-sample prediction."""

    time: float  # [s]
    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    acceleration: FloatArray  # (n,) [rad/s^2]
    temperature: FloatArray | None = None  # (n,) [°C], where it is measured

    def __post_init__(self) -> None:
        super().__post_init__()
        kept = settled_temperature(self.temperature, self.position)
        object.__setattr__(self, "temperature", kept)

    def motion(self) -> Motion:
        """Return the sample as a motion of one row."""
        return Motion.trusted(
            np.array([self.time]),
            self.position[None],
            self.velocity[None],
            self.acceleration[None],
            None if self.temperature is None else self.temperature[None],
        )


@dataclass(frozen=True, repr=False)
class Motion(Displayed):
    """Joint motion over T samples of n joints, in order of time; for batch predictions.

    Args:
        time: (T,) [s].
        position: (T, n) [rad].
        velocity: (T, n) [rad/s].
        acceleration: (T, n) [rad/s^2].
        temperature: (T, n) [°C]; None where it is not measured.

    Raises:
        ShapeError: The shapes do not fit together.

    Example:
        >>> still = np.zeros((2, 7))
        >>> limo.Simulation("iiwa14").predict(limo.Motion([0.0, 0.1], still, still, still))
    """

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    velocity: FloatArray  # (T, n) [rad/s]
    acceleration: FloatArray  # (T, n) [rad/s^2]
    temperature: FloatArray | None = None  # (T, n) [°C], where it is measured

    def __post_init__(self) -> None:
        for field in fields(Motion):
            if (values := getattr(self, field.name)) is not None:
                object.__setattr__(self, field.name, readonly(values))
        if self.position.ndim != 2:  # noqa: PLR2004  # (T, n)
            raise ShapeError("position", self.position.shape, "(T, n)")
        T, n = self.position.shape
        if self.time.shape != (T,):
            raise ShapeError("time", self.time.shape, f"({T},)")
        for name in ("velocity", "acceleration", "temperature"):
            values = getattr(self, name)
            if values is not None and values.shape != (T, n):
                raise ShapeError(name, values.shape, f"({T}, {n})")

    @classmethod
    def from_positions(cls, time: ArrayLike, position: ArrayLike) -> Motion:
        """Return the motion through positions that have no noise, such as those of a sketch.

        Velocity and acceleration are central differences, exact for a parabola. Those of measured
        positions would be mostly noise: `Recording.motion` filters them.

        Args:
            time: (T,) [s], increasing; 3 samples or more.
            position: (T, n) [rad].

        Raises:
            ShapeError: The shapes do not fit together.
            PathError: Fewer than 3 samples, or a time that does not increase.

        Example:
            >>> time = np.linspace(0.0, 4.0, 1001)
            >>> swing = 0.02 * np.sin(np.pi * time)[:, None]
            >>> limo.Motion.from_positions(time, swing)
            <Motion: 4 s, 1001 samples of 1 joint>
        """
        time, position = readonly(time), readonly(position)
        if position.ndim != 2 or time.shape != position.shape[:1]:  # noqa: PLR2004  # (T, n)
            raise ShapeError("position", position.shape, f"(T, n) at {time.shape} times")
        if time.size < 3:  # noqa: PLR2004
            raise PathError(f"a motion of {time.size} positions, expected 3 or more")
        if not (steps := np.diff(time) > 0).all():
            row = int(np.argmin(steps)) + 1
            raise PathError(
                f"time does not increase: {time[row]:.9g} s follows {time[row - 1]:.9g} s "
                f"(row {row})"
            )
        velocity = np.gradient(position, time, axis=0, edge_order=2)
        return Motion(time, position, velocity, np.gradient(velocity, time, axis=0, edge_order=2))

    @classmethod
    def trusted(
        cls,
        time: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        temperature: FloatArray | None = None,
    ) -> Motion:
        """Return a motion of arrays that are known to fit, unchecked: for what runs at 1 kHz.

        Args:
            time: (T,) [s].
            position: (T, n) [rad].
            velocity: (T, n) [rad/s].
            acceleration: (T, n) [rad/s^2].
            temperature: (T, n) [°C]; None where it is not measured.
        """
        motion = object.__new__(cls)
        motion.__dict__.update(
            time=time,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            temperature=temperature,
        )
        return motion

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    def __getitem__(self, rows: slice | IntArray) -> Motion:
        """Return the samples in `rows`: a slice, or increasing indices."""
        return Motion(
            self.time[rows],
            self.position[rows],
            self.velocity[rows],
            self.acceleration[rows],
            None if self.temperature is None else self.temperature[rows],
        )

    def headline(self) -> str:
        """Say how long it is, and of how many joints."""
        joints = f"{self.n} joint{'s' * (self.n != 1)}"
        duration = float(np.ptp(self.time)) if len(self) else 0.0
        return f"{duration:.4g} s, {len(self)} samples of {joints}"

    def sample(self, row: int) -> JointSample:
        """Return one sample.

        Args:
            row: 0-based; from the end if negative.

        Raises:
            IndexError: There is no such sample.
        """
        return JointSample(
            float(self.time[row]),
            self.position[row],
            self.velocity[row],
            self.acceleration[row],
            None if self.temperature is None else self.temperature[row],
        )
