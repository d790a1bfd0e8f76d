"""`limo simulate`: many trajectories and seeds into a folder of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import (
    Machines,
    OnOption,
    WorkersOption,
    progress_lines,
    terminal,
)


@describe_options
def command(
    trajectories: list[str],
    *,
    sim: Path,
    out: Path,
    seeds: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    rate: float | None = None,
    workers: WorkersOption = None,
    on: OnOption = Machines.processes,
) -> None:
    """Simulate a data set: every trajectory with every seed, side by side.

    Writes <trajectory>_seed<k>.parquet for each. What is finished is kept, whatever happens; the
    same command goes on from there. The exit status is 1 where a trajectory could not be used.

    Args:
        trajectories: Trajectories, or patterns of them; files or URLs.
        sim: Physics of the arm, a sim.yaml.
        out: Folder for the recordings.
        seeds: How many recordings of each, with other sensor noise.
        seed: The first seed; the others follow it.
        rate: Record at this rate [Hz], a part of the control rate.

    Example:
        limo simulate "plans/*.traj.parquet" --sim sim.yaml --seeds 10 --out data
    """
    from limo_driver.app.library.simulating import simulate_dataset

    notes = terminal(stderr=True, soft_wrap=True)
    with progress_lines(notes, "simulating") as tell:
        made = simulate_dataset(
            sim,
            trajectories,
            out,
            range(seed, seed + seeds),
            rate=rate,
            workers=workers,
            on=on.value,
            progress=tell,
        )
    for run in made.failed:
        notes.print(f"{run.trajectory}, seed {run.seed}: {run.error}")
    terminal(soft_wrap=True).print(str(made))
    if made.failed:
        raise typer.Exit(1)
