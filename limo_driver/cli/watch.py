"""`limo watch`: show the services on the network, live."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from limo_driver.network.options import ConfigFile, Connect, Listen  # noqa: TC001  # typer

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import zenoh
    from rich.console import RenderableType
    from rich.text import Text

    from limo_driver.network.messages import Event
    from limo_driver.network.streaming import Keys

_PORT = 8642  # of the page of --web
_EVENTS = 12  # shown
_STALE = 3.0  # [s] without status, after which a service is shown as silent
_LONGEST = 65536  # bytes of a status
_WIDEST = 500  # characters of a line
_BARS = " ▁▂▃▄▅▆▇█"
_PER_BAR = 10  # bins of the latency histogram in one bar


def command(
    arm: Annotated[str, typer.Option(help="Name of the arm; * for all.")] = "*",
    connect: Connect = None,
    listen: Listen = None,
    config: ConfigFile = None,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time [s]; else at Ctrl-C.")
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="PHASE",
            help="Show nothing, and end as soon as a service is as far as loading, compiling, "
            "waiting (for joint states), preparing or serving.",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="With --until: wait no longer, then end with exit status 1. 60 if not given.",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print every status and event as JSON, one a line.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="Serve a page to this machine: the arm, torques, events.")
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="With --web: of the page; 0 for any. 8642 if not given."
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar="viewer|FILE.rrd|ADDRESS",
            help="Log the arm, torques and events to Rerun: open its viewer, write a file, or "
            "send to an address such as rerun+http://127.0.0.1:9876/proxy.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="With --web or --rerun: the robot drawn, built in, URDF or MJCF; else iiwa14."
        ),
    ] = None,
) -> None:
    """Show rates, latency, external torque, models, contacts and losses of arms on the network.

    With --until, wait for a service instead: exit status 0 once it is that far, or further.

    Examples:
        limo watch
        limo watch --arm iiwa14 --connect tcp/192.168.1.2:7447 --json
        limo watch --arm iiwa14 --until serving --timeout 60
        limo watch --arm iiwa14 --web
        limo watch --arm iiwa14 --rerun monday.rrd --duration 60
    """
    from limo_driver.console.shortening import shortened
    from limo_driver.errors import ConfigError
    from limo_driver.network.streaming import Keys, follow_history, open_session

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
        _wait(arm, until, timeout, (connect or (), listen or (), config), as_json=as_json)
        return
    if timeout is not None:
        raise ConfigError("--timeout is for --until; watching ends after --duration")
    if drawn and arm == "*":
        raise ConfigError(f"{drawn} shows one arm: name it with --arm")
    watched = Watched(as_json=as_json)
    keys = Keys.of_any() if arm == "*" else Keys(arm)
    with open_session(connect or (), listen or (), config) as session:
        followed = [
            follow_history(session, keys.status("service"), watched.take_status),
            follow_history(session, keys.event, watched.take_event),
        ]
        with suppress(KeyboardInterrupt):
            seconds = shortened("--duration", duration, 5.0)
            if web:
                page = _PORT if port is None else port
                _serve(watched, session, keys, robot, page, seconds)
            elif rerun is not None:
                _log_to_rerun(watched, session, keys, robot, rerun, seconds)
            else:
                _show(watched, seconds)
        for subscriber in followed:
            subscriber.undeclare()


def _serve(
    watched: Watched,
    session: zenoh.Session,
    keys: Keys,
    robot: str | None,
    port: int,
    duration: float | None,
) -> None:
    """Serve the page of an arm until the time is over."""
    from limo_driver.live.feed import ArmFeed
    from limo_driver.live.web import LiveServer
    from limo_driver.model import BUILT_IN, RobotModel

    model = RobotModel.load(robot or BUILT_IN[0])
    with (
        ArmFeed(session, keys, model, lambda: watched.of(keys.arm)) as feed,
        LiveServer(keys.arm, model, feed.snapshot, port) as server,
    ):
        typer.echo(f"open {server.address}")
        threading.Event().wait(duration)


def _log_to_rerun(
    watched: Watched,
    session: zenoh.Session,
    keys: Keys,
    robot: str | None,
    target: str,
    duration: float | None,
) -> None:
    """Log an arm to Rerun until the time is over."""
    from limo_driver.live.feed import ArmFeed
    from limo_driver.live.rerun_log import RATE, RerunLog
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
                    typer.echo(problem or "the arm is drawn again", err=True)
                pause.wait(min(1.0 / RATE, max(ends - time.monotonic(), 0.0)))
        finally:
            followed.undeclare()


def _wait(
    arm: str,
    until: str,
    timeout: float | None,
    ends: tuple[Sequence[str], Sequence[str], Path | None],
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
    from limo_driver.network.streaming import open_session

    phase, seconds = ServicePhase.named(until), PATIENCE if timeout is None else timeout
    require_wait("--timeout", seconds)
    with open_session(*ends) as session:
        heard = wait_until_serving(session, arm, until=phase, timeout=seconds)
    if as_json:
        typer.echo(json.dumps({"arm": heard.arm, "phase": heard.phase, "state": heard.state}))
    else:
        typer.echo(_printable(f"{heard.arm}: {heard.state}"))


class Watched:
    """Messages received so far: the last status of each arm, and the latest events."""

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self.statuses: dict[str, tuple[float, dict[str, Any]]] = {}
        self.events: deque[tuple[str, Event]] = deque(maxlen=_EVENTS)
        self.malformed = 0

    def of(self, arm: str) -> dict[str, Any]:
        """Return status and events of an arm as plain values; no status where it is stale."""
        came, status = self.statuses.get(arm, (-math.inf, None))
        events = [
            f"{event.kind}: {_printable(event.text)}"
            for of, event in list(self.events)
            if of == arm
        ]
        return {"status": status if time.monotonic() - came < _STALE else None, "events": events}

    def take_status(self, sample: zenoh.Sample) -> None:
        """Keep a status; count those that are malformed or of another arm than their key says."""
        arm = _arm_of(sample)
        try:
            status = _read_status(sample.payload.to_bytes())
            if arm is None or status["arm"] != arm:
                raise ValueError(arm)
            _arm(status, 0.0)
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            RecursionError,
            TypeError,
            ValueError,
        ):
            self.malformed += 1
            return
        self.statuses[arm] = time.monotonic(), status
        if self.as_json:
            typer.echo(json.dumps({"status": status}))

    def take_event(self, sample: zenoh.Sample) -> None:
        """Keep an event; count malformed ones."""
        from limo_driver.errors import WireFormatError
        from limo_driver.network.messages import decode_event

        arm = _arm_of(sample)
        try:
            event = decode_event(sample.payload.to_bytes())
        except WireFormatError:
            event = None
        if arm is None or event is None:
            self.malformed += 1
            return
        self.events.append((arm, event))
        if self.as_json:
            line = {"arm": arm, "event": event.kind, "time_ns": event.stamp_ns, "text": event.text}
            typer.echo(json.dumps({**event.facts, **line}))


def _arm_of(sample: zenoh.Sample) -> str | None:
    """Return the arm that a sample is of; what was put on many keys at once is of none."""
    match str(sample.key_expr).split("/"):
        case ["limo", arm, *_] if "*" not in arm:
            return arm
        case _:
            return None


def _read_status(data: bytes) -> dict[str, Any]:
    """Return a JSON object; an error where it is none, or holds what JSON has no word for."""
    if len(data) > _LONGEST:
        raise ValueError(len(data))
    value: object = json.loads(data)
    json.dumps(value, allow_nan=False)
    if not isinstance(value, dict):
        raise TypeError(value)
    return cast("dict[str, Any]", value)


def _printable(text: str) -> str:
    """Return the beginning of a text, without what a terminal would obey."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[:_WIDEST])


def _show(watched: Watched, duration: float | None) -> None:
    """Draw twice a second until the time is over."""
    from rich.live import Live

    from limo_driver.console.terminal import terminal

    ends = math.inf if duration is None else time.monotonic() + duration
    pause = threading.Event()
    if watched.as_json:
        while time.monotonic() < ends:
            pause.wait(min(0.5, max(ends - time.monotonic(), 0.0)))
        return
    with Live(console=terminal(), screen=False, refresh_per_second=4) as live:
        while time.monotonic() < ends:
            live.update(_page(watched))
            pause.wait(min(0.5, max(ends - time.monotonic(), 0.0)))
        live.update(_page(watched))


def _page(watched: Watched) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    if not watched.statuses:
        return Text("no service on the network yet; start one with `limo serve`", style="yellow")
    now = time.monotonic()
    arms = [_arm(status, now - came) for came, status in dict(watched.statuses).values()]
    return Group(*arms, _events(watched))


def _arm(status: dict[str, Any], age: float) -> RenderableType:
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    title = Text(_printable(f"{status['arm']}: {status.get('state', '')}"))
    if age > _STALE:
        return Panel(Text(f"silent for {age:.0f} s", style="red"), title=title)
    if status.get("state") != "serving":
        text = _printable(str(status["state"]))
        bad = text.startswith(("silent", "refused"))
        return Panel(Text(text, style="red" if bad else "yellow"), title=title)
    facts = Table.grid(padding=(0, 2))
    arrivals, latency = status["arrivals"], status["latency"]
    facts.add_row("model", Text(_printable(_model(status))))
    if "retraining" in status:
        facts.add_row("retraining", Text(_printable(_retraining(status["retraining"]))))
    facts.add_row(
        "rate", f"{status['rate']:g} Hz, {status['answered']:d} answered in the last second"
    )
    losses = {k: v for k, v in arrivals.items() if k != "received"}
    facts.add_row("losses", _counts(losses))
    facts.add_row("counts", _counts({k: v for k, v in status["counts"].items() if v}))
    if latency["count"]:
        facts.add_row(
            "latency",
            f"p50 {1e3 * latency['p50']:.2f}  p99 {1e3 * latency['p99']:.2f}  "
            f"longest {1e3 * latency['longest']:.2f} ms   {_bars(latency['counts'])}",
        )
    if "log" in status:
        facts.add_row("log", _log(status["log"]))
    return Panel(Group(facts, _joints(status)), title=title, title_align="left")


def _counts(counts: dict[str, Any]) -> Text:
    from rich.text import Text

    return Text(_printable(", ".join(f"{value:d} {name}" for name, value in counts.items()) or "-"))


def _log(log: dict[str, Any]) -> Text:
    from rich.text import Text

    written = f"{log['written']:d} written, {log['dropped']:d} dropped"
    if log["failure"] is None:
        return Text(written)
    return Text(_printable(f"stopped: {log['failure']}; {written}"), style="red")


def _model(status: dict[str, Any]) -> str:
    return f"{status['model']}, {1e3 * status['delay']:.0f} ms behind"


def _retraining(facts: dict[str, Any]) -> str:
    """Return the stage, and what is known of it."""
    parts = [str(facts["stage"])]
    if "challenger" in facts:
        parts.append(f"challenger {facts['challenger']}")
    parts += [str(facts[name]) for name in ("reason", "verdict") if name in facts]
    if "left" in facts:
        parts.append(f"{facts['left']:.0f} s to go")
    if "judged" in facts:
        parts.append(f"{facts['judged']:.0f} s judged")
    return ", ".join(parts)


def _joints(status: dict[str, Any]) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    table = Table("joint", "external rms [N m]", "outside", "contact", box=None)
    rows = zip(status["external_rms"], status["outside"], status["contact"], strict=False)
    for j, (rms, outside, contact) in enumerate(rows, start=1):
        part = outside / max(status["answered"], 1)
        table.add_row(
            str(j),
            "-" if rms is None else f"{rms:.3f}",
            f"{100 * part:.0f} %",
            Text("contact", style="bold yellow") if contact else "",
        )
    return table


def _bars(counts: list[int]) -> str:
    """Return the histogram as characters, from where it begins to where it ends."""
    sums = [sum(counts[k : k + _PER_BAR]) for k in range(0, len(counts), _PER_BAR)]
    filled = [k for k, value in enumerate(sums) if value]
    if not filled:
        return ""
    shown = sums[filled[0] : filled[-1] + 1]
    return "".join(_BARS[math.ceil(8 * math.log1p(v) / math.log1p(max(shown)))] for v in shown)


def _events(watched: Watched) -> RenderableType:
    from datetime import UTC, datetime

    from rich.panel import Panel
    from rich.text import Text

    lines = Text()
    for arm, event in list(watched.events):
        when = datetime.fromtimestamp(event.stamp_ns / 1e9, UTC).astimezone()
        style = {30: "yellow", 40: "red", 50: "bold red"}.get(int(event.level), "")
        lines.append(_printable(f"{when:%H:%M:%S} {arm}: {event.text}") + "\n", style=style)
    return Panel(lines, title="events", title_align="left")
