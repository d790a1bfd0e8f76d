"""The FRI driver in real time beside a network and a computer that fail, judged by what arrives.

    sudo python benchmarks/backends/fri_real_time.py --cycles 10000

Two processes at 1 kHz. The arm is this one; the driver runs in a network namespace of its own, at
the other end of a pair of virtual interfaces, which takes root on Linux. One after the other, each
for 30 to 150 ms: the driver's route is taken away (ENETUNREACH), its queue takes nothing (ENOBUFS,
by a token bucket without tokens), its frames go to the address of nobody (lost on the way), and it
is stopped (SIGSTOP for 5 to 500 ms). Packets to the driver go on arriving. What the arm receives is
decoded by protobuf's generated code and judged by `tests/contract/wire_rules.py`: steps of velocity
and acceleration from the last command that arrived. What no command left or arrived for 10 packets
has to be held by the driver, which tells at the end when it held, and why.
"""

# ruff: noqa: E402  # what tests share is found once its folders are on the path

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import typer

ROOT = Path(__file__).parents[2]
sys.path[:0] = [
    str(ROOT / "tests" / folder) for folder in ("contract", "backends/fri", "limo_driver/network")
]

from fri_messages import POSE, compile_schema
from stepped_arm import SteppedArm
from wire_rules import POSITION, Applied, Judge

from backends.fri import FriRobot
from backends.fri.codec.messages import SessionState
from limo_driver.errors import BackendError
from limo_driver.types import PositionCommand, RobotSpec

if TYPE_CHECKING:
    from collections.abc import Generator

SPACE, HERE, THERE = "limo-real-time", ("limo-arm", "10.77.31.1"), ("limo-driver", "10.77.31.2")
PORT, PERIOD = 30209, 1e-3
PATIENCE = 11  # packets without effect, after which a hold is there: 10 ms, and the next cycle
EXPIRED = 110  # packets, after which a command has expired
APART, AMPLITUDE, TURN = 0.7, 0.3, 3.0  # [s] between faults, [rad], [s]
EMPTY = ("tbf", "rate", "8bit", "burst", "1", "limit", "1")  # a token bucket that takes nothing
RECVERR = 11  # IP_RECVERR of Linux, which the module socket does not name
NOBODY = "02:00:00:00:00:01"  # the hardware address of no interface
FAULTS = ("route taken away", "ENOBUFS", "lost on the way", "SIGSTOP")
STOPS = (0.005, 0.008, 0.05, 0.15, 0.5)  # [s]


def main(
    cycles: Annotated[int, typer.Option(help="Of 1 ms.")] = 10_000,
    seed: int = 0,
    driver: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Move an arm while things fail; print what arrived."""
    if driver:
        drive()
        return
    with namespace(), driving() as process:
        arm = Arm()
        try:
            arm.run(cycles, process, random.Random(seed))  # noqa: S311
        finally:
            arm.plain.close()
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    raise typer.Exit(not arm.report(json.loads(said.splitlines()[-1])))


def drive() -> None:
    """Move to and fro, and go on after each hold; tell each hold at the end."""
    holds: list[tuple[int, int, str]] = []  # packets from and to, and why
    ended: list[int] = []
    signal.signal(signal.SIGINT, lambda *_: ended.append(1))
    with FriRobot(HERE[1], PORT, version="1.15") as robot:
        # Else Linux drops in silence what its queue does not take.
        robot._link.endpoint._socket.setsockopt(socket.IPPROTO_IP, RECVERR, 1)
        print("ready", flush=True)
        robot.wait_until_ready()
        while not ended:
            start, began = robot.setpoint.copy(), time.monotonic()
            goal = np.array(POSE) - AMPLITUDE * np.sign(start - np.array(POSE) + 1e-9)
            try:
                while not ended:
                    phase = 2.0 * np.pi * (time.monotonic() - began) / TURN
                    way = 0.5 * (1 - np.cos(phase)) * (goal - start)
                    robot.send(PositionCommand(position=start + way))
                    robot.receive()
            except BackendError as error:
                begun, why = robot.monitoring.header.sequence, str(error)
                while not (ended or robot.standing):
                    robot.receive()
                holds.append((begun, robot.monitoring.header.sequence, why))
                robot.resume()
                robot.receive()
        figures = robot.link_figures()
    print(json.dumps({"holds": holds, **figures}))


class Arm:
    """Sends a packet each millisecond, and judges what it receives."""

    def __init__(self) -> None:
        self.schema = compile_schema(tempfile.mkdtemp())
        self.arm = SteppedArm(port=PORT, host=HERE[1])
        self.plain = self.arm.socket
        self.arm.throw = lambda data: self.plain.sendto(data, (THERE[1], PORT))
        limits = robot_limits()
        self.judge = Judge(RobotSpec("iiwa14", tuple(map(str, range(7))), limits, PERIOD))
        self.last: int | None = None  # sequence of the last command that arrived
        self.answered = [0]  # packets that were answered, as far as that arrived
        self.fired: Counter[str] = Counter()
        self.windows: list[tuple[str, int, int]] = []  # fault, first packet and last
        self.violations: list[str] = []
        self.received = 0

    def run(self, cycles: int, process: subprocess.Popen[str], drawn: random.Random) -> None:
        """Send so many packets while things fail."""
        self.begin()
        began, fault_at, which = time.monotonic(), 2 * APART, 0
        for k in range(cycles):
            time.sleep(max(began + (k + 1) * PERIOD - time.monotonic(), 0.0))
            self.arm.sequence, self.arm.ns = self.arm.sequence + 1, self.arm.ns + 1_000_000
            self.take()
            self.arm.send()
            if (k + 1) * PERIOD > fault_at and (cycles - k) * PERIOD > APART:
                name, which = FAULTS[which % len(FAULTS)], which + 1
                self.fired[name] += 1
                lasts = drawn.choice(STOPS) if name == "SIGSTOP" else drawn.uniform(0.03, 0.15)
                threading.Thread(target=self.fail, args=(name, lasts, process)).start()
                fault_at += APART

    def fail(self, name: str, lasts: float, process: subprocess.Popen[str]) -> None:
        """Let something fail for a time [s]; note the packets meanwhile."""
        first = self.arm.sequence
        fail(name, lasts, process)
        self.windows.append((name, first, self.arm.sequence))

    def begin(self) -> None:
        """Lead the driver into a session."""
        for state in (SessionState.MONITORING_READY, SessionState.COMMANDING_WAIT):
            self.arm.state = state
            for _ in range(300):
                self.arm.sequence, self.arm.ns = self.arm.sequence + 1, self.arm.ns + 1_000_000
                self.arm.listen()
                self.arm.send()
                time.sleep(PERIOD)
        self.arm.state = SessionState.COMMANDING_ACTIVE
        self.first = self.arm.sequence + 1

    def take(self) -> None:
        """Judge what has arrived, and obey the last of it."""
        self.plain.settimeout(0)
        while True:
            try:
                data = self.plain.recv(2000)
            except BlockingIOError:
                return
            message = self.schema.Command.FromString(data)
            header = message.header
            self.arm.reflected = header.sequence_counter
            if header.reflected_sequence_counter < self.first:
                continue
            self.answered.append(header.reflected_sequence_counter)
            steps = 1 if self.last is None else header.sequence_counter - self.last
            self.last = header.sequence_counter
            self.arm.position = np.array(message.data.joint_position.value)
            self.received += 1
            zero = np.zeros(7)
            told = Applied(
                POSITION, self.arm.position, zero, zero, zero, steps=min(steps, PATIENCE)
            )
            try:
                self.judge.judge(told, Standing)
            except AssertionError as error:
                self.violations.append(f"{error} at packet {header.reflected_sequence_counter}")
                self.judge.forget()

    def report(self, told: dict[str, Any]) -> bool:
        """Print what arrived, beside what the driver says; say whether all was kept."""
        packets = self.arm.sequence - self.first + 1
        gaps = np.flatnonzero(np.diff(self.answered[1:]) > PATIENCE) + 1
        ends = [(self.answered[k], self.answered[k + 1]) for k in gaps]
        needed = [gap for gap in ends if self.to_be_held(gap)]
        unheld = [gap for gap in needed if not held(gap, told["holds"])]
        shares = ", ".join(f"{name} {share:.4g}" for name, share in self.judge.worst.items())
        print(f"{packets} packets of 1 ms, {self.received} commands arrived, {told['unsent']} were "
              f"not taken by the network, {told['lost']} packets lost, load "
              f"{os.getloadavg()[0]:.1f}")  # fmt: skip
        print("  " + ", ".join(f"{name} {count}" for name, count in self.fired.items()))
        print(f"  steps beyond a limit: {len(self.violations)}; worst: {shares}")
        print(f"  gaps of more than {PATIENCE} packets: {len(ends)}, to be held: {len(needed)}, "
              f"not held: {len(unheld)}")  # fmt: skip
        for reason, count in Counter(why(text) for *_, text in told["holds"]).items():
            print(f"  held {count} times: {reason}")
        for problem in self.violations[:5]:
            print(f"  {problem}")
        return not self.violations and not unheld and all(self.fired[name] for name in FAULTS)

    def to_be_held(self, gap: tuple[int, int]) -> bool:
        """Say whether a gap of answers has to be held: by the network, or as commands expire."""
        first, last = gap
        if last - first > EXPIRED:
            return True
        return any(
            name != "SIGSTOP" and begin <= first and last <= end + PATIENCE
            for name, begin, end in self.windows
        )


class Standing:
    """What positions are judged beside: they go on from one another, whatever is measured."""

    stale = False
    position = velocity = np.zeros(7)


def held(gap: tuple[int, int], holds: list[tuple[int, int, str]]) -> bool:
    """Say whether the driver held in a gap of answers, or at its end at the latest."""
    first, last = gap
    return any(begun <= last + PATIENCE and ended >= first for begun, ended, _ in holds)


def why(text: str) -> str:
    """Return a reason without its numbers."""
    return " ".join(word for word in text.split() if not any(map(str.isdigit, word)))[:110]


def robot_limits() -> Any:  # noqa: ANN401  # the limits of an arm
    """Return the limits of the arm that is driven."""
    from limo_driver.model import RobotModel

    return RobotModel.load("iiwa14").limits


def fail(name: str, lasts: float, process: subprocess.Popen[str]) -> None:
    """Let something fail for a time [s]."""
    device, net = THERE[0], f"{HERE[1]}/32"
    if name == "SIGSTOP":
        process.send_signal(signal.SIGSTOP)
        time.sleep(lasts)
        process.send_signal(signal.SIGCONT)
    elif name == "route taken away":
        inside("ip", "route", "del", net)
        time.sleep(lasts)
        inside("ip", "route", "add", net, "dev", device)
    elif name == "ENOBUFS":
        inside("tc", "qdisc", "add", "dev", device, "root", *EMPTY)
        time.sleep(lasts)
        inside("tc", "qdisc", "del", "dev", device, "root")
    else:
        neighbour(NOBODY)
        time.sleep(lasts)
        neighbour()


def neighbour(address: str = "") -> None:
    """Let the driver's frames go to a hardware address; the arm's if none is given.

    It is stated, not asked for: while Linux asks, it keeps what is sent and delivers it late.
    """
    address = address or Path(f"/sys/class/net/{HERE[0]}/address").read_text().strip()
    inside("ip", "neigh", "replace", HERE[1], "lladdr", address, "dev", THERE[0])


def call(*command: str) -> None:
    """Run a command that has to succeed."""
    subprocess.run(command, check=True)


def inside(*command: str) -> None:
    """Run a command in the driver's namespace."""
    call("ip", "netns", "exec", SPACE, *command)


@contextmanager
def namespace() -> Generator[None]:
    """Have a network namespace with one interface, linked to one here."""
    call("ip", "netns", "add", SPACE)
    try:
        call("ip", "link", "add", HERE[0], "type", "veth", "peer", "name", THERE[0], "netns", SPACE)
        call("ip", "addr", "add", f"{HERE[1]}/24", "dev", HERE[0])
        call("ip", "link", "set", HERE[0], "up")
        inside("ip", "addr", "add", f"{THERE[1]}/32", "dev", THERE[0])
        inside("ip", "link", "set", "lo", "up")
        inside("ip", "link", "set", THERE[0], "up")
        inside("ip", "route", "add", f"{HERE[1]}/32", "dev", THERE[0])
        neighbour()
        yield
    finally:
        call("ip", "netns", "del", SPACE)


@contextmanager
def driving() -> Generator[subprocess.Popen[str]]:
    """Run the driver beside this process, until it listens."""
    command = ["ip", "netns", "exec", SPACE, sys.executable, __file__, "--driver"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


if __name__ == "__main__":
    typer.run(main)
