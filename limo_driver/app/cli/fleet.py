"""`limo fleet`: many recordings of many arms."""

from __future__ import annotations

from pathlib import Path

import typer

from limo_driver.app.console.command_line import MappingOption, describe_options
from limo_driver.app.console.terminal import (
    Machines,
    OnOption,
    WorkersOption,
    progress_lines,
    terminal,
)

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@describe_options
def diagnose(
    recordings: list[str],
    *,
    sim: Path,
    out: Path,
    mapping: MappingOption = None,
    workers: WorkersOption = None,
    on: OnOption = Machines.processes,
    bandwidth: float | None = None,
) -> None:
    """Diagnose every recording by itself, and say which arm is odd and which joint drifts.

    Writes results.parquet (a row for each recording, an error line where it cannot be used),
    fleet.html, and the diagnosis of each recording with its report. What is finished is kept,
    whatever happens; the same command goes on from there. The folder of a recording names its arm,
    and a date in its path, such as 2026-03-01, is its date. Logs of any format will do: one
    mapping, which `limo inspect` writes, is for all of them. A drift takes six dates of an arm, or
    four where values with intervals rise or fall evenly; an odd arm takes four arms.

    Args:
        recordings: Recordings, or patterns of them; files or URLs.
        sim: What is believed of such arms: a sim.yaml, or their URDF or MJCF.
        out: Folder for table, page and diagnoses.
        bandwidth: Bandwidth of the zero-phase filter on motion and torque [Hz]; 10, or less for
            recordings sampled below 25 Hz.

    Example:
        limo fleet diagnose "recordings/**/*.parquet" --sim sim.yaml --out fleet
        limo fleet diagnose "*/*.csv" --sim arm.xml --mapping map.yaml --out fleet
        limo fleet diagnose "s3://logs/**" --sim sim.yaml --out fleet --on ray
    """
    from estimators.studies.fleet_page import PAGE, TABLE
    from limo_driver.app.library.fleets import diagnose_fleet

    notes = terminal(stderr=True, soft_wrap=True)
    with progress_lines(notes, "diagnosing") as tell:
        found = diagnose_fleet(
            recordings,
            sim,
            out,
            mapping=mapping,
            bandwidth=bandwidth,
            workers=workers,
            on=on.value,
            progress=tell,
        )
    console = terminal()
    for row in found.failed:
        notes.print(f"{row.recording}: {row.error}")
    for line in str(found).splitlines():
        console.print(line)
    console.print(f"wrote {out / TABLE}, {out / PAGE}")


@command.callback()
def fleet() -> None:
    """Diagnose the recordings of a fleet of arms, and compare the arms.

    Example:
        limo fleet diagnose "recordings/**/*.parquet" --sim sim.yaml --out fleet
    """


command.command(name="diagnose")(diagnose)
