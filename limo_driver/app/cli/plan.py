"""`limo plan`: locally isotropic motion for a robot."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import RobotOption, describe_options
from limo_driver.app.console.terminal import joint_table, progress, terminal, unchecked
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import page_of, require_file, require_parquet

if TYPE_CHECKING:
    from rich.table import Table

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limopa import Plan, PlanRequest, Statistics, Surroundings, Workspace


AXES, CONTACT = 3, 0.05  # of space; [m/s] of a probe on skin
PICTURES = (".png", ".pdf", ".svg")


@dataclass(frozen=True, kw_only=True)
class Distances:
    """Options of what a planned motion keeps away from.

    Args:
        joint_margin: Margin kept from the end of each joint's range, degrees.
        clearance: Distance kept between links and from the table, m.
        table_height: Height of the table plane above the base frame, m.
        self_collision: Check links against each other and their shapes against the table.
    """

    joint_margin: float = 5.0
    clearance: float = 0.02
    table_height: float = 0.0
    self_collision: bool = True

    @property
    def surroundings(self) -> Surroundings:
        """What is planned for."""
        from math import radians

        from limopa import Surroundings

        return Surroundings(
            joint_margin=radians(self.joint_margin),
            clearance=self.clearance,
            table_height=self.table_height,
            self_collision=self.self_collision,
        )


@describe_options
def command(
    *,
    out: Path,
    robot: RobotOption = "iiwa14",
    scaffolds: int = 150,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    rate: float = 250.0,
    workspace_radius: float | None = None,
    near: Path | None = None,
    region: Annotated[str | None, typer.Option(metavar="X,Y,Z,X,Y,Z")] = None,
    speed: float | None = None,
    distances: Distances,
    picture: Path | None = None,
    as_json: bool = False,
) -> None:
    r"""Plan locally isotropic motion (LIMOPA): straight reaches, then small sinusoids around each.

    Every configuration in between keeps the joint limits, the table and the links apart; the motion
    keeps the limits of velocity, acceleration and jerk. Where the arm is to work, --near and
    --region plan slower motion there.

    Args:
        out: Where to write the trajectory (Parquet), and beside it its page.
        scaffolds: Configurations to reach and explore; 150 last about an hour.
        seed: Seed; the same seed gives the same file.
        rate: Samples per second in the file, Hz; smooth between them.
        workspace_radius: Radius of the effective workspace around the base, m; 0.8.
        near: Recording of the arm at work: scaffolds lie around its poses, and the flange is no
            faster than there.
        region: Two opposite corners of a box in the base frame, m, that the flange never leaves, as
            above a patient's couch.
        speed: Most of the flange and of what is 0.1 m from it, m/s; with --region, 0.05.
        picture: Draw the motion into this file (PNG, PDF or SVG).
        as_json: Print the statistics as JSON.

    Examples:
        limo plan --robot iiwa14 --scaffolds 150 --seed 1 --out limo.traj.parquet
        limo plan --scaffolds 5 --out short.traj.parquet --picture short.png \
            --json
        limo plan --region 0.4,-0.2,0.1,0.7,0.2,0.4 --speed 0.03 \
            --scaffolds 12 --out couch.traj.parquet
    """
    from limo_driver.app.library.reading import read
    from limo_driver.model import RobotModel
    from limopa import PlanRequest, draw, summarise
    from limopa.page import plan_page

    page = require_writable(out, picture, robot)
    if speed is None:
        speed = inf if region is None else CONTACT
    request = PlanRequest(
        scaffolds=scaffolds,
        rate=rate,
        workspace=_workspace(workspace_radius, near, region),
        surroundings=distances.surroundings,
        speed=speed,
    )
    model = RobotModel.load(robot)
    work = None if near is None else read(near, model)
    planned = _plan(model, request, work, seed, quiet=as_json)
    planned.trajectory.save(out)
    if picture is not None:
        draw(planned, model, picture)
    if page is not None:
        plan_page(planned, model, out.name, robot).save(page)
    _report(summarise(planned, model), as_json=as_json)


def require_writable(out: Path, picture: Path | None, robot: str) -> Path | None:
    """Refuse to plan for minutes and then find that the results cannot be written.

    Returns:
        Where the page goes, if there is to be one.
    """
    if picture is not None and picture.suffix.lower() not in PICTURES:
        raise ConfigError(f"is no picture; expected {', '.join(PICTURES)}", path=picture)
    if picture is not None and picture.resolve() == out.resolve():
        raise ConfigError("is to hold both the trajectory and the picture", path=out)
    page = page_of(out)
    for path in (out, picture, page):
        if path is not None:
            require_file(path, [Path(robot)])
    require_parquet(out)
    return page


def _workspace(radius: float | None, near: Path | None, region: str | None) -> Workspace:
    """Return where the flange may be, of options of which some exclude others."""
    from limopa import Workspace

    if radius is not None and (near or region):
        other = "--near" if near else "--region"
        raise ConfigError(f"--workspace-radius has no use with {other}, which says where")
    if region is None:
        return Workspace() if radius is None else Workspace(radius=radius)
    try:
        corners = [float(number) for number in region.split(",")]
    except ValueError:
        corners = []
    if len(corners) != 2 * AXES or not all(map(isfinite, corners)):
        raise ConfigError(
            f"--region is {region!r}, expected x,y,z of a corner and x,y,z of the opposite one [m]"
        )
    ends = [sorted(pair) for pair in zip(corners[:AXES], corners[AXES:], strict=True)]
    (x, x_end), (y, y_end), (z, z_end) = ends
    return Workspace(radius=inf, lower=(x, y, z), upper=(x_end, y_end, z_end), throughout=True)


def _plan(
    model: RobotModel, request: PlanRequest, near: Recording | None, seed: int, *, quiet: bool
) -> Plan:
    """Plan behind a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

    from limo_driver.app.library.moving import plan

    columns = ("planning", BarColumn(), MofNCompleteColumn(), "scaffolds", TimeRemainingColumn())
    with progress(*columns, quiet=quiet) as bar:
        task = bar.add_task("planning", total=request.scaffolds)
        return plan(
            model,
            request,
            near=near,
            seed=seed,
            progress=lambda done, _wanted: bar.update(task, completed=done),
        )


def _report(statistics: Statistics, *, as_json: bool) -> None:

    if as_json:
        import json

        typer.echo(json.dumps(statistics.as_dict(), indent=2))
        return
    console = terminal()
    s = statistics
    console.print(
        f"{s.scaffolds} scaffolds, {s.waypoints} waypoints, {_clock(s.duration)} "
        f"({s.samples} samples)\n"
        f"exploring: {s.waypoints_per_phase.mean:.0f} waypoints and "
        f"{s.exploring_duration.mean:.1f} s each, peaks at {s.exploring_velocity.least:.0%} to "
        f"{s.exploring_velocity.most:.0%} of the velocity limit"
    )
    if s.scaffolds > 1:
        console.print(
            f"reaching: {s.reaching_duration.mean:.1f} s each, "
            f"up to {s.reaching_duration.most:.1f} s"
        )
    from rich.table import Table

    stages = s.rejections
    conditions = sorted({name for counts in stages.values() for name in counts})
    table = Table(title=f"rejected by ({s.candidates} scaffolds drawn)", title_justify="left")
    table.add_column("condition")
    for stage in stages:
        table.add_column(stage, justify="right")
    for name in conditions:
        table.add_row(name, *(str(counts.get(name, 0)) for counts in stages.values()))
    console.print(_joint_table(s), table)
    if line := unchecked(s.unchecked_pairs):
        console.print(line)


def _joint_table(statistics: Statistics) -> Table:
    from math import degrees

    joints = statistics.joints
    turned = (degrees(j.rotation_between_reversals) for j in joints)
    return joint_table(
        joints,
        {
            "range\ncovered": (f"{j.coverage:.0%}" for j in joints),
            "reversals": (j.reversals for j in joints),
            "rotation\nbetween": (f"{rotation:.1f} deg" for rotation in turned),
        },
    )


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"
