"""`limo export`: what was found, in a copy of the user's own MJCF or URDF."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import MappingOption, describe_options
from limo_driver.app.console.terminal import say, terminal
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from estimators.embedded.export import CodeExport
    from limo_driver.exports.export import Export
    from limo_driver.recordings.recording import Recording


@describe_options
def command(
    sim: Path,
    *,
    to: str,
    out: Path,
    into: Path | None = None,
    on: Path | None = None,
    rate: float | None = None,
    delay: float = 0.1,
    false_alarms: float = 1.0,
    free: list[Path] | None = None,
    mapping: MappingOption = None,
    mujoco: int | None = None,
    name: str = "limo",
    frame: Annotated[str, typer.Option("--wrench-frame", metavar="LINK")] = "",
    as_json: bool = False,
) -> None:
    """Write a simulation into a copy of a MuJoCo or URDF file; only what differs in it changes.

    That is every value in which the simulation differs from the file, by however little, whether
    the diagnosis that wrote it reports the value or not. The rest of the file stays byte by byte.

    For Drake, a URDF has rotor inertias; for Isaac Lab, friction and armature stand in a file of
    Python beside it; of USD, a layer over the file
    is written, with friction, armature and drives as PhysX, Newton and Isaac Lab 3 have them.

    Inertias, a payload as a body, dry friction, damping, armature, springs and gravity are written
    where the format has them. The difference is shown, and the size of what the format has no
    number for. MuJoCo, or pinocchio for a URDF, then reads the copy alone: its torque on a minute
    of motion is compared with the prediction.

    With `--to c`, the estimator of a model or simulation is written as a C11 file and its header,
    for a control loop of your own; with `--to ros2`, a colcon package around it, with plug-ins of
    inverse_dynamics_solver and ros2_control; with `--to onnx`, the network of a model by itself.

    Args:
        sim: The simulation, a sim.yaml; for C, ROS 2 also a model/, for ONNX a model/ only.
        to: Format: mjcf, urdf, drake, isaaclab or usd; or c, ros2, onnx.
        out: Folder for the copy, or the copy (.xml, .urdf); for C, ROS 2 and ONNX a folder.
        into: File to write into a copy of; the robot's own if not given.
        on: Log of motion on which what cannot be expressed is counted.
        rate: C: rate of the positions [Hz]; that of --free, else 1000.
        delay: C: by which estimates are late [s].
        false_alarms: C: false alarms of contact that are bearable [1/h].
        free: C: log of motion that nothing touched, which contact needs; several times.
        mujoco: MJCF: release that shall read it, 3 or 4; the installed one if not given.
        name: C, ONNX: of the files; in C all names in them begin with it.
        frame: ROS 2: link or site fixed to the last link, of the wrench; else the flange.
        as_json: Print the result as JSON.

    Examples:
        limo export sim.yaml --to mjcf --into model.xml --out improved/
        limo export diagnosis/sim.yaml --to urdf --out improved/
        limo export sim.yaml --to c --free calm.parquet --out firmware/
        limo export model/ --to ros2 --out ws/src/limo_dynamics
    """
    if to == "onnx":
        from limo_driver.app.library.exporting import export_onnx

        file = export_onnx(sim, out, name)
        say(json.dumps({"files": [str(file)]}) if as_json else str(file))
        return
    if frame and to != "ros2":
        raise ConfigError(f"--wrench-frame is of --to ros2, not of --to {to}")
    if to in {"c", "ros2"}:
        from limo_driver.app.library.exporting import export_c, export_ros2

        calm = read_all(free or [], sim, mapping)
        given = (sim, out, rate, delay, false_alarms, name, calm)
        _show_code(export_c(*given) if to == "c" else export_ros2(*given, frame), as_json=as_json)
        return
    from limo_driver.app.library.exporting import export

    (recorded,) = read_all([on], sim, mapping) if on else (None,)
    found = export(sim, to, out, into, recorded, mujoco)
    if as_json:
        _print_json(found)
    else:
        show(found)


def read_all(logs: list[Path], model: Path, mapping: Path | None) -> list[Recording]:
    """Return logs of the arm of a model or simulation, of any format.

    Raises:
        ConfigError: A question about a log is open, or the model is none.
        RecordingError: A log cannot be used.
    """
    from limo_driver.app.library.inputs import estimator_of
    from limo_driver.app.library.reading import read

    if not logs:
        return []
    robot = estimator_of(model)[1].model
    return [read(log, robot, mapping) for log in logs]


def _show_code(found: CodeExport, *, as_json: bool) -> None:

    if as_json:
        values = {
            "files": [str(found.header), str(found.source)],
            "rate": found.rate,
            "delay": found.delay,
            "contact": None if found.contact is None else found.contact.values(),
        }
        terminal().print_json(data=values)
    else:
        terminal(soft_wrap=True).print(str(found))


def _print_json(found: Export) -> None:

    values = {
        "file": str(found.file),
        "files": [str(path) for path in found.files],
        "diff": found.diff,
        "not_expressed": {item.place: list(item.rms) for item in found.remainder},
        "kept": list(found.kept),
        "dropped": list(found.dropped),
        "unwritten": list(found.unwritten),
        "needs": found.needs,
        "difference": list(found.error),
        "torque": list(found.torque),
        "share": found.share,
    }
    terminal().print_json(data=values)


def show(found: Export) -> None:
    """Print what an export wrote."""
    console = terminal(soft_wrap=True)
    for line in (*found.diff.splitlines(), *str(found).splitlines()):
        console.print(line)
