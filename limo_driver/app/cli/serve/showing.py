"""Print events and status of `limo serve`."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import typer

from limo_driver.app.console.terminal import say

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.network.messages import Event


def teller(*, several: bool, as_json: bool) -> Callable[[str, Event], None]:
    """Return what shows an event to whoever watches the service, with the arm if it has several.

    For people, how far the service is comes on standard output, everything else on standard error.
    """
    import json

    from limo_driver.app.console.terminal import terminal

    console = terminal(stderr=not as_json)

    def tell(arm: str, event: Event) -> None:
        if as_json:
            line = {"event": event.kind, "time_ns": event.stamp_ns, "text": event.text}
            line |= {"arm": arm} if several else {}
            typer.echo(json.dumps({**line, **event.facts}))
            return
        style = {10: "dim", 20: "", 30: "yellow", 40: "red", 50: "bold red"}[event.level]
        line = f"{f'{arm}: ' if several else ''}{event.kind}: {event.text}"
        if "phase" in event.facts:
            with suppress(OSError):  # who reads that may have gone, for example once it serves
                say(line)
            return
        console.print(line, style=style)

    return tell


def status_printer(*, as_json: bool) -> Callable[[dict[str, object]], None]:
    """Return what shows the status of an arm, where it is asked for as JSON."""
    import json

    def show(status: dict[str, object]) -> None:
        if as_json:
            typer.echo(json.dumps({"status": status}))

    return show
