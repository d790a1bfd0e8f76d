"""`limo train`: a hybrid from recordings and a simulation."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from estimators.hybrid import FittedNetwork
    from estimators.training import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording


def command(  # one argument for each option
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one robot.")],
    sim: Annotated[Path, typer.Option(help="The identified simulation, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Model folder to write.")],
    model: Annotated[str, typer.Option(help="Network: mlp7, lstm-fcl.")] = "mlp7",
    features: Annotated[
        str,
        typer.Option(
            help="Inputs: all-joints (the paper's), own-joint (a network for each joint sees that "
            "joint only), drive (also what friction and elasticity of a drive depend on)."
        ),
    ] = "all-joints",
    epochs: Annotated[int, typer.Option(help="Passes over the recordings.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed; the same gives the same weights.")] = 0,
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase filter on motion and torque [Hz].")
    ] = 10.0,
    rate: Annotated[
        float,
        typer.Option(help="Rate of the network's samples [Hz]; faster recordings are thinned."),
    ] = 200.0,
    sequence_length: Annotated[
        int, typer.Option(help="Samples that an LSTM is differentiated through.")
    ] = 100,
    batch: Annotated[int, typer.Option(help="Rows (mlp7) or sequences (lstm-fcl) of a step.")] = 50,
    hidden: Annotated[int, typer.Option(help="Hidden units of a network; 0: as the paper.")] = 0,
    schedule: Annotated[
        str, typer.Option(help="How the step shrinks: cosine, plateau (the paper's).")
    ] = "cosine",
    learning_rate: Annotated[float, typer.Option(help="Initial step of AdamW.")] = 1e-3,
    weight_decay: Annotated[float, typer.Option(help="Weight decay of AdamW.")] = 0.01,
    held_out: Annotated[
        float, typer.Option(help="Part of the motion, in blocks, that training does not see.")
    ] = 0.2,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Train a network on the torque that a simulation leaves unexplained.

    Together they are the hybrid tau_HYB = tau_RBD + F_NN(q, dq, ddq, r, tau_RBD), with r the
    rotation since the last reversal. The folder holds weights, manifest and simulation, and is
    all that `limo evaluate` needs.

    [bold]Examples[/bold]

        limo train run.parquet --sim sim.yaml --model lstm-fcl --out model/

        limo train a.parquet b.parquet --sim sim.yaml --features drive --epochs 40 --out model/
    """
    import json

    from rich.console import Console

    from estimators.hybrid import HybridModel
    from estimators.training import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording

    settings = TrainingSettings(
        model=model,
        features=features,
        epochs=epochs,
        seed=seed,
        bandwidth=bandwidth,
        rate=rate,
        sequence_length=sequence_length,
        batch=batch,
        schedule=schedule,
        learning_rate=learning_rate,
        weight_decay=weight_decay,
        held_out=held_out,
        hidden=hidden,
    )
    simulation = Simulation.load(sim)
    measured = [Recording.load(path) for path in recordings]
    notes = Console(stderr=True, soft_wrap=True, highlight=False)
    for recording in measured:
        for item in recording.left_out:
            notes.print(
                f"{recording.source}: {len(item.rows)} rows left out: {item.reason}", markup=False
            )
    hybrid = HybridModel(simulation, settings)
    hybrid.fitted_ = _train(simulation, measured, settings, notes)
    hybrid.save(out)
    rmse = hybrid.fitted.record["rmse"]
    if as_json:
        Console().print_json(json.dumps({"model": str(out), "rmse": rmse}))
        return
    _print(rmse, bandwidth, Console(highlight=False))


def _train(
    simulation: Simulation, recordings: list[Recording], settings: TrainingSettings, notes: Console
) -> FittedNetwork:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from estimators.training import Epoch, train

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=notes, transient=True) as progress:
        bar = progress.add_task("computing inputs", total=settings.epochs)

        def on_epoch(epoch: Epoch) -> None:
            progress.update(
                bar,
                completed=epoch.number,
                description=f"epoch {epoch.number}/{settings.epochs}  "
                f"loss {epoch.training_loss:.4f}  held-out {epoch.held_out_loss:.4f}",
            )

        return train(simulation, recordings, settings, on_epoch)


def _print(rmse: dict[str, dict[str, list[float]]], bandwidth: float, console: Console) -> None:
    from rich.table import Table

    table = Table(title=f"RMSE [N m] against torque filtered at {bandwidth:g} Hz")
    table.add_column("joint", justify="right")
    for where in ("training", "held-out"):
        table.add_column(f"rigid body, {where}", justify="right")
        table.add_column(f"hybrid, {where}", justify="right")
    columns = [
        rmse[where][name] for where in ("training", "held_out") for name in ("rigid_body", "hybrid")
    ]
    for j, values in enumerate(zip(*columns, strict=True)):
        table.add_row(str(j + 1), *(f"{value:.4f}" for value in values))
    console.print(table)
