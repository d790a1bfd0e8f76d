"""The `limo` command: one file of this folder is one command, found by its name.

A command's module defines `command`, a typer function whose docstring is its help, or a folder of
such functions defines `command`, a typer group; anything heavy is imported inside the functions, so
that `limo --help` stays fast.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pkgutil import iter_modules
from typing import Annotated

import typer

from limo_driver.compilation_line import compilation_line
from limo_driver.errors import LimoError

USAGE_ERROR = 2
INTERRUPTED = 130

app = typer.Typer(
    name="limo",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> None:  # typer's callback
    if wanted:
        typer.echo(f"limo {version('limo')}")
        raise typer.Exit


@app.callback()
def limo(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show it.")
    ] = False,
) -> None:
    """Drive, simulate and learn slow, force-sensitive robot arms.

    The way of the data: plan a motion, run it, identify the arm, train on the rest, evaluate on
    another motion; predict says what an identified arm's torque should be.

    [bold]Example[/bold]

        limo plan --robot iiwa14 --scaffolds 12 --seed 1 --out limo.traj.parquet

        limo run --backend mujoco --trajectory limo.traj.parquet --record run.parquet

        limo identify run.parquet --robot iiwa14 --out sim.yaml
    """


@cache  # a program that calls `main` again would add every command again
def _add_commands() -> None:
    for module in sorted(iter_modules(__path__), key=lambda item: item.name):
        command = import_module(f"{__name__}.{module.name}").command
        name = module.name.replace("_", "-")
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name=name)(command)


def main() -> None:
    """Run the command line; bad input ends with one clear line and exit status 2."""
    # A program that reads figures from stdout need not read about compilation.
    silent = "--json" in sys.argv and not sys.stderr.isatty()
    try:
        _add_commands()
        with compilation_line(silent=silent):
            app()
    except LimoError as error:
        sys.stderr.write(f"limo: {error}\n")
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:  # while commands were imported; the app handles it later on
        sys.exit(INTERRUPTED)
