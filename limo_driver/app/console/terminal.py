"""Consoles on which commands print tables and sentences for people: names in them are data."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import typer

from limo_driver.quoting import on_terminal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console
    from rich.segment import Segment


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
