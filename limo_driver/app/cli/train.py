"""`limo train`: a model from recordings and a simulation."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any, Final

import typer

from limo_driver.app.console.command_line import (
    MappingOption,
    describe_options,
    is_on_command_line,
    refuse_options,
)
from limo_driver.app.console.terminal import (
    Machines,
    OnOption,
    WorkersOption,
    columns_of,
    print_notes,
    progress,
    progress_bar,
    progress_lines,
    terminal,
)
from limo_driver.model.units import unit_of
from limo_driver.runtime.outputs import require_folder

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.residual_model import ResidualModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

OPTIONS: Final = frozenset(
    ("recordings", "sim", "out", "mapping", "as_json", "sweep", "test", "workers", "on")
)


@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Options of training a network; None stands for what suits the features.

    Args:
        features: Inputs: all-joints (the paper's), own-joint (a network for each joint sees that
            joint only), drive (of that joint, what friction and elasticity of a drive depend on).
        epochs: Passes over the recordings; 100, or 20 of an mlp7 with drive.
        seed: Seed; the same gives the same weights.
        bandwidth: Bandwidth of the zero-phase filter on motion and torque [Hz]; if not given, that
            of the simulation, or 10 unless another predicts motion held out much better.
        rate: Rate of the network's samples [Hz], to which faster recordings are thinned; 200, or 50
            with drive, or the bandwidth where that is more.
        sequence_length: Samples that a network with memory is differentiated through, or a
            transformer looks back over.
        batch: Rows (mlp7) or sequences (others) of a step.
        hidden: Hidden units of a network; 0: as the paper.
        layers: Layers of cells of lstm-fcl or gru, 1 or 2; of a transformer's coders.
        schedule: How the step shrinks: cosine, plateau (the paper's).
        learning_rate: Initial step of AdamW; 1e-3, or 3e-3 with drive.
        weight_decay: Weight decay of AdamW.
        held_out: Part of the motion, in blocks, that training does not see.
        folds: Stretches of motion, each predicted by a network that did not see it, that judge the
            gain of each joint; 1: none do, and the gain is 1.
        patience: Epochs without a lower held-out loss after which training ends; 0: never.
        device: cpu, cuda, or auto: a GPU if there is one; an mlp7 is trained on the CPU.
    """

    features: str = "all-joints"
    epochs: int | None = None
    seed: int = 0
    bandwidth: float | None = None
    rate: float | None = None
    sequence_length: int = 100
    batch: int = 50
    hidden: int = 0
    layers: int = 1
    schedule: str = "cosine"
    learning_rate: float | None = None
    weight_decay: float = 0.01
    held_out: float = 0.2
    folds: int = 3
    patience: int = 20
    device: str = "auto"


@describe_options
def command(
    context: typer.Context,
    recordings: list[Path],
    *,
    sim: Path,
    out: Path,
    model: str = "auto",
    network: NetworkOptions,
    mapping: MappingOption = None,
    sweep: Path | None = None,
    test: list[Path] | None = None,
    workers: WorkersOption = None,
    on: OnOption = Machines.processes,
    as_json: bool = False,
) -> None:
    r"""Learn the torque that a simulation leaves unexplained, by a network or by joint physics.

    Without --model, a few are compared on motion held out, which takes minutes, and the best is
    trained; joints of which nothing is confirmed stay as the simulation has them. With an option of
    networks, it is an mlp7.

    Simulation and network are the hybrid tau_HYB = tau_RBD + F_NN(q, dq, ddq, r, tau_RBD), with r
    the rotation since the last reversal. Its part is scaled, joint by joint, by how much of it is
    confirmed by motion not trained on. joint-physics is no network: it fits friction, hysteresis,
    elasticity and errors of the rigid body joint by joint in closed form, needs little motion, and
    says how sure it is. A network whose training was killed goes on where it was when the same
    command runs again. The folder holds weights, manifest and simulation, and is all that
    `limo evaluate` needs; report.html shows what was tried and how large errors are,
    and card.md says on what data, for which robot and within which limits.

    With --sweep, a space.yaml says what is tried, such as `hidden: [8, 16]` or `learning_rate:
    {from: 3e-4, to: 1e-2, scale: log}` with `draws: 4`: every combination. What is trained is kept,
    and the same command goes on. OUT gets results.parquet, sweep.html, and the best model as best/.

    Args:
        recordings: Recordings of one robot.
        sim: The identified simulation, a sim.yaml.
        out: Model folder to write.
        model: auto, the best on motion held out; joint-physics; a network: mlp7, lstm-2, lstm-fcl,
            gru, lru (a linear state space), transformer; or an estimator that another package
            registers.
        sweep: Train with every setting of this space.yaml; OUT is a folder of all.
        test: With --sweep: recording on which each network is evaluated.
        as_json: Print the figures as JSON.

    Examples:
        limo train run.parquet --sim sim.yaml --out model/
        limo train run.parquet --sim sim.yaml --model lstm-fcl --out model/
        limo train a.parquet b.parquet --sim sim.yaml --features drive \
            --out model/
        limo train run.parquet --sim sim.yaml --model joint-physics --out model/
        limo train run.parquet --sim sim.yaml --sweep space.yaml --out sweep/
    """
    from dataclasses import replace

    from estimators.hybrid.training.settings import usual_settings
    from estimators.neural import NETWORKS
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth
    from estimators.training_page import save_training
    from limo_driver.app.library.inputs import AUTO, require_model
    from limo_driver.app.library.reading import read

    is_given = partial(is_on_command_line, context)
    if any(map(is_given, _OF_NETWORKS)) and not is_given("model"):
        model = "mlp7"
    if model != AUTO:
        require_model(model)
    if sweep is not None:
        from estimators.studies.sweep import BEST, PAGE, TABLE
        from limo_driver.app.library.sweeping import sweep as swept

        refuse_options(context, OPTIONS, "is said in the space of a sweep, not beside --sweep")
        simulation, measured = _load(recordings, sim, out, mapping)
        tests = [read(path, simulation.model, mapping) for path in test or ()]
        notes, console = terminal(stderr=True, soft_wrap=True), terminal()
        with progress_lines(notes, "training") as tell:
            found = swept(
                simulation, measured, sweep, out, tests=tests, workers=workers, on=on.value,
                progress=tell,
            )  # fmt: skip
        for trial in found.failed:
            notes.print(f"{trial.key}: {trial.error}")
        if as_json:
            best = {"model": str(out / BEST), "left": found.best.left, "key": found.best.key}
            console.print_json(data=best)
            return
        console.print(found.headline())
        left = "error left: of the simulation's, on motion that training did not see"
        console.print(columns_of(found.figures(), caption=left))
        console.print(f"wrote {out}: {TABLE}, {PAGE}, {BEST}", soft_wrap=True)
        return
    refuse_options(context, frozenset(context.params) - _OF_A_SWEEP, "takes --sweep")
    settings, most = None, float("inf")
    if model in NETWORKS:
        chosen = {name: value for name, value in vars(network).items() if value is not None}
        settings = replace(usual_settings(network.features, model), **chosen)
        most = most if network.rate is None else settings.rate or most
    else:
        refuse_options(context, _OF_EVERY_MODEL, f"is of networks; {model} has no such choice")
    simulation, measured = _load(recordings, sim, out, mapping)
    width, note = fitting_bandwidth(simulation, measured, network.bandwidth, most)
    for line in note:
        terminal(stderr=True, soft_wrap=True).print(line)
    if model == AUTO:
        trained = _train_best(simulation, measured, width, quiet=as_json)
    else:
        trained = _train(simulation, measured, model, width, settings, out / _UNFINISHED)
    trained.save(out)
    rmtree(out / _UNFINISHED, ignore_errors=True)
    page, card = save_training(trained, measured, out)
    _show(trained, out, width, as_json=as_json)
    terminal(stderr=True, soft_wrap=True).print(f"wrote {out} with {page.name} and {card.name}")


def _show(trained: ResidualModel[Any], out: Path, width: float, *, as_json: bool) -> None:
    """Print the errors of a model that was trained at a bandwidth [Hz]."""
    record = trained.fitted.record
    rmse, gain = record.get("rmse", {}), getattr(trained.fitted, "gain", None)
    unit = unit_of("N m", trained.simulation.model.sliding)
    if as_json:
        values = {"model": str(out), "rmse": rmse}
        values |= {} if gain is None else {"gain": gain.tolist()}
        values |= {"choice": record["choice"]} if "choice" in record else {}
        terminal().print_json(data=values)
    elif gain is not None:
        terminal().print(_network_table(rmse, gain.tolist(), width, unit))
    elif {"simulation", "held_out"} <= set(rmse):
        terminal().print(_table(rmse, trained, width, unit))
    else:
        terminal().print(f"{out}: {trained.name}, which does not say how large its errors are")


def _load(
    recordings: list[Path], sim: Path, out: Path, mapping: Path | None
) -> tuple[Simulation, list[Recording]]:
    """Read simulation and recordings; say on stderr what is left out of them."""
    from limo_driver.app.library.reading import read
    from limo_driver.physics import Simulation

    simulation = Simulation.load(sim)
    measured = [read(path, simulation.model, mapping) for path in recordings]
    print_notes(measured)
    require_folder(out, "the model")
    return simulation, measured


def _train(
    simulation: Simulation,
    recordings: list[Recording],
    model: str,
    bandwidth: float,
    settings: TrainingSettings | None,
    unfinished: Path,
) -> ResidualModel[Any]:
    """Train a network behind a progress bar, or any other model."""
    from rich.progress import BarColumn, TimeRemainingColumn

    from limo_driver.app.library.learning import train

    if settings is None:
        return train(simulation, recordings, model, bandwidth=bandwidth)
    settings = settings.following(bandwidth)
    epochs, trainings = settings.epochs, settings.folds + 1 if settings.folds > 1 else 1
    with progress("{task.description}", BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("computing inputs", total=trainings * epochs)

        def on_epoch(epoch: Epoch) -> None:
            bar.update(
                task,
                completed=epoch.fold * epochs + epoch.number,
                description=f"{f'fold {epoch.fold}' if epoch.fold else 'all motion'}  "
                f"epoch {epoch.number}/{epochs}  "
                f"loss {epoch.training_loss:.4f}  held-out {epoch.held_out_loss:.4f}",
            )

        return train(
            simulation, recordings, model, settings=settings, progress=on_epoch,
            unfinished=unfinished,
        )  # fmt: skip


def _train_best(
    simulation: Simulation, recordings: list[Recording], bandwidth: float, *, quiet: bool
) -> ResidualModel[Any]:
    """Compare models behind a progress bar, show that, and train the one that is chosen."""
    from estimators.diagnosis.stages import forward
    from estimators.studies.model_choice import choose_model, fit_chosen

    notes = terminal(stderr=True, soft_wrap=True)
    with progress_bar(notes) as tell:
        choice = choose_model(simulation, recordings, bandwidth, forward(tell, _COMPARED))
        tell(f"training {choice.chosen.name}", _COMPARED)
        trained = fit_chosen(choice, simulation, recordings, bandwidth)
        tell("done", 1.0)
    for one in choice.tried:
        if one.refused:
            notes.print(f"{one.name} was not compared: {one.refused}")
    if not quiet:
        terminal(soft_wrap=True).print(choice.headline())
        table = columns_of(
            choice.figures(),
            title="RMSE of the simulation, and the part of it that each model leaves",
            caption="on stretches that the model did not see, of which it learns what the others "
            "confirm; 1.00: a joint stays as the simulation has it",
        )
        terminal().print(table)
    return trained


def _network_table(
    rmse: dict[str, dict[str, list[float]]], gain: list[float], bandwidth: float, unit: str
) -> Table:
    columns = {
        f"{name.replace('_', ' ')}, {where.replace('_', '-')}": rmse[where][name]
        for where in ("training", "held_out")
        for name in ("rigid_body", "hybrid")
    }
    if "left_out" in rmse:
        columns["hybrid, left out"] = rmse["left_out"]["hybrid"]
    return columns_of(
        {
            "joint": range(1, len(gain) + 1),
            **{name: [f"{value:.4f}" for value in values] for name, values in columns.items()},
            "gain": [f"{part:.2f}" for part in gain],
        },
        title=f"RMSE [{unit}] against torque filtered at {bandwidth:g} Hz",
        caption="held-out: blocks that choose which weights are kept; left out: stretches "
        "predicted by networks that did not see them, which the standard deviation and the gain "
        "come from; gain: the part of the network's torque that they confirm",
    )


def _table(
    rmse: dict[str, list[float]], model: ResidualModel[Any], bandwidth: float, unit: str
) -> Table:
    simulation, held_out = ([f"{x:.4f}" for x in rmse[name]] for name in ("simulation", "held_out"))
    joints = range(1, len(simulation) + 1)
    return columns_of(
        {"joint": joints, "simulation": simulation, f"{model.name}, held out": held_out},
        title=f"RMSE [{unit}] against torque filtered at {bandwidth:g} Hz",
        caption=f"held out: {model.held_out_is}",
    )


_OF_A_SWEEP: Final = frozenset(("test", "workers", "on"))
_OF_EVERY_MODEL: Final = frozenset(
    ("recordings", "sim", "out", "model", "bandwidth", "mapping", "as_json")
)
_OF_NETWORKS: Final = frozenset(item.name for item in fields(NetworkOptions)) - _OF_EVERY_MODEL
_UNFINISHED: Final = "unfinished"  # folder of a network that is being trained, in that of the model
_COMPARED: Final = 0.7  # of the work; the rest is training
