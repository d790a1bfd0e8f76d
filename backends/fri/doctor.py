"""Find out why an FRI link does not work, and say so in words for the laboratory.

First it listens on the port and on FRI's usual ones; where a robot sends, it then answers as the
driver does, for the quality of a connection shows only in answers. It commands nothing: what it
answers is the position that the robot's own application has. Still, to the robot it is a client: a
session that waited for one becomes active, and the application's own motion may begin.
"""

from __future__ import annotations

import select
import socket
import time
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path
from typing import Any, Final

from backends.fri.codec.codec import decode_monitoring, detect
from backends.fri.codec.messages import PORTS, Generation, Quality, SessionState
from backends.fri.connection import Datagram, Endpoint, SilentRobotError, resolve, unusable
from backends.fri.robot import FriRobot
from backends.fri.session import MOST_UNCONFIRMED, advice, drives_off, long_period, safety_stop
from limo_driver.errors import BackendError, ConnectionLostError, CycleTimeoutError, WireFormatError
from limo_driver.robot.registry import Examination

MOST_LOST: Final = 0.001  # of the packets
MOST_LATE: Final = 0.01  # of the answers
MOST_POOR: Final = 0.1  # of the packets below GOOD, once one was better
SILENCE: Final = 0.5  # [s] of no packets at the end, or ten periods, after which a robot is silent
FEWEST_ANSWERS: Final = 10  # of which the robot has to have received some
# Exit statuses, the gravest first; 2 says that an option is wrong.
STATUSES: Final = {
    "nobody": 3,
    "silent": 4,
    "one-way": 5,
    "safety-stop": 6,
    "drives-off": 7,
    "period": 8,
}
ASKED: Final = (
    "the robot's application asks for commands, and was not answered: in this step it may monitor "
    "only, so start one without an overlay of motion"
)
_ROUTES: Final = Path("/proc/net/route")
_DISCARD: Final = 9  # the port that a route is asked for; nothing is sent


def examine(
    host: str | None, port: int, seconds: float, *, listen_only: bool = False
) -> Examination:
    """Find out how a link stands.

    Args:
        host: Address or name of the controller; any sender if not given.
        port: UDP port of the client.
        seconds: How long to listen, and then how long to answer [s].
        listen_only: Answer while the session is monitored only, so that none becomes active.

    Raises:
        ConfigError: The host is unknown, or the port is none.
    """
    found = Examination(STATUSES)
    address = None if host is None else resolve(host)
    others = tuple(other for other in PORTS if other != port)
    try:
        heard, taken = listen(port, others, address, seconds)
    except BackendError as error:
        found.add("port-taken", f"{error}. `ss -ulpn 'sport = :{port}'` names it")
        return found
    found.figures["datagrams"] = {str(at): what.datagrams for at, what in heard.items()}
    robots = heard[port].robots if port in heard else {}
    if address in robots or (address is None and robots):
        sender = address or next(iter(robots))
        _answer(found, sender, port, robots[sender], seconds, listen_only=listen_only)
        return found
    _explain_silence(found, address, port, heard, seconds)
    if taken:
        found.add("ports-taken", f"not listened to, since taken: {_listed(taken)}", problem=False)
    return found


def _explain_silence(
    found: Examination, address: str | None, port: int, heard: dict[int, Heard], seconds: float
) -> None:
    """Say why no robot is at the port."""
    here = heard.get(port)
    if here is not None and here.robots:
        found.add(
            "other-host",
            f"a robot at {_listed(here.robots)} sends to port {port}, but {address} was named: "
            "name that one, or correct the client's address in the other robot's application",
        )
    elif here is not None:
        found.add(
            "not-fri",
            f"{here.datagrams} datagrams came to port {port} from {_listed(here.senders)}, but "
            f"none is a message of FRI 1.11 to 1.16, 2.5 or 2.7: {here.problem}. Another program "
            "sends there, or FRI of a version that limo does not know",
        )
    for other, what in heard.items():
        if other != port and what.robots:
            found.add(
                "other-port",
                f"a robot at {_listed(what.robots)} sends to port {other}, not {port}: give "
                f"--port {other}, or set the port in the robot application to {port}",
            )
    if found.findings:
        return
    found.add(
        "nobody",
        f"nobody sent anything to port {port} in {seconds:g} s. The robot speaks first: its "
        "application has to open an FRI session to this machine's address"
        + _own(address)
        + f" and port {port}; a firewall here may drop UDP to that port",
    )
    if address is not None and not near(address):
        own = ", ".join(str(network) for network in networks()) or "no network"
        found.add(
            "other-network",
            f"no interface of this machine is in the network of {address} (it is in {own}): "
            "give the interface that is wired to the controller's FRI port an address there",
        )


def _own(address: str | None) -> str:
    own = None if address is None else own_address(address)
    return "" if own is None else f" ({own})"


def _answer(
    found: Examination,
    sender: str,
    port: int,
    generation: Generation,
    seconds: float,
    *,
    listen_only: bool,
) -> None:
    """Answer a robot for a while and judge the link."""
    found.add(
        "robot", f"a robot at {sender} speaks FRI {generation.value} to port {port}", problem=False
    )
    found.figures |= {"host": sender, "fri": generation.value}
    qualities: Counter[Quality] = Counter()
    wait = max(seconds, 1.0)
    try:
        with FriRobot(sender, port, connect_timeout=wait, listen_only=listen_only) as robot:
            began = heard = time.monotonic()
            while time.monotonic() < began + seconds:
                with suppress(CycleTimeoutError):  # nothing yet since it was opened
                    if not robot.receive().stale and (quality := robot.quality) is not None:
                        _count(qualities, quality)
                        heard = time.monotonic()
            silent = time.monotonic() - heard
            _judge(found, robot, qualities, silent, listen_only=listen_only)
    except SilentRobotError as error:
        found.add("silent", f"the robot was heard, and then no more: {error.found}")
    except ConnectionLostError as error:
        found.add("lost", str(error))


def _count(qualities: Counter[Quality], quality: Quality) -> None:
    """Count a packet; those before the first good one are forgotten: every session begins POOR."""
    if quality >= Quality.GOOD and max(qualities, default=Quality.POOR) < Quality.GOOD:
        qualities.clear()
    qualities[quality] += 1


def _judge(
    found: Examination,
    robot: FriRobot,
    qualities: Counter[Quality],
    silent: float,
    *,
    listen_only: bool,
) -> None:
    figures = robot.figures
    found.figures |= {
        "link": figures.as_json(),
        "send_period": 1e-3 * robot.send_period,
        "states": [(visit.state.name, visit.time) for visit in robot.visits],
        "quality": {quality.name: count for quality, count in sorted(qualities.items())},
        "answer_latency": robot.latency.as_json(),
        "foreign": robot.foreign,
    }
    if not qualities or silent > max(SILENCE, 10 * robot.spec.period):
        found.add(
            "silent",
            f"the robot stopped sending while it was answered, {silent:.1f} s ago, after "
            f"{figures.received} packets: its application ended the session or was stopped, or the "
            "cable was pulled",
        )
        return
    # One that has received nothing reflects 0, which is the number of the first answer.
    if robot.unconfirmed >= max(min(figures.answered - 1, MOST_UNCONFIRMED), FEWEST_ANSWERS):
        found.add(
            "one-way",
            f"the robot has received none of {figures.answered} answers, while its packets come: "
            "the link works one way only. Let UDP from this machine to the robot through every "
            "firewall on the way, and check the robot's own address and gateway",
        )
        return
    if figures.lost > MOST_LOST * figures.received:
        found.add(
            "loss",
            f"{figures.lost} of {figures.received + figures.lost} packets were lost on their way "
            "here: use a cable of its own, no wireless network and no shared switch",
        )
    if figures.late + figures.unreceived > MOST_LATE * max(figures.answered, 1):
        found.add(
            "late",
            f"{figures.late + figures.unreceived} of {figures.answered} answers came too late or "
            f"never (p99 of answering: {1e3 * robot.latency.percentile(99):.2f} ms): end what "
            "else computes here, or lengthen the send period",
        )
    _judge_quality(found, qualities)
    for code, problem in (
        ("safety-stop", safety_stop(robot.monitoring)),
        ("drives-off", drives_off(robot.monitoring)),
        ("period", long_period(robot.monitoring)),
    ):
        if problem:
            found.add(code, problem)
    state, reasons = robot.session_state, "; ".join(advice(robot.monitoring))
    if listen_only and any(visit.state >= SessionState.COMMANDING_WAIT for visit in robot.visits):
        found.add("asks-for-commands", ASKED)
    elif state is SessionState.COMMANDING_ACTIVE:
        found.add("commanding", "the session takes commands", problem=False)
    elif listen_only and state is SessionState.MONITORING_READY:
        found.add("monitoring", "the session is monitored, and takes no commands", problem=False)
    elif state is SessionState.MONITORING_READY:
        found.add("monitoring", f"the session is monitored: {reasons}", problem=False)
    elif state is not None:
        found.add("stuck", f"the session is stuck in {state.name}: {reasons}")


def _judge_quality(found: Examination, qualities: Counter[Quality]) -> None:
    best, below = max(qualities), sum(qualities[q] for q in qualities if q < Quality.GOOD)
    if best < Quality.GOOD:
        found.add("quality", f"the connection never got better than {best.name}")
    elif below > MOST_POOR * qualities.total():
        counts = ", ".join(
            f"{quality.name} {count}" for quality, count in sorted(qualities.items())
        )
        found.add("quality", f"the quality of the connection goes up and down ({counts} packets)")


def _listed(values: Any) -> str:  # noqa: ANN401  # anything that can be listed
    return ", ".join(str(value) for value in values)


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
            message = decode_monitoring(datagram.data, generation)
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


def networks() -> tuple[IPv4Network, ...]:
    """Return the networks that this machine is directly in; none where the tables cannot be read.

    Linux keeps addresses as hexadecimal numbers in the byte order of the machine.
    """
    try:
        lines = _ROUTES.read_text().splitlines()[1:]
    except OSError:
        return ()
    found: list[IPv4Network] = []
    for columns in (line.split() for line in lines):
        try:
            target, gateway, mask = (
                IPv4Address(int(columns[k], 16).to_bytes(4, "little")) for k in (1, 2, 7)
            )
            if int(gateway) == 0 and int(mask) != 0:
                found.append(IPv4Network(f"{target}/{mask}"))
        except (ValueError, IndexError):
            continue
    return tuple(found)


def near(address: str) -> bool:
    """Say whether an address is reached without a gateway; loopback always is."""
    given = IPv4Address(address)
    return given.is_loopback or any(given in network for network in networks())


def own_address(towards: str) -> str | None:
    """Return this machine's address towards another; None if there is no way to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((towards, _DISCARD))
        except OSError:
            return None
        return str(probe.getsockname()[0])
