"""The FRI driver against the simulated controller, two processes over UDP on this machine.

    python benchmarks/backends/fri_link.py \
        --minutes 10            # cycles of 1 ms: answered late, lost
    python benchmarks/backends/fri_link.py --minutes 10 \
        --fifo     # the same with SCHED_FIFO on both sides
    python benchmarks/backends/fri_link.py \
        --rebuilds 200          # sessions lost and regained under motion
    python benchmarks/backends/fri_link.py \
        --fuzz 1000000          # datagrams that are none, on both sides

Every figure is printed beside its bar. An answer is late if the controller has it more than 0.5 ms
after it sent the packet, by the kernel's time of arrival. Before the link, the same packets go to
and from a process that does nothing but send them back: what is late there is late by the machine.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
import yaml

from backends.fri import FriRobot
from backends.fri.codec.messages import MAX_DATAGRAM, SessionState
from backends.fri.connection import Endpoint
from limo_driver.errors import BackendError
from limo_driver.robot.realtime import LatencyHistogram, Pace, Realtime
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Generator

LIMO = (sys.executable, "-c", "from limo_driver.app.cli import main; main()")
PORT, IDLE = 30209, SessionState.IDLE
PACKET, ANSWER = 471, 90  # bytes
LATE_MS, LATE_BAR, LATE_BAR_FIFO = 0.5, 1e-3, 1e-4  # fractions of the cycles
SPEED = 0.2  # [rad/s], of the motion
REBUILD, APART = 0.1, 1.5  # [s] that a session is interrupted, and from one to the next
STATES = ("monitoring_ready", "monitoring_wait", "idle")


def main(
    minutes: Annotated[float, typer.Option(help="Length of the measurement of the link.")] = 0.0,
    fifo: Annotated[bool, typer.Option("--fifo", help="SCHED_FIFO on both sides.")] = False,
    period_ms: Annotated[int, typer.Option(help="Send period [ms].")] = 1,
    rebuild: Annotated[int, typer.Option("--rebuilds", help="Sessions interrupted.")] = 0,
    fuzz: Annotated[int, typer.Option(help="Datagrams, half on each side.")] = 0,
    echo: Annotated[int, typer.Option(hidden=True)] = 0,
) -> None:
    """Measure what was asked for: --minutes, --rebuilds or --fuzz."""
    if echo:
        send_back(echo, fifo=fifo)
        return
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} CPUs, load "
          f"{os.getloadavg()[0]:.1f}, Linux {platform.release()}")  # fmt: skip
    if minutes:
        bare_link(60.0 * min(minutes, 1.0), period_ms, fifo=fifo)
        link(60.0 * minutes, period_ms, fifo=fifo)
    if rebuild:
        rebuilds(rebuild)
    if fuzz:
        fuzz_both(fuzz // 2)


@contextmanager
def controller(*options: str) -> Generator[subprocess.Popen[str]]:
    """Run `limo controller` beside this process."""
    client = ("--client", f"127.0.0.1:{PORT}", "--late-ms", f"{LATE_MS}", "--json")
    command = [*LIMO, "controller", *client, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        try:
            yield it
        finally:
            if it.poll() is None:
                it.kill()


def report_of(running: subprocess.Popen[str]) -> dict[str, Any]:
    """End a controller in order and return its report."""
    said, complained = running.communicate(timeout=60)
    if running.returncode:
        raise SystemExit(complained)
    return json.loads(said.splitlines()[-1])


def send_back(port: int, *, fifo: bool) -> None:
    """Send back whatever comes to a port, until a datagram is empty."""
    with Realtime(fifo=fifo), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", port))
        while True:
            data, sender = link.recvfrom(MAX_DATAGRAM)
            if not data:
                return
            link.sendto(data[:ANSWER], sender)


def bare_link(seconds: float, period_ms: int, *, fifo: bool) -> None:
    """Say how late packets come back that are only sent back."""
    options = ["--echo", str(PORT), *(["--fifo"] if fifo else [])]
    answers, late, count = LatencyHistogram(), 0, round(1e3 * seconds / period_ms)
    with (
        subprocess.Popen([sys.executable, __file__, *options]) as peer,
        Realtime(fifo=fifo),
        closing(Endpoint(None, 0)) as endpoint,
    ):
        endpoint.settle(("127.0.0.1", PORT))
        while endpoint.send(bytes(PACKET)) and endpoint.receive(0.1) is None:
            if peer.poll() is not None:  # else it is starting
                sys.exit(f"the process that sends back ended with status {peer.returncode}")
        pace = Pace(1e-3 * period_ms)
        for _ in range(count):
            pace.wait()
            while endpoint.receive(0.0) is not None:
                pass  # later than its own period
            sent = time.monotonic()
            endpoint.send(bytes(PACKET))
            answer = endpoint.receive(0.9e-3 * period_ms)
            took = np.inf if answer is None else time.monotonic() - answer.age - sent
            late += took > 1e-3 * LATE_MS
            if answer is not None:
                answers.add(took)
        endpoint.send(b"")
        peer.wait()
    print(f"\nonly sent back, {seconds:.0f} s: {100 * late / count:.4f} % later than {LATE_MS} ms; "
          f"{answers.summary()}")  # fmt: skip


def link(seconds: float, period_ms: int, *, fifo: bool) -> None:
    """Move the arm for a time and say how many cycles were answered late or never."""
    options = ("--period-ms", str(period_ms), *(["--fifo"] if fifo else []))
    with controller(*options) as running, Realtime(fifo=fifo) as realtime:
        with FriRobot(port=PORT, version="1.15") as robot:
            robot.wait_until_ready()
            holds = move(robot, time.monotonic() + seconds, realtime)
            running.send_signal(signal.SIGINT)
            with suppress(BackendError):  # answers to the end of the session
                while robot.receive(timeout=0.5).time and robot.session_state is not IDLE:
                    pass
        report = report_of(running)
    packets, bar = report["packets"], LATE_BAR_FIFO if fifo else LATE_BAR
    share = packets["slow"] / max(packets["expected"], 1)
    loop, answers = report["loop_lateness"], report["answer_latency"]
    print(f"\nlink, {seconds:.0f} s at {period_ms} ms, {'with' if fifo else 'without'} SCHED_FIFO"
          + "".join(f" ({text})" for text in realtime.refused))  # fmt: skip
    show("answers later than 0.5 ms", f"{100 * share:.4f} %", f"{100 * bar:g} %", share <= bar)
    show("lost", str(packets["lost"]), "0", packets["lost"] == 0)
    figures = ", ".join(f"{p} {1e3 * answers[p]:.3f}" for p in ("p50", "p99", "p99_9", "longest"))
    print(f"  of {packets['expected']} expected; late for their interval {packets['late']}; "
          f"answers {figures} ms")  # fmt: skip
    print(f"  controller's own wakes: p99 {1e3 * loop['p99']:.3f}, longest "
          f"{1e3 * loop['longest']:.3f} ms, {loop['skipped']} skipped")  # fmt: skip
    print(f"  driver, packet to answer: {robot.latency.summary()}; {holds} holds")


def move(robot: FriRobot, until: float, realtime: Realtime | None = None) -> int:
    """Move all joints to and fro until a time; begin anew where the arm stands after each hold.

    Returns:
        How often the arm held.
    """
    holds = 0
    while time.monotonic() < until:
        try:
            state = robot.receive()
            start, began = robot.setpoint.copy(), state.time
            while time.monotonic() < until:
                phase = 2.0 * (state.time - began)
                robot.send(PositionCommand(position=start + 0.5 * SPEED * (1.0 - np.cos(phase))))
                if realtime is not None:
                    realtime.tidy()
                state = robot.receive()
        except BackendError:  # it holds: the session left COMMANDING_ACTIVE
            holds += 1
            robot.resume()
            try:
                robot.wait_until_ready(timeout=5.0)
            except BackendError:
                continue
    return holds


def rebuilds(count: int) -> None:
    """Interrupt sessions under motion until they were regained `count` times.

    Now and then the driver is closed in full motion and opened anew as well.
    """
    most = 4 * count  # interruptions; on a busy machine, some meet a session that is not up yet
    events = [
        {"event": "session", "at": 2.0 + APART * k, "for": REBUILD, "state": STATES[k % 3]}
        for k in range(most)
    ]
    regained = opened = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rebuilds.yaml"
        path.write_text(yaml.safe_dump({"events": events}), encoding="utf-8")
        with controller("--period-ms", "2", "--scenario", str(path)) as running:
            ends = time.monotonic() + APART * most
            while regained < count and time.monotonic() < ends:
                with FriRobot(port=PORT, version="1.15") as robot:
                    with suppress(BackendError):
                        robot.wait_until_ready()
                    regained += move(robot, time.monotonic() + 5.6 * APART)
                opened += 1
            running.send_signal(signal.SIGINT)
            report = report_of(running)
    entered = sum(visit["state"] == "COMMANDING_ACTIVE" for visit in report["states"])
    jumps = [stop["reason"] for stop in report["stops"]]
    print(
        f"\nrebuilds under motion: the driver held {regained} times and was opened {opened} times"
    )
    show("sessions regained", str(entered), str(count), entered >= count)
    show("largest step of position", f"{100 * report['largest_step']:.1f} % of a cycle's", "100 %",
         report["largest_step"] <= 1.0)  # fmt: skip
    show("stops by the controller", str(len(jumps)), "0", not jumps)
    print("".join(f"  {text}\n" for text in jumps[:5]), end="")


def fuzz_both(count: int) -> None:
    """Throw `count` datagrams at either side; the tests' own fuzzers judge what comes of it."""
    tests = Path(__file__).parents[2] / "tests" / "backends" / "fri"
    sys.path[:0] = [str(tests), str(tests / "simulator")]
    from controller_fuzzing import fuzz_controller
    from fri_fuzzing import fuzz

    with survival("controller") as found:
        sent, report, packet = fuzz_controller(count)
        packets, stood = report["packets"], packet.data.measured_position
        found.append(
            f"{sent} sent, {packets['malformed']} were no command, {packets['answered']} answers, "
            f"{len(report['stops'])} stops; joint 1 stands at {stood[0]:.3g} rad"
        )
    with survival("driver") as found:
        happened = fuzz(count)
        found.append(
            f"{count} sent, {happened['link']['malformed']} were no message, "
            f"{happened['commands']} commands judged"
        )


@contextmanager
def survival(side: str) -> Generator[list[str]]:
    """Tell what was found on one side, or what it crashed of or broke of the contract."""
    began, found, failed = time.monotonic(), [], False
    try:
        yield found
    except Exception as error:  # noqa: BLE001  # whatever it is
        failed = True
        found.append(f"{type(error).__name__}: {error}")
    print(f"\nfuzz: {side}, {time.monotonic() - began:.0f} s")
    show("crashes, or out of contract", str(int(failed)), "0", met=not failed)
    print(*(f"  {line}" for line in found), sep="\n")


def show(what: str, value: str, bar: str, met: bool) -> None:
    """Print a figure beside its bar."""
    print(f"  {what:28} {value:>24}   bar {bar:10} {'met' if met else 'NOT MET'}")


if __name__ == "__main__":
    typer.run(main)
