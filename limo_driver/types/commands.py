"""Commands to all joints, one class for each control mode."""

from __future__ import annotations

from dataclasses import dataclass

from limo_driver.types.arrays import ArrayFields, FloatArray


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
