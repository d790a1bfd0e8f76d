"""What commands share that do many tasks side by side: where, and how they say how far they are."""

from __future__ import annotations

from contextlib import contextmanager
from enum import StrEnum
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from rich.console import Console


class Machines(StrEnum):
    """Where tasks run."""

    processes = "processes"
    ray = "ray"


OnOption = Annotated[
    Machines, typer.Option("--on", help="Processes of this machine, or a cluster of Ray.")
]
WorkersOption = Annotated[
    int | None, typer.Option(help="How many run at a time; one for each core if not given.")
]


@contextmanager
def told_progress(
    console: Console, doing: str
) -> Generator[Callable[[object | None, int, int], None]]:
    """Yield what is told each task that ends; shows rate and time left where somebody watches.

    Args:
        console: To show it on.
        doing: What is done, as long as nothing is finished.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}", markup=False))
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("reading", total=None)
        start, before = monotonic(), 0

        def tell(ended: object | None, done: int, total: int) -> None:
            nonlocal start, before
            if ended is None:
                start, before = monotonic(), done
                if done:
                    console.print(f"{done} of {total} need no work")
            said = pace(done - before, total - done, monotonic() - start) or doing
            bar.update(task, completed=done, total=total, description=said)

        yield tell


def pace(done: int, left: int, seconds: float) -> str:
    """Say how fast tasks end, and how long the rest will take; nothing before the first.

    Args:
        done: Since the start.
        left: Still to be done.
        seconds: Since the start.
    """
    if not done or seconds <= 0:
        return ""
    rate = done / seconds
    minutes, rest = divmod(round(left / rate), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{60 * rate:.3g} per minute, {hours}:{minutes:02}:{rest:02} left"
