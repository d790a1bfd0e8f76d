"""`limo plan`: locally isotropic motion for a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.arguments import RobotOption, describe_options
from limo_driver.app.console.terminal import progress, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import page_of, require_file, require_parquet

if TYPE_CHECKING:
    from rich.table import Table

    from limo_driver.model import RobotModel
    from limopa import Plan, PlanRequest, Statistics, Surroundings


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
    workspace_radius: float = 0.8,
    distances: Distances,
    picture: Path | None = None,
    as_json: bool = False,
) -> None:
    r"""Plan locally isotropic motion (LIMOPA): straight reaches, then small sinusoids around each.

    Every configuration in between keeps the joint limits, the table and the links apart; the motion
    keeps the limits of velocity, acceleration and jerk.

    Args:
        out: Where to write the trajectory (Parquet), and beside it its page.
        scaffolds: Configurations to reach and explore; 150 last about an hour.
        seed: Seed; the same seed gives the same file.
        rate: Samples per second in the file, Hz; smooth between them.
        workspace_radius: Radius of the effective workspace around the base, m.
        picture: Draw the motion into this file (PNG, PDF or SVG).
        as_json: Print the statistics as JSON.

    Examples:
        limo plan --robot iiwa14 --scaffolds 150 --seed 1 --out limo.traj.parquet
        limo plan --scaffolds 5 --out short.traj.parquet --picture short.png \
            --json
    """
    from limo_driver.model import RobotModel
    from limopa import PlanRequest, Workspace, draw, summarise
    from limopa.page import plan_page

    page = require_writable(out, picture, robot)
    request = PlanRequest(
        scaffolds=scaffolds,
        rate=rate,
        workspace=Workspace(radius=workspace_radius),
        surroundings=distances.surroundings,
    )
    model = RobotModel.load(robot)
    planned = _plan(model, request, seed, quiet=as_json)
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


def _plan(model: RobotModel, request: PlanRequest, seed: int, *, quiet: bool) -> Plan:
    """Plan behind a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

    from limo_driver.app.library.moving import plan

    columns = ("planning", BarColumn(), MofNCompleteColumn(), "scaffolds", TimeRemainingColumn())
    with progress(*columns, quiet=quiet) as bar:
        task = bar.add_task("planning", total=request.scaffolds)
        return plan(
            model,
            request,
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
    console.print(_joint_table(s), _rejection_table(s))
    if s.unchecked_pairs:
        pairs = ", ".join(" and ".join(pair) for pair in s.unchecked_pairs)
        console.print(f"not checked against each other, since they always touch: {pairs}")


def _joint_table(statistics: Statistics) -> Table:
    from math import degrees

    from rich.table import Table

    table = Table(title="joints (peaks relative to their limits)", title_justify="left")
    for heading in (
        "joint", "range\ncovered", "reversals", "rotation\nbetween",
        "peak\nvelocity", "peak\naccel.", "peak\njerk",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for j in statistics.joints:
        table.add_row(
            str(j.joint),
            f"{j.coverage:.0%}",
            str(j.reversals),
            f"{degrees(j.rotation_between_reversals):.1f} deg",
            f"{j.peak_velocity:.0%}",
            f"{j.peak_acceleration:.0%}",
            f"{j.peak_jerk:.0%}",
        )
    return table


def _rejection_table(statistics: Statistics) -> Table:
    from rich.table import Table

    stages = statistics.rejections
    conditions = sorted({name for counts in stages.values() for name in counts})
    table = Table(
        title=f"rejected by ({statistics.candidates} scaffolds drawn)", title_justify="left"
    )
    table.add_column("condition")
    for stage in stages:
        table.add_column(stage, justify="right")
    for name in conditions:
        table.add_row(name, *(str(counts.get(name, 0)) for counts in stages.values()))
    return table


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"
