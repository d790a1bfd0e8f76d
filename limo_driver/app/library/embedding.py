"""A model in somebody else's control loop: the estimator as C, its network as ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from limo_driver.app.library.inputs import recording_of, simulation_of, trained_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators import CodeExport, ResidualModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording


def export_c(
    model: ResidualModel[Any] | Simulation | Path | str,
    out: Path | str,
    rate: float = 1000.0,
    delay: float = 0.1,
    false_alarms: float = 1.0,
    name: str = "limo",
    free: Sequence[Recording | Path | str] = (),
) -> CodeExport:
    """Write the estimator of a stream as one C11 file and its header.

    The code allocates nothing, and needs nothing but the C library's mathematics. It has the rigid
    body, the joint effects with their memory, the filter on live motion, what was learned with its
    standard deviation, external torque and contact.

    Args:
        model: A fitted model or a simulation, or the folder of one or the sim.yaml of the other.
        out: Folder for `<name>.h` and `<name>.c`.
        rate: Of the positions that the code will be given [Hz].
        delay: By which its estimates are late [s], see `Stream`.
        false_alarms: Of contact on the whole arm, that are bearable [1/h].
        name: Of the files, and with which all names in them begin.
        free: Recordings at this rate of motion that nothing touched and the model was not trained
            on. Their errors say where a contact begins; without any, errors are taken for normal,
            which errors at reversals are not.

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

    if isinstance(model, (Path, str)):
        model = trained_of(model) if Path(model).is_dir() else simulation_of(model)
    estimator: Any = model
    recordings = [recording_of(item) for item in free]
    return written(estimator, out, rate, delay, false_alarms, name, recordings)


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
