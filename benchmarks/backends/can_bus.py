"""Seven CiA 402 drives on a bus: 250 Hz between two processes, and a million frames of nonsense.

    python benchmarks/backends/can_bus.py --minutes 10            # udp_multicast, two processes
    python benchmarks/backends/can_bus.py --fuzz 1000000          # one process, without a clock

The first moves an iiwa 14 at 250 Hz over `udp_multicast` and counts cycles in which a drive was not
heard, and by how much cycles began late. Both processes get a real-time priority where the system
grants one (`--no-realtime`: not), as whoever runs an arm at a fixed rate gives them.

The second puts the driver on a bus with simulated drives, all in one process and with a time of
their own, and lets the driver hear frames of nonsense: random bytes on random ids, and well-formed
frames with random contents. Other drives, which nobody drives, hear the same and obey it. What must
not happen: a crash of either, a set-point of the driver beyond the limits of the safety contract,
or a joint of its arm that moves faster than its limit.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import struct
import sys
import tempfile
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import can
import numpy as np

from backends.can import ArmConfig, CanRobot
from backends.can.simulator import SimulatedDrives
from backends.can.simulator.session import Station
from limo_driver.errors import BackendError
from limo_driver.physics import Simulation
from limo_driver.robot.measured import RANGE_TOLERANCE
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from limo_driver.types import FloatArray

EXAMPLE = Path(__file__).parents[2] / "examples" / "can_cia402.yaml"
LATENESS_BAR, LOST_BAR, FUZZ_BAR = 2.0, 0, 0  # [ms] at p99, cycles, violations
PRIORITY = 10  # of SCHED_FIFO, above all that is not real-time
AMPLITUDE, SWING = 0.1, 8.0  # [rad], [s]
PER_CYCLE = 8  # frames of nonsense
QUIET = 50  # cycles after which an arm that holds is told to go on
SLACK = 1e-6  # [rad], one count of these drives is more


def main() -> None:
    """Measure one of both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=EXAMPLE)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--no-realtime", action="store_true")
    parser.add_argument("--fuzz", type=int, help="frames, instead of the run over the bus")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} CPUs, load average "
        f"{os.getloadavg()[0]:.1f}"
    )
    config = ArmConfig.load(given.config)
    if given.fuzz:
        sys.exit(Fuzz(config, given.seed).run(given.fuzz))
    run(config, given.config, given.minutes, realtime=not given.no_realtime)


def run(config: ArmConfig, path: Path, minutes: float, *, realtime: bool) -> None:
    """Move the arm for so many minutes and print what happened to the cycles."""
    with tempfile.TemporaryDirectory() as folder:
        # A held arm would end the measurement; every cycle that is lost is counted all the same.
        patient = Path(folder) / "arm.yaml"
        patient.write_text(
            re.sub("^hold_after:.*$", "", path.read_text(), flags=re.MULTILINE)
            + "hold_after: 1000\n"
        )
        with SimulatedDrives(patient) as drives, CanRobot(patient) as robot:
            granted = realtime and as_realtime(drives.pid) and as_realtime(os.getpid())
            stale, away, used = cycles(robot, round(60 * minutes * config.rate))
    late = robot.lateness
    print(
        f"{config.rate:g} Hz for {minutes:g} min, 7 drives, udp_multicast, two processes, "
        f"real-time priority {'granted' if granted else 'not used'}"
    )
    print(f"  cycles in which a drive was not heard   {stale:8d}      limit {LOST_BAR}")
    print(
        f"  cycles begun late, p99                  {1e3 * late.percentile(99):8.3f} ms   "
        f"limit {LATENESS_BAR} ms"
    )
    print(
        f"                     p50, longest         {1e3 * late.percentile(50):8.3f} ms, "
        f"{1e3 * late.longest:.3f} ms"
    )
    print(f"  cycles that did not take place          {robot.overruns:8d}")
    print(f"  furthest from the set-point             {1e3 * away:8.3f} mrad")
    print(f"  processor time of the driver            {100 * used:8.1f} % of one core")
    print(f"  drives: {drives.summary}")


def cycles(robot: CanRobot, count: int) -> tuple[int, float, float]:
    """Return stale cycles, the largest distance [rad], and the share of a core that was used."""
    state = robot.receive()
    start, stale, away = state.position, 0, 0.0
    robot.lateness.take()  # what came before is the start-up
    began, used = time.monotonic(), time.process_time()
    for k in range(count):
        phase = 2 * np.pi * k * robot.spec.period / SWING
        target = start + AMPLITUDE * (1 - np.cos(phase))
        robot.send(PositionCommand(position=target))
        state = robot.receive()
        stale += state.stale
        away = max(away, float(np.abs(state.position - target).max()))
    return stale, away, (time.process_time() - used) / (time.monotonic() - began)


def as_realtime(process: int) -> bool:
    """Give a process a real-time priority; say whether the system grants it."""
    try:
        os.sched_setscheduler(process, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


class OneProcessBus(can.BusABC):
    """The driver's end of a bus whose drives answer at once, with a time of its own."""

    def __init__(self) -> None:
        super().__init__(channel="one process")
        self.queue: deque[can.Message] = deque()
        self.time = 100.0  # [s]
        self.station: Station | None = None
        self.watch = lambda _frame_id, _data: None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Let the drives hear a frame of the driver."""
        data = bytes(msg.data)
        self.watch(msg.arbitration_id, data)
        self.station.hear(msg.arbitration_id, data)

    def deliver(self, frame_id: int, data: bytes) -> None:
        """Let the driver hear a frame."""
        self.queue.append(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame, or let time pass."""
        if self.queue:
            return self.queue.popleft()
        self.time += timeout or 0.0
        while self.station is not None and self.station.due <= self.time:
            self.station.turn()
        return self.queue.popleft() if self.queue else None


class DrivesEnd:
    """The drives' end of the bus, as a `Station` takes a port."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self.send = send

    def receive(self, until: float) -> None:  # frames are heard as they are sent
        """Hear nothing more."""

    def close(self) -> None:
        """Let go of nothing."""


class Fuzz:
    """Frames at both ends of a bus, and what the joints and the driver do meanwhile."""

    def __init__(self, config: ArmConfig, seed: int) -> None:
        self._config = replace(config, hold_after=2)
        self._random = np.random.default_rng(seed)
        self._bus = OneProcessBus()
        self._station = Station(
            self._config,
            DrivesEnd(self._bus.deliver),
            Simulation(robot=config.robot),
            clock=lambda: self._bus.time,
        )
        self._bus.station = self._station
        self._others = Station(
            self._config,
            DrivesEnd(lambda _frame_id, _data: None),
            Simulation(robot=config.robot),
            clock=lambda: self._bus.time,
        )
        self._nodes = [joint.node for joint in config.joints]
        self._told: dict[int, float] = {}  # last set-point of each node [rad]
        self.violations: Counter[str] = Counter()
        self.crashes: Counter[str] = Counter()

    def run(self, frames: int) -> int:
        """Throw so many frames, print what happened, and return the exit status."""
        self._station.start()
        self._others.start()
        self._bus.watch = self._watch
        began, thrown, held, moved = time.monotonic(), 0, 0, 0
        with CanRobot(self._config, bus=self._bus, clock=lambda: self._bus.time) as robot:
            state, quiet = robot.receive(), 0
            start, since = state.position, 0
            while thrown < frames:
                if quiet == 0:
                    thrown += self._throw()
                quiet = max(quiet - 1, 0)
                since += 1
                phase = 2 * np.pi * since * robot.spec.period / SWING
                command = PositionCommand(position=start + AMPLITUDE * (1 - np.cos(phase)))
                try:
                    self._survive(partial(robot.send, command))
                    moved += 1
                except BackendError:
                    held += 1
                    if held % QUIET == 0:
                        start, since = self._recover(robot, start), 0
                        quiet = QUIET if held % (2 * QUIET) else 0
                with suppress(BackendError):
                    self._survive(robot.receive)
                self._check_joints()
        bad = sum(self.violations.values()) + sum(self.crashes.values())
        print(f"{thrown} frames of nonsense in {time.monotonic() - began:.0f} s")
        print(f"  cycles commanded, held                  {moved:8d}, {held}")
        for what, counted in (
            ("crashes", self.crashes),
            ("set-points or motion out of contract", self.violations),
        ):
            print(f"  {what:<40}{sum(counted.values()):8d}      limit {FUZZ_BAR}")
            for name, count in counted.items():
                print(f"    {count} {name}")
        return int(bad > FUZZ_BAR)

    def _survive(self, call: Callable[[], object]) -> None:
        """Call; an error that is none of limo's own is a crash."""
        try:
            call()
        except BackendError:
            raise
        except Exception as error:  # noqa: BLE001  # whatever it is
            self.crashes[f"{type(error).__name__}: {error}"] += 1

    def _recover(self, robot: CanRobot, start: FloatArray) -> FloatArray:
        """Cure what can be cured, and go on from where the arm is."""
        with suppress(BackendError):
            robot.reset_faults()
            robot.resume()
            self._told.clear()
            return robot.receive().position
        return start

    def _throw(self) -> int:
        """Put nonsense on the bus for one cycle."""
        for frame_id, data in self._nonsense():
            self._bus.deliver(frame_id, data)
            self._others.hear(frame_id, data)
        while self._others.due <= self._bus.time:
            self._others.turn()
        return PER_CYCLE

    def _nonsense(self) -> Iterator[tuple[int, bytes]]:
        random = self._random
        bases = (0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x580, 0x600, 0x700)
        for _ in range(PER_CYCLE):
            kind, node = random.integers(4), int(random.choice(self._nodes))
            if kind == 0:
                yield int(random.integers(0x800)), random.bytes(int(random.integers(9)))
            elif kind == 1:
                yield int(random.choice(bases)) + node, random.bytes(8)
            elif kind == 2:  # a measurement that looks good
                word, count = int(random.choice([0x27, 0x08, 0x40])), int(random.normal(0, 3e5))
                torque = int(random.integers(-999, 999))
                yield 0x180 + node, struct.pack("<Hih", word, count, torque)
            else:  # objects read and written
                index = int(random.choice([0x1016, 0x1400, 0x1600, 0x6007, 0x6040, 0x6060, 0x607A]))
                head = int(random.choice([0x23, 0x2B, 0x2F, 0x40, 0x60, 0x80]))
                sub = int(random.integers(6))
                yield 0x600 + node, struct.pack("<BHB4s", head, index, sub, random.bytes(4))

    def _watch(self, frame_id: int, data: bytes) -> None:
        """Check every set-point that the driver sends to a drive that it enables."""
        node = frame_id - 0x200
        if node not in self._nodes or len(data) != 8:
            return
        word, count, _ = struct.unpack("<Hih", data)
        j = self._nodes.index(node)
        joint, limits = self._config.joints[j], self._config.model.limits
        position = joint.offset + count / joint.counts_per_radian
        if word & 0x8F != 0x0F:
            self._told.pop(node, None)
            return
        outside = RANGE_TOLERANCE + SLACK + 1 / abs(joint.counts_per_radian)
        if not (limits.position_min[j] - outside <= position <= limits.position_max[j] + outside):
            self.violations["set-point outside the range"] += 1
        before = self._told.get(node)
        step = VELOCITY_TOLERANCE * limits.velocity[j] / self._config.rate + outside
        if before is not None and abs(position - before) > step:
            self.violations["set-point that jumps"] += 1
        self._told[node] = position

    def _check_joints(self) -> None:
        """Check that no joint really moves faster than its limit."""
        fastest = VELOCITY_TOLERANCE * self._config.model.limits.velocity
        for j, port in enumerate(self._station.arm.joints):
            if abs(port.measured_velocity) > fastest[j]:
                self.violations[f"joint {j + 1} too fast"] += 1


if __name__ == "__main__":
    main()
