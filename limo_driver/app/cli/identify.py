"""`limo identify`: a simulation from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import (
    MappingOption,
    RobotOption,
    describe_options,
    refuse_options,
)
from limo_driver.app.console.terminal import print_notes, progress, terminal
from limo_driver.runtime.outputs import page_of, require_file

if TYPE_CHECKING:
    from estimators.rigid_body import Identification
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording

_WITHOUT_TORQUE = frozenset(("recordings", "robot", "out", "mapping", "as_json"))


@describe_options
def command(
    context: typer.Context,
    recordings: list[Path],
    *,
    robot: RobotOption,
    out: Path,
    bandwidth: float | None = None,
    sign_width: float | None = None,
    offset: bool = True,
    armature: bool = True,
    moving_only: Annotated[bool, typer.Option("--moving-only/--no-moving-only")] = False,
    weighting: str = "error",
    inertia_tolerance: float | None = None,
    base: bool = False,
    mapping: MappingOption = None,
    as_json: bool = False,
) -> None:
    r"""Identify inertias and friction, and write them as a simulation.

    Least squares estimates the base parameters. A convex fit then estimates physically consistent
    inertias of all links, which keep the values of the robot description where the motion does not
    excite them.

    Recordings of commands and positions without torque identify drives and friction instead, beside
    the inertias of the description, whose weight gives the scale.

    Args:
        recordings: Recordings of one robot.
        out: Where to write the simulation (sim.yaml), and beside it its page (sim.html).
        bandwidth: Bandwidth of the zero-phase filter on motion and torque [Hz]; if not given, 10
            unless another predicts motion held out much better.
        sign_width: Width of Coulomb friction's sign, rad/s; fitted if not given.
        offset: Model an offset of each torque sensor.
        armature: Model the drives' inertia, where the motion reveals it.
        moving_only: Leave out rows of a joint at rest; for torques from currents.
        weighting: Weigh joints by the inverse variance of: error, torque.
        inertia_tolerance: How well the robot's inertias are known, relative, 1 sigma; found from
            the data if not given.
        base: Print every base parameter with its uncertainty.
        as_json: Print the findings as JSON.

    Examples:
        limo identify run.parquet --robot iiwa14 --out sim.yaml
        limo identify a.csv b.csv --robot arm.urdf --moving-only --bandwidth 8 \
            --out sim.yaml --json
    """
    from dataclasses import replace

    from estimators.rigid_body import JointTerms, Rows
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth
    from estimators.rigid_body.page import identification_page
    from estimators.rigid_body.tables import as_values
    from estimators.rigid_body.terms import SIGN_WIDTHS
    from limo_driver.app.library.inputs import model_for
    from limo_driver.app.library.learning import identify
    from limo_driver.app.library.reading import read
    from limo_driver.model import RobotModel

    require_file(out, recordings)
    if (page := page_of(out)) is not None:
        require_file(page, recordings)
    model = RobotModel.load(robot)
    terms = JointTerms(SIGN_WIDTHS if sign_width is None else (sign_width,), offset, armature)
    measured = [read(path, model, mapping) for path in recordings]
    model = model_for(model, measured)
    if not any(recording.has_torque for recording in measured):
        refuse_options(context, _WITHOUT_TORQUE, "is for recordings with torque; these have none")
        _identify_drives(model, measured, out, page, as_json=as_json)
        return
    width, note = fitting_bandwidth(model, measured, bandwidth)
    rows = Rows(width, moving_only, weighting)
    with progress() as bar:
        task = bar.add_task("identify", total=sum(map(len, measured)))
        found = identify(
            model, measured, terms, rows, inertia_tolerance, lambda n: bar.advance(task, n)
        )
    found = replace(found, warnings=(*found.warnings, *note))
    found.simulation.save(out)
    if page is not None:
        identification_page(found, out.name).save(page)
    if as_json:
        terminal().print_json(data=as_values(found) | {"rows": _rows(measured)})
        return
    print_notes(measured)
    _show(found, out, page, base=base)


def _identify_drives(
    model: RobotModel, measured: list[Recording], out: Path, page: Path | None, *, as_json: bool
) -> None:
    """Identify drives and friction of an arm that tells no torque."""
    from estimators.diagnosis.from_motion.pipeline import drives_page
    from limo_driver.app.library.learning import identify_drives

    found = identify_drives(model, measured)
    found.simulation.save(out)
    if page is not None:
        drives_page(found, out.name).save(page)
    if as_json:
        terminal().print_json(data=found.as_values() | {"rows": _rows(measured)})
        return
    print_notes(measured)
    notes = [f"note: {warning}" for warning in found.warnings]
    terminal(soft_wrap=True).print("\n".join([str(found), *notes, _wrote(out, page)]))


def _rows(measured: list[Recording]) -> list[dict[str, object]]:
    """Return which rows of each recording were used and left out, for JSON."""
    return [
        {
            "recording": recording.source,
            "used": len(recording),
            "left_out": {item.reason: item.rows for item in recording.left_out},
            "warnings": list(recording.warnings),
        }
        for recording in measured
    ]


def _wrote(out: Path, page: Path | None) -> str:
    return f"wrote {out}" + (f" and {page}" if page else "")


def _show(found: Identification, out: Path, page: Path | None, *, base: bool) -> None:
    from estimators.rigid_body.tables import base_table, joint_table, known_of, link_table, notes_of

    console = terminal()
    console.print(
        f"{found.samples} samples; {known_of(found)}; condition {found.fit.condition:.3g}",
    )
    fewest = int(found.fit.effective.min())
    console.print(
        f"effective number of independent samples: at least {fewest} for each joint (errors are "
        f"correlated in time); prior of the described inertias: {found.tolerance:.0%} (1 sigma)",
    )
    known = found.simulation.tolerances
    console.print(
        f"tolerances in sim.yaml (relative, 1 sigma, for the torque of such motion): "
        f"inertias {known.inertia:.1%}, friction {known.friction:.0%}",
    )
    console.print(joint_table(found))
    console.print(link_table(found))
    if base:
        console.print(base_table(found))
    for note in notes_of(found):
        console.print(f"note: {note}")
    console.print(_wrote(out, page), soft_wrap=True)
