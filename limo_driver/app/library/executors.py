"""Many tasks in processes or on a cluster of Ray, tried again where a machine fails."""

from __future__ import annotations

import logging
import os
import socket
from collections import Counter, deque
from contextlib import closing, suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeAlias, TypeVar

from limo_driver.errors import ConfigError, LimoError
from limo_driver.runtime.plugins import require_package
from limo_driver.runtime.processes import WorkerProcess, end_with_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from multiprocessing.connection import Connection

TaskT = TypeVar("TaskT")
OutcomeT = TypeVar("OutcomeT")
TaskT_contra = TypeVar("TaskT_contra", contravariant=True)
OutcomeT_co = TypeVar("OutcomeT_co", covariant=True)
_MEMINFO: Final = Path("/proc/meminfo")
_LIMIT: Final = Path("/sys/fs/cgroup/memory.max")  # of a container
_TAKEN: Final = Path("/sys/fs/cgroup/memory.current")
_OWN: Final = version("limo")
_AHEAD: Final = 2  # tasks for each core of the cluster, so that none waits for the next
_ANSWER: Final = 60.0  # [s] that a cluster, or a node that is asked for its limo, has to answer
_TRIES: Final = 2  # of a task that a machine fails


class Job(Protocol[TaskT_contra, OutcomeT_co]):
    """What many tasks share, sent once to each process that does them."""

    def do(self, task: TaskT_contra, /) -> OutcomeT_co | str:
        """Do one task on one thread.

        Returns:
            How it ended; or, if it was the machine or limo itself that failed, why. Then another
            try may end otherwise.
        """
        ...

    def memory_of(self, task: TaskT_contra, /) -> float:
        """Return how much memory a task takes at most [bytes]."""
        ...


def attempted(work: Callable[[], OutcomeT], refused: Callable[[str], OutcomeT]) -> OutcomeT | str:
    """Do a task on one thread, and tell what was given wrongly from what the machine failed.

    Args:
        work: Does it.
        refused: Makes an outcome of the line that says why what was given cannot be used.

    Returns:
        The outcome, or the line that says what the machine failed in.
    """
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(1):
            return work()
    except MemoryError:
        return "the machine had too little memory for it: give fewer `workers`"
    except LimoError as error:
        line = " ".join(str(error).split())
        return line if _is_of_the_machine(error) else refused(line)
    except Exception as error:  # noqa: BLE001  # one task does not end the others
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _is_of_the_machine(error: BaseException | None) -> bool:
    """Say whether an error came from one of the operating system, or from a want of memory.

    Arrow tells damaged files as errors of the operating system, too, but those have no number.
    """
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno):
            return True
        error = error.__cause__ or error.__context__
    return False


class ProcessPool(Generic[TaskT, OutcomeT]):
    """Processes that do tasks one after the other, each its own.

    Args:
        job: What all tasks share.
        workers: How many run side by side at most.
        progress: Told what a task tells on its way; then `do` of the job is given who to tell.
    """

    def __init__(
        self,
        job: Job[TaskT, OutcomeT],
        workers: int,
        progress: Callable[[TaskT, Any], None] | None = None,
    ) -> None:
        self._job, self._workers, self._progress = job, workers, progress
        self._memory = _available()  # [bytes]
        self._idle: list[WorkerProcess[TaskT]] = []
        self._busy: dict[Connection[Any, Any], WorkerProcess[TaskT]] = {}

    def has_room(self, task: TaskT) -> bool:
        """Say whether a process is free, and memory for what runs and this task."""
        taken = sum(self._job.memory_of(worker.task) for worker in self._busy.values())
        return not self._busy or (
            len(self._busy) < self._workers and taken + self._job.memory_of(task) <= self._memory
        )

    def submit(self, task: TaskT) -> None:
        """Have a process do a task."""
        worker = (
            self._idle.pop()
            if self._idle
            else WorkerProcess(_work, (self._job, self._progress is not None))
        )
        worker.start(task)
        self._busy[worker.connection] = worker

    def ended(self) -> list[tuple[TaskT, OutcomeT | str]]:
        """Wait for processes to end a task, or to die."""
        ended = list[tuple[TaskT, OutcomeT | str]]()
        while not ended:
            for ready in connection.wait(list(self._busy)):
                ended += self._received(self._busy[ready])  # type: ignore[index]
        return ended

    def close(self) -> None:
        """Kill the processes."""
        for worker in (*self._idle, *self._busy.values()):
            worker.stop()

    def _received(self, worker: WorkerProcess[TaskT]) -> list[tuple[TaskT, OutcomeT | str]]:
        """Return the task that has ended, if one has."""
        try:
            has_ended, message = worker.connection.recv()
        except (EOFError, OSError):
            del self._busy[worker.connection]
            return [(worker.task, f"its process ended with status {worker.stop()}")]
        if not has_ended:
            if self._progress is not None:
                self._progress(worker.task, message)
            return []
        self._idle.append(self._busy.pop(worker.connection))
        return [(worker.task, message)]


def _work(main: Connection[Any, Any]) -> None:
    """Do what comes through the pipe until its other end is closed."""
    end_with_parent()

    def tell(progress: object) -> None:
        main.send((False, progress))

    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        job, tells = main.recv()
        while True:
            task = main.recv()
            main.send((True, job.do(task, tell) if tells else job.do(task)))


def _available() -> float:
    """Return the memory that this machine or container has left [bytes]; infinite if unknown."""
    found = float("inf")
    with suppress(OSError, ValueError):
        lines = dict(line.split(":") for line in _MEMINFO.read_text().splitlines())
        found = 1024.0 * int(lines["MemAvailable"].split()[0])
    with suppress(OSError, ValueError):  # "max", where there is no limit
        found = min(found, float(_LIMIT.read_text()) - float(_TAKEN.read_text()))
    return found


class RayCluster(Generic[TaskT, OutcomeT]):
    """A cluster of Ray, or this machine as one where there is none.

    `RAY_ADDRESS` names it; without that, one that was started on this machine is taken. It may grow
    and shrink meanwhile.

    Args:
        job: What all tasks share.
        workers: How many run side by side at most; as many as there are cores, if none.

    Raises:
        MissingPackageError: Ray is not installed.
        ConfigError: No cluster answers, or its nodes have other versions of limo.
    """

    def __init__(self, job: Job[TaskT, OutcomeT], workers: int | None) -> None:
        require_package("ray", "a cluster of Ray")
        self._ray: Any = import_module("ray")
        self._workers = workers
        self._tasks: dict[Any, TaskT] = {}  # by Ray's reference
        self._own = not self._ray.is_initialized()
        if self._own:
            quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
            address = os.environ.get("RAY_ADDRESS", "auto")
            _require_answer(address)
            try:
                self._ray.init(address=address, **quiet)
            except (ConnectionError, RuntimeError, ValueError) as error:
                if address != "auto" or not isinstance(error, ConnectionError):
                    raise ConfigError(
                        f"the cluster at {address} cannot be used: {_line(error)}"
                    ) from None
                os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # else Ray reports its use
                self._ray.init(address="local", include_dashboard=False, **quiet)
        try:
            self._require_one_version()
        except BaseException:
            self.close()
            raise
        self._memory_of = job.memory_of
        self._job = self._ray.put(job)
        self._remote = self._ray.remote(num_cpus=1, max_retries=0)(_done)

    def has_room(self, task: TaskT) -> bool:  # noqa: ARG002  # Ray places each where it fits
        """Say whether the cluster has less than it can begin soon."""
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        return len(self._tasks) < (self._workers or max(1, _AHEAD * cores))

    def submit(self, task: TaskT) -> None:
        """Have a node with enough memory left do a task."""
        nodes = [node["Resources"].get("memory", 0.0) for node in self._alive()]
        needed = min(self._memory_of(task), max(nodes, default=0.0))  # else it would wait for ever
        sent = self._remote.options(memory=int(needed)).remote(self._job, task, _OWN, os.getcwd())
        self._tasks[sent] = task

    def ended(self) -> list[tuple[TaskT, OutcomeT | str]]:
        """Wait for tasks to end; one that was lost with its node has ended, too.

        Raises:
            ConfigError: A node that joined meanwhile has another version of limo.
        """
        ready, _ = self._ray.wait(list(self._tasks), num_returns=1)
        return [(self._tasks.pop(item), self._received(item)) for item in ready]

    def close(self) -> None:
        """End the tasks that still run, and leave the cluster, if it was not the caller's."""
        for sent in self._tasks:
            self._ray.cancel(sent, force=True)
        if self._own:
            self._ray.shutdown()

    def _alive(self) -> list[dict[str, Any]]:
        return [node for node in self._ray.nodes() if node["Alive"]]

    def _require_one_version(self) -> None:
        on_node = self._ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy

        def limo() -> str:  # sent as code: a node may be without limo
            try:
                return version("limo")
            except PackageNotFoundError:
                return "none"

        ask = self._ray.remote(num_cpus=0)(limo)
        asked = {
            node["NodeManagerHostname"] + " " + node["NodeID"][:6]: ask.options(
                scheduling_strategy=on_node(node["NodeID"], soft=False)
            ).remote()
            for node in self._alive()
        }
        found = {name: self._version(answer) for name, answer in asked.items()}
        other = [f"{name} has {has}" for name, has in found.items() if has != _OWN]
        if other:
            raise ConfigError(
                f"nodes have other versions of limo than {_OWN} here: {', '.join(other)}"
            )

    def _version(self, answer: Any) -> str:  # noqa: ANN401  # Ray's reference
        try:
            return self._ray.get(answer, timeout=_ANSWER)
        except self._ray.exceptions.RayError as error:
            return f"no answer ({_line(error)})"

    def _received(self, sent: Any) -> OutcomeT | str:  # noqa: ANN401  # Ray's reference
        try:
            other, outcome = self._ray.get(sent)
        except self._ray.exceptions.RayError as error:  # its process or node died
            return _line(error)
        if other:
            raise ConfigError(f"{other}, expected {_OWN} as here")
        return outcome


def _done(job: Job[Any, Any], task: object, limo: str, folder: str) -> tuple[str, object]:
    """Do a task on a node, unless that has another version of limo, which is said instead.

    Args:
        job: What all share.
        task: To be done.
        limo: Version that is wanted.
        folder: That relative paths start from.
    """
    node = f"node {socket.gethostname()}"
    if limo != _OWN:
        return f"{node} has limo {_OWN}", ""
    with suppress(OSError):  # a node may lack it, where the inputs are objects of a store
        os.chdir(folder)
    outcome = job.do(task)
    return "", f"{node}: {outcome}" if isinstance(outcome, str) else outcome


def _require_answer(address: str) -> None:
    """Check that somebody listens at an address with a port: Ray itself waits for many minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not port.isdecimal():
        return
    try:
        socket.create_connection((host, int(port)), _ANSWER).close()
    except OSError as error:
        why = error.strerror or error
        raise ConfigError(f"RAY_ADDRESS={address}: no cluster answers there: {why}") from None


def _line(error: BaseException) -> str:
    """Return the first line of what Ray says, and of what kind that is."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0] if lines else 'without a word'}"


# Where tasks run: it takes them while it has room, and gives each back as it ends.
Executor: TypeAlias = ProcessPool[TaskT, OutcomeT] | RayCluster[TaskT, OutcomeT]


def check_place(workers: int | None, on: str) -> None:
    """Check what says where tasks run.

    Args:
        workers: How many run side by side at most; one for each core, if none.
        on: "processes" or "ray".

    Raises:
        ConfigError: There are no workers, or there is no such place.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"workers is {workers}, expected at least 1")
    if on not in {"processes", "ray"}:
        raise ConfigError(f"on is {on}, expected processes or ray")


def executor_of(
    job: Job[TaskT, OutcomeT],
    workers: int | None,
    on: str,
    progress: Callable[[TaskT, Any], None] | None = None,
) -> Executor[Any, Any]:
    """Return where the tasks of a job run, see both; what says so is checked before.

    Raises:
        ConfigError: The cluster cannot be used.
    """
    if on == "ray":
        return RayCluster(job, workers)
    return ProcessPool(job, workers or len(os.sched_getaffinity(0)), progress)


def run_all(
    executor: Executor[TaskT, OutcomeT], tasks: Iterable[TaskT]
) -> Iterator[tuple[TaskT, OutcomeT | str]]:
    """Do tasks side by side, and give each as it ends.

    A worker that dies, for want of memory for example, or the node that it is on, costs nothing
    but its present task, which is tried once more. When the caller stops listening, all ends.

    Args:
        executor: Where they run; closed in the end.
        tasks: In this order.

    Returns:
        Each task with how it ended, or why it did not, twice: then another call has to try again.
    """
    waiting = deque(tasks)
    tries: Counter[int] = Counter()  # by task, which stays where it is
    running = 0
    with closing(executor):
        while waiting or running:
            while waiting and executor.has_room(waiting[0]):
                executor.submit(waiting.popleft())
                running += 1
            for task, outcome in executor.ended():
                running -= 1
                tries[id(task)] += 1
                if isinstance(outcome, str) and tries[id(task)] < _TRIES:
                    waiting.append(task)
                else:
                    yield task, outcome
