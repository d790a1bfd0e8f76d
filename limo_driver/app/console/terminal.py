"""What a command prints: on a terminal or not, progress, and things side by side."""

from __future__ import annotations

from contextlib import contextmanager
from enum import StrEnum
from functools import cache
from threading import Event, Thread
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from limo_driver.quoting import on_terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence

    from rich.console import Console
    from rich.progress import Progress, ProgressColumn
    from rich.segment import Segment
    from rich.table import Table

    from limo_driver.recordings.recording import Recording

QUIET: Final = 60.0  # [s] between two lines of progress in a file


def say(text: str, *, stderr: bool = False) -> None:
    """Print a sentence where no tables are, without what Rich takes to be imported."""
    typer.echo(on_terminal(text), err=stderr)


def terminal(*, stderr: bool = False, soft_wrap: bool = False) -> Console:
    """Return a console that prints text as it is.

    Rich takes `[mrad]` for the name of a style, and prints nothing for it, unless markup is off. A
    style is given beside a text (`style="bold"`), never in it.

    Args:
        stderr: Print there instead of to stdout.
        soft_wrap: Leave the lines as long as they are.
    """
    made = _console()
    return made(stderr=stderr, soft_wrap=soft_wrap, markup=False, emoji=False, highlight=False)


@cache
def _console() -> type[Console]:
    """Return Rich's console, which prints nothing of a text that a terminal would obey."""
    from rich.console import Console

    class PlainConsole(Console):
        def render(self, *args: Any, **options: Any) -> Iterator[Segment]:  # noqa: ANN401  # Rich's
            for segment in super().render(*args, **options):
                is_plain = segment.control or segment.text.isprintable()
                yield segment if is_plain else segment._replace(text=on_terminal(segment.text))

        def print_json(self, json: str | None = None, **options: Any) -> None:  # noqa: ANN401
            options["ensure_ascii"] = True
            super().print_json(json, **options)

    return PlainConsole


def progress(
    *columns: str | ProgressColumn, console: Console | None = None, quiet: bool = False
) -> Progress:
    """Return a bar on stderr, which leaves stdout to the result and ends without trace.

    Where nobody watches there is none: it would leave an empty line before the message of an error.

    Args:
        columns: Of rich; Rich's own if not given.
        console: To draw it on; stderr if not given.
        quiet: Draw nothing.
    """
    from rich.progress import Progress

    console = console or terminal(stderr=True)
    disable = quiet or not console.is_terminal
    return Progress(*columns, console=console, transient=True, disable=disable)


def table_of(*headings: str, title: str | None = None, caption: str | None = None) -> Table:
    """Return a table of figures: the first column gives way in a narrow terminal."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=title, caption=caption)
    for heading in headings:
        if heading == headings[0]:
            table.add_column(heading, overflow="fold")
        else:
            table.add_column(heading, justify="right", no_wrap=True)
    return table


def columns_of(figures: Mapping[str, Iterable[object]], **look: Any) -> Table:  # noqa: ANN401
    """Return a table with each heading over its column; `look` is as of `rich.table.Table`."""
    from rich.table import Column, Table

    table = Table(*(Column(heading, justify="right") for heading in figures), **look)
    for row in zip(*figures.values(), strict=True):
        table.add_row(*map(str, row))
    return table


def joint_table(joints: Sequence[Any], figures: Mapping[str, Iterable[object]]) -> Table:
    """Return figures of joints with the peaks of their motion, as parts of their limits."""
    return columns_of(
        {
            "joint": [j.joint for j in joints],
            **figures,
            "peak\nvelocity": [f"{j.peak_velocity:.0%}" for j in joints],
            "peak\naccel.": [f"{j.peak_acceleration:.0%}" for j in joints],
            "peak\njerk": [f"{j.peak_jerk:.0%}" for j in joints],
        },
        title="joints (peaks relative to their limits)",
        title_justify="left",
    )


def unchecked(pairs: Iterable[tuple[str, str]]) -> str:
    """Say which links are not checked against each other; empty if all are."""
    listed = ", ".join(" and ".join(pair) for pair in pairs)
    return listed and f"not checked against each other, since they always touch: {listed}"


def print_notes(recordings: Iterable[Recording]) -> None:
    """Print on stderr what is odd about recordings, and which rows were left out."""
    console = terminal(stderr=True, soft_wrap=True)
    for recording in recordings:
        for item in (*recording.warnings, *recording.left_out):
            console.print(f"{recording.source}: {item}")


@contextmanager
def progress_bar(console: Console) -> Generator[Callable[[str, float], None]]:
    """Yield what is told the stage and the part of the work that is done."""
    from rich.progress import BarColumn, TaskProgressColumn

    def tell(stage: str, part: float) -> None:
        bar.update(task, completed=part, description=stage)
        line(f"{part:.0%}: {stage}")

    bars = BarColumn(), TaskProgressColumn(), "{task.description}"
    with progress(*bars, console=console) as bar, _lines(console) as line:
        task = bar.add_task("reading motion", total=1.0)
        yield tell


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
def progress_lines(
    console: Console, doing: str
) -> Generator[Callable[[object | None, int, int], None]]:
    """Yield what is told each task that ends; shows rate and time left where somebody watches.

    Args:
        console: To show it on.
        doing: What is done, as long as nothing is finished.
    """
    from rich.progress import BarColumn, MofNCompleteColumn

    bars = BarColumn(), MofNCompleteColumn(), "{task.description}"
    with progress(*bars, console=console) as bar, _lines(console) as line:
        task = bar.add_task("reading", total=None)
        start, before = monotonic(), 0

        def tell(ended: object | None, done: int, total: int) -> None:
            nonlocal start, before
            if ended is None:
                start, before = monotonic(), done
                if done:
                    console.print(f"{done} of {total} need no work")
            text = pace(done - before, total - done, monotonic() - start) or doing
            bar.update(task, completed=done, total=total, description=text)
            line(f"{done} of {total}: {text}")

        yield tell


@contextmanager
def _lines(console: Console) -> Generator[Callable[[str], None]]:
    """Yield what takes how far work is, and prints that now and then where no bar is drawn."""
    last, begun, is_over = "", monotonic(), Event()

    def line(text: str) -> None:
        nonlocal last
        last = text

    def watch() -> None:
        while not is_over.wait(QUIET):
            if last:
                console.print(f"after {monotonic() - begun:.0f} s, {last}")

    watcher = Thread(target=watch, daemon=True)
    if not console.is_terminal:
        watcher.start()
    try:
        yield line
    finally:
        is_over.set()
        if watcher.ident is not None:
            watcher.join()


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
