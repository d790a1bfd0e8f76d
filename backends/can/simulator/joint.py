"""Interface between a simulated drive and its joint: sensor values in, motor commands out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

AMBIENT = 25.0  # [°C]


class Actuation(Enum):
    """Way in which a drive acts on its joint."""

    BRAKE = "brake"  # closed without power: keeps the position at which it closed
    FREE = "free"  # no power and no brake: the arm falls
    POSITION = "position"  # the drive's servo follows `position`
    TORQUE = "torque"  # `torque` alone
    IMPEDANCE = "impedance"  # spring and damper around `position` and `velocity`, and `torque`


@dataclass
class JointPort:
    """The cable between one drive and its joint; SI units of the joint, signs of the arm.

    The drive writes what it makes the joint do, the arm writes what the sensors read.
    """

    position: float = 0.0  # to be reached at the end of the current communication period [rad]
    velocity: float = 0.0  # of an impedance [rad/s]
    torque: float = 0.0  # made as such, or beside the servo [N m]
    stiffness: float = 0.0  # [N m/rad]
    damping: float = 0.0  # [N m s/rad]
    actuation: Actuation = Actuation.BRAKE

    measured_position: float = 0.0  # [rad]
    measured_velocity: float = 0.0  # [rad/s]
    measured_torque: float = 0.0  # [N m]
    temperature: float = AMBIENT  # of the winding [°C]
