"""Arms of drives on a CAN bus: CiA 402 over CANopen, and Damiao's MIT mode."""

from backends.can.config import ArmConfig, DriveError
from backends.can.link import DriveStatus
from backends.can.robot import CanRobot

__all__ = ["ArmConfig", "CanRobot", "DriveError", "DriveStatus"]
