"""An arm: its description, its dynamics and kinematics, and how its links follow its joints.

The names are imported when they are first used: the processes that read given files need
descriptions alone, and pinocchio takes them longer than most files.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.model.kinematics import ExternalWrench
    from limo_driver.model.robot_model import BUILT_IN, Capsule, RobotModel

__all__ = ["BUILT_IN", "Capsule", "ExternalWrench", "Inertial", "RobotModel"]
_HOME = {"ExternalWrench": "kinematics", "Inertial": "descriptions.geometry"}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'robot_model')}"), name)
