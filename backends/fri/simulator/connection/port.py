"""The network of the simulated controller: its port, the link to a client, and its quality.

A network that loses, delays, reorders and doubles datagrams, the same ones for the same seed.

The fate of a datagram depends on the seed, the direction and its number in that direction alone,
and on what the scenario asks for at that time; not on when other datagrams came.

Quality of the connection: limo's own model of it, with its parameters.

KUKA's thresholds stand in its manual only. Here every receive interval (send period times receive
multiplier) is answered in time or not, and the quality follows from the share that was, over a
window of the last intervals. A window that is not full yet counts what is missing as missed, so
that a session begins POOR and gets better, as real ones do. Many misses in a row are POOR at once.
"""

from __future__ import annotations

import heapq
import random
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from backends.fri.codec.messages import MAX_DATAGRAM, Quality
from limo_driver.errors import BackendError, ConfigError
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.runtime.processes import Closing

MOST_AT_ONCE: Final = 64  # datagrams read in one cycle, so that a flood cannot stop the arm
_SO_TIMESTAMPNS: Final = 35  # of Linux; the module `socket` does not name it
_TIMESPEC: Final = struct.Struct("@ll")
_NANO: Final = 1_000_000_000
_LINUX: Final = sys.platform.startswith("linux")
_NANOSECONDS: Final = 1e9


class Address(NamedTuple):
    """A host and a UDP port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @classmethod
    def parse(cls, text: str, what: str, port: int | None = None) -> Address:
        """Read `HOST:PORT`, or `HOST` where there is a port to go by.

        Raises:
            ConfigError: Something else.
        """
        known = "" if port is None else str(port)  # 0 is any free one
        host, _, number = text.rpartition(":") if ":" in text else (text, "", known)
        if not (host and number.isdecimal() and 0 <= int(number) < 1 << 16):
            expected = "HOST:PORT" if port is None else "HOST or HOST:PORT"
            raise ConfigError(f"{what} {text!r} is no {expected}, for example 127.0.0.1:30200")
        return cls(host, int(number))

    def resolved(self) -> Address:
        """Return the address with the number of its host.

        Raises:
            ConfigError: No such host.
        """
        try:
            return Address(socket.gethostbyname(self.host), self.port)
        except (OSError, UnicodeError) as error:
            raise ConfigError(f"host {self.host!r} is not known: {_said(error)}") from None


class ClientDatagram(NamedTuple):
    """Datagram and its time of arrival."""

    data: bytes
    at_ns: int  # when the kernel received it, on CLOCK_MONOTONIC
    sender: Address


class UdpPort(Closing):
    """An open UDP port.

    Args:
        bind: Where it listens; port 0 is any free one.

    Raises:
        ConfigError: The address is not this machine's, or in use.
    """

    def __init__(self, bind: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            if _LINUX:
                self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.bind(bind)
        except (OSError, UnicodeError) as error:
            self._socket.close()
            raise ConfigError(f"cannot bind {bind}: {_said(error)}") from None
        self.address = Address(*self._socket.getsockname())
        self.unsent = 0  # datagrams that the network refused
        self.last_refusal = ""
        self._sent_once = False

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; what the network refuses is counted.

        Raises:
            BackendError: The very first one is refused: there is no way to this host.
        """
        try:
            self._socket.sendto(data, to)
        except OSError as error:
            if not self._sent_once and not isinstance(error, BlockingIOError):
                raise BackendError(f"cannot send to {to}: {error.strerror}") from None
            self.unsent, self.last_refusal = self.unsent + 1, error.strerror or str(error)
            return
        self._sent_once = True

    def received(self) -> Iterator[ClientDatagram]:
        """Return what came by now, at most 64 datagrams."""
        since_boot = time.time_ns() - time.monotonic_ns()
        for _ in range(MOST_AT_ONCE):
            try:
                data, extra, _, sender = self._socket.recvmsg(MAX_DATAGRAM + 1, 64)
            except BlockingIOError:
                return
            except OSError as error:  # for example a host that says that nobody listens
                self.last_refusal = error.strerror or str(error)
                continue
            at = time.monotonic_ns()
            for level, kind, stamp in extra:
                if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack(stamp[: _TIMESPEC.size])
                    at = min(seconds * _NANO + nanoseconds - since_boot, at)
            yield ClientDatagram(data, at, Address(*sender))

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


def _said(error: OSError | UnicodeError) -> str:
    """Return what is wrong with an address; a name may have too long a part for any."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of datagrams in one direction."""

    loss: float = 0.0  # fraction that is lost
    delay: float = 0.0  # [s]
    jitter: float = 0.0  # [s], up to which more delay is added, evenly distributed
    reorder: float = 0.0  # fraction that is overtaken by the next one
    duplicate: float = 0.0  # fraction that comes twice


UNDISTURBED: Final = Disturbance()


@dataclass
class Fates:
    """Counts of datagrams by what happened to them."""

    passed: int = 0
    lost: int = 0
    delayed: int = 0
    reordered: int = 0
    duplicated: int = 0


class Delivered(NamedTuple):
    """A datagram that the network delivers."""

    data: bytes
    at_ns: int  # when it was due
    disturbed: bool  # it came later than it would have, overtaken or twice


class Channel:
    """One direction of the network.

    Args:
        name: Of the direction.
        seed: Of its fates.
    """

    def __init__(self, name: str, seed: int) -> None:
        self.fates = Fates()
        self._random = random.Random(f"{seed}/{name}")  # noqa: S311  # no secret
        self._waiting: list[tuple[int, int, Delivered]] = []  # due [ns], number
        self._overtaken: list[bytes] = []
        self._number = 0

    @property
    def empty(self) -> bool:
        """Whether nothing is under way."""
        return not self._waiting and not self._overtaken

    def next_ns(self) -> int | None:
        """Return when the next datagram is due; None if there is none."""
        return self._waiting[0][0] if self._waiting else None

    def put(self, datagram: bytes, now_ns: int, disturbance: Disturbance) -> bool:
        """Let a datagram go on its way; say whether anything happens to it."""
        lost, more, overtaken, twice = (self._random.random() for _ in range(4))
        if lost < disturbance.loss:
            self.fates.lost += 1
            return True
        delay = disturbance.delay + more * disturbance.jitter
        self.fates.delayed += delay > 0
        if overtaken < disturbance.reorder and not self._overtaken:
            self.fates.reordered += 1
            self._overtaken.append(datagram)
            return True
        due = now_ns + round(delay * _NANOSECONDS)
        copied = twice < disturbance.duplicate
        disturbed = delay > 0 or copied
        self._enqueue(Delivered(datagram, due, disturbed))
        if copied:
            self.fates.duplicated += 1
            self._enqueue(Delivered(datagram, due, disturbed=True))
        if self._overtaken:
            self._enqueue(Delivered(self._overtaken.pop(), due, disturbed=True))
        return disturbed

    def take(self, now_ns: int) -> list[Delivered]:
        """Return the datagrams that are due by now, in order."""
        due: list[Delivered] = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            due.append(heapq.heappop(self._waiting)[2])
        self.fates.passed += len(due)
        return due

    def _enqueue(self, datagram: Delivered) -> None:
        heapq.heappush(self._waiting, (datagram.at_ns, self._number, datagram))
        self._number += 1


@dataclass(frozen=True)
class QualityModel(Declared):
    """Parameters of the model (limo's, not KUKA's)."""

    fair: float = parameter(
        "", "share of intervals answered in time, from which on the quality is FAIR", default=0.5
    )
    good: float = 0.8
    excellent: float = 0.98
    window: float = parameter(
        "s", "over which the share is taken", lower=0, above=True, default=1.0
    )
    fewest: int = parameter("", "intervals, at least", lower=1, default=10)
    most: int = parameter("", "intervals, at most", lower=1, default=100)
    misses: int = parameter("", "in a row, which are POOR whatever the share", lower=1, default=10)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.fair < self.good < self.excellent <= 1:
            raise ConfigError(
                f"quality thresholds {self.fair:g}, {self.good:g}, {self.excellent:g} have to rise "
                "within 0 to 1"
            )
        if self.most < self.fewest:
            raise self._refused("most", f"{self.fewest} or more")

    def intervals(self, interval: float) -> int:
        """Return how many intervals [s] the window holds."""
        return min(max(round(self.window / interval), self.fewest), self.most)


class ConnectionQuality:
    """Follows the quality of one session.

    Args:
        model: Its parameters.
        interval: Time in which one answer is expected [s].
    """

    def __init__(self, model: QualityModel, interval: float) -> None:
        self.model = model
        self._size = model.intervals(interval)
        self.reset()

    def reset(self) -> None:
        """Begin anew, as for a session that is opened."""
        self._window: deque[bool] = deque([False] * self._size, maxlen=self._size)
        self._answered = 0
        self._missed_in_a_row = 0

    def count(self, *, answered: bool) -> None:
        """Take note of one receive interval."""
        self._answered += answered - self._window[0]
        self._window.append(answered)
        self._missed_in_a_row = 0 if answered else self._missed_in_a_row + 1

    @property
    def share(self) -> float:
        """Share of the intervals of the window that were answered in time."""
        return self._answered / self._size

    @property
    def level(self) -> Quality:
        """The quality."""
        model, share = self.model, self.share
        if self._missed_in_a_row >= model.misses or share < model.fair:
            return Quality.POOR
        if share < model.good:
            return Quality.FAIR
        return Quality.GOOD if share < model.excellent else Quality.EXCELLENT
