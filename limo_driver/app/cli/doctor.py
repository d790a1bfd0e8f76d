"""`limo doctor`: why a link to a real arm does not work, and the steps to its first motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limo_driver.app.cli.plan import Distances
from limo_driver.app.console.command_line import ROBOTS, describe_options
from limo_driver.app.console.terminal import say
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.app.library.first_motion.arms import RealArm
    from limo_driver.app.library.first_motion.steps import FirstMotionSettings
    from limo_driver.model import RobotModel
    from limo_driver.robot.registry import Examination

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
_SECONDS = 5.0  # of an examination


@command.callback()
def doctor() -> None:
    """Find out why a link to a real arm does not work, and take the steps to its first motion.

    Example:
        limo doctor fri
    """


class StepName(StrEnum):
    """Step to a first motion."""

    LINK = "link"
    RECEIVE = "receive"
    SHADOW = "shadow"
    ONE_JOINT = "one-joint"
    LIMOPA = "limopa"


@dataclass(frozen=True, kw_only=True)
class StepOptions:
    """Options of the steps to a first motion.

    Args:
        sim: Take the next step; the arm, its tool and mounting as in this sim.yaml.
        step: Which one; else the first that has not passed.
        out: Folder of the records and pages of all steps.
        minutes: For which the arm is only received, or the link examined.
        seconds: Likewise [s]; 5 for the link, else an hour.
        torque_tolerance: Of torques at rest against gravity, as a share of each joint's limit.
        joint: That moves alone, planned with --step shadow; else the last.
        scaffolds: Poses of the motion of all joints, planned with --step shadow.
        seed: Seed of that plan.
        fifo: Ask for SCHED_FIFO and locked memory while the arm moves.
    """

    robot: Annotated[
        str | None, typer.Option(help=f"Take the next step to the first motion of: {ROBOTS}.")
    ] = None
    sim: Path | None = None
    step: StepName | None = None
    out: Path = Path("first_motion")
    minutes: Annotated[float | None, typer.Option(min=0.0)] = None
    seconds: Annotated[float | None, typer.Option(min=0.05)] = None
    torque_tolerance: Annotated[float, typer.Option(min=0.0, max=0.5)] = 0.02
    joint: Annotated[int | None, typer.Option(min=1)] = None
    scaffolds: Annotated[int, typer.Option(min=1)] = 3
    seed: Annotated[int, typer.Option(min=0)] = 0
    fifo: bool = False

    @property
    def wanted(self) -> bool:
        """Whether a step is to be taken; else the link is examined, and nothing kept."""
        return self.robot is not None or self.sim is not None

    @property
    def described(self) -> tuple[RobotModel, tuple[str, ...]]:
        """The arm as it is described, and the options that say so."""
        from limo_driver.model import RobotModel
        from limo_driver.physics import Simulation

        if self.sim is None:
            return RobotModel.load(str(self.robot)), ("--robot", str(self.robot))
        if self.robot is not None:
            raise ConfigError("give `simulation` or `robot`; a simulation names its robot")
        return Simulation.load(self.sim).body, ("--sim", str(self.sim))

    @property
    def time(self) -> float | None:
        """For how long, if that was given [s]."""
        if self.minutes is not None and self.seconds is not None:
            raise ConfigError("give --minutes or --seconds, not both")
        time = self.seconds if self.minutes is None else 60 * self.minutes
        if time is not None and not time > 0:
            raise ConfigError("--minutes is 0, expected above 0")
        return time

    def settings(self, distances: Distances) -> FirstMotionSettings:
        """Return how the steps are done."""
        from limo_driver.app.library.first_motion.steps import FirstMotionSettings

        settings = FirstMotionSettings(
            tolerance=self.torque_tolerance,
            joint=self.joint or 0,
            scaffolds=self.scaffolds,
            seed=self.seed,
            surroundings=distances.surroundings,
            fifo=self.fifo,
        )
        if (time := self.time) is None:
            return settings
        watch = replace(settings.watch, duration=time)
        return replace(settings, link_seconds=time, watch=watch)


@command.command()
@describe_options
def fri(
    *,
    host: str | None = None,
    port: int = 30200,
    steps: StepOptions,
    distances: Distances,
    as_json: bool = False,
) -> None:
    """Listen to the arm, answer it without commanding anything, and say how the link stands.

    To the robot it is a client like any other: where a session waits for one, the robot's own
    program may begin to move. Keep a hand on the stop.

    With --robot or --sim: take the next of five steps to the first motion. Link; receive only;
    shadow, in which commands are computed and not sent; one joint by 2 degrees; LIMOPA at a tenth
    of the speed. Each writes a page and a record, and is refused until those before it have
    passed. In the first three, only a session that is monitored is answered: nothing moves.

    Exit status 0 if the link works or the step has passed; 3 if nobody sends, 4 if the robot falls
    silent, 5 if it does not hear the answers, 6 at a safety stop, 7 if drives are off, 8 if the
    send period is too long to command, and 1 for anything else that is wrong; 2 if a step is
    refused.

    Args:
        host: Address of the controller; else whoever sends.
        port: UDP port of this machine.
        as_json: Print what was found as JSON.

    Examples:
        limo doctor fri
        limo doctor fri --host 192.170.10.2 --port 30201 --seconds 10 --json
        limo doctor fri --robot iiwa14 --host 192.170.10.2
        limo doctor fri --sim with_tool.yaml --step receive --minutes 10
    """
    from backends.fri.doctor import examine
    from limo_driver.app.library.first_motion.arms import FriArm

    if not steps.wanted:
        _end(examine(host, port, steps.time or _SECONDS), as_json=as_json)
    model, options = steps.described
    _take(FriArm(model, options, host, port), steps, distances, as_json=as_json)


@command.command()
@describe_options
def can(
    *,
    config: Path,
    steps: StepOptions,
    distances: Distances,
    as_json: bool = False,
) -> None:
    """Find the drives of an arm on its CAN bus, and say how the bus stands; none gets power.

    Drives are configured as `limo run` does, and put out of operation by that: an arm that they
    hold, and that has no brakes, has to be supported.

    With --robot or --sim: take the next of five steps to the first motion, as `limo doctor fri
    --help` says. The description has to be that of the configuration.

    Exit status 0 if the bus works or the step has passed, 1 if something is wrong, 2 if a step is
    refused.

    Args:
        config: The arm (arm.yaml): its bus, its drives.
        as_json: Print what was found as JSON.

    Examples:
        limo doctor can --config arm.yaml
        limo doctor can --config arm.yaml --robot arm.urdf
    """
    from backends.can.config import ArmConfig
    from backends.can.doctor import examine
    from limo_driver.app.library.first_motion.arms import CanArm

    arm = ArmConfig.load(config)
    if not steps.wanted:
        _end(examine(arm, steps.time or _SECONDS), as_json=as_json)
    model, options = steps.described
    _take(CanArm(model, options, arm, config), steps, distances, as_json=as_json)


def _take(arm: RealArm, steps: StepOptions, distances: Distances, *, as_json: bool) -> None:
    """Take a step, and end with its verdict."""
    from limo_driver.app.library.first_motion.steps import take_step

    def tell(time: float, poses: int) -> None:
        if not as_json and round(time) % 60 == 0:
            say(f"received for {time:.0f} s, {poses} poses at rest", stderr=True)

    name = None if steps.step is None else steps.step.value
    result = take_step(arm, steps.out, name, steps.settings(distances), tell)
    more = {"step": result.record["step"], "page": str(result.page)}
    _end(result.found, as_json=as_json, verdict=result.record["verdict"], more=more)


def _end(
    found: Examination, *, as_json: bool, verdict: str = "", more: dict[str, Any] | None = None
) -> None:
    """Print what was found, and end with its status."""
    import json

    if as_json:
        typer.echo(json.dumps(found.as_json() | (more or {})))
        raise typer.Exit(found.status)
    for finding in found.findings:
        kind = "problem" if finding.problem else "note"
        say(f"{kind}: {f'{finding.code}: ' if verdict else ''}{finding.text}")
    if more is not None:
        say(f"{more['step']}: {verdict}; {more['page']}")
    elif found.healthy:
        typer.echo("the link works")
    raise typer.Exit(found.status)
