"""`limo inspect`: what a log of any format holds, and the mapping that reads it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.console.options import ROBOTS

if TYPE_CHECKING:
    from limo_driver.workflow.inspecting import Inspection

_MAPPING = Path("mapping.yaml")


def command(
    log: Annotated[Path, typer.Argument(help="The log: a file, or the folder of a bag.")],
    robot: Annotated[str, typer.Option(help=f"The arm: {ROBOTS}.")],
    out: Annotated[Path, typer.Option(help="Where to write the mapping.")] = _MAPPING,
    topic: Annotated[
        str | None, typer.Option(help="Topic of the joint states of a bag, if there are several.")
    ] = None,
    episode: Annotated[
        int | None, typer.Option(help="Episode of a LeRobotDataset; all if not given.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Say what a log holds, and write how to read it.

    Columns or topics are matched to the robot's joints by name, else by number; units are read
    from names, limits, velocities and gravity. Where two readings fit, the question stands under
    `undecided:` in the mapping, which cannot be used before it is answered: state what is meant,
    and delete the question. A mapping that is there and reads otherwise is not written over.

    Then it says what the recording is worth: sampling, quantisation, dropouts, on which side of the
    gear the torque was measured, and which parameters the motion says nothing about.

    Every command that takes a recording takes the log itself, too, with `--mapping`, or without
    one where nothing is left to be decided.

    Examples:
        limo inspect log.csv --robot iiwa14
        limo convert log.csv --mapping mapping.yaml --out run.parquet
    """
    from limo_driver.outputs import require_file
    from limo_driver.workflow.inspecting import inspect

    require_file(out, [log] if log.is_file() else [])
    found = inspect(log, robot, topic=topic, episode=episode)
    kept = _is_another(out, found)
    if not kept:
        found.mapping.save(out)
    if as_json:
        _print_json(found, out, kept=kept)
    else:
        _show(found, out, kept=kept)
        _show_next(found, log, robot, out, kept=kept)


def _is_another(out: Path, found: Inspection) -> bool:
    """Say whether a mapping is there that reads otherwise: somebody has answered in it."""
    return out.exists() and out.read_bytes() != found.mapping.as_file.encode()


def _print_json(found: Inspection, out: Path, *, kept: bool) -> None:
    import json

    from limo_driver.console.terminal import terminal

    taken = {
        item.quantity: {"columns": item.columns, "unit": item.unit, "because": item.why}
        for item in found.proposal.taken
    }
    values = {
        "mapping": str(out),
        "kept": kept,
        "kind": found.table.kind,
        "rows": found.table.rows,
        "taken": taken,
        "telemetry": list(found.telemetry),
        "undecided": list(found.questions),
        "notes": list(found.notes()),
    }
    terminal().print_json(json.dumps(values))


def _show(found: Inspection, out: Path, *, kept: bool) -> None:
    from limo_driver.console.terminal import terminal

    console = terminal(soft_wrap=True)
    for line in str(found).splitlines():
        console.print(line)
    if kept:
        console.print(
            f"kept {out}, which is there and reads otherwise; "
            "to see what is proposed now, give --out another file"
        )
    else:
        console.print(f"wrote {out}")


def _show_next(found: Inspection, log: Path, robot: str, out: Path, *, kept: bool) -> None:
    """Say what to do with the mapping."""
    from limo_driver.console.terminal import terminal

    console = terminal(soft_wrap=True)
    if (open_ones := len(found.questions)) and not kept:
        what = "the question" if open_ones == 1 else f"each of the {open_ones} questions"
        console.print(f"next: answer {what} under `undecided:` there, and delete it", style="bold")
    elif kept or found.recording is not None:
        words = ["limo", "diagnose", str(log), "--robot", robot, "--mapping", str(out)]
        console.print(f"next: {shlex.join(words)} --out diagnosis", style="bold")
