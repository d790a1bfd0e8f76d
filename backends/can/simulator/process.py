"""SimulatedDrives: `limo drives` in a process of its own, for tests, examples and benchmarks."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import BackendError
from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from pathlib import Path

ENDING: Final = 120.0  # [s] in which the process has to end once it is told; it may compile
_COMMAND: Final = "from limo_driver.app.cli import main; main()"


class SimulatedDrives(Closing):
    """Drives on the bus of an `arm.yaml`, ready when the constructor returns.

    Args:
        config: The `arm.yaml`.
        sim: A `sim.yaml`; else the rigid body of the arm alone.
        scenario: What goes wrong.
        trajectory: The arm stands where it starts; in the middle of its range if not given.
        seed: Of the sensor noise.
        fifo: Ask for SCHED_FIFO, where the computer has to keep time for both ends of the bus.

    Raises:
        BackendError: They did not start; says what they said.
    """

    def __init__(
        self,
        config: Path | str,
        *,
        sim: Path | str | None = None,
        scenario: Path | str | None = None,
        trajectory: Path | str | None = None,
        seed: int = 0,
        fifo: bool = False,
    ) -> None:
        options = {"config": config, "sim": sim, "scenario": scenario, "trajectory": trajectory}
        given = [
            word
            for name, value in options.items()
            if value is not None
            for word in (f"--{name}", str(value))
        ]
        given += ["--fifo"] if fifo else []
        self._process = subprocess.Popen(  # noqa: S603  # this interpreter, with our own options
            [sys.executable, "-c", _COMMAND, "drives", *given, "--seed", str(seed), "--json"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.summary: dict[str, Any] | None = None  # once closed: what happened on the bus
        try:
            started = self._read_line()
        except BaseException:
            self.kill()
            raise
        if not started:
            _, said = self._process.communicate()
            raise BackendError(f"the simulated drives did not start: {said.strip()}")

    @property
    def pid(self) -> int:
        """The process."""
        return self._process.pid

    def close(self) -> None:
        """Switch the drives off: the process ends."""
        if self._process.returncode is not None:
            return
        self._process.terminate()
        try:
            said, _ = self._process.communicate(timeout=ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
            return
        if lines := said.splitlines():
            self.summary = json.loads(lines[-1])

    def kill(self) -> None:
        """End the process as a cut cable would: at once, without a word."""
        self._process.kill()
        self._process.communicate()

    def _read_line(self) -> str:
        stream = self._process.stdout
        return "" if stream is None else stream.readline()
