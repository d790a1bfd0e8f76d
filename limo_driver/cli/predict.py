"""`limo predict`: what a simulation says the recorded torque is."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray


def command(
    recording: Annotated[Path, typer.Argument(help="Recording: Parquet, CSV or limo's own log.")],
    sim: Annotated[Path, typer.Option(help="The simulation, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Where to write the torques (Parquet).")],
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase differentiator [Hz].")
    ] = 10.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the rows used and left out as JSON.")
    ] = False,
) -> None:
    """Predict the noise-free torque of a recorded motion: columns time, torque_1 … torque_n.

    One row for each row of the recording; rows that cannot be used are NaN and named.

    [bold]Example[/bold]

        limo predict run.parquet --sim sim.yaml --out torque.parquet
    """
    import json

    from rich.console import Console

    from limo_driver.outputs import require_file
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording

    require_file(out, [recording, sim])
    simulation, measured = Simulation.load(sim), Recording.load(recording)
    measured.check_robot(simulation.model)
    torque = simulation.predict_recording(measured, bandwidth)
    write_torque(measured, torque, out)
    if as_json:
        left_out = {item.reason: item.rows for item in measured.left_out}
        rows = {"used": len(measured), "left_out": left_out}
        Console().print_json(
            json.dumps({"file": str(out), "rows": rows, "warnings": measured.warnings})
        )
        return
    notes = Console(stderr=True, soft_wrap=True, highlight=False)
    for warning in measured.warnings:
        notes.print(f"{recording}: {warning}", markup=False)
    for item in measured.left_out:
        notes.print(f"{recording}: {item}", markup=False)


def write_torque(recording: Recording, torque: FloatArray, path: Path) -> None:
    """Write one row for each row of the recorded file; NaN where a row was left out."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    from limo_driver.errors import ConfigError

    time = np.full(recording.rows_total, np.nan)
    values = np.full((recording.rows_total, recording.n), np.nan)
    time[recording.rows], values[recording.rows] = recording.time, torque
    columns = {"time": time} | {f"torque_{j + 1}": values[:, j] for j in range(recording.n)}
    try:
        pq.write_table(pa.table(columns), path, use_dictionary=False)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror or error}", path=path) from None
