"""A cluster of Ray, each task where there is a core and memory for it."""

from __future__ import annotations

import logging
import os
import socket
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, Final, Generic

from limo_driver.app.library.executors.job import OutcomeT, TaskT
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.app.library.executors.job import Job

_OWN: Final = version("limo")
_AHEAD: Final = 2  # tasks for each core of the cluster, so that none waits for the next
_ANSWER: Final = 60.0  # [s] that a cluster, or a node that is asked for its limo, has to answer


class RayCluster(Generic[TaskT, OutcomeT]):
    """A cluster of Ray, or this machine as one where there is none.

    `RAY_ADDRESS` names it; without that, one that was started on this machine is taken. It may grow
    and shrink meanwhile.

    Args:
        job: What all tasks share.
        workers: How many run side by side at most; as many as there are cores, if none.

    Raises:
        ConfigError: Ray is not installed, no cluster answers, or its nodes have other versions of
            limo.
    """

    def __init__(self, job: Job[TaskT, OutcomeT], workers: int | None) -> None:
        try:
            self._ray: Any = import_module("ray")
        except ImportError as error:
            raise ConfigError(f"Ray needs `pip install limo[fleet]`: {error}") from None
        self._workers = workers
        self._tasks: dict[Any, TaskT] = {}  # by Ray's reference
        self._own = not self._ray.is_initialized()
        if self._own:
            self._connect()
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

    def _connect(self) -> None:
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
