"""`limo evaluate`: a model against its rigid body, or a simulation against another, on motion."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limo_driver.app.console.command_line import MappingOption, describe_options
from limo_driver.app.console.terminal import table_of, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import require_folder

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.diagnosis.comparison import SimulationComparison
    from estimators.evaluation import Evaluation


@describe_options
def command(
    recording: Path,
    *,
    model: Path | None = None,
    sim: Path | None = None,
    against: Path | None = None,
    estimate: str = "estimate",
    external: str = "external_torque",
    out: Path | None = None,
    mapping: MappingOption = None,
    as_json: bool = False,
) -> None:
    """Compare measured torque with rigid body and model, or with an improved simulation.

    Measured and predicted torque go through the zero-phase filter that was used in training. The
    noise floor is what sensor noise, judged by the spectrum above, leaves after it. The second
    table says how many torques were within the interval that is meant to hold 95 %, and how much
    of the motion is unlike what was learned.

    With --against, the simulation of --sim is compared with that one, joint by joint: by how much
    it is better, with a 95 % interval by resampled blocks of time, and where it is worse, which
    part of it makes it so. What the arm's maker says of the torque is compared as well.

    Args:
        recording: Recording that was not trained on.
        model: Model folder of `limo train`.
        sim: The simulation it was trained on; with --against, the improved one.
        against: The simulation that --sim is an improvement of.
        estimate: NAME of columns NAME_1 … NAME_n: the maker's own joint torque.
        external: Likewise: the part of the torque that the maker calls external.
        out: Folder for evaluation.json and report.html; pictures of a model.
        as_json: Print the figures as JSON.

    Examples:
        limo evaluate test.parquet --model model/ --sim sim.yaml --out evaluation/
        limo evaluate test.parquet --sim new/sim.yaml --against sim.yaml
    """
    from limo_driver.app.library.learning import evaluate
    from limo_driver.app.library.reading import read
    from limo_driver.physics import Simulation

    _check(model, sim, against)
    if out is not None:
        require_folder(out, "the evaluation", _files(against), [recording])
    if against is not None:
        improved, given = Simulation.load(sim or ""), Simulation.load(against)
        judge = partial(evaluate, improved, against=given, estimate=estimate, external=external)
        robot = improved.model
    else:
        from estimators.model_folder import check_simulation, load_model

        trained = load_model(model or "")
        if sim is not None:
            check_simulation(trained, Simulation.load(sim))
        judge, robot = partial(evaluate, trained), trained.simulation.model
    measured = read(recording, robot, mapping)
    notes = terminal(stderr=True, soft_wrap=True)
    for item in (*measured.left_out, *measured.warnings):
        notes.print(f"{recording}: {item}")
    evaluation: Any = judge(measured)
    if getattr(evaluation, "trained_on", False):
        notes.print(
            f"{recording}: the model was trained on it; these errors say nothing of other motion",
        )
    if out is not None:
        evaluation.save(out)
        notes.print(f"wrote {out}: {', '.join(_files(against))}")
    if as_json:
        terminal().print_json(data=evaluation.as_values())
    elif against is not None:
        terminal().print(of_simulations(evaluation))
        for reason in evaluation.reasons():
            terminal(soft_wrap=True).print(reason)
    else:
        terminal().print(table(evaluation), certainty(evaluation))
        for line in evaluation.changed:
            terminal(soft_wrap=True).print(line)


def _check(model: Path | None, sim: Path | None, against: Path | None) -> None:
    """Refuse what does not say what is to be compared with what.

    Raises:
        ConfigError: It does not.
    """
    if against is not None and (sim is None or model is not None):
        given = "--model" if model is not None else "no --sim"
        raise ConfigError(
            f"{given} given with --against, expected two simulations: "
            "--sim IMPROVED --against GIVEN"
        )
    if against is None and model is None:
        alone = "--sim alone" if sim is not None else "neither"
        raise ConfigError(f"{alone} given, expected --model, or --sim IMPROVED --against GIVEN")


def _files(against: Path | None) -> tuple[str, ...]:
    from estimators.diagnosis import comparison
    from estimators.evaluation import FILES

    return FILES if against is None else comparison.FILES


def of_simulations(found: SimulationComparison) -> Table:
    """Return the errors of two simulations, and of estimates."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    result = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        title=found.headline(),
        caption="RMSE in N m; change: improved less given, with its 95 % interval",
    )
    figures = found.figures()
    result.add_column("joint", overflow="fold")
    for heading in list(figures)[1:]:
        result.add_column(heading.removesuffix(" [N m]"), justify="right")
    for row in zip(*figures.values(), strict=True):
        result.add_row(*(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row))
    return result


def table(evaluation: Evaluation) -> Table:
    """Return the figures per joint and on average."""
    values, unit = evaluation.as_values(), ", ".join(dict.fromkeys(evaluation.units))
    result = table_of(
        "joint",
        "rigid\nbody\nRMSE",
        "learned\n\nRMS",
        "model\n\nRMSE",
        "noise\nfloor\nRMS",
        "rigid\nbody\nMSE",
        "model\n\nMSE",
        "ratio\n\nof MSE",
        title=f"{evaluation.recording.source}: against torque filtered at "
        f"{evaluation.bandwidth:g} Hz, zero phase, {values['samples']} samples",
        caption=f"RMS(E) in {unit}, MSE in ({unit})²; learned: the torque that it adds; model: "
        f"{evaluation.model}",
    )
    squared = ("mse_rigid_body", "mse_hybrid", "mse_ratio")
    keys = ("rmse_rigid_body", "rms_network", "rmse_hybrid", "noise_floor")
    for j, name in enumerate(evaluation.joint_names):
        result.add_row(
            name,
            *("unknown" if values[key][j] is None else f"{values[key][j]:.4f}" for key in keys),
            *("unknown" if values[key][j] is None else f"{values[key][j]:.3g}" for key in squared),
        )
    result.add_section()
    result.add_row(
        "average",
        *[""] * 4,
        f"{values['mean_mse_rigid_body']:.3g}",
        f"{values['mean_mse_hybrid']:.3g}",
        f"{values['mean_mse_ratio']:.3g}",
    )
    return result


def certainty(evaluation: Evaluation) -> Table:
    """Return how often the torque was within the model's 95 % interval, and how often outside."""
    from math import isnan

    result = table_of(
        "joint",
        "within the\n95 % interval",
        "with what\nchanged",
        "outside",
        title="How sure the model is",
        caption="with what changed: where offset, friction, gain and interval follow the errors "
        "before each row; outside: motion unlike what was learned, where the interval is a guess",
    )
    parts = evaluation.coverage, evaluation.coverage_with_change
    for name, *within, outside in zip(
        evaluation.joint_names, *parts, evaluation.outside, strict=True
    ):
        known = ("unknown" if isnan(part) else f"{part:.1%}" for part in within)
        result.add_row(name, *known, f"{outside:.1%}")
    return result
