"""Datagrams that are none, thrown at the simulated controller and at the driver over real UDP."""

from __future__ import annotations

import random
import socket
import threading
import time
from typing import TYPE_CHECKING

import numpy as np

from backends.fri import FriRobot
from backends.fri.codec import decode_command, decode_monitoring, encode_command, encode_monitoring
from backends.fri.controller.controller import SimulatedController
from backends.fri.controller.port import Address
from backends.fri.controller.settings import ControllerSettings
from backends.fri.messages import (
    Command,
    CommandData,
    CommandMode,
    ConnectionInfo,
    ControlMode,
    DriveState,
    Header,
    IpoData,
    MonitorData,
    Monitoring,
    OperationMode,
    OverlayType,
    Quality,
    RobotInfo,
    SafetyState,
    SessionState,
    Timestamp,
)
from backends.fri.version import FriVersion
from limo_driver.errors import BackendError, WireFormatError
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Iterator

HOST = "127.0.0.1"
VERSION = FriVersion.V1_15
POSE = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)
BURST = 32  # mutants for each good datagram


def mutants(datagram: bytes, chance: random.Random) -> Iterator[bytes]:
    """Return datagrams that a good one can become: bits, ends, pieces, noise."""
    for _ in range(BURST):
        data = bytearray(datagram)
        kind = chance.randrange(6)
        if kind == 0:
            for _ in range(chance.randrange(1, 9)):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        elif kind == 1:
            del data[chance.randrange(len(data)) :]
        elif kind == 2:
            at = chance.randrange(len(data))
            data[at:at] = chance.randbytes(chance.randrange(1, 20))
        elif kind == 3:
            at = chance.randrange(len(data))
            del data[at : at + chance.randrange(1, 20)]
        elif kind == 4:
            data = bytearray(chance.randbytes(chance.randrange(1501)))
        else:
            data[chance.randrange(len(data))] = 0xFF
        yield bytes(data)


def fuzz_controller(count: int) -> None:
    """Answer a controller's packets properly, each with a burst of mutants of the answer."""
    chance = random.Random(1)  # noqa: S311  # no secret
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.bind((HOST, 0))
    client.settimeout(0.0)
    settings = ControllerSettings(Address(*client.getsockname()), period_ms=2, duration=0.2)
    began = time.monotonic()
    with client, SimulatedController(settings) as controller:
        controller._ends = float("inf")  # the fuzz says when
        robot = controller._port.address
        thrown, sequence = 0, 0
        while thrown < count:
            controller._wait()  # in steps: what is thrown in is also read
            controller._cycle()
            try:
                packet = decode_monitoring(client.recv(1500), VERSION)
            except BlockingIOError:
                continue
            good = answer_to(packet, sequence)
            sequence += 1
            for mutant in mutants(good, chance):
                client.sendto(mutant, (HOST, robot.port))
                thrown += 1
            client.sendto(good, (HOST, robot.port))
        controller.stop()
        report = controller.run()
    found = report.findings
    lower, upper = found.ranges["position"]
    print(f"\nfuzz of the controller: {thrown} datagrams in {time.monotonic() - began:.0f} s")
    print(f"  no crash; {found.malformed} were no command, {len(found.stops)} commands stopped it, "
          f"{report.ledger.answered} answers counted")  # fmt: skip
    print(f"  it was told joint 1 to go from {lower[0]:.3g} to {upper[0]:.3g} rad and stands at "
          f"{controller._motion.state.position[0]:.3g} rad")  # fmt: skip


def answer_to(packet: Monitoring, sequence: int) -> bytes:
    """Return a good answer."""
    position = packet.ipo.joint_position if packet.ipo else None
    if position is None and packet.data is not None:
        position = packet.data.commanded_position
    header = Header(sequence, packet.header.sequence)
    return encode_command(Command(header, CommandData(joint_position=position)), VERSION)


def fuzz_driver(count: int) -> None:
    """Send a driver good packets, each with a burst of mutants, and judge what it commands."""
    chance = random.Random(2)  # noqa: S311  # no secret
    began, thrown, opened, commands = time.monotonic(), 0, 0, 0
    worst = 0.0
    while thrown < count:
        robot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with robot:
            robot.bind((HOST, 0))
            robot.setblocking(False)
            arm = GoodRobot(robot)
            with arm.connected() as driver:
                opened += 1
                while thrown < count and arm.quiet < 50:  # it took a mutant's numbers
                    for mutant in mutants(arm.packet(SessionState.COMMANDING_ACTIVE), chance):
                        robot.sendto(mutant, arm.driver)
                        thrown += 1
                    arm.send(SessionState.COMMANDING_ACTIVE)
                    try:
                        state = driver.receive(timeout=0.002)
                        if driver._contract.holding:
                            driver.resume()
                        driver.send(PositionCommand(position=driver.setpoint + 1e-4))
                        del state
                    except BackendError:
                        pass
                    taken, step = arm.judge(driver.spec.limits.velocity * 1e-3)
                    commands, worst = commands + taken, max(worst, step)
    print(f"\nfuzz of the driver: {thrown} datagrams in {time.monotonic() - began:.0f} s, "
          f"opened {opened} times")  # fmt: skip
    print(f"  no crash; {commands} commands came, the largest step {100 * worst:.1f} % of one "
          f"cycle's, bar 100 % {'met' if worst <= 1 else 'NOT MET'}")  # fmt: skip


class GoodRobot:
    """Sends good packets, and reads what comes."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock, self.driver = sock, (HOST, 30208)
        self.sequence = self.quiet = self.reflected = 0
        self.last: np.ndarray | None = None
        self.state = SessionState.IDLE

    def connected(self) -> FriRobot:
        """Speak first until the driver has heard it."""
        heard = threading.Event()

        def speak() -> None:
            while not heard.wait(0.005):
                self.send(SessionState.MONITORING_READY)

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            return FriRobot(port=self.driver[1], version=VERSION.value, connect_timeout=5.0)
        finally:
            heard.set()
            speaker.join()

    def packet(self, state: SessionState) -> bytes:
        """Return the next packet."""
        return encode_monitoring(
            Monitoring(
                header=Header(self.sequence, self.reflected),
                robot=RobotInfo(7, SafetyState.NORMAL, (DriveState.ACTIVE,) * 7, OperationMode.AUT,
                                ControlMode.POSITION),
                data=MonitorData(POSE, (0.0,) * 7, POSE, (0.0,) * 7, (0.0,) * 7,
                                 timestamp=Timestamp(*divmod(self.sequence * 10**6, 10**9))),
                connection=ConnectionInfo(state, Quality.EXCELLENT, 1, 1),
                ipo=IpoData(joint_position=POSE, command_mode=CommandMode.POSITION,
                            overlay_type=OverlayType.JOINT, tracking_performance=1.0),
            ),
            VERSION,
        )  # fmt: skip

    def send(self, state: SessionState) -> None:
        """Send the next packet."""
        if state is not self.state:
            self.state, self.last = state, None
        self.sock.sendto(self.packet(state), self.driver)
        self.sequence += 1

    def judge(self, step: np.ndarray) -> tuple[int, float]:
        """Return how many commands came, and their largest step as a share of `step`."""
        count, worst = 0, 0.0
        while True:
            try:
                data = self.sock.recv(1500)
            except BlockingIOError:
                break
            try:
                command = decode_command(data, VERSION)
            except WireFormatError:
                raise SystemExit(f"the driver sent what is no command: {data.hex()}") from None
            self.reflected, count = command.header.sequence, count + 1
            if command.data is None or command.data.joint_position is None:
                continue
            position = np.array(command.data.joint_position)
            if not np.isfinite(position).all():
                raise SystemExit(f"the driver commanded {position}")
            if self.last is not None:
                worst = max(worst, float((np.abs(position - self.last) / step).max()))
            self.last = position
        self.quiet = 0 if count else self.quiet + 1
        return count, worst
