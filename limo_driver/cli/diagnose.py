"""`limo diagnose`: what physics a simulation leaves out of recordings."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from rich.console import Console
    from rich.table import Table

    from estimators.diagnosis.result import Diagnosis
    from estimators.diagnosis.verdict import Verdict


def command(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one arm.")],
    sim: Annotated[Path, typer.Option(help="What is believed of that arm, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Folder for verdict, improved simulation and report.")],
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase filter on motion and torque [Hz].")
    ] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the verdict as JSON.")] = False,
) -> None:
    r"""Find where a simulation and recordings differ, which physics is missing, and add it.

    Writes verdict.json, sim.yaml (the improved simulation), report.html, and next_motion.parquet
    where one more motion would decide between explanations. A finished diagnosis ends with exit
    status 0, whatever it finds.

    Examples:
        limo diagnose monday.parquet tuesday.parquet --sim sim.yaml \
            --out diagnosis
        limo run --backend mujoco --trajectory diagnosis/next_motion.parquet \
            --record next.parquet
    """
    import json
    import sys

    from estimators.diagnosis.saving import FILES, REPORT
    from limo_driver.console.terminal import terminal
    from limo_driver.outputs import require_folder
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.workflow.diagnosing import diagnose

    simulation = Simulation.load(sim)
    measured = [Recording.load(path) for path in recordings]
    for recording in measured:
        recording.check_robot(simulation.model)
    require_folder(out, "the diagnosis", FILES, [sim, *recordings])
    notes = terminal(stderr=True, soft_wrap=True)
    with _progress(notes) as progress:
        found = diagnose(simulation, measured, bandwidth=bandwidth, progress=progress)
        found.save(out)
        progress("done", 1.0)
    if as_json:
        sys.stdout.write(json.dumps(found.verdict.as_values(), indent=1) + "\n")
        return
    for recording in measured:
        for item in (*recording.warnings, *recording.left_out):
            notes.print(f"{recording.source}: {item}")
    _show(found, out / REPORT)


@contextmanager
def _progress(console: Console) -> Generator[Callable[[str, float], None]]:
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}", markup=False))
    # where nobody watches, the bar would leave an empty line before the message of an error
    disable = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task("reading motion", total=1.0)
        yield lambda stage, part: bar.update(task, completed=part, description=stage)


def _show(found: Diagnosis, report: Path) -> None:
    from limo_driver.console.terminal import terminal
    from limo_driver.physics import spoken

    console = terminal()
    verdict = found.verdict
    console.print(verdict.sentence(), style="bold")
    for item in verdict.findings:
        same = ", ".join(spoken(other) for other in item.equivalent)
        console.print(f"{item.evidence}")
        console.print(
            f"  confidence {item.confidence:.0%}" + (f"; cannot be told from {same}" * bool(same)),
        )
    console.print(_errors(verdict))
    for note in verdict.notes:
        console.print(f"note: {note}")
    if found.next_motion is not None:
        console.print(f"next motion: {found.next_motion_purpose}")
    console.print(f"wrote {report}")


def _errors(verdict: Verdict) -> Table:
    from rich.table import Table

    table = Table("joint", title="held-out RMSE [N m]", title_justify="left")
    fit = verdict.fit
    columns = {"given": fit.heldout_rmse_before, "within tolerances": fit.heldout_rmse_tolerances,
               "improved": fit.heldout_rmse_after, "noise floor": fit.noise_floor}  # fmt: skip
    told = {heading: values for heading, values in columns.items() if values}
    for heading in told:
        table.add_column(heading, justify="right")
    for j, values in enumerate(zip(*told.values(), strict=True), start=1):
        table.add_row(str(j), *(f"{value:.4f}" for value in values))
    return table
