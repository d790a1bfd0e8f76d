"""The screen of `limo watch`: a panel for each arm, and the latest events."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING

from limo_driver.app.cli.watch.panels import arm_panel, printable

if TYPE_CHECKING:
    from rich.console import RenderableType

    from limo_driver.app.cli.watch.watched import Watched


def show(watched: Watched, duration: float | None) -> None:
    """Draw twice a second until the time is over."""
    from rich.live import Live

    from limo_driver.app.console.terminal import terminal

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
    for arm, event in list(watched.events):
        when = datetime.fromtimestamp(event.stamp_ns / 1e9, UTC).astimezone()
        style = {30: "yellow", 40: "red", 50: "bold red"}.get(int(event.level), "")
        lines.append(printable(f"{when:%H:%M:%S} {arm}: {event.text}") + "\n", style=style)
    return Panel(lines, title="events", title_align="left")
