"""`limo controller`: an FRI controller without a robot."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import say
from limo_driver.errors import ConfigError


class CommandOption(StrEnum):
    """Quantity that the client may command."""

    POSITION = "position"
    TORQUE = "torque"
    WRENCH = "wrench"


@describe_options
def command(
    *,
    client: str = "127.0.0.1:30200",
    fri: str = "1.15",
    bind: str | None = None,
    mode: CommandOption = CommandOption.POSITION,
    period_ms: int = 2,
    multiplier: int = 1,
    duration: float | None = None,
    sim: Path | None = None,
    scenario: Path | None = None,
    position: str | None = None,
    trajectory: Path | None = None,
    late_ms: Annotated[float | None, typer.Option(min=0.0)] = None,
    io: list[str] | None = None,
    transformation: list[str] | None = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    fifo: bool = False,
    as_json: bool = False,
) -> None:
    r"""Be an FRI controller with a simulated iiwa, for any FRI client.

    It says on standard output when it is ready, and at its end what was sent and answered, how the
    session went, and what the client did wrong. A client that never answers is waited for; the
    robot speaks first.

    Args:
        client: Where the client listens, HOST:PORT; the controller speaks first.
        fri: Version: 1.11, 1.14, 1.15, 1.16, 2.5 or 2.7.
        bind: Own address, HOST or HOST:PORT; else any free port.
        mode: What the client commands.
        period_ms: Send period, 1 to 100 [ms]; at most 10 to be commanded positions, 5 torques.
        multiplier: Receive multiplier: the client answers every that many packets.
        duration: End the session after this time [s]; else at Ctrl-C.
        sim: A sim.yaml for the arm; else the iiwa's rigid body alone.
        scenario: What goes wrong when (YAML, see docs/fri_controller.md).
        position: Where the arm stands at first, seven angles [rad].
        trajectory: The arm stands where this trajectory starts.
        late_ms: Count answers slower than this [ms].
        io: NAME:TYPE:DIRECTION[:VALUE] that the application names; repeatable.
        transformation: Name of a frame that the client shall send; repeatable.
        seed: Seed of the sensors' noise.
        fifo: Ask for SCHED_FIFO and locked memory.
        as_json: Say that it is ready, and the report, as JSON.

    Examples:
        limo controller --fri 1.15 --client 127.0.0.1:30200 \
            --trajectory limo.traj.parquet
        limo controller --fri 2.7 --mode torque --period-ms 1 --duration 10 --json
        limo controller --client 192.168.1.5:30200 --sim sim.yaml \
            --scenario lossy.yaml
        limo controller --io FRI.Clock:bool:input:1 --transformation PickPos
    """
    from backends.fri.codec.messages import FriVersion
    from backends.fri.simulator.connection.port import Address
    from backends.fri.simulator.controller import SimulatedController
    from backends.fri.simulator.judge import check_signal_name, parse_io
    from backends.fri.simulator.scenario import ControllerScenario
    from backends.fri.simulator.session import ANYWHERE, MODES, ControllerSettings
    from limo_driver.physics import Simulation
    from limo_driver.robot.interrupts import interrupts

    for name in transformation or ():
        check_signal_name(name)
    settings = ControllerSettings(
        client=Address.parse(client, "--client"),
        version=FriVersion.named(fri),
        bind=ANYWHERE if bind is None else Address.parse(bind, "--bind", port=ANYWHERE.port),
        mode=MODES[mode.value],
        period_ms=period_ms,
        multiplier=multiplier,
        duration=duration,
        late_after=None if late_ms is None else 1e-3 * late_ms,
        position=_start(position, trajectory),
        seed=seed,
        fifo=fifo,
        ios=tuple(parse_io(text) for text in io or ()),
        transformations=tuple(transformation or ()),
    )
    simulation = None if sim is None else Simulation.load(sim)
    played = None if scenario is None else ControllerScenario.load(scenario)
    with SimulatedController(settings, simulation, played) as controller:
        if as_json:
            ends = {"from": controller.address, "to": str(settings.client)}
            typer.echo(json.dumps({"ready": True, "fri": fri, **ends}))
        else:
            words = f"FRI {fri} from {controller.address} to {settings.client}, {settings.note}"
            say(f"ready: {words}; end it with Ctrl-C")
        with interrupts(controller.stop):
            report = controller.run()
    say(json.dumps(report.as_json()) if as_json else report.as_text())


def _start(position: str | None, trajectory: Path | None) -> tuple[float, ...]:
    """Return where the arm stands at first [rad]."""
    from backends.fri.codec.messages import JOINTS
    from backends.fri.simulator.session import POSE
    from limo_driver.model import BUILT_IN
    from limo_driver.trajectory import Trajectory

    if trajectory is None:
        return POSE if position is None else _angles(position)
    if position is not None:
        raise ConfigError("give --position or --trajectory, not both")
    motion = Trajectory.load(trajectory)
    motion.check_robot(JOINTS, BUILT_IN[0])
    return tuple(motion.position[0].tolist())


def _angles(text: str) -> tuple[float, ...]:
    from backends.fri.codec.messages import JOINTS

    try:
        angles = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        angles = ()
    if len(angles) != JOINTS:
        raise ConfigError(f"--position {text!r} has to be {JOINTS} angles in rad, with commas")
    return angles
