"""Frozen values that pass between the parts: limits, specifications, states and commands.

SI units; joints are counted from 1 in everything a user reads, from 0 in arrays.
Arrays are float64 and read-only, since they are shared.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import PurePath
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limo_driver.display import Displayed
from limo_driver.errors import ConfigError, PathError, ShapeError

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


@dataclass(frozen=True)
class JointLimits(ArrayFields):
    """Limits of n joints; each array has shape (n,)."""

    position_min: FloatArray  # [rad]
    position_max: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s^2]
    jerk: FloatArray  # [rad/s^3]
    torque: FloatArray  # [N m]
    torque_rate: FloatArray  # [N m/s]


@dataclass(frozen=True)
class WrenchLimits(ArrayFields):
    """Limits of a wrench [Fx Fy Fz τA τB τC] at the tool; each array has shape (6,)."""

    wrench: FloatArray  # [N, N, N, N m, N m, N m]
    rate: FloatArray  # [N/s, N/s, N/s, N m/s, N m/s, N m/s]


@dataclass(frozen=True)
class RobotSpec:
    """Specification of an arm that a user needs before commanding it."""

    name: str
    joint_names: tuple[str, ...]
    limits: JointLimits
    period: float  # control cycle [s]
    wrench_limits: WrenchLimits | None = None  # of a robot that takes wrenches
    torque_resolution: FloatArray | None = None  # (n,) [N m], of measured torque, where known
    measures_temperature: bool = False  # of its joints
    jerk: FloatArray | None = None  # (n,) [rad/s^3], that set-points keep, where the arm states one
    # An arm that gave way and is not measured any more: hold where it should be, or float, without
    # torque but that of gravity, until it is measured again.
    on_loss: Literal["hold", "float"] = "hold"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)


def same_robot(first: str, second: str) -> bool:
    """Say whether two names can be of one robot: built-in names, or paths to a URDF.

    A URDF may have moved from one machine to another, and `iiwa14.urdf` may well be of the built-in
    iiwa14, so only the file name without its ending counts, whichever joints of it are chosen.
    """
    one, other = (PurePath(name.partition("#")[0]).stem for name in (first, second))
    return one == other


@dataclass(frozen=True)
class JointState(ArrayFields):
    """One measured sample of all n joints.

    Args:
        time: Of the robot's own clock [s], which never goes back.
        position: (n,) [rad].
        velocity: (n,) [rad/s].
        torque: Measured, (n,) [N m].
        sequence: Counts cycles; a gap is a lost sample.
        stale: There was no new measurement in this cycle; the values are the last known ones.
        holding: The arm holds its pose and takes no command.
        temperature: (n,) [°C], NaN before a joint's first reading; None where it is not measured.
        drives: Status of each joint's drive, in its own words; empty where it is not told.

    Raises:
        ShapeError: The arrays are not all (n,).

    Example:
        >>> with limo.open_robot("virtual", robot="iiwa14") as robot:
        ...     print(robot.receive().position)
    """

    time: float  # [s], monotonic, of the robot
    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    torque: FloatArray  # (n,) [N m], measured
    sequence: int  # counts cycles; a gap is a lost sample
    stale: bool = False  # no new measurement this cycle: values are the last known ones
    holding: bool = False  # the arm holds its pose and takes no command
    temperature: FloatArray | None = None  # (n,) [°C], where measured; NaN before its first reading
    drives: tuple[str, ...] = ()  # status of each joint's drive, in its own words, where it is told

    def __post_init__(self) -> None:
        super().__post_init__()
        _settle_temperature(self)

    @classmethod
    def trusted(
        cls,
        time: float,
        position: FloatArray,
        velocity: FloatArray,
        torque: FloatArray,
        sequence: int,
        temperature: FloatArray | None = None,
        drives: tuple[str, ...] = (),
    ) -> JointState:
        """Return a state that takes over its arrays, unchecked: for what runs at 1 kHz.

        Args:
            time: Of the robot's own clock [s].
            position: (n,) [rad]; all arrays are float64, and nobody else writes to them.
            velocity: (n,) [rad/s].
            torque: Measured, (n,) [N m].
            sequence: Counts cycles.
            temperature: (n,) [°C]; None where it is not measured.
            drives: Status of each joint's drive.
        """
        position.setflags(write=False)
        velocity.setflags(write=False)
        torque.setflags(write=False)
        if temperature is not None:
            temperature.setflags(write=False)
        state = object.__new__(cls)
        state.__dict__.update(
            time=time,
            position=position,
            velocity=velocity,
            torque=torque,
            sequence=sequence,
            stale=False,
            holding=False,
            temperature=temperature,
            drives=drives,
        )
        return state


@dataclass(frozen=True, kw_only=True)
class JointCommand(ArrayFields):
    """Command to all joints; a subclass for each control mode."""

    valid_for: float = 0.1  # [s] after which the arm holds unless the next command came
    limited_by: tuple[str, ...] = ()  # limits that changed the command on its way out


@dataclass(frozen=True)
class PositionCommand(JointCommand):
    """Follow a joint position.

    Args:
        position: (n,) [rad].
        valid_for: [s] after which the arm holds unless the next command came.
        limited_by: Limits that changed the command on its way out; `Robot.send` fills it in.

    Raises:
        ShapeError: The position is not (n,).

    Example:
        >>> with limo.open_robot("virtual", robot="iiwa14") as robot:
        ...     state = robot.receive()
        ...     robot.send(limo.PositionCommand(position=state.position))
    """

    position: FloatArray  # (n,) [rad]


@dataclass(frozen=True)
class ImpedanceCommand(JointCommand):
    """Follow a joint position like a spring and damper, with gravity compensated.

    tau = stiffness (position - q) - damping dq + torque + gravity

    Args:
        position: (n,) [rad].
        stiffness: (n,) [N m/rad].
        damping: (n,) [N m s/rad].
        torque: Feed-forward, (n,) [N m].
        valid_for: [s] after which the arm holds unless the next command came.
        limited_by: Limits that changed the command on its way out; `Robot.send` fills it in.

    Raises:
        ShapeError: The arrays are not all (n,).

    Example:
        >>> k = np.full(7, 300.0)
        >>> with limo.open_robot("virtual", robot="iiwa14") as robot:
        ...     state = robot.receive()
        ...     robot.send(limo.ImpedanceCommand(state.position, k, 0.1 * k, np.zeros(7)))
    """

    position: FloatArray  # (n,) [rad]
    stiffness: FloatArray  # (n,) [N m/rad]
    damping: FloatArray  # (n,) [N m s/rad]
    torque: FloatArray  # (n,) [N m], feed-forward


@dataclass(frozen=True)
class TorqueCommand(JointCommand):
    """Apply a joint torque on top of gravity compensation.

    Args:
        torque: (n,) [N m].
        valid_for: [s] after which the arm holds unless the next command came.
        limited_by: Limits that changed the command on its way out; `Robot.send` fills it in.

    Raises:
        ShapeError: The torque is not (n,).

    Example:
        >>> with limo.open_robot("virtual", robot="iiwa14") as robot:
        ...     state = robot.receive()
        ...     robot.send(limo.TorqueCommand(torque=-2.0 * state.velocity))  # 2 N m s/rad
    """

    torque: FloatArray  # (n,) [N m]


@dataclass(frozen=True)
class WrenchCommand(JointCommand):
    """Apply a wrench at the tool, on top of what the arm's own Cartesian control does.

    Args:
        wrench: Fx Fy Fz τA τB τC, (6,) [N, N m].
        valid_for: [s] after which the arm holds unless the next command came.
        limited_by: Limits that changed the command on its way out; `Robot.send` fills it in.

    Raises:
        ShapeError: The wrench is no array of one dimension.

    Example:
        >>> down = limo.WrenchCommand(wrench=[0.0, 0.0, -5.0, 0.0, 0.0, 0.0])
        >>> down.wrench[2]  # [N]; `robot.send(down)` in the session of an arm that takes wrenches
    """

    wrench: FloatArray  # (6,) [Fx Fy Fz τA τB τC], [N, N m]


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
        _settle_temperature(self)

    def motion(self) -> Motion:
        """Return the sample as a motion of one row."""
        return Motion.trusted(
            np.array([self.time]),
            self.position[None],
            self.velocity[None],
            self.acceleration[None],
            None if self.temperature is None else self.temperature[None],
        )


def _settle_temperature(owner: JointState | JointSample) -> None:
    """Make a temperature, if there is one, read-only and of all joints."""
    if owner.temperature is not None:
        object.__setattr__(owner, "temperature", readonly(owner.temperature))
        if owner.temperature.shape != owner.position.shape:
            raise ShapeError("temperature", owner.temperature.shape, f"{owner.position.shape}")


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

    def __getitem__(self, rows: slice | NDArray[np.int64]) -> Motion:
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
