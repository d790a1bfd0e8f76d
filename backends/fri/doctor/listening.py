"""Listen on several FRI ports at once, to find out who sends what where."""

from __future__ import annotations

import select
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field

from backends.fri.codec.decoding import decode
from backends.fri.codec.layouts import LAYOUTS
from backends.fri.codec.version import Generation, detect
from backends.fri.connection import unusable
from backends.fri.endpoint import Datagram, Endpoint
from limo_driver.errors import BackendError, WireFormatError


@dataclass
class Heard:
    """Datagrams that came to one port."""

    datagrams: int = 0
    senders: Counter[str] = field(default_factory=Counter[str])
    robots: dict[str, Generation] = field(default_factory=dict[str, Generation])  # by sender
    problem: str = ""  # why a datagram was no usable message

    def note(self, datagram: Datagram) -> None:
        """Take a datagram."""
        sender = datagram.sender[0]
        self.datagrams += 1
        self.senders[sender] += 1
        try:
            generation = detect(datagram.data) or Generation.ONE
            message = decode(datagram.data, LAYOUTS[generation].monitoring, generation)
        except WireFormatError as error:
            self.problem = str(error)
            return
        if problem := unusable(message):
            self.problem = problem
        else:
            self.robots[sender] = generation


def listen(
    port: int, others: tuple[int, ...], host: str | None, seconds: float
) -> tuple[dict[int, Heard], tuple[int, ...]]:
    """Listen until a robot sends to `port`, or `seconds` have passed.

    Args:
        port: Where the robot is expected.
        others: Ports to listen on besides; those that are taken are left out.
        host: Address of the robot, if only one counts.
        seconds: Longest time [s].

    Returns:
        What came, by port, and the other ports that are taken.

    Raises:
        BackendError: `port` is taken.
    """
    heard: dict[int, Heard] = {}
    taken: list[int] = []
    with ExitStack() as opened:
        ends = [Endpoint(None, port)]
        opened.callback(ends[0].close)
        for other in others:
            try:
                ends.append(Endpoint(None, other))
            except BackendError:
                taken.append(other)
                continue
            opened.callback(ends[-1].close)
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            for end in select.select(ends, [], [], left)[0]:
                datagram = end.receive(0.0)
                if datagram is not None:
                    heard.setdefault(end.port, Heard()).note(datagram)
            robots = heard[port].robots if port in heard else {}
            if robots and (host is None or host in robots):
                break
    return heard, tuple(taken)
