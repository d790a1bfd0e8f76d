"""Messages of services on the network, as far as they are well formed."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from typing import TYPE_CHECKING, Any, cast

import typer

from limo_driver.app.cli.watch.panels import STALE, arm_panel, printable

if TYPE_CHECKING:
    import zenoh

    from limo_driver.network.messages import Event

_EVENTS = 12  # shown
_LONGEST = 65536  # bytes of a status


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
            f"{event.kind}: {printable(event.text)}" for of, event in list(self.events) if of == arm
        ]
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
