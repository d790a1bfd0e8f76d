"""Write an estimator as a ROS 2 package: the C, plug-ins around it, and what builds and starts it.

The plug-ins stand in `ros2/` as they are compiled, for a model called limo; of
the robot they have names and kinematics.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from estimators.base import LiveEstimator
from estimators.embedded.contact import FALSE_ALARMS
from estimators.embedded.export import NAME, CodeExport, export_c, named, simulation_of
from estimators.embedded.tables import table
from estimators.rigid_body.regressor import RegressorChain
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.kinematics import FlangeWrench
from limo_driver.physics import Simulation
from limo_driver.quoting import in_c_string, in_xml
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.outputs import require_folder, whole

_TEMPLATES: Final = Path(__file__).parent / "ros2"
_MARK: Final = re.compile("@(robot|frame|tables)@")
_CONFIG: Final = "config/wrench_broadcaster.yaml"


def export_ros2(
    model: LiveEstimator | Simulation,
    folder: Path | str,
    rate: float,
    delay: float = 0.1,
    false_alarms: float = FALSE_ALARMS,
    name: str = NAME,
    free: Sequence[Recording] = (),
    frame: str = "",
) -> CodeExport:
    """Write a colcon package around the C of an estimator; see `export_c` for what is not here.

    Args:
        model: Fitted or loaded, or a bare simulation.
        folder: Of the package.
        rate: Of the controller that publishes wrenches [Hz].
        delay: By which they are late [s].
        false_alarms: Of contact, on the whole arm [1/h].
        name: With which all names begin, that of the package, too.
        free: Motion that nothing touched.
        frame: Of the wrench, a link or site fixed to the last link; the flange if empty.

    Raises:
        ConfigError: The arm has no such frame or no form in C, or a file cannot be written.
    """
    simulation = model if isinstance(model, Simulation) else simulation_of(model)
    out = Path(folder)
    wrench = FlangeWrench(simulation.model, frame)
    values = {
        "@robot@": in_xml(Path(simulation.robot).name),
        "@frame@": in_xml(wrench.frame),
        "@tables@": _tables(simulation.model, wrench.frame),
    }
    written = {
        str(file.relative_to(_TEMPLATES)).removesuffix(".in"): _MARK.sub(
            lambda mark: values[mark[0]], named(file.read_text("utf-8"), name)
        )
        for file in sorted(_TEMPLATES.rglob("*"))
        if file.is_file()
    }
    written[_CONFIG] = yaml.safe_dump(_parameters(simulation.model, wrench.frame, name))
    for path in written:
        (out / path).parent.mkdir(parents=True, exist_ok=True)
    require_folder(out, "a ROS 2 package", tuple(written))
    code = export_c(model, out / "src", rate, delay, false_alarms, name, free)
    for path, text in written.items():
        with whole(out / path) as draft:
            draft.write_text(text, encoding="utf-8")
    return code


def _parameters(model: RobotModel, frame: str, name: str) -> dict[str, Any]:
    """Return the controller's parameters, which may be changed where links have a prefix."""
    parameters = {
        "type": f"{name}_dynamics/WrenchBroadcaster",
        "joints": list(model.joint_names),
        "frame_id": frame,
    }
    return {f"{name}_wrench_broadcaster": {"ros__parameters": parameters}}


def _tables(model: RobotModel, frame: str) -> str:
    """Return names of joints and frame, and kinematics, as C++.

    Raises:
        ConfigError: Links of the arm follow others.
    """
    chain = RegressorChain.of(model)
    if not chain.linkage.is_plain:
        raise ConfigError(f"links of {model.name} follow other joints, which has no form in C")
    place = model.last_frames[frame]
    names = ", ".join(map(in_c_string, model.joint_names))
    return (
        "inline const std::vector<std::string> &joint_names() {\n"
        f"  static const std::vector<std::string> names{{{names}}};\n  return names;\n}}\n"
        f"inline std::string frame_name() {{ return {in_c_string(frame)}; }}\n"
        + table("joint_turn", chain.rotation)
        + table("joint_place", chain.translation)
        + table("joint_axis", np.ascontiguousarray(chain.axis[:, 3:]))
        + table("frame_turn", np.ascontiguousarray(place[:3, :3]))
        + table("frame_place", np.ascontiguousarray(place[:3, 3]))
    )
