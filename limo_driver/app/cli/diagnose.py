"""`limo diagnose`: what physics a simulation leaves out of recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import (
    ROBOTS,
    MappingOption,
    describe_options,
    refuse_options,
)
from limo_driver.app.console.terminal import print_notes, progress_bar, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import require_place

if TYPE_CHECKING:
    from rich.console import Console

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

_DIAGNOSED = 0.97  # of the work; the rest is writing
_OF_TORQUE = frozenset(("bandwidth", "budget", "gain_tolerance"))


@describe_options
def command(
    context: typer.Context,
    recordings: list[Path],
    *,
    out: Path,
    sim: Path | None = None,
    robot: Annotated[
        str | None,
        typer.Option(help=f"Or the arm alone, inertias trusted, friction unknown: {ROBOTS}."),
    ] = None,
    inertia_tolerance: float | None = None,
    gain_tolerance: float | None = None,
    export: Path | None = None,
    bandwidth: float | None = None,
    budget: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    mapping: MappingOption = None,
    as_json: bool = False,
) -> None:
    r"""Find where a simulation and recordings differ, which physics is missing, and add it.

    Writes verdict.json, sim.yaml (the improved simulation), report.html, and next_motion.parquet
    where one more motion would decide between explanations. A finished diagnosis ends with exit
    status 0, whatever it finds; where one of its stages failed, the verdict says so, and the status
    is 1.

    Recordings of commands and positions without torque identify drives and friction; errors are
    then those of the closed loop simulated forward from the commands, in rad.

    Give --sim with what you simulate: a sim.yaml, or a model.xml whose friction, damping and
    armature are meant as they stand. The verdict says which of them is off. Give --robot where
    nothing of that is known, as of most URDFs: friction is identified beside everything else, and
    inertias are trusted to --inertia-tolerance, so that a payload or a wrong link shows.
    Tolerances that are given take the place of those that a sim.yaml states.

    Args:
        recordings: Recordings of one arm.
        out: Folder for verdict, improved simulation and report.
        sim: What is believed of that arm: a sim.yaml, or its URDF or MJCF, with the friction that
            this states.
        inertia_tolerance: How far inertias may be off, relative; what --sim says, or 0.05 with
            --robot.
        gain_tolerance: The same of the scale of each joint's torque, as of currents; what --sim
            says, or 0 with --robot.
        export: Write what was found into a copy of the robot's file, too: .xml, .urdf, .usda, or a
            folder.
        bandwidth: Bandwidth of the zero-phase filter on motion and torque [Hz]; 10, or less for
            recordings sampled below 25 Hz or with noisy positions.
        budget: End the search after this time, with what is proven by then.
        as_json: Print the verdict as JSON.

    Examples:
        limo diagnose log.csv --robot model.xml --out diagnosis --export new.xml
        limo diagnose monday.parquet tuesday.parquet --sim sim.yaml \
            --out diagnosis
        limo run --backend mujoco --trajectory diagnosis/next_motion.parquet \
            --record next.parquet
    """
    from estimators.diagnosis.from_torque.pipeline import FILES, Diagnosis, save
    from estimators.diagnosis.stages import forward
    from estimators.diagnosis.verdict import VERDICT
    from estimators.telemetry import telemetry_in
    from limo_driver.app.cli.export import show
    from limo_driver.app.library.diagnosing import diagnose
    from limo_driver.app.library.exporting import export as write_copy
    from limo_driver.app.library.exporting import format_for

    notes = terminal(stderr=True, soft_wrap=True)
    given = [sim] if sim is not None else []
    require_place(out, "the diagnosis", FILES, [*given, *recordings])
    asked = {"inertia": inertia_tolerance, "gain": gain_tolerance}
    tolerances = {name: value for name, value in asked.items() if value is not None}
    simulation, measured = _start(recordings, sim, robot, tolerances, mapping, notes)
    if not any(recording.has_torque for recording in measured):
        known = frozenset(context.params) - _OF_TORQUE
        refuse_options(context, known, "is for recordings with torque; these have none")
    kind = "" if export is None else format_for(export, simulation.model.description.kind)
    with progress_bar(notes) as progress:
        found = diagnose(
            simulation,
            measured,
            bandwidth=bandwidth,
            budget=budget,
            progress=forward(progress, _DIAGNOSED),
        )
        progress("writing", _DIAGNOSED)
        if isinstance(found, Diagnosis):
            found, written = save(found, out)
        else:
            written = found.save(out)
        progress("done", 1.0)
    if as_json:
        typer.echo((out / VERDICT).read_text(encoding="utf-8"), nl=False)
    else:
        print_notes(measured)
        for recording in measured if robot is not None else ():
            for item in telemetry_in(found.simulation, recording) if recording.has_torque else ():
                notes.print(f"{recording.source}: {item}")
        console = terminal()
        sentence, *rest = str(found).splitlines()
        console.print(sentence, style="bold")
        for line in rest:
            console.print(line)
        console.print(f"wrote {', '.join(map(str, written))}")
    if export is not None:
        copied = write_copy(found.simulation, kind, export)
        if not as_json:
            show(copied)
    for failure in found.failures:
        notes.print(f"limo: a stage of the diagnosis failed: {failure}")
    if found.failures:
        raise typer.Exit(1)


def _start(
    recordings: list[Path],
    sim: Path | None,
    robot: str | None,
    tolerances: dict[str, float],
    mapping: Path | None,
    notes: Console,
) -> tuple[Simulation, list[Recording]]:
    """Return the simulation to start from, and the recordings.

    Raises:
        ConfigError: Both or none of simulation and robot are given.
    """
    from limo_driver.app.library.inputs import model_for
    from limo_driver.app.library.learning import described, nominal
    from limo_driver.app.library.reading import read
    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation

    if (sim is None) == (robot is None):
        given = "neither" if sim is None else "both"
        raise ConfigError(f"{given} of --sim and --robot given, expected one of them")
    if sim is not None:
        simulation = Simulation.load(sim)
        measured = [read(path, simulation.model, mapping) for path in recordings]
    else:
        model = RobotModel.load(str(robot))
        measured = [read(path, model, mapping) for path in recordings]
        model = model_for(model, measured)
        for note in model.notes:
            notes.print(f"{robot}: {note}")
        has_torque = any(recording.has_torque for recording in measured)
        simulation = nominal(model) if has_torque else described(model)
    known = simulation.tolerances.with_stated(**tolerances)
    return replace(simulation, tolerances=known), measured
