"""`limo export`: what was found, in a copy of the user's own MJCF or URDF."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from limo_driver.exports.export import Export


def command(
    sim: Annotated[Path, typer.Argument(help="The simulation, a sim.yaml.")],
    to: Annotated[str, typer.Option(help="Format: mjcf or urdf.")],
    out: Annotated[Path, typer.Option(help="Folder for the copy, or the copy (.xml, .urdf).")],
    into: Annotated[
        Path | None,
        typer.Option(help="File to write into a copy of; the robot's own if not given."),
    ] = None,
    on: Annotated[
        Path | None,
        typer.Option(help="Recording on which what cannot be expressed is counted."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Write a simulation into a copy of a MuJoCo or URDF file; only what was found changes.

    Inertias, a payload as a body, dry friction, damping, armature, springs and gravity are written
    where the format has them. The difference is shown, and the size of what the format has no
    number for. MuJoCo, or pinocchio for a URDF, then reads the copy alone: its torque on a minute
    of motion is compared with the prediction.

    Examples:
        limo export sim.yaml --to mjcf --into model.xml --out improved/
        limo export diagnosis/sim.yaml --to urdf --out improved/
    """
    from limo_driver.workflow.exporting import export

    found = export(sim, to, out, into, on)
    if as_json:
        _print_json(found)
    else:
        show(found)


def _print_json(found: Export) -> None:
    import json

    from limo_driver.console.terminal import terminal

    values = {
        "file": str(found.file),
        "files": [str(path) for path in found.files],
        "diff": found.diff,
        "not_expressed": {item.place: list(item.rms) for item in found.remainder},
        "difference": list(found.error),
        "torque": list(found.torque),
        "share": found.share,
    }
    terminal().print_json(json.dumps(values))


def show(found: Export) -> None:
    """Print what an export wrote."""
    from limo_driver.console.terminal import terminal

    console = terminal(soft_wrap=True)
    for line in found.diff.splitlines():
        console.print(line)
    for item in found.remainder:
        console.print(f"left: {item}")
    for line in str(found).splitlines():
        console.print(line)
