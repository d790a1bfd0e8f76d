"""The command line as typer sees it: every command of the folder `cli`, found by its name.

Imported by `limo_driver.app.cli.main`, which listens for Ctrl-C before it imports anything else.

One line on stderr while a command compiles.

The line is rewritten in place on a terminal, and written once elsewhere. Nothing is imported here
that compiles or draws, since every command begins with it.
"""

from __future__ import annotations

import sys
from collections import UserDict
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.metadata import version
from inspect import getdoc
from pkgutil import iter_modules
from typing import Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command, get_group

from limo_driver.app.console.arguments import without_args
from limo_driver.runtime.compilation import Compilation, report_to

_COMMANDS = "limo_driver.app.cli"  # imported by name, as each command is: it imports this module
_UNWRAPPED = "\b\n"  # before a paragraph that keeps its lines

WORKFLOW: Final = {  # what one does, in order, with which commands
    "Look at recordings": ("inspect", "convert"),
    "Move an arm, real or simulated": ("plan", "excite", "run", "simulate"),
    "Find what the simulation lacks": ("identify", "diagnose", "report", "fleet", "export", "demo"),
    "Learn and predict torque": ("train", "evaluate", "predict", "models", "reproduce"),
    "Feel what touches the arm, live": ("serve", "watch", "bridge", "secure"),
    "Connect an arm, or stand in for one": ("doctor", "controller", "drives"),
}


class _Workflow(TyperGroup):
    """Lists commands by what they are for."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002  # click's
        """Write a section for each part of the workflow, in columns alike."""
        width = max(map(len, self.commands))
        for title, names in WORKFLOW.items():
            with formatter.section(title):
                listed = [(f"{x:{width}}", self.commands[x].get_short_help_str()) for x in names]
                formatter.write_dl(listed)


# Without markup: it would take a unit in brackets for a style, and wraps examples within a word.
app = typer.Typer(
    name="limo",
    cls=_Workflow,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
_PATIENCE: Final = 0.3  # [s] of compilation that nobody needs to be told of
_CLEAR: Final = "\r\x1b[2K"


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
    """Find what the simulation of a robot arm lacks, and put it in.

    From recordings of the arm: friction and its hysteresis, payloads, springs, backlash,
    inertias and drives that are not as the model says. What is found is written into the model,
    and tells what touches the arm. limo also moves slow, force-sensitive arms, real and simulated.

    Example:
        limo inspect monday.csv --robot arm.urdf
        limo identify monday.csv tuesday.csv --robot arm.urdf --out sim.yaml
        limo diagnose wednesday.csv --sim sim.yaml --out diagnosis
        limo export diagnosis/sim.yaml --to urdf --out improved
    """


@cache  # a program may call `main` again
def command_line() -> TyperGroup:
    """Return `limo` with every command of the folder."""
    _describe(app)
    line = get_command(app)
    assert isinstance(line, TyperGroup)  # noqa: S101  # `app` has a callback
    line.commands = _Commands()
    return line


class _Commands(UserDict[str, Any]):
    """Commands by name, each imported when it is first asked for.

    What typer makes of the signatures of all takes longer than all else that a command begins with.
    """

    def __init__(self) -> None:
        folder = import_module(_COMMANDS).__path__
        modules = sorted(module.name for module in iter_modules(folder))
        super().__init__({name.replace("_", "-"): None for name in modules})

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401  # click's, which typer keeps private
        if super().__getitem__(name) is None:
            self[name] = _command(name)
        return super().__getitem__(name)


def _command(name: str) -> object:
    """Return a command of the folder, with the help that its docstring is."""
    found = import_module(f"{_COMMANDS}.{name.replace('-', '_')}").command
    alone = typer.Typer(rich_markup_mode=None)
    if isinstance(found, typer.Typer):
        alone.add_typer(found, name=name)
    else:
        alone.command(name=name)(found)
    _describe(alone)
    return get_group(alone).commands[name]


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
    text = without_args(getdoc(command) or "")
    first = text.split("\n\n")[0].replace("\n", " ")
    return text.replace("\n\nExample", f"\n\n{_UNWRAPPED}Example"), first


@contextmanager
def compilation_line(*, silent: bool = False) -> Generator[None]:
    """Show, inside, how far compilation is.

    Args:
        silent: Show nothing.
    """
    line = _Line(silent=silent)
    with report_to(line.follow):
        try:
            yield
        finally:
            line.clear()


class _Line:
    """Progress line of a compilation."""

    def __init__(self, *, silent: bool) -> None:
        self._silent = silent
        self._shown = ""  # what stands on the terminal now
        self._said = False

    def follow(self, state: Compilation) -> None:
        if not state.running:
            self.clear()
        elif state.seconds > _PATIENCE and not self._silent:
            self._show(min(state.done + 1, state.most), state.most)

    def _show(self, number: int, most: int) -> None:
        text = f"compiling once on this machine: {number} of up to {most}"
        # Where a progress bar is drawn, stderr is its own, and takes whole lines.
        in_place = sys.stderr.isatty() and not hasattr(sys.stderr, "rich_proxied_file")
        if in_place and text != self._shown:
            _write(f"{_CLEAR}{text}")
            self._shown = text
        elif not in_place and not self._said:
            _write(f"{text}\n")
        self._said = True

    def clear(self) -> None:
        """Leave no trace of the line."""
        if self._shown:
            _write(_CLEAR)
            self._shown = ""


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError):  # closed, or nobody reads it any more
        pass
