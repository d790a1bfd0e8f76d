"""The client's end of the link: one UDP socket that answers whoever is the robot."""

from __future__ import annotations

import errno
import socket
import struct
import time
from contextlib import suppress
from typing import Final, NamedTuple, TypeAlias

from backends.fri.codec.messages import MAX_DATAGRAM
from limo_driver.errors import BackendError, ConfigError, ConnectionLostError

Address: TypeAlias = tuple[str, int]

_KERNEL_TIME: Final = 35  # SO_TIMESTAMPNS of Linux, which the module socket does not name
_TIMESPEC: Final = struct.Struct("@qq")
_ANCILLARY: Final = socket.CMSG_SPACE(_TIMESPEC.size)
_LAST_PORT: Final = 0xFFFF
MOST_FOREIGN: Final = 1000  # datagrams that are read past when no time is left
_OLDEST: Final = 10.0  # [s]; a greater age is a step of the clock


class Datagram(NamedTuple):
    """Datagram, and how long it had been waiting."""

    data: bytes
    sender: Address
    age: float  # [s] since the kernel received it


class Endpoint:
    """A UDP port on which one robot is listened to.

    The port is not shared: with a second listener, one of the two would hear nothing. Without a
    host, the first sender of a valid message becomes the robot by `settle`. From then on it is an
    address and a port for as long as this is open, however long it is silent: one that restarted on
    another port could not be told from a forger.

    Args:
        host: Address or name of the robot; any sender if not given.
        port: UDP port, which the robot's application names, too.

    Raises:
        ConfigError: The host is unknown, or the port is no port.
        BackendError: The port is taken, or may not be used.
    """

    def __init__(self, host: str | None, port: int) -> None:
        if not 0 <= port <= _LAST_PORT:
            raise ConfigError(f"UDP port {port} is outside 0 to {_LAST_PORT}")
        self.port = port
        self.robot: str | None = None if host is None else resolve(host)
        self.peer: Address | None = None  # where answers go
        self.foreign = 0  # datagrams from anybody else
        self.last_foreign = ""  # their last sender
        self.refusal = ""  # why the network did not take the last answer that it did not
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("0.0.0.0", port))  # noqa: S104  # the robot may be on any network
        except OSError as error:
            self._socket.close()
            raise BackendError(_not_bound(port, error)) from None
        self.port = int(self._socket.getsockname()[1])
        with suppress(OSError):  # ages are zero then
            self._socket.setsockopt(socket.SOL_SOCKET, _KERNEL_TIME, 1)

    def receive(self, timeout: float) -> Datagram | None:
        """Return the oldest datagram of the robot that waits, or comes within `timeout` [s]."""
        deadline, foreign = time.monotonic() + timeout, MOST_FOREIGN
        while foreign:
            self._socket.settimeout(max(deadline - time.monotonic(), 0.0))
            try:
                data, extra, _, sender = self._socket.recvmsg(MAX_DATAGRAM + 1, _ANCILLARY)
            except (BlockingIOError, TimeoutError):
                return None
            except ConnectionError:
                continue  # the network reports that an earlier answer found nobody
            except OSError as error:
                raise ConnectionLostError(f"UDP port {self.port}: {error}") from None
            if self._is_robot(sender):
                return Datagram(data, sender, _age(extra))
            self.foreign += 1
            self.last_foreign = f"{sender[0]}:{sender[1]}"
            foreign -= time.monotonic() >= deadline  # the robot's packet may wait behind them
        return None

    def settle(self, sender: Address) -> None:
        """Take a sender for the robot: nobody else is listened to any more."""
        self.robot, self.peer = sender[0], sender

    def _is_robot(self, sender: Address) -> bool:
        """Say whether a sender may be the robot."""
        if self.peer is not None:
            return sender == self.peer
        return self.robot is None or sender[0] == self.robot

    def send(self, data: bytes) -> bool:
        """Answer the robot; False if the network did not take it."""
        if self.peer is None:
            return False
        try:
            self._socket.sendto(data, self.peer)
        except OSError as error:  # unplugged, or the queue is full: the robot sees a lost answer
            self.refusal = error.strerror or str(error)
            return False
        return True

    def fileno(self) -> int:
        """Return the descriptor, to wait for several ports at a time."""
        return self._socket.fileno()

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


def resolve(host: str) -> str:
    """Return the IPv4 address of a host.

    Raises:
        ConfigError: It has none.
    """
    try:
        found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"host {host!r} has no IPv4 address: {error}") from None
    return str(found[0][4][0])


def _age(ancillary: list[tuple[int, int, bytes]]) -> float:
    for level, kind, value in ancillary:
        if level == socket.SOL_SOCKET and kind == _KERNEL_TIME and len(value) >= _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack_from(value)
            age = 1e-9 * (time.time_ns() - seconds * 1_000_000_000 - nanoseconds)
            return age if 0.0 <= age <= _OLDEST else 0.0
    return 0.0


def _not_bound(port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"UDP port {port} is taken by another program on this machine; end that one first"
    if error.errno == errno.EACCES:
        return f"UDP port {port} may not be used by this user; FRI uses 30200 to 30209"
    return f"UDP port {port} cannot be opened: {error}"
