"""Readers in libraries that nobody can interrupt: each reads in a process of its own, with limits.

Whatever a file does there, compute for ever, fill the memory or end the process, becomes one line.
The process is told the function by its name, and answers with what it returned, pickled.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

from limo_driver.errors import LimoError
from limo_driver.runtime.given_files.budget import ReadingBudget
from limo_driver.runtime.given_files.door import check_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.errors import PlacedError, RecordingError

_T = TypeVar("_T")
_PATIENCE: Final = 60.0  # [s] beyond any budget, for what waits instead of computing
_MIB: Final = 1 << 20
_MEMORY: Final = Path("/proc/self/statm")  # in pages
_DATA: Final = 5  # which of its numbers is that of data
_ROOM: Final = 1 << 26  # bytes for what is imported on the way
_NO_MEMORY: Final = 3  # status of a process that got none
_COMMAND: Final = f"import sys; from {__name__} import main; main(*sys.argv[1:])"
_OUT_OF_TIME: Final = {signal.SIGXCPU, signal.SIGKILL}


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
    refused, answer, status = _asked(*map(str, given), patience=_PATIENCE + 10 * seconds)
    if status == 0 and not refused:
        return answer
    raise error(refused or _told(status, size, seconds, memory), path=path)


def _asked(*given: str, patience: float) -> tuple[str, Any, int]:
    """Run the process; return why it refused the file, what it read, and its exit status."""
    with subprocess.Popen(  # noqa: S603  # our own module
        [sys.executable, "-P", "-c", _COMMAND, *given],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # where libraries say what the answer says, in many lines
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
    ) as process:
        assert process.stdout is not None  # noqa: S101  # it is a pipe
        timer = Timer(patience, process.kill)
        timer.start()
        try:
            refused, answer = pickle.load(process.stdout)  # noqa: S301  # of limo's own process
        except (EOFError, pickle.UnpicklingError):
            refused, answer = "", None
        finally:
            timer.cancel()
        return refused, answer, process.wait()


def _told(status: int, size: int, seconds: float, memory: int) -> str:
    """Say why a process ended without an answer."""
    of = f"of a file of {size} bytes"
    if status == _NO_MEMORY:
        most = f"{memory / _MIB:.0f} MiB"
        return f"takes more than {most} of memory to read, expected at most {most} {of}"
    if -status in _OUT_OF_TIME:
        most = f"{seconds:.3g} s"
        return f"takes more than {most} of CPU time to read, expected at most {most} {of}"
    how = f"with {signal.Signals(-status).name}" if status < 0 else f"with status {status}"
    return f"is damaged: what reads it ended {how}"


def _limit(seconds: float, memory: int) -> None:
    """Limit what this process may take beyond what it has: interpreter and libraries."""
    spent = resource.getrusage(resource.RUSAGE_SELF)
    most = int(spent.ru_utime + spent.ru_stime + seconds) + 1
    own = int(_MEMORY.read_text().split()[_DATA]) * resource.getpagesize() + _ROOM
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
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
        said = " ".join(str(getattr(failure, "message", failure)).split())
        known = isinstance(failure, LimoError)
        answer = said if known else f"is damaged: {type(failure).__name__}: {said}", None
    try:
        with answers:
            pickle.dump(answer, answers, protocol=5)
    except MemoryError:
        os._exit(_NO_MEMORY)
    os._exit(0)  # without the ends of libraries
