"""What cycles of the FRI and the CAN driver cost, beside an earlier state of the project.

    git worktree add ../before <commit>
    python benchmarks/backends/cycle_costs.py --before ../before

Both run in turn, each round in a process of its own, so that they suffer alike from whatever else
the machine does; who comes first changes. Printed is the p50 [µs] of the least disturbed round,
decode, safety contract and encode of a position command, with the bars. The exit status is 1 where
a cycle costs more than 1.05 times what it did.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).parents[2]
BARS = {"FRI": 30.0, "CAN": 75.0}  # [µs]
SLOWER = 1.05  # times the earlier state, at most
CODE = """
import sys
sys.path[:0] = [f"{sys.argv[1]}/{folder}" for folder in (
    "benchmarks/backends", "tests/backends/fri", "tests/limo_driver/network")]
if sys.argv[2] == "CAN":
    import types
    sys.modules.setdefault("cantools", types.ModuleType("cantools"))  # a peer that is not timed
    from can_cycle import cycle_of_the_driver
    taken = cycle_of_the_driver(6000)
else:
    from time import perf_counter
    from fri_cycle import FriVersion, PositionCommand, Realtime, fed_robot, np, packets
    version, taken = FriVersion.named("1.15"), []
    made, path = packets(version, 12000)
    commands = [PositionCommand(position=position) for position in path]
    with Realtime(), fed_robot(version, made) as robot:
        for command in commands:
            began = perf_counter()
            robot.receive()
            robot.send(command)
            taken.append(1e6 * (robot._link.endpoint.sent - began))
import numpy as np
print(np.median(taken[2000:]))
"""


def timed(tree: Path, driver: str) -> float:
    """Return the p50 of a driver's cycles in a tree [µs]."""
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    given = [sys.executable, "-c", CODE, str(tree), driver]
    done = subprocess.run(
        given, cwd=tree, env=environment, capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def main(
    before: Annotated[Path | None, typer.Option(help="Tree of an earlier commit.")] = None,
    rounds: Annotated[int, typer.Option(min=1)] = 5,
    only: Annotated[str | None, typer.Option(help="FRI or CAN; both if not given.")] = None,
) -> None:
    """Time both drivers in both trees."""
    trees = {"now": ROOT} if before is None else {"before": before.resolve(), "now": ROOT}
    slower = False
    for driver, bar in BARS.items():
        if only not in {None, driver}:
            continue
        found: dict[str, list[float]] = {name: [] for name in trees}
        for k in range(rounds):
            for name, tree in list(trees.items())[:: -1 if k % 2 else 1]:
                found[name].append(timed(tree, driver))
        told = "   ".join(f"{name} {min(times):5.1f}" for name, times in found.items())
        ratio = min(found["now"]) / min(found.get("before", found["now"]))
        slower |= ratio > SLOWER
        print(f"{driver} cycle, p50 [µs]: {told}   bar {bar:g}   ratio {ratio:.3f}, bar {SLOWER}")
    raise typer.Exit(slower)


if __name__ == "__main__":
    typer.run(main)
