"""Progress of long work as a bar, where somebody watches."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from rich.console import Console


@contextmanager
def progress_bar(console: Console) -> Generator[Callable[[str, float], None]]:
    """Yield what is told the stage and the part of the work that is done."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}", markup=False))
    # where nobody watches, the bar would leave an empty line before the message of an error
    disable = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task("reading motion", total=1.0)
        yield lambda stage, part: bar.update(task, completed=part, description=stage)
