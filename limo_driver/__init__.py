"""limo: driver, simulator and torque estimator for slow, force-sensitive robot arms.

```python
import limo_driver as limo

sim = limo.identify("iiwa14", "run.parquet").simulation
found = limo.diagnose(sim, "other.parquet")
print(found)
found.save("diagnosis/")
```

Values: RobotModel, Motion, Trajectory, Recording, Commanded, Simulation. Robots: open_robot, Robot,
JointState and commands. What to do with them: inspect, read, plan, excite, excite_servos, run,
simulate, simulate_dataset, identify, predict, predict_forward, train, sweep, evaluate, diagnose,
diagnose_fleet, export, external_wrench, contact_thresholds,
serve. Requests and settings say how: PlanRequest, Rows, ...

Where a recording is taken, so is the path of its file, and where several are, one alone or any
iterable; likewise simulations, trajectories, models and robots. Arguments that cannot be used raise
a `LimoError` that says what was given and what was expected. Examples in the help assume this
import, and `import numpy as np`.

The names are imported when they are first used, so that `import limo_driver` stays cheap.
"""

TYPE_CHECKING = False  # as in `typing`, which takes 10 ms, in which Ctrl-C would not be answered
if TYPE_CHECKING:
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.rigid_body import JointTerms, Rows
    from estimators.service.settings import RetrainingSettings, ServiceSettings
    from limo_driver.app.library.contacts import contact_thresholds, external_wrench
    from limo_driver.app.library.diagnosing import diagnose
    from limo_driver.app.library.exporting import export, export_c, export_onnx, export_ros2
    from limo_driver.app.library.fleets import diagnose_fleet
    from limo_driver.app.library.inspecting import inspect
    from limo_driver.app.library.learning import (
        evaluate,
        identify,
        load_model,
        nominal,
        predict,
        train,
    )
    from limo_driver.app.library.moving import Streaming, excite, excite_servos, plan, run
    from limo_driver.app.library.reading import read
    from limo_driver.app.library.serving import serve
    from limo_driver.app.library.simulating import predict_forward, simulate, simulate_dataset
    from limo_driver.app.library.sweeping import sweep
    from limo_driver.errors import LimoError
    from limo_driver.logs.mcap_log import LogLimits
    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.model import RobotModel
    from limo_driver.network.ros import RosTopic
    from limo_driver.physics import Simulation
    from limo_driver.recordings.commanded import Commanded
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
    from limopa import (
        ExcitationRequest,
        Exploring,
        PlanRequest,
        Reaching,
        ServoRequest,
        Surroundings,
        Workspace,
    )

    __version__: str

_NAMES = {  # by the module that has them
    "estimators.hybrid.training.settings": "TrainingSettings",
    "estimators.rigid_body": "JointTerms Rows",
    "estimators.service.settings": "RetrainingSettings ServiceSettings",
    "limo_driver.app.library.contacts": "contact_thresholds external_wrench",
    "limo_driver.app.library.diagnosing": "diagnose",
    "limo_driver.app.library.exporting": "export export_c export_onnx export_ros2",
    "limo_driver.app.library.fleets": "diagnose_fleet",
    "limo_driver.app.library.inspecting": "inspect",
    "limo_driver.app.library.learning": "evaluate identify load_model nominal predict train",
    "limo_driver.app.library.moving": "Streaming excite excite_servos plan run",
    "limo_driver.app.library.reading": "read",
    "limo_driver.app.library.serving": "serve",
    "limo_driver.app.library.simulating": "predict_forward simulate simulate_dataset",
    "limo_driver.app.library.sweeping": "sweep",
    "limo_driver.errors": "LimoError",
    "limo_driver.logs.mcap_log": "LogLimits",
    "limo_driver.logs.readers.mapping": "LogMapping",
    "limo_driver.model": "RobotModel",
    "limo_driver.network.ros": "RosTopic",
    "limo_driver.physics": "Simulation",
    "limo_driver.recordings.commanded": "Commanded",
    "limo_driver.recordings.recording": "Recording",
    "limo_driver.robot.registry": "open_robot",
    "limo_driver.robot.robot": "Robot",
    "limo_driver.trajectory": "Trajectory",
    "limo_driver.types": "ImpedanceCommand JointState Motion PositionCommand TorqueCommand "
    "WrenchCommand",
    "limopa": "ExcitationRequest Exploring PlanRequest Reaching ServoRequest Surroundings "
    "Workspace",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [
    "Commanded",
    "ExcitationRequest",
    "Exploring",
    "ImpedanceCommand",
    "JointState",
    "JointTerms",
    "LimoError",
    "LogLimits",
    "LogMapping",
    "Motion",
    "PlanRequest",
    "PositionCommand",
    "Reaching",
    "Recording",
    "RetrainingSettings",
    "Robot",
    "RobotModel",
    "RosTopic",
    "Rows",
    "ServiceSettings",
    "ServoRequest",
    "Simulation",
    "Streaming",
    "Surroundings",
    "TorqueCommand",
    "TrainingSettings",
    "Trajectory",
    "Workspace",
    "WrenchCommand",
    "contact_thresholds",
    "diagnose",
    "diagnose_fleet",
    "evaluate",
    "excite",
    "excite_servos",
    "export",
    "export_c",
    "export_onnx",
    "export_ros2",
    "external_wrench",
    "identify",
    "inspect",
    "load_model",
    "nominal",
    "open_robot",
    "plan",
    "predict",
    "predict_forward",
    "read",
    "run",
    "serve",
    "simulate",
    "simulate_dataset",
    "sweep",
    "train",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version("limo")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    from limo_driver.runtime.plugins import require_own_packages

    if name != "LimoError":  # by which to catch what this raises
        require_own_packages()
    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name[:2] == "__")})
