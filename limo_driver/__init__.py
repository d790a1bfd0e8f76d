"""limo: driver, simulator and torque estimator for slow, force-sensitive robot arms.

The names below are imported when they are first used, so that `import limo_driver` stays cheap.
"""

TYPE_CHECKING = False  # as in `typing`, which takes 10 ms, in which Ctrl-C would not be answered
if TYPE_CHECKING:
    from limo_driver.errors import LimoError
    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.robot.registry import open_robot
    from limo_driver.robot.robot import Robot
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import (
        ImpedanceCommand,
        JointState,
        Motion,
        PositionCommand,
        TorqueCommand,
        WrenchCommand,
    )

_HOME = {
    "ImpedanceCommand": "types",
    "JointState": "types",
    "LimoError": "errors",
    "Motion": "types",
    "PositionCommand": "types",
    "Recording": "recordings.recording",
    "Robot": "robot.robot",
    "RobotModel": "model",
    "Simulation": "physics",
    "TorqueCommand": "types",
    "Trajectory": "trajectory",
    "WrenchCommand": "types",
    "open_robot": "robot.registry",
}

__all__ = [
    "ImpedanceCommand",
    "JointState",
    "LimoError",
    "Motion",
    "PositionCommand",
    "Recording",
    "Robot",
    "RobotModel",
    "Simulation",
    "TorqueCommand",
    "Trajectory",
    "WrenchCommand",
    "open_robot",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
