"""`limo controller` and a client, each a process of its own, over real UDP."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Generator

LIMO = (sys.executable, "-c", "from limo_driver.cli import main; main()")
CLIENT = Path(__file__).parent / "bare_client.py"
PATIENCE = 60  # [s]


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


def session(controller: tuple[str, ...], client: tuple[str, ...], *, ends: bool = False) -> Session:
    """Run both; the controller is told to stop when the client has seen enough.

    Args:
        controller: Options of `limo controller`.
        client: Options of the client.
        ends: Whether the controller ends by itself.
    """
    with started_client(*client) as (asked, port):
        address = ("--client", f"127.0.0.1:{port}", "--json")
        with process(*LIMO, "controller", *address, *controller) as robot:
            assert asked.stdout is not None
            if not ends:
                asked.stdout.readline()  # that it is enough, or what it said at its end
                robot.send_signal(signal.SIGINT)
            said, complained = robot.communicate(timeout=PATIENCE)
            assert robot.returncode == 0, complained
            rest, _ = asked.communicate(timeout=PATIENCE)
    last = rest.splitlines()[-1] if rest else "{}"
    return Session(json.loads(said), json.loads(last), asked.returncode)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]
