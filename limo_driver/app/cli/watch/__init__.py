"""`limo watch`: show the services on the network, live."""

from __future__ import annotations

import json
import math
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.console.command_line import SessionOptions, describe_options
from limo_driver.app.console.terminal import say
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    import zenoh

    from limo_driver.app.cli.watch.screen import Watched
    from limo_driver.network.streaming import Keys

_PORT = 8642  # of the page of --web


@describe_options
def command(
    *,
    arm: str = "*",
    network: SessionOptions,
    duration: Annotated[float | None, typer.Option(min=0.0)] = None,
    until: Annotated[str | None, typer.Option(metavar="PHASE")] = None,
    timeout: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    as_json: bool = False,
    web: bool = False,
    port: Annotated[int | None, typer.Option(min=0, max=65535)] = None,
    rerun: Annotated[str | None, typer.Option(metavar="viewer|FILE.rrd|ADDRESS")] = None,
    robot: str | None = None,
) -> None:
    """Show rates, latency, external torque, models, contacts and losses of arms on the network.

    With --until, wait for a service instead: exit status 0 once it is that far, or further.

    Args:
        arm: Name of the arm; * for all.
        duration: Stop after this time [s]; else at Ctrl-C.
        until: Show nothing, and end as soon as a service is as far as loading, compiling, waiting
            (for joint states), preparing or serving.
        timeout: With --until: wait no longer, then end with exit status 1. 60 if not given.
        as_json: Print every status and event as JSON, one a line.
        web: Serve a page to this machine: the arm, torques, events.
        port: With --web: of the page; 0 for any. 8642 if not given.
        rerun: Log the arm, torques and events to Rerun: open its viewer, write a file, or send to
            an address such as rerun+http://127.0.0.1:9876/proxy.
        robot: With --web or --rerun: the robot drawn, built in, URDF or MJCF; else iiwa14.

    Examples:
        limo watch
        limo watch --arm iiwa14 --connect tcp/192.168.1.2:7447 --json
        limo watch --arm iiwa14 --until serving --timeout 60
        limo watch --arm iiwa14 --web
        limo watch --arm iiwa14 --rerun monday.rrd --duration 60
    """
    from limo_driver.app.cli.watch.screen import Watched, show
    from limo_driver.network.streaming import Keys, follow_history

    drawn = "--web" if web else "" if rerun is None else "--rerun"
    if not web and port is not None:
        raise ConfigError("--port is of the page that --web serves")
    if not drawn and robot is not None:
        raise ConfigError("--robot is of what --web or --rerun draws")
    if web and rerun is not None:
        raise ConfigError("--web and --rerun are two programs' work: give one of them")
    if until is not None:
        if drawn:
            raise ConfigError(f"{drawn} is for watching; --until only waits")
        if duration is not None:
            raise ConfigError("--duration is for watching; --until ends after --timeout")
        _wait(arm, until, timeout, network, as_json=as_json)
        return
    if timeout is not None:
        raise ConfigError("--timeout is for --until; watching ends after --duration")
    if drawn and arm == "*":
        raise ConfigError(f"{drawn} shows one arm: name it with --arm")
    watched = Watched(as_json=as_json)
    keys = Keys.of_any() if arm == "*" else Keys(arm)
    with network.open() as session:
        followed = [
            follow_history(session, keys.status("service"), watched.take_status),
            follow_history(session, keys.event, watched.take_event),
        ]
        with suppress(KeyboardInterrupt):
            if web:
                page = _PORT if port is None else port
                # Serve the page of an arm until the time is over
                from limo_driver.app.live.web import ArmFeed, LiveServer
                from limo_driver.model import BUILT_IN, RobotModel

                model = RobotModel.load(robot or BUILT_IN[0])
                with (
                    ArmFeed(session, keys, model, lambda: watched.of(keys.arm)) as feed,
                    LiveServer(keys.arm, model, feed.snapshot, page) as server,
                ):
                    say(f"open {server.address}")
                    threading.Event().wait(duration)
            elif rerun is not None:
                _log_to_rerun(watched, session, keys, robot, rerun, duration)
            else:
                show(watched, duration)
        for subscriber in followed:
            subscriber.undeclare()


def _log_to_rerun(
    watched: Watched,
    session: zenoh.Session,
    keys: Keys,
    robot: str | None,
    target: str,
    duration: float | None,
) -> None:
    """Log an arm to Rerun until the time is over."""
    from limo_driver.app.live.rerun_log import RATE, RerunLog
    from limo_driver.app.live.web import ArmFeed
    from limo_driver.model import BUILT_IN, RobotModel
    from limo_driver.network.streaming import follow_history

    model = RobotModel.load(robot or BUILT_IN[0])
    ends, pause = math.inf if duration is None else time.monotonic() + duration, threading.Event()
    with (
        RerunLog(keys.arm, model, target) as log,
        ArmFeed(session, keys, model, lambda: watched.of(keys.arm)) as feed,
    ):
        followed = follow_history(session, keys.event, log.take_event)
        problem = ""
        try:
            while time.monotonic() < ends:
                log.take(shown := feed.snapshot())
                if shown.get("problem", "") != problem:
                    problem = shown.get("problem", "")
                    say(problem or "the arm is drawn again", stderr=True)
                pause.wait(min(1.0 / RATE, max(ends - time.monotonic(), 0.0)))
        finally:
            followed.undeclare()


def _wait(
    arm: str,
    until: str,
    timeout: float | None,
    network: SessionOptions,
    *,
    as_json: bool,
) -> None:
    """Wait for a service, and say how far it is."""
    from limo_driver.network.readiness import (
        PATIENCE,
        ServicePhase,
        require_wait,
        wait_until_serving,
    )

    phase, seconds = ServicePhase.named(until), PATIENCE if timeout is None else timeout
    require_wait("--timeout", seconds)
    with network.open() as session:
        heard = wait_until_serving(session, arm, until=phase, timeout=seconds)
    if as_json:
        typer.echo(json.dumps({"arm": heard.arm, "phase": heard.phase, "state": heard.state}))
    else:
        say(f"{heard.arm}: {heard.state}")
