"""Violations of the safety contract at the wire of every backend, under random use and abuse.

    python benchmarks/backends/contract.py --cycles 1000000
    python benchmarks/backends/contract.py --cycles 20000 --only virtual --only damiao

The bar is none in 10^6 cycles of each. Actions are drawn at random: streams of every kind, several
modes a cycle, holds, resumes, expiries, lost, false and unreadable measurements, jumps of clocks,
motion at the limits; see `tests/contract/attacker.py`. What the drives are told is decoded by code
of its own (protobuf's generated code, `struct`) and judged by `tests/contract/wire_rules.py`, which
shares nothing with what limits commands. One core.
"""

# ruff: noqa: E402  # what tests share is found once its folders are on the path

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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


def sessions(
    opened: Callable[[], AbstractContextManager[rigs.Rig]], cycles: int, seed: int
) -> Iterator[tuple[int, str]]:
    """Attack until so many cycles were judged; yield the cycles of each session and what broke."""
    done = 0
    while done < cycles:
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
        done, seed = done + attacker.cycles, seed + 1
        yield attacker.cycles, broken


def main(
    cycles: Annotated[int, typer.Option(help="Of each backend.")] = 20_000,
    only: Annotated[list[str] | None, typer.Option(help="Backends; all if not given.")] = None,
    seed: int = 0,
) -> None:
    """Attack every backend and print cycles, violations and time."""
    os.chdir(ROOT)
    failed = 0
    print(f"{'backend':12} {'cycles':>9} {'violations':>10} {'us/cycle':>9}")
    for name, opened in backends().items():
        if only and name not in only:
            continue
        began, judged, broken = time.perf_counter(), 0, []
        for count, problem in sessions(opened, cycles, seed):
            judged += count
            broken += [problem] if problem else []
        each = 1e6 * (time.perf_counter() - began) / judged
        print(f"{name:12} {judged:9d} {len(broken):10d} {each:9.0f}", flush=True)
        for problem in broken[:5]:
            print(f"    {problem}")
        failed += len(broken)
    raise typer.Exit(failed > 0)


if __name__ == "__main__":
    typer.run(main)
