"""`limo fleet diagnose`: a row for each recording, and which arms are odd or drift."""

from __future__ import annotations

from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path  # noqa: TC003  # typer reads the annotations
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from rich.console import Console

    from estimators.fleet.row import FleetRow


class FleetMachines(StrEnum):
    """Where diagnoses run."""

    processes = "processes"
    ray = "ray"


def diagnose(
    recordings: Annotated[
        list[str], typer.Argument(help="Recordings, or patterns of them; files or URLs.")
    ],
    sim: Annotated[Path, typer.Option(help="What is believed of such arms, a sim.yaml.")],
    out: Annotated[Path, typer.Option(help="Folder for table, page and diagnoses.")],
    workers: Annotated[
        int | None, typer.Option(help="How many run at a time; one for each core if not given.")
    ] = None,
    on: Annotated[
        FleetMachines, typer.Option(help="Processes of this machine, or a cluster of Ray.")
    ] = FleetMachines.processes,
    bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bandwidth of the zero-phase filter on motion and torque [Hz]; 10, or less for "
            "recordings sampled below 25 Hz."
        ),
    ] = None,
) -> None:
    """Diagnose every recording by itself, and say which arm is odd and which joint drifts.

    Writes results.parquet (a row for each recording, an error line where it cannot be used),
    fleet.html, and the diagnosis of each recording with its report. What is finished is kept,
    whatever happens; the same command goes on from there. The folder of a recording names its arm,
    and a date in its path, such as 2026-03-01, is its date.

    Example:
        limo fleet diagnose "recordings/**/*.parquet" --sim sim.yaml --out fleet
        limo fleet diagnose "s3://logs/**" --sim sim.yaml --out fleet --on ray
    """
    from estimators.fleet.saving import PAGE, TABLE
    from limo_driver.console.terminal import terminal
    from limo_driver.workflow.fleets.diagnosing import diagnose_fleet

    notes = terminal(stderr=True, soft_wrap=True)
    with _progress(notes) as tell:
        found = diagnose_fleet(
            recordings, sim, out, bandwidth=bandwidth, workers=workers, on=on.value, progress=tell
        )
    console = terminal()
    for row in found.failed:
        notes.print(f"{row.recording}: {row.error}")
    for line in str(found).splitlines():
        console.print(line)
    console.print(f"wrote {out / TABLE}, {out / PAGE}")


@contextmanager
def _progress(
    console: Console,
) -> Generator[Callable[[FleetRow | None, int, int], None]]:
    """Yield what is told each finished row; shows rate and the time left where somebody watches."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}", markup=False))
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("reading", total=None)
        start, before = monotonic(), 0

        def tell(row: FleetRow | None, done: int, total: int) -> None:
            nonlocal start, before
            if row is None:
                start, before = monotonic(), done
                if done:
                    console.print(f"{done} of {total} need no work")
            said = pace(done - before, total - done, monotonic() - start)
            bar.update(task, completed=done, total=total, description=said)

        yield tell


def pace(done: int, left: int, seconds: float) -> str:
    """Say how fast recordings are diagnosed, and how long the rest will take.

    Args:
        done: Since the start.
        left: Still to be done.
        seconds: Since the start.
    """
    if not done or seconds <= 0:
        return "diagnosing"
    rate = done / seconds
    minutes, rest = divmod(round(left / rate), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{60 * rate:.3g} per minute, {hours}:{minutes:02}:{rest:02} left"
