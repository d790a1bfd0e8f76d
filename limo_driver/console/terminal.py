"""Consoles on which commands print tables and sentences for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def terminal(*, stderr: bool = False, soft_wrap: bool = False) -> Console:
    """Return a console that prints text as it is.

    Rich takes `[mrad]` for the name of a style, and prints nothing for it, unless markup is off. A
    style is given beside a text (`style="bold"`), never in it.

    Args:
        stderr: Print there instead of to stdout.
        soft_wrap: Leave the lines as long as they are.
    """
    from rich.console import Console

    return Console(stderr=stderr, soft_wrap=soft_wrap, markup=False, emoji=False, highlight=False)
