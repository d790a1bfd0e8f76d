"""`limo controller` and a client, each a process of its own, over real UDP."""

from __future__ import annotations

import json
import select
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from backends.fri.codec.messages import FriVersion, SessionState
from backends.fri.simulator.connection.port import Address, QualityModel
from backends.fri.simulator.controller import SimulatedController
from backends.fri.simulator.session import MODES, ControllerSettings, SessionTimes
from limo_driver.robot.realtime import Pace

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

LIMO = (sys.executable, "-c", "from limo_driver.app.cli import main; main()")
CLIENT = Path(__file__).parent / "bare_client.py"
PATIENCE = 120  # [s]
# Other work on this machine may set either side aside for long; that is not what is tested.
PATIENT = {
    "quality": QualityModel(fair=0.1, good=0.2, misses=50),
    "times": SessionTimes(monitor=0.1, confirm=5, restart=0.2, stop=0.2),
}


class InStep(Pace):
    """The pace of a controller that goes on once its client has answered, however long that takes.

    No period is left out, so what a scenario has at one time of the robot is met there.
    """

    def __init__(self, robot: SimulatedController) -> None:
        super().__init__(1e-3 * robot.settings.period_ms)
        self._robot = robot

    def wait(self) -> int:
        over = self._robot._session.state is SessionState.IDLE  # in which nobody answers
        select.select([self._robot._port._socket], [], [], 0.01 if over else 10.0)
        return 0


@dataclass(frozen=True)
class Session:
    """What both sides said at the end."""

    report: dict[str, Any]
    client: dict[str, Any]
    client_status: int

    @property
    def states(self) -> list[str]:
        return [visit["state"] for visit in self.report["states"]]

    @property
    def complaints(self) -> str:
        return "\n".join(one["what"] for one in self.report["complaints"])


@contextmanager
def process(*command: str) -> Generator[subprocess.Popen[str]]:
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            yield running
        finally:
            if running.poll() is None:
                running.kill()


@contextmanager
def started_client(*options: str, port: int = 0) -> Generator[tuple[subprocess.Popen[str], int]]:
    """Start the client and say on which port it listens; it is bound by then."""
    with process(sys.executable, str(CLIENT), "--port", str(port), *options) as client:
        assert client.stdout is not None
        yield client, json.loads(client.stdout.readline())["bound"]


def session(
    client: tuple[str, ...],
    *,
    process_of_its_own: bool = False,
    until: Callable[[SimulatedController], bool] | None = None,
    **controller: Any,
) -> Session:
    """Run both over UDP; the controller is told to stop when the client has seen enough.

    Args:
        client: Options of the client, which is always a process of its own.
        process_of_its_own: Run `limo controller`, and not the same in a thread, which starts
            sooner and is patient.
        until: What the controller in a thread has to have seen, too.
        controller: Options of `limo controller`.
    """
    with started_client(*client) as (asked, port):
        if process_of_its_own:
            report = _by_command(asked, port, controller)
        else:
            report = _in_thread(asked, port, controller, until)
        told = last_line(asked)
    return Session(report, told, asked.returncode)


def last_line(client: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for the end of a client, which comes by itself, and return what it said last.

    `communicate` would not see what `readline` has taken from the pipe beyond its line.
    """
    assert client.stdout is not None
    lines = client.stdout.read().splitlines()
    client.wait(PATIENCE)
    return json.loads(lines[-1])


def _wait_until_enough(client: subprocess.Popen[str]) -> None:
    assert client.stdout is not None
    client.stdout.readline()


def _by_command(
    client: subprocess.Popen[str], port: int, controller: dict[str, Any]
) -> dict[str, Any]:
    address = ("--client", f"127.0.0.1:{port}", "--json")
    options = (f"--{name.replace('_', '-')}={value}" for name, value in controller.items())
    with process(*LIMO, "controller", *address, *options) as robot:
        _wait_until_enough(client)
        robot.send_signal(signal.SIGINT)
        said, complained = robot.communicate(timeout=PATIENCE)
        assert robot.returncode == 0, complained
    return json.loads(said.splitlines()[-1])


def _in_thread(
    client: subprocess.Popen[str],
    port: int,
    controller: dict[str, Any],
    until: Callable[[SimulatedController], bool] | None,
) -> dict[str, Any]:
    known = dict(controller)
    settings = ControllerSettings(
        Address("127.0.0.1", port),
        version=FriVersion.named(known.pop("fri", "1.15")),
        mode=MODES[known.pop("mode", "position")],
        **{**PATIENT, **known},
    )
    with SimulatedController(settings) as robot, ThreadPoolExecutor(1) as thread:
        running = thread.submit(robot.run)
        _wait_until_enough(client)
        deadline = time.monotonic() + PATIENCE
        while until is not None and not until(robot) and time.monotonic() < deadline:
            time.sleep(0.01)
        robot.stop()
        return running.result(timeout=PATIENCE).as_json()
