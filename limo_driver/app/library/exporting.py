"""Export what was found: a simulation for other simulators, an estimator as C or ONNX."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from limo_driver.app.library.inputs import estimator_of, recording_of, simulation_of, trained_of
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators import CodeExport, ResidualModel
    from limo_driver.exports.export import Export
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

_FILES: Final = {".xml": "mjcf", ".urdf": "urdf", ".usda": "usd"}  # by ending


def format_for(out: Path | str, own: str) -> str:
    """Return the target that the name of a file to be written means: one of `mjcf`, `urdf`, `usd`.

    Args:
        out: A file, or a folder, into which a copy of the robot's own file goes.
        own: Kind of the robot's description, in capitals.

    Raises:
        ConfigError: Its ending is that of no format, or of one that only lies over a file.
    """
    path = Path(out)
    found = _FILES.get(path.suffix, own.lower())
    if path.suffix and path.suffix not in _FILES and not path.is_dir():
        raise ConfigError(
            f"cannot be written: its ending is {path.suffix}, expected {', '.join(_FILES)} or a "
            "folder",
            path=path,
        )
    if found == "usd" != own.lower():
        raise ConfigError(f"an export to USD is a layer over a USD file; the robot is {own}")
    return found


def export(
    simulation: Simulation | Path | str,
    to: str,
    out: Path | str,
    into: Path | str | None = None,
    on: Recording | Path | str | None = None,
    mujoco: int | None = None,
) -> Export:
    """Write a simulation into a copy of a MuJoCo or URDF file, and prove that it is in it.

    Only what differs in the simulation changes, by however little: inertias, a payload as a body,
    dry friction, damping, armature, springs and gravity, as far as the format has them. Comments,
    names and order stay. The copy is then read by MuJoCo or pinocchio alone, whose torque on a
    minute of motion is compared with the prediction.

    Args:
        simulation: What was found, or its sim.yaml.
        to: `mjcf`, `urdf`, `drake` (a URDF with rotor inertias) or `isaaclab` (a URDF, and
            actuators in Python beside it), or `usd` (a layer over the file).
        out: Folder for the copy, and for meshes and files that it includes; or the copy itself, if
            its name ends in .xml or .urdf.
        into: The file; that of the simulation's robot if not given, where it is of that format,
            else a bare one is made.
        on: Recording on whose motion the size of what cannot be expressed is counted; a minute
            through most of the joints' range if not given.
        mujoco: Release that shall read an MJCF file, 3 or 4: the latter has slip elements, the
            former one bristle in their place; the installed one if not given.

    Returns:
        The files, a diff, what is not expressed with its size, and the proof.

    Raises:
        ConfigError: No such format, the file is of another arm, or cannot be written.

    Example:
        >>> sim = limo.Simulation.load("sim.yaml")
        >>> print(limo.export(sim, "mjcf", "exported/"))
    """
    from limo_driver.exports.export import write
    from limo_driver.exports.xml_edits import KINDS, MJCF, USD, edited_format
    from limo_driver.recordings.bandwidth import bandwidth_for
    from limo_driver.runtime.installed_mujoco import RELEASE, RELEASES

    release = mujoco or RELEASE[0]
    if mujoco not in (None, *RELEASES):
        raise ConfigError(f"`mujoco` is {mujoco}, expected {' or '.join(map(str, RELEASES))}")
    if to not in KINDS:
        raise ConfigError(f"there is no export to {to!r}, expected one of {', '.join(KINDS)}")
    found = simulation_of(simulation)
    recorded = None if on is None else recording_of(on)
    motion = (
        None
        if recorded is None
        else recorded.motion(bandwidth_for([recorded], found=found.bandwidth))
    )
    folder, name = Path(out), ""
    if folder.suffix in _FILES:
        if _FILES[folder.suffix] != edited_format(to):
            raise ConfigError(
                f"ends in {folder.suffix}, but an export to {to} is {edited_format(to).upper()}",
                path=folder,
            )
        folder, name = folder.parent, folder.name
    own = found.model.description
    if into is None and own.kind.lower() == edited_format(to):
        into = found.model.urdf
    if into is not None:
        return write(found, Path(into), to, folder, motion, name, release)
    if to == USD:
        raise ConfigError("an export to usd is a layer over a USD file: give it with `into`")
    with TemporaryDirectory() as bare_folder:
        bare = Path(bare_folder) / f"{found.model.urdf.stem}.{'xml' if to == MJCF else 'urdf'}"
        bare.write_text(_bare(found, to), encoding="utf-8")
        written = write(found, bare, to, folder, motion, name, release)
        return replace(written, diff=f"{written.file.name} is new\n")


def _bare(simulation: Simulation, to: str) -> str:
    """Return the robot as a file of a format that its own is not of."""
    from limo_driver.exports.xml_edits import MJCF

    if to != MJCF:
        return simulation.model.description.text
    from backends.mujoco_sim.scene import bare_mjcf

    return bare_mjcf(simulation.model)


def export_c(
    model: ResidualModel[Any] | Simulation | Path | str,
    out: Path | str,
    rate: float | None = None,
    delay: float = 0.1,
    false_alarms: float = 1.0,
    name: str = "limo",
    free: Sequence[Recording | Path | str] = (),
) -> CodeExport:
    """Write the estimator of a stream as one C11 file and its header.

    The code allocates nothing, and needs nothing but the C library's mathematics. It has the rigid
    body, the joint effects with their memory, the filter on live motion, what was learned with its
    standard deviation, external torque, and contact where free motion is given.

    Args:
        model: A fitted model or a simulation, or the folder of one or the sim.yaml of the other.
        out: Folder for `<name>.h` and `<name>.c`.
        rate: Of the positions that the code will be given [Hz]; that of `free`, else 1000.
        delay: By which its estimates are late [s], see `Stream`.
        false_alarms: Of contact on the whole arm, that are bearable [1/h].
        name: Of the files, and with which all names in them begin.
        free: Recordings at this rate of motion that nothing touched and the model was not trained
            on. Their errors say where a contact begins; without any, the code has no contact.

    Returns:
        The files, with what they were made for.

    Raises:
        ConfigError: An effect, a network or the name has no form in C, the delay or rate does not
            suit the model, or the files cannot be written.
        RecordingError: A recording has another rate or robot, or is too short.
        ModelStoreError: The folder is incomplete, or its memory cannot have this rate.

    Example:
        >>> print(limo.export_c("sim.yaml", "firmware/", rate=1000.0))
    """
    from estimators.embedded.export import export_c as written

    recordings, rate = _free(free, rate)
    return written(estimator_of(model)[0], out, rate, delay, false_alarms, name, recordings)


def export_ros2(
    model: ResidualModel[Any] | Simulation | Path | str,
    out: Path | str,
    rate: float | None = None,
    delay: float = 0.1,
    false_alarms: float = 1.0,
    name: str = "limo",
    free: Sequence[Recording | Path | str] = (),
    frame: str = "",
) -> CodeExport:
    """Write a colcon package of ROS 2 around what `export_c` writes.

    It has an implementation of inverse_dynamics_solver's interface, and a controller of
    ros2_control that publishes external torques and the wrench which explains them.

    Args:
        model: A fitted model or a simulation, or the folder of one or the sim.yaml of the other.
        out: Folder of the package, for example `ws/src/limo_dynamics`.
        rate: Of the controller manager [Hz]; likewise.
        delay: By which estimates and wrenches are late [s].
        false_alarms: Of contact on the whole arm, that are bearable [1/h].
        name: With which all names begin; the package is `<name>_dynamics`.
        free: See `export_c`.
        frame: Of the wrench, a link or site fixed to the last link; the flange if empty.

    Returns:
        The C in it, with what it was made for.

    Raises:
        ConfigError: As for `export_c`, or the arm has no such frame.

    Example:
        >>> print(limo.export_ros2("sim.yaml", "ws/src/limo_dynamics", rate=1000.0))
    """
    from estimators.embedded.ros2_package import export_ros2 as written

    recordings, rate = _free(free, rate)
    return written(estimator_of(model)[0], out, rate, delay, false_alarms, name, recordings, frame)


def _free(
    given: Sequence[Recording | Path | str], rate: float | None
) -> tuple[list[Recording], float]:
    """Return free motion, and the rate [Hz]: as a loop has it, to three digits."""
    found = [recording_of(item) for item in given]
    return found, rate or (float(f"{found[0].rate:.3g}") if found else 1000.0)


def export_onnx(
    model: ResidualModel[Any] | Path | str, out: Path | str, name: str = "limo"
) -> Path:
    """Write the network of a model as ONNX: its features in, what it adds to the simulation out.

    What makes features of motion, and the simulation, are not in it: `export_c` has all.

    Args:
        model: A fitted model with a network, or its folder.
        out: Folder for `<name>.onnx`.
        name: Of the file.

    Returns:
        The file.

    Raises:
        ConfigError: The model has no network or one without a form in ONNX, the extra `limo[onnx]`
            is not installed, or the file cannot be written.
        ModelStoreError: The folder is incomplete.

    Example:
        >>> limo.export_onnx("model/", "network/")
    """
    from estimators.embedded.onnx_graph import write_onnx

    path = Path(out) / f"{name}.onnx"
    write_onnx(trained_of(model) if isinstance(model, (Path, str)) else model, path)
    return path
