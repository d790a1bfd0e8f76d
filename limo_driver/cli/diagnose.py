"""`limo diagnose`: what physics a simulation leaves out of recordings."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.console.options import MappingOption  # noqa: TC001  # typer reads it
from limo_driver.recordings.bandwidth import BANDWIDTH

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from rich.console import Console

    from estimators.diagnosis.result import Diagnosis

_DIAGNOSED = 0.97  # of the work; the rest is writing


def command(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one arm.")],
    sim: Annotated[Path, typer.Option(help="What is believed of that arm, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Folder for verdict, improved simulation and report.")],
    bandwidth: Annotated[
        float, typer.Option(help="Bandwidth of the zero-phase filter on motion and torque [Hz].")
    ] = BANDWIDTH,
    mapping: MappingOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the verdict as JSON.")] = False,
) -> None:
    r"""Find where a simulation and recordings differ, which physics is missing, and add it.

    Writes verdict.json, sim.yaml (the improved simulation), report.html, and next_motion.parquet
    where one more motion would decide between explanations. A finished diagnosis ends with exit
    status 0, whatever it finds; where one of its stages failed, the verdict says so, and the status
    is 1.

    Examples:
        limo diagnose monday.parquet tuesday.parquet --sim sim.yaml \
            --out diagnosis
        limo run --backend mujoco --trajectory diagnosis/next_motion.parquet \
            --record next.parquet
    """
    import json
    import sys

    from estimators.diagnosis.saving import FILES, save
    from limo_driver.console.terminal import terminal
    from limo_driver.outputs import require_place
    from limo_driver.physics import Simulation
    from limo_driver.workflow.diagnosing import diagnose
    from limo_driver.workflow.reading import read

    simulation = Simulation.load(sim)
    measured = [read(path, simulation.model, mapping) for path in recordings]
    require_place(out, "the diagnosis", FILES, [sim, *recordings])
    notes = terminal(stderr=True, soft_wrap=True)
    with _progress(notes) as progress:
        found = diagnose(
            simulation,
            measured,
            bandwidth=bandwidth,
            progress=lambda stage, part: progress(stage, _DIAGNOSED * part),
        )
        progress("writing", _DIAGNOSED)
        found, written = save(found, out)
        progress("done", 1.0)
    if as_json:
        sys.stdout.write(json.dumps(found.verdict.as_values(), indent=1) + "\n")
    else:
        for recording in measured:
            for item in (*recording.warnings, *recording.left_out):
                notes.print(f"{recording.source}: {item}")
        _show(found, written)
    for failure in found.failures:
        notes.print(f"limo: a stage of the diagnosis failed: {failure}")
    if found.failures:
        raise typer.Exit(1)


@contextmanager
def _progress(console: Console) -> Generator[Callable[[str, float], None]]:
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}", markup=False))
    # where nobody watches, the bar would leave an empty line before the message of an error
    disable = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task("reading motion", total=1.0)
        yield lambda stage, part: bar.update(task, completed=part, description=stage)


def _show(found: Diagnosis, written: Sequence[Path]) -> None:
    from limo_driver.console.terminal import terminal

    console = terminal()
    verdict, *rest = str(found).splitlines()
    console.print(verdict, style="bold")
    for line in rest:
        console.print(line)
    console.print(f"wrote {', '.join(map(str, written))}")
