"""The processes of the whole: an arm and its driver, the service, and what a consumer hears."""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
import subprocess
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import takewhile
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from limo_driver.errors import BackendError, ConfigError, LimoError
from limo_driver.network.messages import (
    Attachment,
    decode_event,
    decode_joint_state,
    decode_torque_estimate,
)
from limo_driver.network.streaming import Keys, follow_history
from limo_driver.robot.realtime import RealtimeThreads
from limo_driver.runtime.processes import Closing, command_of, end_with_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from multiprocessing.process import BaseProcess
    from pathlib import Path

    import zenoh

    from limo_driver.network.messages import Event

    Process = subprocess.Popen[bytes] | BaseProcess

ARM: Final = "iiwa14"
RATE: Final = 250  # [Hz] of the stream
_LIMO: Final = command_of("limo_driver.app.cli")
_PATIENCE: Final = 1200.0  # [s] for what is waited for, where something is broken
_LOOK: Final = 0.5  # [s] between two looks whether the processes live
_ENDING: Final = 60.0  # [s] for a process to end in order

_T = TypeVar("_T")


@dataclass(frozen=True)
class ProvenWire:
    """How the driver reaches its arm.

    Args:
        name: For people.
        backend: Registered name of the driver's end.
        options: Of `limo run`, with which it reaches the other end.
        other_end: Words of the command that is the other end, to which `--sim` and `--trajectory`
            are added; none where the arm is in the driver.
    """

    name: str
    backend: str
    options: tuple[str, ...] = ()
    other_end: tuple[str, ...] = ()


BACKENDS: Final = ("mujoco", "fri", "can")
# As drives that share a computer with all else it does need it.
_BUS: Final = """\
bus:
  {{interface: udp_multicast, channel: 239.74.163.2, options: {{port: {port}, hop_limit: 0}}}}
convention: cia402
robot: iiwa14
rate: 250
watchdog: 0.1
hold_after: 25
answer_timeout: 5
joints:
"""
_RATED: Final = (107, 107, 59, 59, 37, 13, 13)  # [N m], a third of what each joint can


def wire_of(backend: str, folder: Path) -> ProvenWire:
    """Return how a backend's driver reaches a simulated arm on this computer.

    Args:
        backend: mujoco, where the arm is in the driver; fri, to `limo controller` by UDP; can, to
            `limo drives` on a bus.
        folder: Where the bus is described.

    Raises:
        ConfigError: No such backend.
    """
    if backend == "mujoco":
        return ProvenWire("MuJoCo", backend)
    if backend not in BACKENDS:
        raise ConfigError(f"`backend` is {backend!r}, expected one of {', '.join(BACKENDS)}")
    port = _free_port(socket.SOCK_DGRAM)
    if backend == "fri":
        period = str(round(1e3 / RATE))  # a state a packet
        other_end = ("controller", "--client", f"127.0.0.1:{port}", "--period-ms", period)
        return ProvenWire("FRI", backend, ("--port", str(port)), other_end)
    config = folder / "can.yaml"
    joints = "".join(
        f"  - {{node: {node}, counts_per_turn: 524288, rated_torque: {rated}}}\n"
        for node, rated in enumerate(_RATED, start=11)
    )
    config.write_text(_BUS.format(port=port) + joints)
    options = ("--config", str(config))
    return ProvenWire("CAN (CiA 402)", backend, options, ("drives", *options))


@contextmanager
def moving(
    wire: ProvenWire, simulation: Path, motion: Path, record: Path, network: Path | None = None
) -> Generator[subprocess.Popen[bytes]]:
    """Move an arm in processes of their own until the block ends; the arm is slowed down to a hold.

    Args:
        wire: How the driver reaches it.
        simulation: The arm (sim.yaml).
        motion: Trajectory.
        record: Where the driver keeps its recording.
        network: Zenoh's configuration, to stream by; the arm then stands until estimates come.

    Yields:
        The driver.

    Raises:
        BackendError: The other end did not start, or the driver ended before the block.
    """
    given = ["--trajectory", str(motion), "--record", str(record), "--rate", str(RATE), "--json"]
    given += [*wire.options, "--fifo"] if wire.other_end else ["--sim", str(simulation)]
    if network is not None:
        given += ["--stream", "--name", ARM, "--zenoh-config", str(network)]
        given += ["--wait-for-estimates", str(_PATIENCE)]
    with ExitStack() as open_:
        errors = open_.enter_context(record.with_suffix(".err").open("wb"))
        if wire.other_end and network is not None:
            open_.enter_context(RealtimeThreads())  # states pass through this process
        if wire.other_end:
            physics = ["--sim", str(simulation), "--trajectory", str(motion), "--fifo", "--json"]
            arm = subprocess.Popen(  # noqa: S603  # this interpreter, with our own options
                [*_LIMO, *wire.other_end, *physics], stdout=subprocess.PIPE, stderr=errors
            )
            open_.callback(_end, arm, record.with_suffix(".other_end.json"))
            if arm.stdout is None or not arm.stdout.readline():
                raise BackendError(f"{wire.other_end[0]} did not start: see {errors.name}")
        driver = subprocess.Popen(  # noqa: S603
            [*_LIMO, "run", "--backend", wire.backend, *given],
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )
        open_.callback(_end, driver)
        try:
            yield driver
        except LimoError as error:
            if driver.poll():  # that is why
                raise BackendError(_why_ended(record, wire)) from error
            raise


def _why_ended(record: Path, wire: ProvenWire) -> str:
    """Return the last line of a driver, and how busy this computer is that has to keep time."""
    lines = record.with_suffix(".err").read_text(errors="replace").strip().splitlines()
    why = f"the driver ended early: {lines[-1] if lines else record}"
    if not wire.other_end:
        return why
    load = f"a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    return f"{why}; {wire.name} needs real time at both ends, and this computer has {load}"


def _end(process: subprocess.Popen[bytes], report: Path | None = None) -> None:
    process.terminate()  # what a shell starts in the background ignores SIGINT, and so would this
    try:
        output, _ = process.communicate(timeout=_ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        output, _ = process.communicate()
    if report is not None:
        report.write_bytes(output)


def recorded(driver: subprocess.Popen[bytes], record: Path) -> Path:
    """Wait until a driver has moved its arm to the end, and return its recording.

    Raises:
        BackendError: It did not get there.
    """
    if driver.wait(_PATIENCE):
        raise BackendError("the driver ended early")  # inside `moving`, which knows why
    return record


class ServiceProcess(Closing):
    """A service in a process of its own.

    Args:
        options: Of `limo.serve`.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        self.process = multiprocessing.get_context("spawn").Process(target=_serve, args=(options,))
        self.process.start()

    def kill(self) -> None:
        """End it as a loss of power does: at once, without a word."""
        self.process.kill()
        self.process.join()

    def close(self) -> None:
        """End it in order."""
        self.process.terminate()
        self.process.join(_ENDING)
        self.process.kill()
        self.process.join()


def _serve(options: dict[str, Any]) -> None:
    from limo_driver.app.library.serving import serve

    end_with_parent()
    with serve(ARM, **options) as service:
        service.wait()


@dataclass(frozen=True)
class HeardStates:
    """Estimates in the order in which a consumer heard them."""

    sequences: np.ndarray  # (T,) of the states that they answer
    stamps: np.ndarray  # (T,) [ns]
    external: np.ndarray  # (T, n) [N m], NaN where the memory began anew
    models: tuple[str, ...]  # (T,) versions


class Consumer(Closing):
    """Hears what a service says, as a controller would.

    Args:
        session: Open Zenoh session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        keys = Keys(ARM)
        self._changed = threading.Condition()
        self._estimates: list[tuple[int, bytes]] = []  # sequence and payload
        self._states: list[bytes] = []
        self.events: list[Event] = []
        self.status: dict[str, Any] = {}
        self._subscribers = (
            session.declare_subscriber(keys.estimate, self._take),
            session.declare_subscriber(
                keys.joints, lambda sample: self._states.append(sample.payload.to_bytes())
            ),
            follow_history(session, keys.event, self._tell),
            follow_history(session, keys.status("service"), self._note),
        )

    def wait(self, found: Callable[[], _T | None], living: Sequence[Process] = ()) -> _T:
        """Wait until something is found in what was heard, and return it.

        Args:
            found: Returns it, or None as long as it was not heard.
            living: Processes without which it would be waited for in vain.

        Raises:
            LimoError: One of them ended, or nothing came for twenty minutes.
        """
        ends = monotonic() + _PATIENCE
        with self._changed:
            while (value := found()) is None:
                if not all(_lives(process) for process in living):
                    raise LimoError("a process ended while something of it was waited for")
                if monotonic() > ends:
                    raise LimoError(f"nothing came for {_PATIENCE:g} s; heard last: {self.status}")
                self._changed.wait(_LOOK)
        return value

    def forget_status(self) -> None:
        """Wait for another status: the service that said the last one is no more."""
        with self._changed:
            self.status = {}

    def event(self, kind: str, after: int = 0) -> Event | None:
        """Return the first event of a kind after the first `after` ones, if it came."""
        return next((event for event in self.events[after:] if event.kind == kind), None)

    @property
    def count(self) -> int:
        """Estimates heard."""
        return len(self._estimates)

    def heard(self, first: int = 0) -> HeardStates:
        """Return the estimates from one on."""
        pairs = self._estimates[first:]
        answers = [decode_torque_estimate(payload) for _, payload in pairs]
        return HeardStates(
            np.array([sequence for sequence, _ in pairs], dtype=np.int64),
            np.array([answer.stamp_ns for answer in answers], dtype=np.int64),
            np.array([x.external * (np.nan if x.reset else 1.0) for x in answers]),
            tuple(answer.model for answer in answers),
        )

    def positions(self, begin: int, end: int) -> np.ndarray:
        """Return where the joints were between two stamps [ns], (T, n) [rad]."""
        states = (decode_joint_state(payload) for payload in reversed(self._states))
        newest = takewhile(lambda state: state.stamp_ns >= begin, states)
        return np.array([state.position for state in newest if state.stamp_ns <= end])

    def close(self) -> None:
        """Hear no more."""
        for subscriber in self._subscribers:
            subscriber.undeclare()

    def _take(self, sample: zenoh.Sample) -> None:
        about = sample.attachment
        if about is not None:
            sequence = Attachment.decode(about.to_bytes()).sequence
            with self._changed:
                self._estimates.append((sequence, sample.payload.to_bytes()))
                self._changed.notify_all()

    def _tell(self, sample: zenoh.Sample) -> None:
        event = decode_event(sample.payload.to_bytes())
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def _note(self, sample: zenoh.Sample) -> None:
        status = json.loads(sample.payload.to_bytes())
        with self._changed:
            self.status = status
            self._changed.notify_all()


def _lives(process: Process) -> bool:
    if isinstance(process, subprocess.Popen):
        return process.poll() is None
    return process.is_alive()


def configurations(folder: Path) -> tuple[Path, Path]:
    """Write Zenoh's configurations of this process, which listens, and of all others."""
    endpoint = f"tcp/127.0.0.1:{_free_port(socket.SOCK_STREAM)}"
    alone = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    here, there = folder / "here.json5", folder / "there.json5"
    listen = {"mode": "router", "listen": {"endpoints": [endpoint]}, "scouting": alone}
    here.write_text(json.dumps(listen))
    connect = {"mode": "client", "connect": {"endpoints": [endpoint]}, "scouting": alone}
    there.write_text(json.dumps(connect))
    return here, there


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(type=kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
