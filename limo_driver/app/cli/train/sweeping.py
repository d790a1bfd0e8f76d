"""`limo train --sweep`: many settings side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.app.console.side_by_side import Machines
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

OPTIONS: Final = frozenset(
    ("recordings", "sim", "out", "mapping", "as_json", "sweep", "test", "workers", "on")
)


def run_sweep(
    simulation: Simulation,
    recordings: Sequence[Recording],
    space: Path,
    out: Path,
    tests: Sequence[Recording],
    workers: int | None,
    on: Machines,
    *,
    as_json: bool,
) -> None:
    """Train every setting, and print the best ones.

    Args:
        simulation: The identified one.
        recordings: To train on.
        space: The space.yaml.
        out: Folder of the sweep.
        tests: Recordings that choose nothing.
        workers: How many run at a time.
        on: Processes, or a cluster of Ray.
        as_json: Print the figures as JSON.
    """
    import json

    from rich.table import Table

    from estimators.sweep.saving import BEST, PAGE, TABLE
    from limo_driver.app.console.side_by_side import told_progress
    from limo_driver.app.console.terminal import terminal
    from limo_driver.app.library.sweeping import sweep

    notes, console = terminal(stderr=True, soft_wrap=True), terminal()
    with told_progress(notes, "training") as tell:
        found = sweep(
            simulation,
            recordings,
            space,
            out,
            tests=tests,
            workers=workers,
            on=on.value,
            progress=tell,
        )
    for trial in found.failed:
        notes.print(f"{trial.key}: {trial.error}")
    if as_json:
        best = {"model": str(out / BEST), "left": found.best.left, "key": found.best.key}
        console.print_json(json.dumps(best))
        return
    console.print(found.headline())
    grid = Table(caption="error left: of the simulation's, on motion that training did not see")
    columns = found.figures()
    for name in columns:
        grid.add_column(name, justify="right")
    for row in zip(*columns.values(), strict=True):
        grid.add_row(*map(str, row))
    console.print(grid)
    console.print(f"wrote {out}: {TABLE}, {PAGE}, {BEST}", soft_wrap=True)
