"""`limo predict`: what a simulation says the recorded torque is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    recording: Annotated[Path, typer.Argument(help="Recording: Parquet, CSV or limo's own log.")],
    sim: Annotated[Path, typer.Option(help="The simulation, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Where to write the torques (Parquet).")],
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase differentiator [Hz].")
    ] = 10.0,
) -> None:
    """Predict the noise-free torque of a recorded motion: columns time, torque_1 … torque_n.

    One row for each row of the recording; rows that cannot be used are NaN and counted.

    [bold]Example[/bold]

        limo predict run.parquet --sim sim.yaml --out torque.parquet
    """
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording

    raise NotImplementedError(recording, sim, out, bandwidth, Simulation, Recording)
