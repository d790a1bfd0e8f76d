"""The screen of `limo watch`: what is seen of an arm, as panels."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Any, cast

import typer

from limo_driver.app.console.terminal import terminal
from limo_driver.errors import WireFormatError
from limo_driver.quoting import in_line

if TYPE_CHECKING:
    from collections.abc import Iterable

    import zenoh
    from rich.console import RenderableType
    from rich.text import Text

    from limo_driver.network.messages import Event

STALE = 3.0  # [s] without status, after which a service is shown as silent
_WIDEST = 500  # characters of a line
_BARS = " ▁▂▃▄▅▆▇█"
_PER_BAR = 10  # bins of the latency histogram in one bar
_EVENTS = 12  # shown
_KEPT = 100  # of them, as on the network
_DULL = "reset"  # a kind of which many would bury the others
_LONGEST = 65536  # bytes of a status
_LAST = 2**63  # [ns] of a stamp


def show(watched: Watched, duration: float | None) -> None:
    """Draw twice a second until the time is over."""
    from rich.live import Live

    ends = math.inf if duration is None else time.monotonic() + duration
    pause = threading.Event()
    if watched.as_json:
        while time.monotonic() < ends:
            pause.wait(min(0.5, max(ends - time.monotonic(), 0.0)))
        return
    with Live(console=terminal(), screen=False, refresh_per_second=4) as live:
        while time.monotonic() < ends:
            live.update(page(watched))
            pause.wait(min(0.5, max(ends - time.monotonic(), 0.0)))
        live.update(page(watched))


def page(watched: Watched) -> RenderableType:
    """Return what is shown of all services that were heard."""
    from rich.console import Group
    from rich.text import Text

    if not watched.statuses:
        return Text("no service on the network yet; start one with `limo serve`", style="yellow")
    now = time.monotonic()
    arms = [arm_panel(status, now - came) for came, status in dict(watched.statuses).values()]
    return Group(*arms, _events(watched))


def _events(watched: Watched) -> RenderableType:
    from datetime import UTC, datetime

    from rich.panel import Panel
    from rich.text import Text

    lines = Text()
    for arm, event, times in folded(watched.events)[-_EVENTS:]:
        when = datetime.fromtimestamp(event.stamp_ns / 1e9, UTC).astimezone()
        style = {30: "yellow", 40: "red", 50: "bold red"}.get(int(event.level), "")
        often = f" ({times} times)" if times > 1 else ""
        lines.append(printable(f"{when:%H:%M:%S} {arm}: {event.text}{often}") + "\n", style=style)
    return Panel(lines, title="events", title_align="left")


def arm_panel(status: dict[str, Any], age: float) -> RenderableType:
    """Return what is shown of a service; an error where its status is no status.

    Args:
        status: As it was received.
        age: Since then [s].
    """
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    title = Text(printable(f"{status['arm']}: {status.get('state', '')}"))
    if age > STALE:
        return Panel(Text(f"silent for {age:.0f} s", style="red"), title=title)
    if status.get("state") != "serving":
        text = printable(str(status["state"]))
        bad = text.startswith(("silent", "refused"))
        return Panel(Text(text, style="red" if bad else "yellow"), title=title)
    facts = Table.grid(padding=(0, 2))
    arrivals, latency = status["arrivals"], status["latency"]
    facts.add_row("model", Text(printable(_model(status))))
    if "retraining" in status:
        facts.add_row("retraining", Text(printable(_retraining(status["retraining"]))))
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

    return Text(printable(", ".join(f"{value:d} {name}" for name, value in counts.items()) or "-"))


def _log(log: dict[str, Any]) -> Text:
    from rich.text import Text

    written = f"{log['written']:d} written, {log['dropped']:d} dropped"
    if log["failure"] is None:
        return Text(written)
    return Text(printable(f"stopped: {log['failure']}; {written}"), style="red")


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
    from rich.console import Group
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
    changed = [Text(printable(line), style="yellow") for line in status.get("changed", ())]
    return Group(table, *changed)


def _bars(counts: list[int]) -> str:
    """Return the histogram as characters, from where it begins to where it ends."""
    sums = [sum(counts[k : k + _PER_BAR]) for k in range(0, len(counts), _PER_BAR)]
    filled = [k for k, value in enumerate(sums) if value]
    if not filled:
        return ""
    shown = sums[filled[0] : filled[-1] + 1]
    return "".join(_BARS[math.ceil(8 * math.log1p(v) / math.log1p(max(shown)))] for v in shown)


def printable(text: str) -> str:
    """Return the beginning of a text, without what a terminal would obey."""
    return in_line(text[:_WIDEST])


def folded(events: Iterable[tuple[str, Event]]) -> list[tuple[str, Event, int]]:
    """Return events with how many they stand for: the last reset of an arm for all of them."""
    listed = list(events)
    resets = Counter(arm for arm, event in listed if event.kind == _DULL)
    left, found = resets.copy(), list[tuple[str, Any, int]]()
    for arm, event in listed:
        if event.kind == _DULL:
            left[arm] -= 1
        if event.kind != _DULL or not left[arm]:
            found.append((arm, event, resets[arm] if event.kind == _DULL else 1))
    return found


def _plain_event(event: Event, times: int) -> dict[str, Any]:
    """Return an event as plain values, with the stamps [s] between which its contact lies."""
    whole = {k: v for k, v in event.facts.items() if isinstance(v, int) and 0 < v < _LAST}
    seconds = {k: v / 1e9 for k, v in whole.items() if k.endswith("_stamp")}
    return {
        "kind": printable(event.kind),
        "text": printable(event.text),
        "t": event.stamp_ns / 1e9,
        "times": times,
        "joint": whole.get("joint"),
        "began": seconds.get("began_stamp"),
        "ended": seconds.get("ended_stamp"),
    }


class Watched:
    """Messages received so far: the last status of each arm, and the latest events."""

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self.statuses: dict[str, tuple[float, dict[str, Any]]] = {}
        self.events: deque[tuple[str, Event]] = deque(maxlen=_KEPT)
        self.malformed = 0

    def of(self, arm: str) -> dict[str, Any]:
        """Return status and events of an arm as plain values; no status where it is stale."""
        came, status = self.statuses.get(arm, (-math.inf, None))
        own = [(of, event) for of, event in list(self.events) if of == arm]
        events = [_plain_event(event, times) for _, event, times in folded(own)]
        return {"status": status if time.monotonic() - came < STALE else None, "events": events}

    def take_status(self, sample: zenoh.Sample) -> None:
        """Keep a status; count those that are malformed or of another arm than their key says."""
        arm = _arm_of(sample)
        try:
            status = _read_status(sample.payload.to_bytes())
            if arm is None or status["arm"] != arm:
                raise ValueError(arm)
            arm_panel(status, 0.0)
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
