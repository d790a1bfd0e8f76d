"""Print events and status of `limo serve`."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import zenoh

    from limo_driver.machine_code.compilation import Compilation
    from limo_driver.network.messages import Event
    from limo_driver.network.readiness import ServicePhase

COMPILING = "compiling what the first estimate needs, or reading it from the cache"


class Bulletins:
    """Bulletins of all arms of a service, from before it is on the network.

    Args:
        arms: Their names.
        as_json: Print events as JSON.
    """

    def __init__(self, arms: Sequence[str], *, as_json: bool) -> None:
        from estimators.service.inference.bulletin import Bulletin
        from limo_driver.network.streaming import Keys

        several = len(arms) > 1
        self.of = {
            arm: Bulletin(Keys(arm), teller(arm if several else None, as_json=as_json))
            for arm in arms
        }
        self._state = ""

    def join(self, session: zenoh.Session) -> None:
        """Publish everything so far, and all that follows."""
        for bulletin in self.of.values():
            bulletin.join(session)

    def enter(self, phase: ServicePhase, text: str, state: str = "") -> None:
        """Tell how far the service of every arm is."""
        self._state = state
        for bulletin in self.of.values():
            bulletin.enter(phase, text, state=state)

    def tell_compiled(self, how_far: Compilation) -> None:
        """Let the status say how much is compiled."""
        from limo_driver.network.readiness import ServicePhase

        state = f"compiling, {how_far.done} of at most {how_far.most} functions done"
        if state != self._state:
            self.enter(ServicePhase.COMPILING, COMPILING, state)


def teller(arm: str | None, *, as_json: bool) -> Callable[[Event], None]:
    """Return what shows an event to whoever watches the service, with the arm if it has several.

    For people, how far the service is comes on standard output, everything else on standard error.
    """
    import json

    from limo_driver.console.terminal import terminal

    console = terminal(stderr=not as_json)

    def tell(event: Event) -> None:
        if as_json:
            line = {"event": event.kind, "time_ns": event.stamp_ns, "text": event.text}
            line |= {} if arm is None else {"arm": arm}
            typer.echo(json.dumps({**line, **event.facts}))
            return
        style = {10: "dim", 20: "", 30: "yellow", 40: "red", 50: "bold red"}[event.level]
        line = f"{'' if arm is None else f'{arm}: '}{event.kind}: {event.text}"
        if "phase" in event.facts:
            with suppress(OSError):  # who reads that may have gone, for example once it serves
                typer.echo(line)
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
