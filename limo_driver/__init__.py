"""limo: driver, simulator and torque estimator for slow, force-sensitive robot arms.

```python
import limo_driver as limo

data = limo.Recording.from_arrays(time, position, torque)
sim = limo.identify("iiwa14", [data]).simulation
found = limo.diagnose(sim, [other])
print(found)
found.save("diagnosis/")
```

Values: RobotModel, Motion, Trajectory, Recording, Simulation. Robots: open_robot, Robot, JointState
and commands. What to do with them: plan, excite, run, identify, predict, train, evaluate, diagnose,
serve.

The names are imported when they are first used, so that `import limo_driver` stays cheap.
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
    from limo_driver.workflow.diagnosing import diagnose
    from limo_driver.workflow.learning import evaluate, identify, load_model, predict, train
    from limo_driver.workflow.planning import excite, plan
    from limo_driver.workflow.running import Streaming, run
    from limo_driver.workflow.serving import serve
    from limopa import ExcitationRequest, PlanRequest

    __version__: str

_HOME = {
    "ExcitationRequest": "limopa",
    "ImpedanceCommand": "limo_driver.types",
    "JointState": "limo_driver.types",
    "LimoError": "limo_driver.errors",
    "Motion": "limo_driver.types",
    "PlanRequest": "limopa",
    "PositionCommand": "limo_driver.types",
    "Recording": "limo_driver.recordings.recording",
    "Robot": "limo_driver.robot.robot",
    "RobotModel": "limo_driver.model",
    "Simulation": "limo_driver.physics",
    "Streaming": "limo_driver.workflow.running",
    "TorqueCommand": "limo_driver.types",
    "Trajectory": "limo_driver.trajectory",
    "WrenchCommand": "limo_driver.types",
    "diagnose": "limo_driver.workflow.diagnosing",
    "evaluate": "limo_driver.workflow.learning",
    "excite": "limo_driver.workflow.planning",
    "identify": "limo_driver.workflow.learning",
    "load_model": "limo_driver.workflow.learning",
    "open_robot": "limo_driver.robot.registry",
    "plan": "limo_driver.workflow.planning",
    "predict": "limo_driver.workflow.learning",
    "run": "limo_driver.workflow.running",
    "serve": "limo_driver.workflow.serving",
    "train": "limo_driver.workflow.learning",
}

__all__ = [
    "ExcitationRequest",
    "ImpedanceCommand",
    "JointState",
    "LimoError",
    "Motion",
    "PlanRequest",
    "PositionCommand",
    "Recording",
    "Robot",
    "RobotModel",
    "Simulation",
    "Streaming",
    "TorqueCommand",
    "Trajectory",
    "WrenchCommand",
    "diagnose",
    "evaluate",
    "excite",
    "identify",
    "load_model",
    "open_robot",
    "plan",
    "predict",
    "run",
    "serve",
    "train",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version("limo")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
