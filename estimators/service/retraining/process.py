"""The process that trains a challenger, as the service sees it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from estimators.service.retraining.logged_motion import Span
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.store import ModelStore

_COMMAND: Final = (sys.executable, "-P", "-m", "estimators.service.retraining.trainer")
_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
_GLANCE: Final = 0.01  # [s] that a look at the process takes
_LATE: Final = 10.0  # [s] beyond its limit, after which a process that did not end itself is killed


class TrainingProcess:
    """The trainer in a process of its own, started at once, at low priority and with a time limit.

    Args:
        store: To learn the champion from, and to add to.
        logs: Folder of the service's logs.
        arm: Its name in keys.
        settings: Which kind to learn, and the limit.
        span: What to learn from.
        delay: Of the service [s].
        margin: Left out around contact [s].
    """

    def __init__(
        self,
        store: ModelStore,
        logs: Path,
        arm: str,
        settings: RetrainingSettings,
        span: Span,
        delay: float,
        margin: float,
    ) -> None:
        self._limit = settings.training_limit
        self._ends = time.monotonic() + self._limit + _LATE
        arguments = [str(store.root.resolve()), f"--robot={store.robot}", f"--arm={arm}"]
        arguments += [f"--logs={logs.resolve()}", f"--seconds={span.seconds!r}"]
        arguments += [] if span.rate is None else [f"--rate={span.rate!r}"]
        arguments += [] if span.until_ns is None else [f"--until={span.until_ns}"]
        arguments += [f"--kind={settings.kind}", "--attended"]
        arguments += [f"--delay={delay!r}", f"--margin={margin!r}", f"--limit={self._limit!r}"]
        arguments += [f"--trust={key.resolve()}" for key in store.trusted_keys]
        if store.signing_key is not None:
            arguments.append(f"--sign={store.signing_key.resolve()}")
        held, self._held = os.pipe()  # closed when this process ends, however it does
        try:
            self._process = _start(arguments, held)
        except BaseException:
            os.close(self._held)
            raise
        finally:
            os.close(held)

    def result(self) -> dict[str, Any] | None:
        """Return what was trained, or None while it goes on.

        Raises:
            LimoError: It failed, and why.
        """
        try:
            out, errors = self._process.communicate(timeout=_GLANCE)
        except subprocess.TimeoutExpired:
            if time.monotonic() < self._ends:
                return None
            self.end()
            raise LimoError(f"training took longer than {self._limit:g} s") from None
        self._let_go()
        try:
            found: object = json.loads(out)
        except ValueError:
            found = None
        if isinstance(found, dict) and "error" in found:
            raise LimoError(f"training failed: {found['error']}")
        if not isinstance(found, dict) or "version" not in found or self._process.returncode:
            raise LimoError(self._why(errors))
        return found

    def end(self) -> None:
        """Kill it, if it still runs; the store is as it was."""
        self._process.kill()
        self._process.communicate()
        self._let_go()

    def _let_go(self) -> None:
        held, self._held = self._held, -1
        if held >= 0:
            os.close(held)

    def _why(self, errors: str) -> str:
        status = self._process.returncode
        if status == -signal.SIGALRM:
            return f"training took longer than {self._limit:g} s"
        told = errors.strip().splitlines()
        return f"training ended with status {status}" + (f": {told[-1]}" if told else "")


def _start(arguments: Sequence[str], held: int) -> subprocess.Popen[str]:
    return subprocess.Popen(  # noqa: S603  # our own module
        [*_COMMAND, *arguments],
        stdin=held,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | _ONE_THREAD,
        start_new_session=True,  # Ctrl-C is for the service, which then ends this one
    )
