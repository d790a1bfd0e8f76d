"""An arm: its description, its dynamics and kinematics, and how its links follow its joints."""

from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.robot_model import BUILT_IN, Capsule, RobotModel

__all__ = ["BUILT_IN", "Capsule", "Inertial", "RobotModel"]
