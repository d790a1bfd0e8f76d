"""The door for files that a user gives, or a stranger: what is none, or costs much, is refused.

Each reader has the same budget of bytes, rows and seconds (`ReadingBudget`), and refuses in one
line that says what was given and what is allowed. What reads in Python counts what it has spent
(`Spent`); what reads in a library that nobody can interrupt does so in a process of its own
(`apart`): whatever a file does there, compute for ever, fill the memory or end the process, becomes
one line. The process is told the function by its name, and answers with what it returned, pickled.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import resource
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from time import thread_time
from typing import Any, Final, NoReturn, TypeVar

from limo_driver.errors import LimoError, PlacedError, RecordingError

__all__ = [
    "ReadingBudget",
    "Spent",
    "apart",
    "check_file",
    "json_of",
    "read_bytes",
    "read_json_file",
    "read_text",
    "text_of",
]
_MIB: Final = 1 << 20
LARGEST: Final = 1 << 26  # bytes of what is read at once, if nothing else is said
_VALUES: Final = 1 << 24  # of JSON: Python makes about 100 bytes of each
_SURROGATE: Final = re.compile(r"\\u[dD][89a-fA-F]")  # half of a character, of which two make one
_T = TypeVar("_T")
_MEMORY: Final = Path("/proc/self/statm")  # in pages
_DATA: Final = 5  # which of its numbers is that of data
_ROOM: Final = 1 << 26  # bytes for what is imported on the way
_NO_MEMORY: Final = 3  # status of a process that got none
_COMMAND: Final = f"import sys; from {__name__} import main; main(*sys.argv[1:])"


@dataclass(frozen=True)
class ReadingBudget:
    """What reading a file may take.

    Time is that of the CPU, which no busy machine makes longer. Ordinary logs take a tenth of it,
    and are packed ten times at most; what is one value alone is packed a thousand times.
    """

    memory: int = 1 << 28  # bytes that any file may unpack to
    ratio: int = 100  # times its size that a larger one may
    rows: int = 10_000_000  # of any file
    rows_per_byte: int = 100  # more; a time that goes on evenly can be told in few bits
    seconds: float = 4.0  # of any file [s]
    seconds_per_byte: float = 2e-6  # more [s]

    def memory_for(self, size: int) -> int:
        """Return what a file of a size may unpack to [bytes]."""
        return max(self.memory, self.ratio * size)

    def rows_for(self, size: int) -> int:
        """Return how many rows a file of a size may have."""
        return self.rows + self.rows_per_byte * size

    def seconds_for(self, size: int) -> float:
        """Return how long a file of a size may be read [s]."""
        return self.seconds + self.seconds_per_byte * size


class Spent:
    """What reading a file has taken so far, and the refusal of what goes beyond its budget.

    Its clock runs from the beginning, and stands while what was read is used (`metered`).

    Args:
        path: The file.
        error: Raised for it.
        budget: That it has.
    """

    def __init__(
        self,
        path: Path,
        error: type[PlacedError | RecordingError],
        budget: ReadingBudget | None = None,
    ) -> None:
        self.path, self._error, self.budget = path, error, budget or ReadingBudget()
        self._size = path.stat().st_size
        self._rows = self._unpacked = 0
        self._before, self._began = 0.0, thread_time()

    def take(self, *, rows: int = 0, unpacked: int = 0) -> None:
        """Count rows and bytes, and refuse what is too much.

        Raises:
            error: More rows or bytes than its budget has.
        """
        self._rows += rows
        self._unpacked += unpacked
        if self._rows > (most := self.budget.rows_for(self._size)):
            self._refuse(f"has {self._rows} rows or more", f"{most}")
        if self._unpacked > (most := self.budget.memory_for(self._size)):
            given = f"unpacks to {self._unpacked / _MIB:.0f} MiB or more"
            self._refuse(given, f"{most / _MIB:.0f} MiB")

    def check_time(self) -> None:
        """Refuse what takes too long.

        Raises:
            error: It does.
        """
        if self.is_over:
            most = f"{self.budget.seconds_for(self._size):.3g} s"
            self._refuse(f"takes more than {most} of CPU time to read", most)

    @property
    def is_over(self) -> bool:
        """Whether it has taken too long."""
        return self.seconds > self.budget.seconds_for(self._size)

    @property
    def seconds(self) -> float:
        """CPU time that reading has taken [s]."""
        return self._before + thread_time() - self._began

    def metered(self, pieces: Iterator[_T], rows: int = 1) -> Iterator[_T]:
        """Yield pieces and count their rows, and the time that they take, not that of their use.

        Args:
            pieces: What is read, one after the other.
            rows: Of each.

        Raises:
            error: More rows or seconds than its budget has.
        """
        for piece in pieces:
            self.take(rows=rows)
            self.check_time()
            self._before = self.seconds
            yield piece
            self._began = thread_time()

    def _refuse(self, given: str, most: str) -> NoReturn:
        raise self._error(
            f"{given}, expected at most {most} of a file of {self._size} bytes", path=self.path
        )


def read_bytes(path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST) -> bytes:
    """Return the content of a file.

    What is opened is what is judged: nothing can take its place in between.

    Args:
        path: The file.
        error: Raised for every reason not to read it.
        most: Bytes that such a file has.

    Raises:
        error: It cannot be read, is no file, or larger.
    """
    try:
        with open(path, "rb", opener=_at_once) as file:
            check_kind(os.fstat(file.fileno()), path, error, most)
            return file.read(most + 1)
    except OSError as failure:
        raise error(f"cannot be read: {failure.strerror}", path=path) from None


def read_text(path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST) -> str:
    """Return the text of a file in UTF-8, with or without a mark at its beginning.

    Raises:
        error: It cannot be read, is no text, or larger than `most` [bytes].
    """
    return text_of(read_bytes(path, error, most), path, error)


def text_of(data: bytes, path: Path, error: type[PlacedError | RecordingError]) -> str:
    """Return bytes of a file as text.

    Raises:
        error: They are none of UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error("is no text of UTF-8", path=path) from None


def read_json_file(
    path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST
) -> Any:  # noqa: ANN401  # any JSON
    """Return what a JSON file holds.

    Raises:
        error: It cannot be read, is no JSON, or too large or too deep.
    """
    return json_of(read_text(path, error, most), path, error)


def json_of(
    text: str,
    path: Path,
    error: type[PlacedError | RecordingError],
    parse: Callable[[str], Any] = json.loads,
) -> Any:  # noqa: ANN401  # any JSON
    """Return what a text of JSON says.

    Args:
        text: The text.
        path: The file that it is from.
        error: Raised for every reason not to take it.
        parse: What makes values of it.

    Raises:
        error: It is no JSON, or has more values, levels or digits than data have.
    """
    if (values := sum(map(text.count, ",[{"))) > _VALUES:
        raise error(f"has {values} values of JSON, expected at most {_VALUES}", path=path)
    try:
        found = parse(text)
        if _SURROGATE.search(text):
            json.dumps(found, ensure_ascii=False).encode()
        return found
    except UnicodeEncodeError:
        raise error("is no JSON: a text has half of a character", path=path) from None
    except json.JSONDecodeError as failure:
        raise error(
            f"is no JSON at line {failure.lineno}: {failure.msg}; was it cut off?", path=path
        ) from None
    except RecursionError:
        raise error("is no JSON: it is nested far deeper than a log", path=path) from None
    except ValueError:
        raise error("is no JSON: a number has thousands of digits", path=path) from None


def _at_once(path: str, flags: int) -> int:
    """Open without waiting, as a pipe to which nobody writes would have to."""
    return os.open(path, flags | os.O_NONBLOCK)


def check_file(
    path: Path, error: type[PlacedError | RecordingError], most: int | None = None
) -> None:
    """Refuse what would be read for ever, or waited for: a device or a pipe, also behind a link.

    What is not there, or may not be read, is left to whoever opens it.

    Args:
        path: Of the file, or a folder.
        error: Raised for it.
        most: Size of the largest such file [bytes].

    Raises:
        error: A device, a pipe, or too large.
    """
    try:
        check_kind(path.stat(), path, error, most)
    except OSError:
        return


def check_kind(
    about: os.stat_result,
    path: Path,
    error: type[PlacedError | RecordingError],
    most: int | None = None,
) -> None:
    """Refuse by what the system says of a file, as `check_file` does.

    Raises:
        error: A device, a pipe, or too large.
    """
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        raise error("is a device or a pipe, expected a file", path=path)
    if most is not None and about.st_size > most:
        raise error(
            f"has {about.st_size} bytes, expected at most {most}: is another file meant?", path=path
        )


def apart(
    reader: Callable[[Path], _T],
    path: Path,
    error: type[PlacedError | RecordingError],
    budget: ReadingBudget | None = None,
) -> _T:
    """Return what a reader makes of a file, in a process of its own.

    Args:
        reader: Function of a module, whose result can be pickled.
        path: The file.
        error: Raised for every reason not to read it.
        budget: That it has.

    Raises:
        error: The reader refuses it, fails in any other way, or takes too much.
    """
    check_file(path, error)
    budget = budget or ReadingBudget()
    size = path.stat().st_size
    seconds, memory = budget.seconds_for(size), budget.memory_for(size)
    given = (reader.__module__, reader.__qualname__, os.fspath(path), seconds, memory)
    refused, answer, status = _asked(*map(str, given))
    if status == 0 and not refused:
        return answer
    raise error(refused or _told(status, size, seconds, memory), path=path)


def _asked(*given: str) -> tuple[str, Any, int]:
    """Run the process; return why it refused the file, what it read, and its exit status.

    It limits its own time on the CPU. However slow the machine is, it has that time; it is ended
    here only where it waits and nothing happens.
    """
    from limo_driver.runtime.processes import ended_if_idle  # slow to import

    with subprocess.Popen(  # noqa: S603  # our own module
        [sys.executable, "-P", "-c", _COMMAND, *given],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # where libraries say what the answer says, in many lines
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
    ) as process:
        assert process.stdout is not None  # noqa: S101  # it is a pipe
        with ended_if_idle(process) as idle:
            try:
                refused, answer = pickle.load(process.stdout)  # noqa: S301  # of limo's own process
            except (EOFError, pickle.UnpicklingError):
                refused, answer = "", None
        if idle.is_set():
            refused = "is damaged, or its disk gives no answer: what reads it waited a minute"
        return refused, answer, process.wait()


def _told(status: int, size: int, seconds: float, memory: int) -> str:
    """Say why a process ended without an answer."""
    if status == _NO_MEMORY:
        most, what = f"{memory / _MIB:.0f} MiB", "memory"
    elif -status == signal.SIGPROF:
        most, what = f"{seconds:.3g} s", "CPU time"
    else:
        how = f"with {signal.Signals(-status).name}" if status < 0 else f"with status {status}"
        return f"is damaged: what reads it ended {how}"
    over = f"takes more than {most} of {what} to read"
    return f"{over}, expected at most {most} of a file of {size} bytes"


def _limit(seconds: float, memory: int) -> None:
    """Limit what this process may take beyond what it has: interpreter and libraries."""
    own = int(_MEMORY.read_text().split()[_DATA]) * resource.getpagesize() + _ROOM
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, seconds)  # of the CPU; RLIMIT_CPU knows whole ones alone
    resource.setrlimit(resource.RLIMIT_DATA, (own + memory, own + memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(module: str, name: str, path: str, seconds: str, memory: str) -> NoReturn:
    """Read a file and answer, as the process that `apart` starts."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints does not get between
    reader = getattr(import_module(module), name)
    _limit(float(seconds), int(memory))
    try:
        answer = "", reader(Path(path))
    except MemoryError:
        os._exit(_NO_MEMORY)
    except Exception as failure:  # noqa: BLE001  # whatever a library raises for damaged bytes
        text = " ".join(str(getattr(failure, "message", failure)).split())
        known = isinstance(failure, LimoError)
        answer = text if known else f"is damaged: {type(failure).__name__}: {text}", None
    try:
        with answers:
            pickle.dump(answer, answers, protocol=5)
    except MemoryError:
        os._exit(_NO_MEMORY)
    os._exit(0)  # without the ends of libraries
