"""Find the robot: wait for its first packet, and learn version and period from it."""

from __future__ import annotations

import errno
import socket
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from backends.fri.codec.codec import decode_monitoring, detect
from backends.fri.codec.messages import MAX_DATAGRAM, FriVersion, Generation, Joints, Monitoring
from limo_driver.errors import BackendError, ConfigError, ConnectionLostError, WireFormatError

LARGEST_POSITION: Final = 10.0  # [rad], beyond any arm
LARGEST_TORQUE: Final = 1e4  # [N m], beyond any arm
LONGEST_PERIOD: Final = 100  # [ms] between packets
_UNTOLD: Final = 20  # messages without a telling field, after which it is 1.x
Address: TypeAlias = tuple[str, int]

_KERNEL_TIME: Final = 35  # SO_TIMESTAMPNS of Linux, which the module socket does not name
_TIMESPEC: Final = struct.Struct("@qq")
_ANCILLARY: Final = socket.CMSG_SPACE(_TIMESPEC.size)
_LAST_PORT: Final = 0xFFFF
MOST_FOREIGN: Final = 1000  # datagrams that are read past when no time is left
_OLDEST: Final = 10.0  # [s]; a greater age is a step of the clock


class SilentRobotError(ConnectionLostError):
    """No robot was heard on a port.

    Args:
        found: What was heard instead.
        port: UDP port.
    """

    def __init__(self, found: str, port: int) -> None:
        self.found = found
        super().__init__(f"{found}; `limo doctor fri --port {port}` finds out why")


@dataclass(frozen=True)
class Connection:
    """A robot that speaks, and how."""

    endpoint: Endpoint
    generation: Generation
    send_period: int  # [ms]
    multiplier: int  # packets to an answer

    @property
    def period(self) -> float:
        """Time from one answer to the next [s]."""
        return 1e-3 * self.send_period * self.multiplier

    def fits(self, message: Monitoring) -> bool:
        """Say whether a message has the periods that the connection began with."""
        return pace(message) == (self.send_period, self.multiplier)


def connect(host: str | None, port: int, version: FriVersion | None, timeout: float) -> Connection:
    """Open the port and wait for a robot.

    Raises:
        BackendError: The port is taken, or the robot speaks another version.
        SilentRobotError: No usable packet within `timeout` [s]; says what came instead.
    """
    endpoint = Endpoint(host, port)
    try:
        return _first_packet(endpoint, version, timeout)
    except BaseException:
        endpoint.close()
        raise


def _first_packet(endpoint: Endpoint, version: FriVersion | None, timeout: float) -> Connection:
    deadline = time.monotonic() + timeout
    came, untold, problem = 0, 0, ""
    while (left := deadline - time.monotonic()) > 0:
        datagram = endpoint.receive(left)
        if datagram is None:
            continue
        came += 1
        try:
            generation = _generation(datagram.data, version)
            if generation is None:
                untold += 1
                if untold < _UNTOLD:
                    continue
                generation = Generation.ONE
            message = decode_monitoring(datagram.data, generation)
        except WireFormatError as error:
            problem = str(error)
            continue
        if problem := unusable(message):
            continue
        endpoint.settle(datagram.sender)
        return Connection(endpoint, generation, *pace(message))
    raise SilentRobotError(_nobody(endpoint, timeout, came, problem), endpoint.port)


def _generation(data: bytes, version: FriVersion | None) -> Generation | None:
    seen = detect(data)
    if version is None:
        return seen
    if seen is not None and seen is not version.generation:
        raise BackendError(f"the robot speaks FRI {seen.value}, but {version.value} was asked for")
    return version.generation


def unusable(message: Monitoring) -> str:
    """Say why a message cannot be used; empty if it can."""
    if (problem := incomplete(message)) or (data := message.data) is None:
        return problem
    return _unlike(data.measured_position, LARGEST_POSITION, "measured position") or _unlike(
        data.measured_torque, LARGEST_TORQUE, "measured torque"
    )


def incomplete(message: Monitoring) -> str:
    """Say what a message lacks, whatever its measurements are; empty for nothing."""
    data, connection = message.data, message.connection
    if connection is None:
        return "the message does not say how the session stands"
    if connection.send_period is None or not 0 < connection.send_period <= LONGEST_PERIOD:
        return f"a send period of {connection.send_period} ms, expected 1 to {LONGEST_PERIOD}"
    if (connection.receive_multiplier or 1) * connection.send_period > 10 * LONGEST_PERIOD:
        return f"a receive multiplier of {connection.receive_multiplier}"
    if data is None:
        return "no measurements"
    if data.measured_position is None or data.measured_torque is None:
        return f"no measured {'position' if data.measured_position is None else 'torque'}"
    return ""


def _unlike(values: Joints | None, most: float, name: str) -> str:
    """Say why values cannot be those of an arm; empty if they can."""
    for value in values or ():
        if not -most <= value <= most:  # a NaN compares false
            return f"a {name} that no arm has"
    return ""


def pace(message: Monitoring) -> tuple[int, int]:
    """Return send period [ms] and receive multiplier; 0 or none means every packet."""
    connection = message.connection
    if connection is None:
        return 0, 1
    return connection.send_period or 0, connection.receive_multiplier or 1


def _nobody(endpoint: Endpoint, timeout: float, came: int, problem: str) -> str:
    where = f"UDP port {endpoint.port} within {timeout:g} s"
    if came:
        return f"{came} datagrams came to {where}, but none could be used: {problem}"
    if endpoint.foreign:
        return (
            f"nothing came from {endpoint.robot} to {where}, "
            f"but {endpoint.foreign} datagrams from {endpoint.last_foreign}"
        )
    return f"nobody sent to {where}"


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
        self._ahead: tuple[Datagram, float] | None = None  # and when it was read [s]
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
        if self._ahead is not None:
            (found, read), self._ahead = self._ahead, None
            return found._replace(age=found.age + time.monotonic() - read)
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

    @property
    def waits(self) -> bool:
        """Whether a datagram of the robot waits: `receive` returns it next."""
        if self._ahead is None and (found := self.receive(0.0)) is not None:
            self._ahead = found, time.monotonic()
        return self._ahead is not None

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
