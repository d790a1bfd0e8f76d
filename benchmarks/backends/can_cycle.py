"""Encode and decode one cycle of seven CiA 402 drives, beside the bar and two peers.

    python benchmarks/backends/can_cycle.py

From joint positions [rad] to seven RPDOs, and from seven TPDOs to positions [rad] and torques
[N m]. `canopen` packs and unpacks the same PDOs by its object dictionary, `cantools` by a DBC with
the same scaling, where it is installed; that all make the same bytes is checked first. All are
timed in turn in one run, so that they suffer alike from whatever else the machine does. Then: what
`CanRobot` spends on a whole cycle, contract and python-can messages included, on a bus that answers
at once.
"""

from __future__ import annotations

import importlib.util
import math
import os
import struct
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import can
import canopen
import numpy as np
import typer
from canopen.objectdictionary import (
    INTEGER16,
    INTEGER32,
    UNSIGNED16,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

from backends.can import ArmConfig, CanRobot
from backends.can.cia402.codec import MEASURED, Codec, Controlword
from backends.can.cia402.drive import Drive
from backends.can.config import Bus, Cia402Joint
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen.pdo import PdoMap

BAR = 60.0  # [µs], p50 of limo
WHOLE = 75.0  # [µs], p50 of a whole cycle of the driver
NODES = tuple(range(11, 18))
COUNTS = 524288  # of a turn
RATED = 320_000  # [mN m], object 6076
WARM_UP = 200
JOINTS = tuple(
    Cia402Joint(node=node, counts_per_turn=COUNTS, rated_torque=RATED / 1e3) for node in NODES
)
PER_RADIAN = COUNTS / math.tau
STEP = RATED * 1e-6  # [N m]


class Limo:
    """The driver's own codec."""

    def __init__(self) -> None:
        self.codec = Codec(JOINTS, [RATED] * len(JOINTS))
        self.words = [Controlword.ENABLE] * len(JOINTS)
        self.drives = [Drive(j + 1, node) for j, node in enumerate(NODES)]

    def encode(self, position: np.ndarray) -> list[bytes]:
        """Return the RPDOs of positions [rad]."""
        return self.codec.targets(position, self.words)

    def decode(self, frames: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [rad] and torques [N m] of TPDOs."""
        for drive, data in zip(self.drives, frames, strict=True):
            drive.take_measured(data)
        position = self.codec.positions([drive.count for drive in self.drives])
        return position, self.codec.measured_torques([drive.per_mille for drive in self.drives])


class Canopen:
    """canopen's PDO maps, and the scaling by hand, which it does not do."""

    def __init__(self) -> None:
        network = canopen.Network()
        nodes = [network.add_node(canopen.RemoteNode(node, _dictionary())) for node in NODES]
        self.targets = [_map(node.rpdo[1], (0x6040, 0x607A, 0x60B2)) for node in nodes]
        self.measured = [_map(node.tpdo[1], (0x6041, 0x6064, 0x6077)) for node in nodes]

    def encode(self, position: np.ndarray) -> list[bytes]:
        """Return the RPDOs of positions [rad]."""
        counts = np.rint(position * PER_RADIAN).astype(int).tolist()
        for pdo, count in zip(self.targets, counts, strict=True):
            pdo[0].raw, pdo[1].raw, pdo[2].raw = 0x0F, count, 0
        return [bytes(pdo.data) for pdo in self.targets]

    def decode(self, frames: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [rad] and torques [N m] of TPDOs."""
        for pdo, data in zip(self.measured, frames, strict=True):
            pdo.data = data
        read = [(pdo[0].raw, pdo[1].raw, pdo[2].raw) for pdo in self.measured]
        _, counts, torques = zip(*read, strict=True)
        return np.array(counts) / PER_RADIAN, np.array(torques) * STEP


class Cantools:
    """cantools on a database of the same frames."""

    def __init__(self) -> None:
        from cantools.database import load_string  # pyright: ignore[reportMissingImports]

        database = load_string(_dbc(), "dbc")
        self.targets = [database.get_message_by_name(f"RPDO1_{node}") for node in NODES]
        self.measured = [database.get_message_by_name(f"TPDO1_{node}") for node in NODES]

    def encode(self, position: np.ndarray) -> list[bytes]:
        """Return the RPDOs of positions [rad]."""
        return [
            message.encode({"word": 0x0F, "target": q, "offset": 0.0})
            for message, q in zip(self.targets, position.tolist(), strict=True)
        ]

    def decode(self, frames: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [rad] and torques [N m] of TPDOs."""
        read: list[Any] = [
            message.decode(data) for message, data in zip(self.measured, frames, strict=True)
        ]
        position = np.array([values["position"] for values in read])
        return position, np.array([values["torque"] for values in read])


def _dictionary() -> ObjectDictionary:
    od = ObjectDictionary()
    kinds = {
        0x6040: UNSIGNED16,
        0x6041: UNSIGNED16,
        0x6064: INTEGER32,
        0x607A: INTEGER32,
        0x6077: INTEGER16,
        0x60B2: INTEGER16,
    }
    for index, kind in kinds.items():
        variable = ODVariable(f"object {index:04X}", index)
        variable.data_type = kind
        od.add_object(variable)
    for index in (0x1400, 0x1600, 0x1800, 0x1A00):
        od.add_object(ODRecord(f"record {index:04X}", index))
    return od


def _map(pdo: PdoMap, indices: tuple[int, ...]) -> PdoMap:
    pdo.clear()
    for index in indices:
        pdo.add_variable(index)
    return pdo


def _dbc() -> str:
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: master"]
    scale = f"({1 / PER_RADIAN!r},0)"
    for node in NODES:
        lines += [
            f"BO_ {0x200 + node} RPDO1_{node}: 8 master",
            ' SG_ word : 0|16@1+ (1,0) [0|0] "" master',
            f' SG_ target : 16|32@1- {scale} [0|0] "rad" master',
            f' SG_ offset : 48|16@1- ({STEP!r},0) [0|0] "Nm" master',
            f"BO_ {0x180 + node} TPDO1_{node}: 8 master",
            ' SG_ word : 0|16@1+ (1,0) [0|0] "" master',
            f' SG_ position : 16|32@1- {scale} [0|0] "rad" master',
            f' SG_ torque : 48|16@1- ({STEP!r},0) [0|0] "Nm" master',
        ]
    return "\n".join(lines) + "\n"


class Answering(can.BusABC):
    """A bus whose drives are enabled, stand where they are told to, and answer at once."""

    def __init__(self) -> None:
        super().__init__(channel="answering")
        self.waiting: list[can.Message] = []
        self.counts = dict.fromkeys(NODES, 0)
        self.time = 0.0

    def now(self) -> float:
        """Return the time, which passes only where the driver waits [s]."""
        return self.time

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Take a frame and answer it."""
        frame_id, data = msg.arbitration_id, bytes(msg.data)
        if frame_id - 0x600 in NODES:
            head, about = (0x43, data[1:4]) if data[0] == 0x40 else (0x60, data[1:4])
            value = {0x1000: 402, 0x6076: RATED, 0x6041: 0x27}.get(
                int.from_bytes(about[:2], "little"), 0
            )
            answer = bytes([head]) + about + value.to_bytes(4, "little")
            self._put(frame_id - 0x80, answer)
        elif frame_id - 0x200 in NODES:
            self.counts[frame_id - 0x200] = struct.unpack_from("<i", data, 2)[0]
        elif frame_id == 0x080:
            for node, count in self.counts.items():
                self._put(0x180 + node, MEASURED.pack(0x27, count, 10))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next answer; time passes if there is none."""
        if self.waiting:
            return self.waiting.pop(0)
        self.time += timeout or 0.0
        return None

    def _put(self, frame_id: int, data: bytes) -> None:
        self.waiting.append(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False))


def in_turn(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Return the wall time of each call [µs]; a burst of each, over and over."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            for _ in range(100):
                began = time.perf_counter()
                call()
                taken[name].append(time.perf_counter() - began)
    return {name: 1e6 * np.array(values[WARM_UP:]) for name, values in taken.items()}


def cycle_of_the_driver(cycles: int) -> np.ndarray:
    """Return what whole cycles of the driver take [µs]."""
    bus = Answering()
    config = ArmConfig(
        bus=Bus(interface="virtual", channel="benchmark"), robot="iiwa14", joints=JOINTS
    )
    taken = np.empty(cycles)
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        state = robot.receive()
        for k in range(cycles):
            began = time.perf_counter()
            robot.send(PositionCommand(position=state.position))
            state = robot.receive()
            taken[k] = time.perf_counter() - began
    return 1e6 * taken[WARM_UP:]


def main(
    rounds: Annotated[int, typer.Option(min=5, help="Bursts of 100 calls of each.")] = 30,
) -> None:
    """Time one cycle of seven joints."""
    random = np.random.default_rng(0)
    position = np.rint(random.uniform(-2, 2, len(NODES)) * PER_RADIAN) / PER_RADIAN
    frames = [
        MEASURED.pack(0x1627, int(count), int(torque))
        for count, torque in zip(
            np.rint(position * PER_RADIAN), random.integers(-900, 900, len(NODES)), strict=True
        )
    ]
    codecs: dict[str, Limo | Canopen | Cantools] = {"limo": Limo(), "canopen": Canopen()}
    if importlib.util.find_spec("cantools") is not None:
        codecs["cantools"] = Cantools()
    sent = {name: codec.encode(position) for name, codec in codecs.items()}
    read = {name: np.array(codec.decode(frames)) for name, codec in codecs.items()}
    assert all(frames == sent["limo"] for frames in sent.values())
    assert all(np.allclose(values, read["limo"], atol=1e-12) for values in read.values())

    def both(codec: Limo | Canopen | Cantools) -> Callable[[], object]:
        return lambda: (codec.encode(position), codec.decode(frames))

    taken = in_turn({name: both(codec) for name, codec in codecs.items()}, rounds)
    print("encode and decode a cycle of 7 joints [µs]     p50      p99   against limo")
    for name, values in taken.items():
        p50, p99 = np.percentile(values, [50, 99])
        ratio = p50 / np.median(taken["limo"])
        print(f"  {name:<42} {p50:7.1f}  {p99:7.1f}   {ratio:.1f}")
    whole = np.percentile(cycle_of_the_driver(20 * rounds + WARM_UP), [50, 99])
    print(
        f"  {'CanRobot, whole cycle (16 frames)':<42} {whole[0]:7.1f}  {whole[1]:7.1f}"
        f"   bar {WHOLE:g}"
    )
    reached = float(np.median(taken["limo"]))
    print(f"limo: {reached:.1f} µs, bar {BAR:g} µs: {'kept' if reached <= BAR else 'MISSED'}")
    if reached > BAR:
        sys.exit(1)


if __name__ == "__main__":
    typer.run(main)
