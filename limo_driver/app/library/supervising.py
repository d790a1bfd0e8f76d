"""Serve several arms, each by a process of its own, and begin one anew that dies."""

from __future__ import annotations

import json
import signal
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from typing import TYPE_CHECKING, Any, Final

from limo_driver.app.library.serving import checked_stores, serve
from limo_driver.errors import ConfigError, LimoError
from limo_driver.network.messages import Event, Level
from limo_driver.network.readiness import ServicePhase
from limo_driver.runtime.processes import Closing, Ending, signals_given_back, uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.context import ForkServerProcess
    from pathlib import Path

    from estimators.service.server import Service

_LOADED: Final = [  # once, by the process that all workers are forked from
    "estimators.hybrid",
    "estimators.joint_physics",
    "estimators.service.server",
    "estimators.service.arm_server",
    "estimators.service.opening",
    "limo_driver.logs.mcap_log",
    "limo_driver.app.library.inputs",
    "limo_driver.app.library.serving",
]
_ENDS: Final = 15.0  # [s] in which a worker has to end by itself
_PAUSES: Final = (0.0, 0.5, 1.0, 2.0)  # [s] before a worker is begun anew, by how often it died
_LASTED: Final = 30.0  # [s] after which a worker that dies has not died before
_TRIES: Final = 3  # of an arm that has never been served
_LOADING: Final = (ServicePhase.LOADING, ServicePhase.COMPILING)


@contextmanager
def serve_apart(
    arms: Mapping[str, Path | str | None] | Sequence[str] | str,
    *,
    store: Path | str | None = None,
    told: Callable[[str, Event], None] | None = None,
    show: Callable[[dict[str, Any]], None] | None = None,
    **options: Any,  # noqa: ANN401  # of `serve`, which checks them
) -> Generator[Supervisor]:
    """Serve arms as `serve` does, each from a process and a core of its own.

    A process that dies is begun anew within three seconds; `told` hears of it as an event `worker`.
    All are forked from one that has loaded what they need. In a program that is a file, the call
    has to stand behind `if __name__ == "__main__":`.

    Args:
        arms: Names, as their drivers publish them; a mapping gives each a store of its own.
        store: Of the models of every arm that has none of its own.
        told: Told the arm and the event of all that happens, from another thread.
        show: Told the status of each arm once a second, and when its phase changes.
        options: Others of `serve`. Endpoints to be reached at can be of one process only.

    Yields:
        The supervisor: `phases`, `wait` for Ctrl-C or a time, `stop`.

    Raises:
        ConfigError: The options contradict each other, or an arm could not be served from the
            beginning on; `wait` raises the latter.
    """
    checked = ("model", "simulation", "log", "retraining", "ros", "config")
    stores = checked_stores(arms, store, **{k: options[k] for k in checked if k in options})
    if listens(options.get("listen", ()), options.get("config")):
        raise ConfigError("one process alone can listen at an endpoint: use `serve` for all arms")
    with ExitStack() as open_:
        open_.enter_context(signals_given_back())
        with uninterrupted():
            given = {arm: {**options, "arms": {arm: own}} for arm, own in stores.items()}
            supervisor = Supervisor(
                given, told or (lambda _arm, _event: None), show or (lambda _status: None)
            )
            open_.enter_context(supervisor)
        yield supervisor


def listens(listen: Sequence[str] | str, config: Path | str | None) -> bool:
    """Say whether a session would listen at an endpoint that no second one can have."""
    if listen:
        return True
    if config is None:
        return False
    from pathlib import Path

    from limo_driver.network.config import read_config

    own = read_config(Path(config))
    endpoints: Any = json.loads(own.get_json("listen/endpoints"))
    mode: Any = json.loads(own.get_json("mode")) or "peer"
    named = endpoints.get(mode, []) if isinstance(endpoints, dict) else endpoints
    return any(not str(endpoint).endswith(":0") for endpoint in named or ())


@dataclass
class _Worker:
    """The process of one arm."""

    options: dict[str, Any]
    process: ForkServerProcess | None = None
    pipe: Connection | None = None
    began: float = 0.0  # [s]
    due: float | None = 0.0  # [s], when it is to begin; None while it works
    deaths: int = 0  # one soon after the other
    served: bool = False  # it has been ready once
    refusal: str = ""  # why it cannot serve
    phase: ServicePhase | None = None
    said: set[str] = field(default_factory=set[str])


class Supervisor(Closing):
    """Processes that serve an arm each.

    Args:
        options: Arguments of `serve`, by arm.
        told: As for `serve_apart`, likewise `show`.
        show: Told each status.
    """

    def __init__(
        self,
        options: Mapping[str, dict[str, Any]],
        told: Callable[[str, Event], None],
        show: Callable[[dict[str, Any]], None],
    ) -> None:
        self.lost_logs: dict[str, str] = {}  # why logs ended before the service did, by arm
        self._workers = {arm: _Worker(own) for arm, own in options.items()}
        self._told, self._show = told, show
        self._ending, self._closing = Ending(), threading.Event()
        self._failure: Exception | None = None
        self._context = get_context("forkserver")
        self._context.set_forkserver_preload(_LOADED)
        self._thread = threading.Thread(target=self._watch, name="limo-supervisor")
        self._thread.start()

    @property
    def phases(self) -> dict[str, ServicePhase | None]:
        """How far the service of each arm is; None while it has no process."""
        return {arm: worker.phase for arm, worker in self._workers.items()}

    @property
    def processes(self) -> dict[str, int | None]:
        """Number of the process that serves each arm now, if any."""
        known = {arm: worker.process for arm, worker in self._workers.items()}
        return {arm: None if own is None else own.pid for arm, own in known.items()}

    def wait(self, duration: float | None = None) -> None:
        """Wait until SIGINT or SIGTERM, until `stop`, or for a time [s].

        Raises:
            ConfigError: An arm cannot be served, or what is told of one could not be passed on.
        """
        self._ending.wait(duration)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End `wait`, from any thread; the service goes on until it is closed."""
        self._ending.stop()

    def close(self) -> None:
        """End all processes, those that do not end by themselves by force."""
        self._closing.set()
        self._thread.join()
        self._ending.close()

    def _watch(self) -> None:
        try:
            while not self._closing.is_set():
                self._begin_what_is_due()
                self._hear()
        except Exception as error:  # noqa: BLE001  # `wait` raises it
            self._failure = error
            self._ending.stop()
        self._end_all()

    def _begin_what_is_due(self) -> None:
        """Begin workers, the first alone until it has compiled what all need."""
        first = next(iter(self._workers.values()))
        alone = not first.served and not first.deaths
        for arm, worker in self._workers.items():
            if worker.due is not None and worker.due <= time.monotonic():
                self._begin(arm, worker)
            if alone:
                return

    def _begin(self, arm: str, worker: _Worker) -> None:
        worker.pipe, theirs = self._context.Pipe()
        worker.process = self._context.Process(
            target=_work, args=(theirs, worker.options), name=f"limo-{arm}"
        )
        worker.process.start()
        theirs.close()
        worker.began, worker.due, worker.refusal = time.monotonic(), None, ""
        text = f"its process is {worker.process.pid}"
        facts = {"process": worker.process.pid}
        self._told(arm, Event(time.time_ns(), Level.INFO, "working", text, facts))

    def _hear(self) -> None:
        """Take what workers tell, for a tenth of a second at most."""
        pipes = {w.pipe: arm for arm, w in self._workers.items() if w.pipe is not None}
        if not pipes:
            self._closing.wait(0.1)
            return
        for pipe in connection.wait(list(pipes), 0.1):
            arm = pipes[pipe]  # type: ignore[index]
            worker = self._workers[arm]
            try:
                self._take(arm, worker, pipe.recv())  # type: ignore[union-attr]
            except (EOFError, OSError):
                self._bury(arm, worker)

    def _take(self, arm: str, worker: _Worker, message: tuple[str, Any]) -> None:
        kind, content = message
        if kind == "status":
            self._show(content)
        elif kind == "refusal":
            worker.refusal = content
        elif kind == "log":
            self.lost_logs[arm] = content
        else:
            self._take_event(arm, worker, content)

    def _take_event(self, arm: str, worker: _Worker, event: Event) -> None:
        if "phase" in event.facts:
            worker.phase = ServicePhase(event.facts["phase"])
            worker.served = worker.served or worker.phase not in _LOADING
        if event.kind == "fifo":  # the machine permits it to all or to none
            if any(event.text in other.said for other in self._workers.values()):
                return
            worker.said.add(event.text)
        self._told(arm, event)

    def _bury(self, arm: str, worker: _Worker) -> None:
        """Let a worker that has ended be begun anew, or give up where it was never of use."""
        assert worker.process is not None  # noqa: S101  # it had a pipe
        assert worker.pipe is not None  # noqa: S101
        worker.process.join(_ENDS)
        worker.pipe.close()
        worker.pipe = worker.phase = None
        why = worker.refusal or _ending_of(worker.process.exitcode)
        lasted = time.monotonic() - worker.began > _LASTED
        worker.deaths = 1 if lasted else worker.deaths + 1
        if self._closing.is_set():
            return
        if not worker.served and (worker.refusal or worker.deaths >= _TRIES):
            raise ConfigError(why if arm in why else f"arm {arm}: {why}")
        pause = _PAUSES[min(worker.deaths, len(_PAUSES)) - 1]
        worker.due = time.monotonic() + pause
        text = f"{why}; another takes its place {f'in {pause:g} s' if pause else 'now'}"
        facts = {"deaths": worker.deaths, "process": worker.process.pid}
        self._told(arm, Event(time.time_ns(), Level.ERROR, "worker", text, facts))

    def _end_all(self) -> None:
        """Ask all to end, hear what they still say, and end those by force that do not."""
        ends = time.monotonic() + _ENDS
        for worker in self._workers.values():
            if worker.pipe is not None:
                with suppress(OSError):
                    worker.pipe.send("stop")
        while time.monotonic() < ends and any(w.pipe for w in self._workers.values()):
            with suppress(LimoError, OSError):  # whoever is told may have gone
                self._hear()
        for worker in self._workers.values():
            if worker.process is not None:
                worker.process.join(max(ends - time.monotonic(), 0.0))
                worker.process.kill()
                worker.process.join()


def _ending_of(code: int | None) -> str:
    if code is not None and code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended with status {code}"


def _work(pipe: Connection, options: dict[str, Any]) -> None:
    """Serve one arm until the pipe says so or closes, in a process of its own."""
    one_at_a_time = threading.Lock()

    def say(kind: str, content: object) -> None:
        with one_at_a_time, suppress(OSError):  # the supervisor has gone: the service ends
            pipe.send((kind, content))

    def told(_arm: str, event: Event) -> None:
        say("event", event)

    try:
        with serve(**options, told=told, show=lambda status: say("status", status)) as service:
            threading.Thread(target=_until_told, args=(pipe, service), daemon=True).start()
            service.wait()
        for why in service.lost_logs.values():
            say("log", why)
    except LimoError as error:
        say("refusal", str(error))
    except KeyboardInterrupt:
        pass


def _until_told(pipe: Connection, service: Service) -> None:
    with suppress(EOFError, OSError):
        pipe.recv()
    service.stop()
