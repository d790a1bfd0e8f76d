"""McapLog: log network messages, off the hot path, for as long as the machine runs.

`write` only appends to a queue; a thread writes. Messages come one by one, a few at a time, since a
thread that computes for milliseconds holds up the others of its process. A chunk is finished and
synced every quarter of a second, so a killed process loses no more than that and what one sync
takes.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import inf
from pathlib import Path

from limo_driver.errors import ConfigError
from limo_driver.logs.mcap_file import LoggedMessage, McapWriter, read_mcap
from limo_driver.network.messages.cdr import SCHEMAS
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.runtime.processes import Closing

__all__ = ["LogLimits", "LoggedMessage", "McapLog", "read_mcap"]

SYNC_PERIOD = 0.25  # [s]
_DRAIN_PERIOD = 0.01  # [s]
_TIME_LIMIT = 2**64  # [ns]
_STAMP = "%Y%m%dT%H%M%S.%fZ"
_SUFFIX = ".mcap"


def _limit(unit: str, description: str, default: float):  # noqa: ANN202  # a dataclass field
    return parameter(unit, description, lower=0.0, above=True, finite=False, default=default)


@dataclass(frozen=True)
class LogLimits(Declared):
    """Limits on the size and age of log files, one alone and all together.

    Args:
        file_bytes: Beyond which a new file is begun.
        file_seconds: Likewise [s].
        total_bytes: Beyond which the oldest finished files are deleted.
        total_seconds: Files last written longer ago than this are deleted [s].
        queue: Messages that wait for the disk; more are dropped.

    Raises:
        ParameterError: Names the limit, what was given and what is possible.

    Example:
        >>> week = limo.LogLimits(total_bytes=20e9, total_seconds=7 * 86400.0)
        >>> with limo.serve("iiwa14", model="model/", log="logs/", log_limits=week) as service:
        ...     service.wait(60.0)
    """

    file_bytes: float = _limit("", "a new file is begun beyond this", 256e6)
    file_seconds: float = _limit("s", "a new file is begun beyond this", 600.0)
    total_bytes: float = _limit("", "the oldest finished files are deleted beyond this", inf)
    total_seconds: float = _limit("s", "so are files last written longer ago than this", inf)
    queue: int = parameter("", lower=1, default=20_000)


class McapLog(Closing):
    """Files `NAME_20260131T235959.123456Z.mcap` in a folder; names sort by time.

    Where the disk is full or fails, or anything else goes wrong, logging stops: `on_failure` is
    called once, everything is counted in `dropped`, and `resume` begins a new file. Nothing of this
    reaches whoever writes.

    Args:
        folder: Made if it is not there.
        name: What the files' names begin with; retention touches no others.
        limits: Of size and age.
        on_failure: Told why logging stopped, from the thread that writes; must not raise.

    Raises:
        ConfigError: No file can be made in the folder.
    """

    def __init__(
        self,
        folder: Path | str,
        name: str = "limo",
        limits: LogLimits | None = None,
        on_failure: Callable[[Exception], None] | None = None,
    ) -> None:
        self.folder, self.name = Path(folder), name
        self.limits = limits or LogLimits()
        self.failure: Exception | None = None  # why logging stopped, while it is stopped
        self.written = 0  # messages that are on the disk
        self._refused = 0  # messages that found the queue full, or logging stopped
        self._lost = 0  # messages that could not be written
        self._on_failure = on_failure
        self._counting = threading.Lock()
        self._queue: deque[LoggedMessage] = deque()
        self._pending = 0  # messages in the chunk under way
        self._begun = datetime.min.replace(tzinfo=UTC)  # of the newest file
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._retain()
            self._file: McapWriter | None = self._new_file()
        except OSError as error:
            raise ConfigError(
                f"cannot be written to: {error.strerror or error}", path=self.folder
            ) from None
        self._synced = time.monotonic()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work_on, name="limo-log", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that are not known to be in the log."""
        return self._refused + self._lost

    def write(
        self,
        topic: str,
        schema: str,
        payload: bytes,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int = 0,
    ) -> None:
        """Hand over a message; never waits, and never fails because of the disk.

        Args:
            topic: For example `limo/iiwa14/state/joints`.
            schema: Name of its type, one of `SCHEMAS`.
            payload: The message in CDR.
            log_time_ns: Unix time [ns].
            publish_time_ns: Unix time at which the source sent it [ns].
            sequence: Number of the source; kept modulo 2**32.

        Raises:
            ConfigError: No such schema, or a time that is no Unix time.
        """
        if schema not in SCHEMAS:
            raise ConfigError(f"no schema is called {schema!r}; known: {', '.join(SCHEMAS)}")
        if not (0 <= log_time_ns < _TIME_LIMIT and 0 <= publish_time_ns < _TIME_LIMIT):
            raise ConfigError(
                f"times are {log_time_ns} and {publish_time_ns} ns, expected Unix times"
            )
        full = len(self._queue) >= self.limits.queue
        if full or self.failure is not None or self._closing.is_set():
            with self._counting:
                self._refused += 1
            return
        self._queue.append(
            LoggedMessage(topic, schema, payload, log_time_ns, publish_time_ns, sequence)
        )

    def resume(self) -> None:
        """Begin a new file after a failure, once there is room again; else nothing."""
        self.failure = None

    def close(self) -> None:
        """Write what waits and finish the file; a second call does nothing."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        if self.failure is None:
            self._attempt(self._finish)
        self._lost += len(self._queue)
        self._queue.clear()

    def _work_on(self) -> None:
        while not self._closing.wait(_DRAIN_PERIOD):
            if self.failure is None:
                self._attempt(self._work)

    def _attempt(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:  # noqa: BLE001  # whatever it is, the thread has to live on
            self._stop(error)

    def _work(self) -> None:
        self._drain()
        if time.monotonic() >= self._synced + SYNC_PERIOD:
            self._sync()
            self._rotate()

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            if self._file is None:
                self._file = self._new_file()
            self._pending += 1
            self._file.add(self._queue.popleft())

    def _sync(self) -> None:
        if self._file is not None and self._pending:
            self._file.sync()
            self.written += self._pending
            self._pending = 0
        self._synced = time.monotonic()

    def _rotate(self) -> None:
        file = self._file
        if file is None or not file.messages:
            return
        age = time.monotonic() - self._opened
        if age >= self.limits.file_seconds or file.size >= self.limits.file_bytes:
            self._file = None  # the next message begins another
            file.finish()
            self._retain()

    def _finish(self) -> None:
        self._drain()
        self._sync()
        if self._file is not None:
            file, self._file = self._file, None
            file.finish()

    def _stop(self, error: Exception) -> None:
        """Give up the file; what waits in the queue is written if logging is resumed."""
        self.failure = error
        self._lost += self._pending
        self._pending = 0
        if self._file is not None:
            self._file.abandon()
            self._file = None
        if self._on_failure is not None:
            self._on_failure(error)

    def _new_file(self) -> McapWriter:
        # two files never share a name, nor does a clock set back put the newer one first
        self._begun = max(datetime.now(UTC), self._begun + timedelta(microseconds=1))
        stamp = self._begun.strftime(_STAMP)
        self._opened = time.monotonic()
        return McapWriter(self.folder / f"{self.name}_{stamp}{_SUFFIX}")

    def _retain(self) -> None:
        """Delete the oldest files beyond the limits; none is being written now."""
        files = [(path, path.stat()) for path in log_files(self.folder, self.name)]
        total = sum(status.st_size for _, status in files)
        oldest = time.time() - self.limits.total_seconds
        for path, status in files:
            if total <= self.limits.total_bytes and status.st_mtime >= oldest:
                continue
            path.unlink(missing_ok=True)
            total -= status.st_size


def log_files(folder: Path, name: str | None = None) -> list[Path]:
    """Return the files of a log in order of time; of every log in the folder if none is named."""
    pattern = re.compile(
        rf"{'.+' if name is None else re.escape(name)}_(\d{{8}}T\d{{6}}\.\d{{6}}Z)\.mcap"
    )
    found = [
        (match[1], path) for path in folder.iterdir() if (match := pattern.fullmatch(path.name))
    ]
    return [path for _, path in sorted(found)]
