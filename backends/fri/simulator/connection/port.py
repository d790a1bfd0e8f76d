"""The controller's UDP port: datagrams with the times at which the kernel received them."""

from __future__ import annotations

import socket
import struct
import sys
import time
from typing import TYPE_CHECKING, Final, NamedTuple

from backends.fri.codec.messages import MAX_DATAGRAM
from limo_driver.errors import BackendError, ConfigError
from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_AT_ONCE: Final = 64  # datagrams read in one cycle, so that a flood cannot stop the arm
_SO_TIMESTAMPNS: Final = 35  # of Linux; the module `socket` does not name it
_TIMESPEC: Final = struct.Struct("@ll")
_NANO: Final = 1_000_000_000
_LINUX: Final = sys.platform.startswith("linux")


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
