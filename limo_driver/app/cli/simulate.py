"""`limo simulate`: many trajectories and seeds into a folder of recordings."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import Annotated

import typer

from limo_driver.app.console.terminal import Machines, OnOption, WorkersOption  # typer


def command(
    trajectories: Annotated[
        list[str], typer.Argument(help="Trajectories, or patterns of them; files or URLs.")
    ],
    sim: Annotated[Path, typer.Option(help="Physics of the arm, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Folder for the recordings.")],
    seeds: Annotated[
        int, typer.Option(min=1, help="How many recordings of each, with other sensor noise.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="The first seed; the others follow it.")] = 0,
    rate: Annotated[
        float | None, typer.Option(help="Record at this rate [Hz], a part of the control rate.")
    ] = None,
    workers: WorkersOption = None,
    on: OnOption = Machines.processes,
) -> None:
    """Simulate a data set: every trajectory with every seed, side by side.

    Writes <trajectory>_seed<k>.parquet for each. What is finished is kept, whatever happens; the
    same command goes on from there. The exit status is 1 where a trajectory could not be used.

    Example:
        limo simulate "plans/*.traj.parquet" --sim sim.yaml --seeds 10 --out data
    """
    from limo_driver.app.console.terminal import terminal, told_progress
    from limo_driver.app.library.simulating import simulate_dataset

    notes = terminal(stderr=True, soft_wrap=True)
    with told_progress(notes, "simulating") as tell:
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
