"""Violations of the safety contract at the wire of every backend, under abuse and faults.

    python benchmarks/backends/contract.py --cycles 1000000 --log contract.csv
    python benchmarks/backends/contract.py --cycles 20000 --only fri --only damiao
    python benchmarks/backends/contract.py --cycles 20000 --before ../before  # an earlier commit

The bar is none in 10^6 cycles of each. Four in ten actions are use and abuse of a robot: streams
of every kind, several modes a cycle, holds, resumes, expiries, jumps of clocks, motion at the
limits; see `tests/contract/attacker.py`. Six are faults of the network, the drives and this
computer under a stream that runs, see `tests/contract/faults.py`: sends that fail, answers that are
lost one way or kept, false replies, duplicates, foreign datagrams, flips of counters and modes,
stalls of 5 to 500 ms, foreign SYNCs and set-points. Each kind has to fire once in 1000 cycles, and
is held within the time that docs/safety.md states, or that is a violation, too.

What the drives are told is decoded by code of its own (protobuf's generated code, `struct`) and
judged by `tests/contract/wire_rules.py`, which shares nothing with what limits commands. One core,
and no clock but those of simulated wires. `--before` needs a tree whose FRI messages are those of
this one; older trees are attacked from a checkout of their age. With a log, each session is a line
of it, and what was begun is gone on with. The exit status is 1 where anything was violated, or a
fault was too rare.
"""

# ruff: noqa: E402  # what tests share is found once its folders are on the path

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
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
FAULTY = 0.6  # share of the actions that are faults
RARELY = 1000  # cycles in which each fault has to fire
SHOWN = 5  # violations of each backend


def backends() -> dict[str, Callable[[], AbstractContextManager[rigs.Rig]]]:
    """Return what opens each backend, with an arm behind it."""
    return rigs.every(compile_schema(tempfile.mkdtemp()))


class Session(NamedTuple):
    """One robot from its opening to its end, or to what broke."""

    seed: int
    cycles: int  # that were judged
    seconds: float
    broken: str  # empty if nothing
    fired: str  # times of each fault, as JSON
    holds: str  # of each fault: times that it had to be held, longest and stated time [s]
    worst: str  # of each limit: the largest step, 1 is the limit


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
                for name, seed, judged, seconds, *rest in csv.reader(file):
                    self._note(name, Session(int(seed), int(judged), float(seconds), *rest))

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
        began = time.process_time()
        random, broken, actions = np.random.default_rng(seed), "", 0
        with opened() as rig:
            attacker = Attacker(rig)
            try:
                for actions in range(1, SESSION + 1):  # noqa: B007  # how far it came
                    attack(attacker, random)
                    if done + attacker.cycles >= cycles:
                        break
            except Exception as error:  # noqa: BLE001  # a loop that crashes holds no arm
                kind = "" if isinstance(error, AssertionError) else f"{type(error).__name__}: "
                broken = f"{kind}{error} (seed {seed}, action {actions})"
            told = (attacker.fired, attacker.holds, attacker.worst)
        taken = time.process_time() - began
        yield Session(seed, attacker.cycles, taken, broken, *map(json.dumps, told))
        done, seed = done + max(attacker.cycles, 1), seed + 1


def attack(attacker: Attacker, random: np.random.Generator) -> None:
    """Do something that is drawn: one of the faults that fired least, or another action."""
    faults, fired = attacker.rig.faults, attacker.fired
    if faults and random.random() < FAULTY:
        least = min(fired[fault] for fault in faults)
        fault = random.choice([fault for fault in faults if fired[fault] == least])
        attacker.fail(str(fault), int(random.integers(2**31)))
    else:
        attacker.act(str(random.choice(ACTIONS)), int(random.integers(2**31)))


def fault_table(rows: list[Session]) -> Counter[str]:
    """Print how often each fault fired and was held, and within which time; return the first."""
    fired: Counter[str] = Counter()
    holds: dict[str, tuple[int, float, float]] = {}
    for row in rows:
        fired.update(json.loads(row.fired))
        for name, (count, longest, stated) in json.loads(row.holds).items():
            before = holds.get(name, (0, 0.0, 0.0))
            latest = max(before[1], longest), max(before[2], stated)
            holds[name] = (before[0] + count, *latest)
    for name, count in sorted(fired.items()):
        held, longest, stated = holds.get(name, (0, 0.0, 0.0))
        times = f"longest {1e3 * longest:5.1f} ms, stated {1e3 * stated:5.1f} ms" if held else ""
        print(f"    {name:24} fired {count:7d}   to be held {held:7d}   {times}")
    return fired


def worst(rows: list[Session]) -> str:
    """Say the largest step of each limit, as a multiple of it."""
    found: dict[str, float] = {}
    for row in rows:
        for name, share in json.loads(row.worst).items():
            found[name] = max(found.get(name, 0.0), share)
    return ", ".join(f"{name} {share:.4g}" for name, share in sorted(found.items()))


def report(name: str, rows: list[Session]) -> bool:
    """Print what came of a backend; say whether it kept everything."""
    judged, broken = sum(row.cycles for row in rows), [row.broken for row in rows if row.broken]
    each = 1e6 * sum(row.seconds for row in rows) / max(judged, 1)
    print(f"{name:12} {judged:9d} {len(broken):10d} {each:9.0f}   worst: {worst(rows)}", flush=True)
    for problem in broken[:SHOWN]:
        print(f"    {problem}")
    rare = [fault for fault, n in fault_table(rows).items() if n < judged // RARELY]
    if rare:
        print(f"    fired too rarely: {', '.join(rare)}")
    return not broken and not rare


def main(
    cycles: Annotated[int, typer.Option(help="Of each backend.")] = 20_000,
    only: Annotated[list[str] | None, typer.Option(help="Backends; all if not given.")] = None,
    seed: int = 0,
    log: Annotated[Path | None, typer.Option(help="CSV of sessions, to go on with.")] = None,
    before: Annotated[Path | None, typer.Option(help="Tree of the packages to attack.")] = None,
) -> None:
    """Attack every backend and print cycles, violations and time."""
    if before is not None:
        raise typer.Exit(attack_tree(before.resolve()))
    kept = Log(log and log.absolute())
    os.chdir(ROOT)
    kept_all = True
    opened_by_name = backends()
    if unknown := sorted(set(only or ()) - set(opened_by_name)):
        raise typer.BadParameter(f"{', '.join(unknown)}: choose of {', '.join(opened_by_name)}")
    print(f"{'backend':12} {'cycles':>9} {'violations':>10} {'us/cycle':>9}")
    for name in only or opened_by_name:
        opened = opened_by_name[name]
        rows = kept.rows.setdefault(name, [])
        done, after = sum(row.cycles for row in rows), max((row.seed for row in rows), default=-1)
        for session in sessions(opened, cycles - done, max(seed, after + 1)):
            kept.add(name, session)
        kept_all &= report(name, rows)
    raise typer.Exit(not kept_all)


def attack_tree(tree: Path) -> int:
    """Run the same in a process that imports the packages of another tree."""
    at = sys.argv.index("--before")
    given = sys.argv[1:at] + sys.argv[at + 2 :]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    return subprocess.run(
        [sys.executable, __file__, *given], env=environment, check=False
    ).returncode


if __name__ == "__main__":
    typer.run(main)
