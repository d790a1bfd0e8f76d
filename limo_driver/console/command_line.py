"""The command line as typer sees it: every command of the folder `cli`, found by its name.

Imported by `limo_driver.cli.main`, which listens for Ctrl-C before it imports anything else.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.metadata import version
from inspect import cleandoc, getdoc
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_COMMANDS = "limo_driver.cli"  # imported by name, as each command is: it imports this module
_UNWRAPPED = "\b\n"  # before a paragraph that keeps its lines

# Without markup: it would take a unit in brackets for a style, and wraps examples within a word.
app = typer.Typer(
    name="limo",
    no_args_is_help=True,
    rich_markup_mode=None,
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
    r"""Drive, simulate and learn slow, force-sensitive robot arms.

    Workflow: plan a motion, run it, identify the arm, train on the residual, evaluate on
    another motion; predict says what an identified arm's torque should be.

    Example:
        limo plan --robot iiwa14 --scaffolds 12 --out limo.traj.parquet
        limo run --backend mujoco --trajectory limo.traj.parquet \
            --record run.parquet
        limo identify run.parquet --robot iiwa14 --out sim.yaml
    """


@cache  # a program that calls `main` again would add every command again
def add_commands() -> None:
    """Add every command of the folder, with the help that its docstring is."""
    cli = import_module(_COMMANDS)
    for module in sorted(iter_modules(cli.__path__), key=lambda item: item.name):
        command = import_module(f"{cli.__name__}.{module.name}").command
        name = module.name.replace("_", "-")
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name=name)(command)
    _describe(app)


def _describe(group: typer.Typer) -> None:
    """Give a group and its commands their help: whole in a list, and examples as they stand."""
    infos = [*group.registered_commands, group.registered_callback]
    for info in infos:
        if info is not None and info.callback is not None:
            info.help, info.short_help = help_of(info.callback)
    for inner in group.registered_groups:
        if inner.typer_instance is not None:
            _describe(inner.typer_instance)


def help_of(command: Callable[..., Any]) -> tuple[str, str]:
    """Return the help of a command and its first sentence, from its docstring.

    Paragraphs are wrapped to the terminal; the lines of the examples stay as they are, so that
    they can be copied.
    """
    text = cleandoc(getdoc(command) or "")
    first = text.split("\n\n")[0].replace("\n", " ")
    return text.replace("\n\nExample", f"\n\n{_UNWRAPPED}Example"), first
