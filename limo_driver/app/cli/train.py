"""`limo train`: a model from recordings and a simulation."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from limo_driver.app.console.arguments import MappingOption, refuse_options
from limo_driver.app.console.terminal import (
    Machines,  # typer
    OnOption,
    WorkersOption,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.residual_model import ResidualModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

OPTIONS: Final = frozenset(
    ("recordings", "sim", "out", "mapping", "as_json", "sweep", "test", "workers", "on")
)


def command(  # one argument for each option
    context: typer.Context,
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one robot.")],
    sim: Annotated[Path, typer.Option(help="The identified simulation, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Model folder to write.")],
    model: Annotated[
        str,
        typer.Option(
            help="joint-physics, or a network: mlp7, lstm-2, lstm-fcl, transformer; or an "
            "estimator that another package registers."
        ),
    ] = "mlp7",
    features: Annotated[
        str,
        typer.Option(
            help="Inputs: all-joints (the paper's), own-joint (a network for each joint sees that "
            "joint only), drive (of that joint, what friction and elasticity of a drive depend on)."
        ),
    ] = "all-joints",
    epochs: Annotated[
        int | None, typer.Option(help="Passes over the recordings; 100, or 20 with drive.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed; the same gives the same weights.")] = 0,
    bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bandwidth of the zero-phase filter on motion and torque [Hz]; if not given, that "
            "of the simulation, or 10 unless another predicts motion held out much better."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Rate of the network's samples [Hz], to which faster recordings are thinned; "
            "200, or 50 with drive."
        ),
    ] = None,
    sequence_length: Annotated[
        int,
        typer.Option(
            help="Samples that an LSTM is differentiated through, or a transformer looks back over."
        ),
    ] = 100,
    batch: Annotated[int, typer.Option(help="Rows (mlp7) or sequences (others) of a step.")] = 50,
    hidden: Annotated[int, typer.Option(help="Hidden units of a network; 0: as the paper.")] = 0,
    layers: Annotated[
        int, typer.Option(help="LSTM layers of lstm-fcl, 1 or 2; of a transformer's coders.")
    ] = 1,
    schedule: Annotated[
        str, typer.Option(help="How the step shrinks: cosine, plateau (the paper's).")
    ] = "cosine",
    learning_rate: Annotated[
        float | None, typer.Option(help="Initial step of AdamW; 1e-3, or 3e-3 with drive.")
    ] = None,
    weight_decay: Annotated[float, typer.Option(help="Weight decay of AdamW.")] = 0.01,
    held_out: Annotated[
        float, typer.Option(help="Part of the motion, in blocks, that training does not see.")
    ] = 0.2,
    folds: Annotated[
        int,
        typer.Option(
            help="Stretches of motion, each predicted by a network that did not see it, that judge "
            "the gain of each joint; 1: none do, and the gain is 1."
        ),
    ] = 3,
    device: Annotated[
        str, typer.Option(help="cpu, cuda, or auto: a GPU if there is one, but for an mlp7.")
    ] = "auto",
    mapping: MappingOption = None,
    sweep: Annotated[
        Path | None,
        typer.Option(help="Train with every setting of this space.yaml; OUT is a folder of all."),
    ] = None,
    test: Annotated[
        list[Path] | None,
        typer.Option(help="With --sweep: recording on which each network is evaluated."),
    ] = None,
    workers: WorkersOption = None,
    on: OnOption = Machines.processes,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    r"""Learn the torque that a simulation leaves unexplained, by a network or by joint physics.

    Simulation and network are the hybrid tau_HYB = tau_RBD + F_NN(q, dq, ddq, r, tau_RBD), with r
    the rotation since the last reversal. Its part is scaled, joint by joint, by how much of it is
    confirmed by motion not trained on. joint-physics is no network: it fits friction, hysteresis,
    elasticity and errors of the rigid body joint by joint in closed form, needs little motion, and
    says how sure it is. The folder holds weights, manifest and simulation, and is all that
    `limo evaluate` needs.

    With --sweep, a space.yaml says what is tried, such as `hidden: [8, 16]` or `learning_rate:
    {from: 3e-4, to: 1e-2, scale: log}` with `draws: 4`: every combination. What is trained is kept,
    and the same command goes on. OUT gets results.parquet, sweep.html, and the best model as best/.

    Examples:
        limo train run.parquet --sim sim.yaml --model lstm-fcl --out model/
        limo train a.parquet b.parquet --sim sim.yaml --features drive \
            --out model/
        limo train run.parquet --sim sim.yaml --model joint-physics --out model/
        limo train run.parquet --sim sim.yaml --sweep space.yaml --out sweep/
    """
    import json
    from dataclasses import replace

    from estimators.hybrid.training.settings import usual_settings
    from estimators.neural import NETWORKS
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth
    from limo_driver.app.console.terminal import terminal
    from limo_driver.app.library.inputs import require_model
    from limo_driver.app.library.reading import read

    require_model(model)
    if sweep is not None:
        refuse_options(context, OPTIONS, "is said in the space of a sweep, not beside --sweep")
        simulation, measured, _ = _load(recordings, sim, out, mapping)
        tests = [read(path, simulation.model, mapping) for path in test or ()]
        run_sweep(simulation, measured, sweep, out, tests, workers, on, as_json=as_json)
        return
    refuse_options(context, frozenset(context.params) - _OF_A_SWEEP, "takes --sweep")
    if model not in NETWORKS:
        refuse_options(context, _OF_EVERY_MODEL, f"is of networks; {model} has no such choice")
        _train_estimator(model, recordings, sim, out, bandwidth, mapping=mapping, as_json=as_json)
        return
    usual = usual_settings(features)
    settings = replace(
        usual,
        model=model,
        epochs=usual.epochs if epochs is None else epochs,
        seed=seed,
        bandwidth=usual.bandwidth if bandwidth is None else bandwidth,
        rate=usual.rate if rate is None else rate,
        sequence_length=sequence_length,
        batch=batch,
        schedule=schedule,
        learning_rate=usual.learning_rate if learning_rate is None else learning_rate,
        weight_decay=weight_decay,
        held_out=held_out,
        hidden=hidden,
        folds=folds,
        layers=layers,
        device=device,
    )
    simulation, measured, notes = _load(recordings, sim, out, mapping)
    most = settings.rate or float("inf")
    width, note = fitting_bandwidth(simulation, measured, bandwidth, most)
    for line in note:
        notes.print(line)
    settings = replace(settings, bandwidth=width)
    hybrid = _train(simulation, measured, settings, notes)
    hybrid.save(out)
    rmse, gain = hybrid.fitted.record["rmse"], hybrid.fitted.gain.tolist()
    if as_json:
        terminal().print_json(json.dumps({"model": str(out), "rmse": rmse, "gain": gain}))
        return
    _print(rmse, gain, width, terminal())


def _load(
    recordings: list[Path], sim: Path, out: Path, mapping: Path | None
) -> tuple[Simulation, list[Recording], Console]:
    """Read simulation and recordings; say on the console what is left out of them."""
    from limo_driver.app.console.terminal import terminal
    from limo_driver.app.library.reading import read
    from limo_driver.physics import Simulation
    from limo_driver.runtime.outputs import require_folder

    simulation = Simulation.load(sim)
    measured = [read(path, simulation.model, mapping) for path in recordings]
    notes = terminal(stderr=True, soft_wrap=True)
    for recording in measured:
        for item in (*recording.left_out, *recording.warnings):
            notes.print(f"{recording.source}: {item}")
    require_folder(out, "the model")
    return simulation, measured, notes


def _train(
    simulation: Simulation, recordings: list[Recording], settings: TrainingSettings, notes: Console
) -> ResidualModel[Any]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from limo_driver.app.library.learning import train

    trainings = settings.folds + 1 if settings.folds > 1 else 1
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    silent = not notes.is_terminal  # else a blank line, which is no message
    with Progress(*columns, console=notes, transient=True, disable=silent) as progress:
        bar = progress.add_task("computing inputs", total=trainings * settings.epochs)

        def on_epoch(epoch: Epoch) -> None:
            progress.update(
                bar,
                completed=epoch.fold * settings.epochs + epoch.number,
                description=f"{f'fold {epoch.fold}' if epoch.fold else 'all motion'}  "
                f"epoch {epoch.number}/{settings.epochs}  "
                f"loss {epoch.training_loss:.4f}  held-out {epoch.held_out_loss:.4f}",
            )

        return train(simulation, recordings, settings.model, settings=settings, progress=on_epoch)


def _print(
    rmse: dict[str, dict[str, list[float]]], gain: list[float], bandwidth: float, console: Console
) -> None:
    from rich.table import Table

    table = Table(
        title=f"RMSE [N m] against torque filtered at {bandwidth:g} Hz",
        caption="held-out: blocks that choose which weights are kept; left out: stretches "
        "predicted by networks that did not see them, which the standard deviation and the gain "
        "come from; gain: the part of the network's torque that they confirm",
    )
    table.add_column("joint", justify="right")
    for where in ("training", "held-out"):
        table.add_column(f"rigid body, {where}", justify="right")
        table.add_column(f"hybrid, {where}", justify="right")
    columns = [
        rmse[where][name] for where in ("training", "held_out") for name in ("rigid_body", "hybrid")
    ]
    if "left_out" in rmse:
        table.add_column("hybrid, left out", justify="right")
        columns.append(rmse["left_out"]["hybrid"])
    table.add_column("gain", justify="right")
    for j, values in enumerate(zip(*columns, strict=True)):
        table.add_row(str(j + 1), *(f"{value:.4f}" for value in values), f"{gain[j]:.2f}")
    console.print(table)


_OF_A_SWEEP: Final = frozenset(("test", "workers", "on"))
_OF_EVERY_MODEL: Final = frozenset(
    ("recordings", "sim", "out", "model", "bandwidth", "mapping", "as_json")
)


def _train_estimator(
    name: str,
    recordings: list[Path],
    sim: Path,
    out: Path,
    bandwidth: float | None,
    *,
    mapping: Path | None,
    as_json: bool,
) -> None:
    import json

    from rich.table import Table

    from estimators.rigid_body.best_bandwidth import fitting_bandwidth
    from limo_driver.app.console.terminal import terminal
    from limo_driver.app.library.learning import train

    simulation, measured, notes = _load(recordings, sim, out, mapping)
    width, note = fitting_bandwidth(simulation, measured, bandwidth)
    for line in note:
        notes.print(line)
    model = train(simulation, measured, name, bandwidth=width)
    model.save(out)
    rmse = model.fitted.record.get("rmse", {})
    if as_json:
        terminal().print_json(json.dumps({"model": str(out), "rmse": rmse}))
        return
    if not {"simulation", "held_out"} <= set(rmse):
        terminal().print(f"{out}: {model.name}, which does not say how large its errors are")
        return
    table = Table(
        title=f"RMSE [N m] against torque filtered at {width:g} Hz",
        caption=f"held out: {model.held_out_is}",
    )
    for heading in ("joint", "simulation", f"{model.name}, held out"):
        table.add_column(heading, justify="right")
    for j, values in enumerate(zip(rmse["simulation"], rmse["held_out"], strict=True)):
        table.add_row(str(j + 1), *(f"{value:.4f}" for value in values))
    terminal().print(table)


def run_sweep(
    simulation: Simulation,
    recordings: Sequence[Recording],
    space: Path,
    out: Path,
    tests: Sequence[Recording],
    workers: int | None,
    on: Machines,
    *,
    as_json: bool,
) -> None:
    """Train every setting, and print the best ones.

    Args:
        simulation: The identified one.
        recordings: To train on.
        space: The space.yaml.
        out: Folder of the sweep.
        tests: Recordings that choose nothing.
        workers: How many run at a time.
        on: Processes, or a cluster of Ray.
        as_json: Print the figures as JSON.
    """
    import json

    from rich.table import Table

    from estimators.studies.sweep import BEST, PAGE, TABLE
    from limo_driver.app.console.terminal import terminal, told_progress
    from limo_driver.app.library.sweeping import sweep

    notes, console = terminal(stderr=True, soft_wrap=True), terminal()
    with told_progress(notes, "training") as tell:
        found = sweep(
            simulation,
            recordings,
            space,
            out,
            tests=tests,
            workers=workers,
            on=on.value,
            progress=tell,
        )
    for trial in found.failed:
        notes.print(f"{trial.key}: {trial.error}")
    if as_json:
        best = {"model": str(out / BEST), "left": found.best.left, "key": found.best.key}
        console.print_json(json.dumps(best))
        return
    console.print(found.headline())
    grid = Table(caption="error left: of the simulation's, on motion that training did not see")
    columns = found.figures()
    for name in columns:
        grid.add_column(name, justify="right")
    for row in zip(*columns.values(), strict=True):
        grid.add_row(*map(str, row))
    console.print(grid)
    console.print(f"wrote {out}: {TABLE}, {PAGE}, {BEST}", soft_wrap=True)
