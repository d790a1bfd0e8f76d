"""How a program closes what it opened, is told to end, shares tasks out and gives way."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading
import time
from abc import ABC, abstractmethod
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, Generic, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess
    from subprocess import Popen
    from types import FrameType

_ENDING: Final = {signal.SIGINT, signal.SIGTERM}
_STOP: Final = b"\0"  # no signal has this number
_AT_ONCE: Final = 4096  # signals read
_LONGEST: Final = 1e6  # [s] that the operating system waits at once
TaskT = TypeVar("TaskT")
_LEAST: Final = 19
_ABANDONED: Final = 3  # exit status
_LOOK: Final = 1.0  # [s] between two looks at a process
_IDLE: Final = 60  # of them in a row, at which it waits and has computed nothing
_TICK: Final = 1.0 / os.sysconf("SC_CLK_TCK")  # [s] of processor time
_STATE: Final = 0  # which word of /proc/PID/stat behind the name is the state
_TICKS: Final = slice(11, 15)  # and which are its time on the CPU, and that of ended children


@contextmanager
def ended_if_idle(process: Popen[bytes]) -> Generator[threading.Event]:
    """End a process that waits for a minute and computes nothing, however slow the machine is.

    Yields:
        What is set where it was ended so.
    """
    over, idle = threading.Event(), threading.Event()
    watch = Thread(target=_end_idle, args=(process, over, idle), daemon=True)
    watch.start()
    try:
        yield idle
    finally:
        over.set()
        watch.join()


def _end_idle(process: Popen[bytes], over: threading.Event, idle: threading.Event) -> None:
    many, before = 0, -1.0
    while many < _IDLE:
        if over.wait(_LOOK):
            return
        used = processor_time(process.pid)
        waits = used == before and _stat_of(process.pid)[_STATE] != "R"  # without a turn it can run
        many, before = many + 1 if waits else 0, used
    idle.set()
    process.kill()


def processor_time(process: int) -> float:
    """Return the processor time of a process and its children [s]; 0 where nobody counts it."""
    total, waiting = 0, [process]
    while waiting:
        own = waiting.pop()
        with suppress(OSError):  # it has ended
            total += sum(map(int, _stat_of(own)[_TICKS]))
            waiting += map(int, Path(f"/proc/{own}/task/{own}/children").read_text().split())
    return _TICK * total


def _stat_of(process: int) -> list[str]:
    """Return the words of /proc/PID/stat behind the name, which may have blanks."""
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()


class Closing(ABC):
    """Closes at the end of a `with` block."""

    @abstractmethod
    def close(self) -> None:
        """Let go of everything; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def deferred(*numbers: int) -> Generator[None]:
    """Let signals wait for the end of the block, which has to be short.

    Elsewhere than in the main thread, where none arrives, this does nothing; so it does to signals
    that are ignored, or whose handler is none of Python's.

    Args:
        numbers: Of the signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in numbers}
    taken = {number: handler for number, handler in handlers.items() if callable(handler)}
    try:
        for number in taken:
            signal.signal(number, lambda number, _: came.append(number))
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


def uninterrupted() -> AbstractContextManager[None]:
    """Let Ctrl-C wait for the end of a block.

    Between the start of a thread and the `with` that ends it, an interrupt would leave a thread
    that nobody ends, and the process would wait for it for ever.
    """
    return deferred(signal.SIGINT)


class Ending(Closing):
    """SIGINT, SIGTERM, a call of `stop`, or the end of a time, whichever comes first."""

    def __init__(self) -> None:
        # A signal writes into the one end itself. A lock would not hear a signal that comes just
        # before it is waited for.
        self._heard, self._ended = socket.socketpair()
        self._ended.setblocking(False)

    def wait(self, duration: float | None = None) -> None:
        """Wait for the end.

        Elsewhere than in the main thread, signals stay as they are. In it, both do nothing more
        from now on, whoever needs them has to give them back.

        Args:
            duration: Longest wait [s]; without end if not given.
        """
        ends = None if duration is None else time.monotonic() + duration
        with self._signalled():
            while not self._asked_to_end(ends):
                pass

    def stop(self) -> None:
        """End `wait`, from any thread."""
        with suppress(OSError):  # closed, or so much was written that it will be heard
            self._ended.send(_STOP)

    def close(self) -> None:
        """Close both ends."""
        self._heard.close()
        self._ended.close()

    @contextmanager
    def _signalled(self) -> Generator[None]:
        """Let SIGINT and SIGTERM do nothing but end `wait`, where they can be listened to."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.set_wakeup_fd(self._ended.fileno(), warn_on_full_buffer=False)
        for number in _ENDING:
            signal.signal(number, _do_nothing)
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)

    def _asked_to_end(self, ends: float | None) -> bool:
        """Wait for the next signal or `stop`, and say whether to go on no longer."""
        left = None if ends is None else min(max(ends - time.monotonic(), 0.0), _LONGEST)
        if select.select([self._heard], [], [], left)[0]:
            heard = self._heard.recv(_AT_ONCE)
            return _STOP in heard or not _ENDING.isdisjoint(heard)
        return ends is not None and time.monotonic() >= ends


def _do_nothing(_signal: int, _frame: FrameType | None) -> None:
    """Take a signal, which has written its number into the socket."""


@contextmanager
def signals_given_back() -> Generator[None]:
    """Give SIGINT and SIGTERM back, at the end of the block, to whom they were of before."""
    handlers = {number: signal.getsignal(number) for number in _ENDING}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():  # which alone can change them
            for number, handler in handlers.items():
                if handler is not None:  # else it is none of Python's
                    signal.signal(number, handler)


class WorkerProcess(Generic[TaskT]):
    """One process and the task that it does.

    Args:
        work: Runs in the process, with its end of the pipe. It calls `end_with_parent` first,
            takes the job and then tasks until the pipe is closed, and answers each as it likes.
        job: What all tasks share. It comes through the pipe, which breaks where the process dies:
            arguments of a process that dies as it starts are waited for without end.
    """

    task: TaskT

    def __init__(self, work: Callable[[Connection[Any, Any]], None], job: object) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()  # so that the end of the process is the end of the pipe
        self._send(job)

    def start(self, task: TaskT) -> None:
        """Send the next task."""
        self.task = task
        self._send(task)

    def _send(self, value: object) -> None:
        with suppress(BrokenPipeError):  # it has died, which the next receipt tells
            self.connection.send(value)

    def stop(self) -> int | None:
        """End the process, whatever it does, and return its exit status."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        return self.process.exitcode


def end_with_parent() -> None:
    """Have this worker process end when its parent is gone, even in the midst of its work.

    Ctrl-C is left to the parent, which ends its workers, and so is real time.
    """
    leave_real_time()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def command_of(module: str) -> tuple[str, ...]:
    """Return what runs `main` of a module in a process, from the start scheduled as any other."""
    begin = f"from {__name__} import leave_real_time; leave_real_time()"
    return sys.executable, "-P", "-c", f"{begin}; from {module} import main; main()"


def leave_real_time() -> None:
    """Be scheduled as any other process from now on, though the thread that began it was not.

    A thread that resets what it forks would reset the threads that it starts as well.
    """
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def give_way(nice: int) -> None:
    """Take the CPU only when others leave it, from now on.

    Args:
        nice: 19 gives way the most.
    """
    os.nice(nice)
    if os.getsid(0) == os.getpid():  # in a group of its own, whose weight is what counts then
        with suppress(OSError):  # a kernel without such groups
            Path("/proc/self/autogroup").write_text(str(nice))


def end_when_abandoned() -> None:
    """End this process when whoever holds the other end of its standard input is gone.

    However that one ended: nobody would hear the result, and another may have begun the same.
    """

    def wait() -> None:
        with suppress(OSError):
            while os.read(0, 1):
                pass
        os._exit(_ABANDONED)

    threading.Thread(target=wait, name="limo-abandoned", daemon=True).start()


def thread_aside(name: str) -> ThreadPoolExecutor:
    """Return a thread that takes the CPU only when others leave it, where the system can say so.

    What runs there must hold no lock that the stream waits for.
    """
    return ThreadPoolExecutor(1, name, initializer=_give_way_thread)


def _give_way_thread() -> None:
    with suppress(OSError):  # threads have priorities of their own on Linux only
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _LEAST)
