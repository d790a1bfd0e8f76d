"""The `limo` command: one file of this folder is one command, found by its name.

A command's module defines `command`, a typer function whose docstring is its help; it imports
anything heavy inside the function, so that `limo --help` stays fast.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pkgutil import iter_modules

import typer

from limo_driver.errors import LimoError

USAGE_ERROR = 2

app = typer.Typer(
    name="limo",
    help="Drive, simulate and learn slow, force-sensitive robot arms.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line; bad input ends with one clear line and exit status 2."""
    for module in sorted(iter_modules(__path__), key=lambda item: item.name):
        command = import_module(f"{__name__}.{module.name}").command
        app.command(name=module.name.replace("_", "-"))(command)
    try:
        app()
    except LimoError as error:
        sys.stderr.write(f"limo: {error}\n")
        sys.exit(USAGE_ERROR)
