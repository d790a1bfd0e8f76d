"""One cycle of the FRI driver beside generated protobuf code, and fuzzing of the driver.

    python benchmarks/backends/fri_cycle.py
    python benchmarks/backends/fri_cycle.py --fuzz 1000000

One core. A cycle is what stands between the socket and the socket: decode a monitoring message,
check it, keep track of the session, make the joint state, apply the safety contract to a position
command, encode the answer. It ends where the answer is handed to the socket; the last row has all
that is counted after that. The peer is the code that protobuf generates from `fri.proto` (upb, in
C): it decodes, reads the joint arrays, and encodes an answer; no safety, no session. All are timed
in turn in one run, so that they suffer alike from whatever else the machine does: wall time, and
the 99th percentile of CPU time, which leaves out what the scheduler gave to others.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import typer

from backends.fri.codec import messages as m
from backends.fri.codec.codec import decode_monitoring, encode_command, encode_monitoring
from backends.fri.codec.messages import FriVersion
from backends.fri.codec.template import CommandTemplate, MonitoringTemplate
from backends.fri.connection import Datagram
from limo_driver.robot.realtime import Realtime
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from backends.fri import FriRobot

SHARED = Path(__file__).parents[2] / "tests" / "backends" / "fri"
P50, P99 = 30.0, 80.0  # [µs], bars of a whole cycle
WARM = 2000  # cycles before anything counts
BURST = 1000  # calls in a row; the first few find the caches full of what ran before


class Fed:
    """A socket that has every packet already, for timing without the kernel."""

    foreign, last_foreign = 0, ""
    peer = ("127.0.0.2", 30200)

    def __init__(self, packets: list[bytes]) -> None:
        self.packets, self.at, self.sent = packets, 0, 0.0

    def receive(self, _timeout: float) -> Datagram | None:
        """Return the next packet; None after the last."""
        self.at += 1
        if self.at > len(self.packets):
            return None
        return Datagram(self.packets[self.at - 1], self.peer, 0.0)

    def send(self, _data: bytes) -> bool:
        """Note when the answer came."""
        self.sent = time.perf_counter()
        return True

    def close(self) -> None:
        """Do as the socket does."""


def packets(version: FriVersion, count: int) -> tuple[list[bytes], np.ndarray]:
    """Return the packets of a slow motion at 1 kHz, and its positions (count, 7) [rad]."""
    from fri_messages import POSE, monitoring

    phase = 2e-3 * np.arange(count)[:, None]
    path = np.array(POSE) + 0.1 * (1 - np.cos(phase))
    start = 1_700_000_000_000_000_000
    made: list[bytes] = []
    for k, position in enumerate(path):
        message = monitoring(version.generation, sequence=k)
        stamp = m.Timestamp(*divmod(start + k * 1_000_000, 1_000_000_000))
        data = message.data._replace(measured_position=tuple(position), timestamp=stamp)
        message = message._replace(header=m.Header(k, max(k - 1, 0)), data=data)
        made.append(encode_monitoring(message, version))
    return made, path


@contextmanager
def fed_robot(version: FriVersion, made: list[bytes]) -> Generator[FriRobot]:
    """Open a driver on packets instead of a network."""
    from stepped_arm import SteppedArm, wake

    arm = SteppedArm(generation=version.generation)
    with wake(arm) as robot:
        robot._link.endpoint.close()
        object.__setattr__(robot._link, "endpoint", Fed(made))
        yield robot
    arm.close()


def in_turn(
    calls: dict[str, Callable[[int], object]], cycles: int
) -> dict[str, list[tuple[float, float]]]:
    """Return wall and CPU time of each call [s]; a burst of each, over and over.

    A call that returns a number ended at that reading of the clock.
    """
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for first in range(0, cycles, BURST):
        for name, call in calls.items():
            for k in range(first, min(first + BURST, cycles)):
                busy, began = time.thread_time(), time.perf_counter()
                ended = call(k)
                if not isinstance(ended, float):
                    ended = time.perf_counter()
                taken[name].append((ended - began, time.thread_time() - busy))
    return {name: values[WARM:] for name, values in taken.items()}


def peer(version: FriVersion, made: list[bytes]) -> Callable[[int], object]:
    """Return a cycle of generated protobuf code."""
    from fri_messages import compile_schema

    with tempfile.TemporaryDirectory() as folder:
        generated = compile_schema(folder)
    bare = [data[4:-4] if version.generation.framed else data for data in made]

    def cycle(k: int) -> bytes:
        told = generated.Monitoring.FromString(bare[k])
        data = told.data
        for joints in (data.measured_position, data.measured_torque, data.external_torque):
            np.array(joints.value)
        answer = generated.Command()
        answer.header.message_identifier = m.COMMAND_ID
        answer.header.sequence_counter = k
        answer.header.reflected_sequence_counter = told.header.sequence_counter
        answer.data.joint_position.value.extend(told.ipo.joint_position.value)
        return answer.SerializeToString()

    return cycle


def main(
    cycles: Annotated[int, typer.Option(min=3 * WARM, help="Of each row.")] = 20_000,
    fri: Annotated[str, typer.Option(help="FRI version.")] = "1.15",
    fuzz: Annotated[int, typer.Option(help="Fuzz the driver with this many datagrams.")] = 0,
) -> None:
    """Print what a cycle costs, or fuzz the driver."""
    sys.path[:0] = [str(SHARED), str(SHARED.parents[1] / "limo_driver" / "network")]
    if fuzz:
        _fuzz(fuzz)
        return
    version = FriVersion.named(fri)
    made, path = packets(version, cycles)
    read, write = MonitoringTemplate(version), CommandTemplate(version)
    answers = [
        m.Command(m.Header(k, k), m.CommandData(tuple(position))) for k, position in enumerate(path)
    ]
    commands = [PositionCommand(position=position) for position in path]
    ends: list[float] = []
    with Realtime(), fed_robot(version, made) as robot:  # as the loop of a driver has it
        fed: Fed = robot._link.endpoint

        def cycle(k: int) -> float:
            began = time.perf_counter()
            robot.receive()
            robot.send(commands[k])
            ends.append(time.perf_counter() - began)
            return fed.sent

        taken = in_turn(
            {
                "decode + safety + encode": cycle,
                "generated protobuf, decode + encode": peer(version, made),
                "template, decode": lambda k: read.decode(made[k]),
                "template, encode": lambda k: write.encode(answers[k]),
                "strict codec, decode": lambda k: decode_monitoring(made[k], version),
                "strict codec, encode": lambda k: encode_command(answers[k], version),
            },
            cycles,
        )
        assert robot.figures.malformed == 0
        assert robot.figures.received == cycles
    taken["decode + safety + encode + counting"] = [(wall, np.nan) for wall in ends[WARM:]]
    print(f"FRI {fri}, {len(made[-1])} bytes, {cycles - WARM} cycles [µs]")
    for name, values in taken.items():
        wall, busy = 1e6 * np.array(values).T
        p50, p99 = np.percentile(wall, [50, 99])
        bar = f"   bars {P50:g} / {P99:g}" if name == "decode + safety + encode" else ""
        print(
            f"{name:36s} p50 {p50:6.1f}   p99 {p99:7.1f}   p99 CPU {np.percentile(busy, 99):6.1f}"
            + bar
        )


def _fuzz(count: int) -> None:
    from fri_fuzzing import fuzz

    for mode in (m.CommandMode.POSITION, m.CommandMode.TORQUE):
        began = time.monotonic()
        happened = fuzz(count // 2, seed=7, mode=mode)
        print(f"{mode.name}: {count // 2} datagrams in {time.monotonic() - began:.0f} s")
        print(f"  {happened['commands']} commands, none out of contract; {happened['errors']}")
        print(f"  {happened['link']}")


if __name__ == "__main__":
    typer.run(main)
