"""Find the robot: wait for its first packet, and learn version and period from it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from backends.fri.codec.codec import decode_monitoring
from backends.fri.codec.version import FriVersion, Generation, detect
from backends.fri.endpoint import Endpoint
from limo_driver.errors import BackendError, ConnectionLostError, WireFormatError

if TYPE_CHECKING:
    from backends.fri.codec.messages import Joints, Monitoring

LARGEST_POSITION: Final = 10.0  # [rad], beyond any arm
LARGEST_TORQUE: Final = 1e4  # [N m], beyond any arm
LONGEST_PERIOD: Final = 100  # [ms] between packets
_UNTOLD: Final = 20  # messages without a telling field, after which it is 1.x


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
    told = detect(data)
    if version is None:
        return told
    if told is not None and told is not version.generation:
        raise BackendError(f"the robot speaks FRI {told.value}, but {version.value} was asked for")
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
