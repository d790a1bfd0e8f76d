"""`limo predict`: predict torque, or position from commands, of a recorded motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from limo_driver.app.console.command_line import MappingOption, describe_options
from limo_driver.app.console.terminal import terminal
from limo_driver.errors import ConfigError
from limo_driver.model.units import unit_of
from limo_driver.runtime.outputs import require_file, require_parquet, whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from estimators.base import Estimate
    from estimators.residual_model import ResidualModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.commanded import Commanded
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_UNITS = {"torque": "N m", "std": "N m", "position": "rad"}


@describe_options
def command(
    recording: Path,
    *,
    out: Path,
    sim: Path | None = None,
    model: Path | None = None,
    bandwidth: float | None = None,
    delay: float | None = None,
    free_running: bool = False,
    mapping: MappingOption = None,
    as_json: bool = False,
) -> None:
    """Predict the noise-free torque, or the positions, of a recorded motion, as Parquet.

    --out has one row for each row of the recording: time [s] and torque_1 … torque_n [N m], one
    column for each joint. Rows that cannot be used are empty and named.

    A model adds std_1 … std_n [N m], the standard deviation of its error, and outside_1 …
    outside_n, true where the motion is unlike what it learned from. With --delay, time is that of
    the torque, which is that much before the position that came with it.

    With --free-running, arm and drives are simulated forward from command_j, command_velocity_j or
    command_torque_j alone, from the first recorded position on: time [s] and position_1 …
    position_n [rad]. Other positions may be missing; where they are there, commands are held
    against them first.

    Args:
        recording: Recording: Parquet, CSV or limo's own log.
        out: Where to write torques or positions (Parquet).
        sim: The simulation, a sim.yaml.
        model: Or a model folder of `limo train`.
        bandwidth: Bandwidth of the differentiator, Hz; 10. A model has its own.
        delay: Predict what a live stream would have said this late, s; from the past alone.
        free_running: Predict positions instead: simulated forward from the commands alone.
        as_json: Print the rows used and left out as JSON.

    Examples:
        limo predict run.parquet --sim sim.yaml --out torque.parquet
        limo predict run.parquet --model model/ --delay 0.1 --out torque.parquet
        limo predict run.parquet --sim sim.yaml --free-running --out moved.parquet
    """
    from limo_driver.app.library.learning import predict
    from limo_driver.app.library.reading import read, read_commanded
    from limo_driver.app.library.simulating import simulate_forward

    require_file(out, [path for path in (recording, sim) if path is not None])
    require_parquet(out)
    if free_running:
        _check_free_running(model, bandwidth, delay)
    physics, learned = _load(sim, model, bandwidth)
    odd: tuple[str, ...] = ()
    if free_running:
        moved = simulate_forward(physics, read_commanded(recording, physics.model, mapping))
        measured, odd = moved.told, moved.warnings
        time, columns = measured.time, {"position": moved.position}
    else:
        measured = read(recording, physics.model, mapping)
        estimate = predict(learned or physics, measured, bandwidth=bandwidth, delay=delay)
        time, columns = getattr(estimate, "time", measured.time), _columns(estimate)
    write(measured, time, columns, out)
    if as_json:
        left_out = {item.reason: item.rows for item in measured.left_out}
        rows = {"used": len(measured), "left_out": left_out}
        warnings = [*measured.warnings, *odd]
        units = {
            name: [unit_of(_UNITS[name], physics.model.sliding, j) for j in range(measured.n)]
            for name in columns
            if name in _UNITS
        }
        terminal().print_json(
            data={"file": str(out), "units": units, "rows": rows, "warnings": warnings}
        )
        return
    notes = terminal(stderr=True, soft_wrap=True)
    for item in (*measured.warnings, *measured.left_out, *odd):
        notes.print(f"{recording}: {item}")
    terminal(soft_wrap=True).print(_written(out, measured, columns, physics.model.sliding))


def _check_free_running(model: Path | None, bandwidth: float | None, delay: float | None) -> None:
    """Refuse what is of torques alone.

    Raises:
        ConfigError: One of them is given.
    """
    given = {"--model": model, "--bandwidth": bandwidth, "--delay": delay}
    if named := [name for name, value in given.items() if value is not None]:
        raise ConfigError(
            f"{', '.join(named)} given with --free-running, expected --sim alone: positions are "
            "simulated, nothing is filtered, and delays are the drives' own"
        )


def _written(
    out: Path,
    recording: Recording | Commanded,
    columns: Mapping[str, NDArray[Any]],
    sliding: Sequence[bool],
) -> str:
    """Say what the file holds."""
    empty = recording.rows_total - len(recording)
    rows = f"{recording.rows_total} rows" + (f", {empty} of them empty" if empty else "")
    units = {name: f" [{unit_of(unit, sliding)}]" for name, unit in _UNITS.items()}
    named = ", ".join(f"{name}_1 … {name}_{recording.n}{units.get(name, '')}" for name in columns)
    return f"{out}: {rows}: time [s], {named}"


def _load(
    sim: Path | None, model: Path | None, bandwidth: float | None
) -> tuple[Simulation, ResidualModel[Any] | None]:
    """Return the simulation, and the model that adds to it, if one was given.

    Raises:
        ConfigError: Both or none were given, or a bandwidth to a model.
    """
    from limo_driver.physics import Simulation

    if (sim is None) == (model is None):
        given = "neither" if sim is None else "both"
        raise ConfigError(f"{given} of --sim and --model given, expected one of them")
    if sim is not None:
        return Simulation.load(sim), None
    if bandwidth is not None:
        raise ConfigError("--bandwidth is of --sim; a model has the bandwidth it was trained with")
    from estimators.model_folder import load_model

    assert model is not None  # noqa: S101  # one of them is there
    learned = load_model(model)
    return learned.simulation, learned


def _columns(estimate: Estimate) -> dict[str, NDArray[Any]]:
    """Return torque, and std and outside where they are known, (T, n) each."""
    import numpy as np

    if np.isnan(estimate.std).all():
        return {"torque": estimate.torque}
    return {"torque": estimate.torque, "std": estimate.std, "outside": estimate.outside}


def write(
    recording: Recording | Commanded,
    time: FloatArray,
    columns: Mapping[str, NDArray[Any]],
    path: Path,
) -> None:
    """Write one row for each row of the recorded file, empty where a row was left out.

    Args:
        recording: T samples of n joints.
        time: Of what is written, (T,) [s].
        columns: (T, n) each, by the name that stands before the number of the joint.
        path: To be written (Parquet).

    Raises:
        ConfigError: The file cannot be written.
    """
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    left_out = np.ones(recording.rows_total, dtype=bool)
    left_out[recording.rows] = False

    def spread(values: NDArray[Any]) -> NDArray[Any]:
        whole = np.zeros(recording.rows_total, values.dtype)
        whole[recording.rows] = values
        return whole

    arrays = {"time": time} | {
        f"{name}_{j + 1}": values[:, j]
        for name, values in columns.items()
        for j in range(recording.n)
    }
    table = {name: pa.array(spread(values), mask=left_out) for name, values in arrays.items()}
    with whole(path) as draft:
        pq.write_table(pa.table(table), draft, use_dictionary=False)
