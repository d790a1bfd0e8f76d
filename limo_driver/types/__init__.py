"""Frozen values that pass between the parts: limits, specifications, states and commands.

SI units; joints are counted from 1 in everything a user reads, from 0 in arrays.
Arrays are float64 and read-only, since they are shared.

What an arm measures each cycle, what it is commanded, and the limits of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

from limo_driver.types.motion import (
    ArrayFields,
    BoolArray,
    FloatArray,
    IntArray,
    JointSample,
    Motion,
    as_numbers,
    readonly,
    settled_temperature,
)

__all__ = [
    "ArrayFields",
    "BoolArray",
    "FloatArray",
    "ImpedanceCommand",
    "IntArray",
    "JointCommand",
    "JointLimits",
    "JointSample",
    "JointState",
    "Motion",
    "PositionCommand",
    "RobotSpec",
    "StatesAhead",
    "TorqueCommand",
    "WrenchCommand",
    "WrenchLimits",
    "as_numbers",
    "readonly",
    "same_robot",
]


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
        kept = settled_temperature(self.temperature, self.position)
        object.__setattr__(self, "temperature", kept)

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


@dataclass(frozen=True)
class StatesAhead:
    """States of T cycles in a row."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    velocity: FloatArray  # (T, n) [rad/s]
    torque: FloatArray  # (T, n) [N m]
    last: JointState  # as `receive` returned it


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
