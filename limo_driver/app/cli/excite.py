"""`limo excite`: plan persistently exciting motion for the identification of a robot."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.cli.plan import Distances, require_writable
from limo_driver.app.console.command_line import RobotOption, describe_options, refuse_options
from limo_driver.app.console.terminal import joint_table, progress, terminal, unchecked
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import page_of, require_file

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.rigid_body.base_parameters import Conditioning
    from limo_driver.model import RobotModel
    from limopa.excitation.search import Excitation, ExcitationRequest
    from limopa.excitation.servo import ServoExcitation

_FOR_TORQUE = frozenset(("harmonics", "starts", "iterations", "workspace_radius", "picture"))
_FOR_SERVOS = frozenset(("lerobot", "motors"))
PAPER = 68  # condition number that Çallar and Böttger 2022 state for their iiwa


class Drives(StrEnum):
    """What moves the joints, and so what a recording tells."""

    TORQUE = "torque"
    POSITION_SERVO = "position-servo"


@dataclass(frozen=True)
class JointFigures:
    """Motion of one joint; peaks are relative to its limits."""

    joint: int  # 1-based
    harmonics: tuple[int, ...]  # multiples of the base frequency
    position_min: float  # [rad]
    position_max: float  # [rad]
    peak_velocity: float
    peak_acceleration: float
    peak_jerk: float


@describe_options
def command(
    context: typer.Context,
    *,
    out: Path,
    robot: RobotOption = "iiwa14",
    drives: Annotated[Drives, typer.Option("--for")] = Drives.TORQUE,
    duration: float = 60.0,
    harmonics: int = 5,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    starts: int = 16,
    iterations: int = 250,
    rate: float | None = None,
    workspace_radius: float | None = None,
    distances: Distances,
    lerobot: Path | None = None,
    motors: str | None = None,
    picture: Path | None = None,
    as_json: bool = False,
) -> None:
    r"""Plan persistently exciting motion, from which inertias and friction are best identified.

    Each joint moves on harmonics of its own of one base frequency. Pose and coefficients minimise
    the condition number of the regressor of the base parameters, Coulomb and viscous friction
    included, within the limits of the joints. The motion is one period; it starts and ends in one
    pose, at rest.

    For position servos, --out is a CSV of commands: ramps, steps, creeping reversals and holds of
    each joint in poses of its own, and of all together, from which positions alone identify drives.

    Args:
        out: Where to write the trajectory (Parquet), and beside it its page.
        drives: What the joints tell: torque, or positions alone behind servos.
        duration: Of the motion, one period of the base frequency, s; for servos at least.
        harmonics: Of each joint; no two joints share any of them.
        seed: Seed; the same seed gives the same file.
        starts: Random motions to begin with; the best are refined.
        iterations: Of each of the last two refinements; 0 leaves a random motion.
        rate: Samples per second in the file, Hz; 250, for servos 50.
        workspace_radius: Keep the flange this near to the base, m.
        lerobot: For servos: folder for a LeRobotDataset of the same commands.
        motors: Their names there, with commas between; those of the joints.
        picture: Draw the motion into this file (PNG, PDF or SVG).
        as_json: Print the figures as JSON.

    Examples:
        limo excite --robot iiwa14 --seed 1 --out excite.traj.parquet \
            --picture excite.png
        limo excite --robot arm.urdf --duration 30 --harmonics 4 \
            --out excite.traj.parquet --json
        limo excite --for position-servo --robot so101.xml --out moves.csv \
            --lerobot moves --motors shoulder_pan,shoulder_lift,elbow_flex
    """
    from math import inf

    from estimators.rigid_body.base_parameters import Conditioning
    from limo_driver.model import RobotModel
    from limopa.excitation.search import ExcitationRequest
    from limopa.page import excitation_page
    from limopa.picture import draw_excitation
    from limopa.request import Workspace

    surroundings = distances.surroundings
    if drives is Drives.POSITION_SERVO:
        from limo_driver.app.library.moving import excite_servos
        from limopa.excitation.servo import ServoRequest
        from limopa.page import servo_page

        if picture is not None:
            raise ConfigError("is not drawn for servos; the page beside --out is", path=picture)
        refuse_options(
            context, frozenset(context.params) - _FOR_TORQUE, "is not for position servos"
        )
        wanted = ServoRequest(duration=duration, rate=rate or 50.0, surroundings=surroundings)
        if out.suffix.lower() != ".csv":
            raise ConfigError(
                "is no CSV; commands for position servos are written as .csv", path=out
            )
        page = page_of(out)
        for path in (out, page):
            if path is not None:
                require_file(path)
        model = RobotModel.load(robot)
        names = tuple(motors.split(",")) if motors else model.joint_names
        if len(names) != model.n:
            raise ConfigError(f"--motors names {len(names)}, but {model.name} has {model.n} joints")
        commands = excite_servos(model, wanted, seed=seed)
        commands.save(out)
        if lerobot is not None:
            commands.save_for_lerobot(lerobot, names)
        if page is not None:
            servo_page(commands, model, out.name, robot, names).save(page)
        _report_servos(commands, as_json=as_json)
        return
    refuse_options(context, frozenset(context.params) - _FOR_SERVOS, "is for position servos")
    page = require_writable(out, picture, robot)
    request = ExcitationRequest(
        duration=duration,
        harmonics=harmonics,
        rate=rate or 250.0,
        surroundings=surroundings,
        workspace=Workspace(
            radius=inf if workspace_radius is None else workspace_radius, lower=(-inf, -inf, -inf)
        ),
        starts=starts,
        iterations=iterations,
    )
    model = RobotModel.load(robot)
    conditioning = Conditioning(model)
    found = _excite(model, conditioning, request, seed, quiet=as_json)
    found.trajectory.save(out)
    if picture is not None:
        draw_excitation(found, model, picture)
    if page is not None:
        condition = conditioning.condition(found.trajectory)
        excitation_page(found, model, condition, out.name, robot).save(page)
    _report(found, conditioning, model, as_json=as_json)


def _excite(
    model: RobotModel,
    conditioning: Conditioning,
    request: ExcitationRequest,
    seed: int,
    *,
    quiet: bool,
) -> Excitation:
    """Search behind a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, TimeElapsedColumn

    from limo_driver.app.library.moving import excite

    columns = ("exciting", BarColumn(), MofNCompleteColumn(), "iterations", TimeElapsedColumn())
    with progress(*columns, "condition number {task.fields[condition]}", quiet=quiet) as bar:
        task = bar.add_task("exciting", total=None, condition="")

        def show(done: int, most: int, condition: float) -> None:
            bar.update(task, completed=done, total=most, condition=f"{condition:.1f}")

        return excite(model, request, seed=seed, conditioning=conditioning, progress=show)


def _report(
    found: Excitation, conditioning: Conditioning, model: RobotModel, *, as_json: bool
) -> None:

    motion, console = found.trajectory, terminal(soft_wrap=True)
    condition, scaled = conditioning.condition(motion), conditioning.scaled(motion)
    rigid = conditioning.columns - 2 * model.n
    if as_json:
        console.print_json(
            data={
                "robot": motion.robot,
                "seed": found.seed,
                "duration": motion.duration,
                "samples": len(motion),
                "columns": {"rigid_body": rigid, "viscous": model.n, "coulomb": model.n},
                "condition": condition,
                "condition_of_columns_of_unit_norm": scaled,
                "condition_in_callar_and_boettger_2022": PAPER,
                "joints": [asdict(figures) for figures in _joints(found, model)],
            }
        )
        return
    console.print(
        f"condition number {condition:.1f}; {PAPER} in Çallar and Böttger 2022, of an iiwa\n"
        f"of the regressor of {conditioning.columns} base parameters in SI units, unscaled: "
        f"{rigid} of the rigid body, {model.n} of viscous, {model.n} of Coulomb friction\n"
        f"condition number with columns scaled to unit norm: {scaled:.1f}\n"
        f"{motion.duration:g} s ({len(motion)} samples), base frequency "
        f"{found.request.frequency:.4g} Hz, at rest at both ends",
    )
    console.print(_table(_joints(found, model)))
    if line := unchecked(found.unchecked_pairs):
        console.print(line)


def _joints(found: Excitation, model: RobotModel) -> list[JointFigures]:
    motion, limits = found.trajectory, model.limits
    peaks = motion.peaks()
    return [
        JointFigures(
            j + 1,
            own,
            float(motion.position[:, j].min()),
            float(motion.position[:, j].max()),
            float(peaks.velocity[j] / limits.velocity[j]),
            float(peaks.acceleration[j] / limits.acceleration[j]),
            float(peaks.jerk[j] / limits.jerk[j]),
        )
        for j, own in enumerate(found.harmonics)
    ]


def _table(joints: list[JointFigures]) -> Table:
    from math import degrees

    return joint_table(
        joints,
        {
            "harmonics": (" ".join(map(str, j.harmonics)) for j in joints),
            "from\n[deg]": (f"{degrees(j.position_min):.0f}" for j in joints),
            "to\n[deg]": (f"{degrees(j.position_max):.0f}" for j in joints),
        },
    )


def _report_servos(found: ServoExcitation, *, as_json: bool) -> None:

    if as_json:
        import json

        figures = {name: list(values) for name, values in found.figures().items()}
        values = {
            "robot": found.robot,
            "seed": found.seed,
            "duration": found.duration,
            "rate": found.request.rate,
            "samples": len(found.time),
            "repetitions": [[rows.start, rows.stop] for rows in found.repetitions],
            **figures,
        }
        typer.echo(json.dumps(values, indent=2))
        return
    console = terminal(soft_wrap=True)
    console.print(str(found))
    console.print("lead the arm slowly to the first pose before the first command is sent")
    if line := unchecked(found.unchecked_pairs):
        console.print(line)
