"""Violations of the safety contract at the wire of every backend, under random use and abuse.

    python benchmarks/backends/contract.py --cycles 1000000
    python benchmarks/backends/contract.py --cycles 20000 --only virtual --only damiao
    python benchmarks/backends/contract.py --cycles 1000000 --log contract.csv

The bar is none in 10^6 cycles of each. Actions are drawn at random: streams of every kind, several
modes a cycle, holds, resumes, expiries, lost, false and unreadable measurements, jumps of clocks,
motion at the limits; see `tests/contract/attacker.py`. What the drives are told is decoded by code
of its own (protobuf's generated code, `struct`) and judged by `tests/contract/wire_rules.py`, which
shares nothing with what limits commands. One core, and no clock but those of simulated wires. With
a log, each session is a line of it, and what was begun is gone on with.
"""

# ruff: noqa: E402  # what tests share is found once its folders are on the path

from __future__ import annotations

import csv
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import typer

ROOT = Path(__file__).parents[2]
sys.path[:0] = [
    str(ROOT / "tests" / folder)
    for folder in (
        "contract", "backends/fri", "backends/can", "backends/can/simulator",
        "limo_driver/network",
    )
]  # fmt: skip

import rigs
from attacker import ACTIONS, Attacker
from fri_messages import compile_schema

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

SESSION = 300  # actions, after which the robot is opened anew


def backends() -> dict[str, Callable[[], AbstractContextManager[rigs.Rig]]]:
    """Return what opens each backend, with an arm behind it."""
    return rigs.every(compile_schema(tempfile.mkdtemp()))


class Session(NamedTuple):
    """One robot from its opening to its end, or to what broke."""

    seed: int
    cycles: int  # that were judged
    seconds: float
    broken: str  # empty if nothing


class Log:
    """Sessions that were judged, a line each: backend, seed, cycles, seconds, and what broke.

    Args:
        path: Of a CSV file, which is made where there is none; None keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.rows: dict[str, list[Session]] = {}
        if path is not None and path.exists():
            with path.open(newline="") as file:
                for name, *row in csv.reader(file):
                    seed, judged, seconds, broken = row
                    self._note(name, Session(int(seed), int(judged), float(seconds), broken))

    def add(self, name: str, session: Session) -> None:
        """Keep a session of a backend."""
        self._note(name, session)
        if self._path is not None:
            with self._path.open("a", newline="") as file:
                csv.writer(file).writerow([name, *session])

    def _note(self, name: str, session: Session) -> None:
        self.rows.setdefault(name, []).append(session)


def sessions(
    opened: Callable[[], AbstractContextManager[rigs.Rig]], cycles: int, seed: int
) -> Iterator[Session]:
    """Attack until so many cycles were judged; yield each session."""
    done = 0
    while done < cycles:
        began = time.perf_counter()
        random, broken, actions = np.random.default_rng(seed), "", 0
        with opened() as rig:
            attacker = Attacker(rig)
            try:
                for actions in range(1, SESSION + 1):  # noqa: B007  # how far it came
                    attacker.act(str(random.choice(ACTIONS)), int(random.integers(2**31)))
                    if done + attacker.cycles >= cycles:
                        break
            except AssertionError as error:
                broken = f"{error} (seed {seed}, action {actions})"
        yield Session(seed, attacker.cycles, time.perf_counter() - began, broken)
        done, seed = done + attacker.cycles, seed + 1


def main(
    cycles: Annotated[int, typer.Option(help="Of each backend.")] = 20_000,
    only: Annotated[list[str] | None, typer.Option(help="Backends; all if not given.")] = None,
    seed: int = 0,
    log: Annotated[Path | None, typer.Option(help="CSV of sessions, to go on with.")] = None,
) -> None:
    """Attack every backend and print cycles, violations and time."""
    kept = Log(log and log.absolute())
    os.chdir(ROOT)
    failed = 0
    print(f"{'backend':12} {'cycles':>9} {'violations':>10} {'us/cycle':>9}")
    for name, opened in backends().items():
        if only and name not in only:
            continue
        rows = kept.rows.setdefault(name, [])
        done, after = sum(row.cycles for row in rows), max((row.seed for row in rows), default=-1)
        for session in sessions(opened, cycles - done, max(seed, after + 1)):
            kept.add(name, session)
        judged, broken = sum(row.cycles for row in rows), [row.broken for row in rows if row.broken]
        each = 1e6 * sum(row.seconds for row in rows) / judged
        print(f"{name:12} {judged:9d} {len(broken):10d} {each:9.0f}", flush=True)
        for problem in broken[:5]:
            print(f"    {problem}")
        failed += len(broken)
    raise typer.Exit(failed > 0)


if __name__ == "__main__":
    typer.run(main)
