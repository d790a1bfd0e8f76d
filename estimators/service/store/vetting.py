"""Check in a process of its own that a version of a model is fit to serve.

    python -m estimators.service.store.vetting models 3 --rate 1000 --delay 0.1


Files → load → fits robot and rate → golden motion as on the day it was added → at the rate of the
service: finite, within the torque limits of the joints, and fast enough. Whatever a version does
there, hang, crash or eat memory, the service that asked goes on; the process runs at low priority,
and its limit is of processor time, so that a busy machine refuses nobody.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.embedded.compiled_stream import fastest
from estimators.service.store.store import ModelStore
from estimators.service.store.version import replay
from estimators.stream import Stream
from limo_driver.errors import LimoError, ModelStoreError
from limo_driver.runtime.processes import command_of, give_way, processor_time

if TYPE_CHECKING:
    import threading
    from collections.abc import Generator, Sequence


_LOOK: Final = 0.2  # [s] between two looks whether it has to end
TIMEOUT: Final = 120.0  # [s] of processor time; a fresh process compiles first
_LONGEST: Final = 3600.0  # [s], whoever asked
_NICE: Final = 10
_COMMAND: Final = command_of("estimators.service.store.vetting")


@dataclass(frozen=True)
class Vetted:
    """Result of vetting: whether a version may serve, and the figures found on the way."""

    ok: bool
    refused: str | None = None  # corrupt, incompatible, changed, diverging, slow, hanging, crashed
    reason: str = ""
    figures: dict[str, float | int] = field(default_factory=dict)

    def as_json(self) -> str:
        """Return one line."""
        return json.dumps(asdict(self), allow_nan=False)


@dataclass(frozen=True)
class Demand:
    """Requirements of the service on a version."""

    rate: float  # of the stream [Hz]
    delay: float  # of the stream [s]
    limit: float | None = None  # on the median CPU time of a step [s]; one period
    joints: tuple[str, ...] = ()  # their names, in order; none: those of the version

    @property
    def slowest(self) -> float:
        """Limit on the median CPU time of a step [s], beyond which the stream falls behind.

        Every step does the same work. What it takes longest is up to the machine, and must not keep
        a model from serving, or from being rolled back to, while the machine is busy.
        """
        return 1.0 / self.rate if self.limit is None else self.limit


def vet(
    store: ModelStore,
    which: int | str,
    demand: Demand,
    timeout: float = TIMEOUT,
    stopped: threading.Event | None = None,
) -> Vetted:
    """Check a version in a process of its own, whatever it does there.

    Args:
        store: Where it is.
        which: Its number or alias.
        demand: What the service needs.
        timeout: Processor time after which it counts as hanging, and time in which it uses none of
            that [s].
        stopped: Ends it when it is set.

    Raises:
        ModelStoreError: There is no such version.
    """
    number = store.number(which)
    used, at = 0.0, time.monotonic()  # processor time, and when there was last more of it
    given = [str(store.root.resolve()), str(number), f"--robot={store.robot}"]
    given += [f"--rate={demand.rate!r}", f"--delay={demand.delay!r}"]
    given += [f"--limit={demand.slowest!r}"]
    given += [f"--joint={name}" for name in demand.joints]
    with subprocess.Popen(  # noqa: S603  # our own module
        [*_COMMAND, *(given + [f"--trust={key.resolve()}" for key in store.trusted_keys])],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the service, which then ends this one
    ) as process:
        while True:
            try:
                answer, told = process.communicate(timeout=_LOOK)
                return _answered(answer, told, process.returncode)
            except subprocess.TimeoutExpired:
                if stopped is not None and stopped.is_set():
                    process.kill()
                    return Vetted(ok=False, refused="ended", reason="the service ends")
                if (now := processor_time(process.pid)) > used:
                    used, at = now, time.monotonic()
                if used >= timeout or time.monotonic() - at >= timeout:
                    process.kill()
                    reason = f"gave no answer within {timeout:g} s of a processor"
                    return Vetted(ok=False, refused="hanging", reason=reason)


def _answered(answer: str, told: str, status: int) -> Vetted:
    """Return what a process found that ended."""
    try:
        return Vetted(**json.loads(answer))
    except (TypeError, ValueError):
        lines = told.strip().splitlines()
        reason = f"ended with status {status}" + (f": {lines[-1]}" if lines else "")
        return Vetted(ok=False, refused="crashed", reason=reason)


def check(store: ModelStore, which: int | str, demand: Demand) -> Vetted:
    """Check a version in this process; the first thing that fails names the reason."""
    figures: dict[str, float | int] = {}
    try:
        _examine(store, which, demand, figures)
    except _Refused as refusal:
        return Vetted(ok=False, refused=refusal.kind, reason=str(refusal), figures=figures)
    return Vetted(ok=True, figures=figures)


class _Refused(LimoError):  # noqa: N818  # it is an answer
    def __init__(self, kind: str, reason: str) -> None:
        self.kind = kind
        super().__init__(reason)


@contextmanager
def _refusing(kind: str) -> Generator[None]:
    """Take any failure for the reason to refuse a version."""
    try:
        yield
    except LimoError as error:
        raise _Refused(kind, str(error)) from None


def _examine(
    store: ModelStore, which: int | str, demand: Demand, figures: dict[str, float | int]
) -> None:
    with _refusing("corrupt"):
        version = store.open(which)
        model, golden = version.load(), version.golden()
    with _refusing("incompatible"):
        _check_joints(version.joints, demand.joints)
        stream = fastest(Stream(model, demand.rate, demand.delay))
    with _refusing("changed"):
        figures["deviation"] = golden.deviation(model)
    with _refusing("diverging"):
        answered = replay(stream, *golden.at(demand.rate))
        # Check that no torque is beyond what the joint can give
        highest = np.abs(answered.torque).max(axis=0)  # (n,), NaN if any is
        beyond = ~(highest <= model.simulation.model.limits.torque)
        if beyond.any():
            j = int(beyond.argmax())
            raise ModelStoreError(
                f"joint {j + 1} gives up to {highest[j]:.4g} N m on the golden motion, expected at "
                f"most the {model.simulation.model.limits.torque[j]:.4g} N m of its limit"
            )
    with _refusing("slow"):
        figures |= answered.latency()
        _check_latency(figures["p50"], demand)


def _check_joints(found: tuple[str, ...], expected: tuple[str, ...]) -> None:
    if expected and found != expected:
        raise ModelStoreError(
            f"is of joints {', '.join(found)}, expected {', '.join(expected)}, in this order"
        )


def _check_latency(median: float, demand: Demand) -> None:
    if median > demand.slowest:
        raise ModelStoreError(
            f"a step takes {1e6 * median:.0f} µs of CPU (median), expected at most "
            f"{1e6 * demand.slowest:.0f} µs at {demand.rate:g} Hz"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Check a version and print what was found as JSON."""
    parser = argparse.ArgumentParser(description="Check whether a version may serve.")
    parser.add_argument("store", type=Path)
    parser.add_argument("version")
    parser.add_argument("--robot")
    parser.add_argument("--rate", type=float, required=True, help="of the stream [Hz]")
    parser.add_argument("--delay", type=float, default=0.1, help="of the stream [s]")
    parser.add_argument("--limit", type=float, help="on a step's median [s]; one period")
    parser.add_argument("--joint", action="append", default=[], help="name, for each in order")
    parser.add_argument("--trust", action="append", default=[], type=Path, help="public key")
    given = parser.parse_args(arguments)
    give_way(_NICE)
    signal.setitimer(signal.ITIMER_REAL, _LONGEST)  # should whoever asked be gone
    store = ModelStore(given.store, given.robot, given.trust)
    demand = Demand(given.rate, given.delay, given.limit, tuple(given.joint))
    vetted = check(store, given.version, demand)
    sys.stdout.write(f"{vetted.as_json()}\n")


if __name__ == "__main__":
    main()
