"""`limo evaluate`: a model against its rigid body on motion that it has not seen."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.arguments import MappingOption  # noqa: TC001  # typer reads it

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.evaluation import Evaluation


def command(
    recording: Annotated[Path, typer.Argument(help="Recording that was not trained on.")],
    model: Annotated[Path, typer.Option(help="Model folder of `limo train`.")],
    sim: Annotated[
        Path | None, typer.Option(help="The simulation it was trained on, to be sure of it.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for evaluation.json, torque.png, loops.png and report.html."),
    ] = None,
    mapping: MappingOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Compare measured torque with rigid body and model: tables, with --out pictures and a page.

    Measured and predicted torque go through the zero-phase filter that was used in training. The
    noise floor is what sensor noise, judged by the spectrum above, leaves after it. The second
    table says how many torques were within the interval that is meant to hold 95 %, and how much
    of the motion is unlike what was learned.

    Example:
        limo evaluate test.parquet --model model/ --sim sim.yaml --out evaluation/
    """
    import json

    from estimators.evaluation import FILES
    from estimators.model_folder import check_simulation, load_model
    from limo_driver.app.console.terminal import terminal
    from limo_driver.app.library.learning import evaluate
    from limo_driver.app.library.reading import read
    from limo_driver.physics import Simulation
    from limo_driver.runtime.outputs import require_folder

    if out is not None:
        require_folder(out, "the evaluation", FILES, [recording])
    trained = load_model(model)
    if sim is not None:
        check_simulation(trained, Simulation.load(sim))
    measured = read(recording, trained.simulation.model, mapping)
    notes = terminal(stderr=True, soft_wrap=True)
    for item in (*measured.left_out, *measured.warnings):
        notes.print(f"{recording}: {item}")
    evaluation = evaluate(trained, measured)
    if evaluation.trained_on:
        notes.print(
            f"{recording}: the model was trained on it; these errors say nothing of other motion",
        )
    values = json.dumps(evaluation.as_values())
    if out is not None:
        evaluation.save(out)
        notes.print(f"wrote {out}: {', '.join(FILES)}")
    if as_json:
        terminal().print_json(values)
        return
    terminal().print(table(evaluation), certainty(evaluation))


def table(evaluation: Evaluation) -> Table:
    """Return the figures per joint and on average."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    values = evaluation.as_values()
    result = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        title=f"{evaluation.recording.source}: against torque filtered at "
        f"{evaluation.bandwidth:g} Hz, zero phase, {values['samples']} samples",
        caption="RMS(E) in N m, MSE in (N m)²; learned: the torque that it adds; model: "
        f"{evaluation.model}",
    )
    # the one column that gives way in a narrow terminal
    result.add_column("joint", overflow="fold")
    for heading in (
        "rigid\nbody\nRMSE",
        "learned\n\nRMS",
        "model\n\nRMSE",
        "noise\nfloor\nRMS",
        "rigid\nbody\nMSE",
        "model\n\nMSE",
        "ratio\n\nof MSE",
    ):
        result.add_column(heading, justify="right", no_wrap=True)
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

    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    result = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        title="How sure the model is",
        caption="outside: motion unlike what was learned, where the interval is a guess",
    )
    result.add_column("joint", overflow="fold")
    for heading in ("within the\n95 % interval", "outside"):
        result.add_column(heading, justify="right", no_wrap=True)
    rows = zip(evaluation.joint_names, evaluation.coverage, evaluation.outside, strict=True)
    for name, within, outside in rows:
        known = "unknown" if isnan(within) else f"{within:.1%}"
        result.add_row(name, known, f"{outside:.1%}")
    return result
