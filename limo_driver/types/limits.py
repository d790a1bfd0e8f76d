"""What an arm is and can do: limits and specification."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

from limo_driver.types.arrays import ArrayFields, FloatArray


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
