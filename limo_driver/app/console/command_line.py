"""The command line as typer sees it: every command of the folder `cli`, found by its name.

Imported by `limo_driver.app.cli.main`, which listens for Ctrl-C before it imports anything else.

One line on stderr while a command compiles.

The line is rewritten in place on a terminal, and written once elsewhere. Nothing is imported here
that compiles or draws, since every command begins with it.

Arguments and options: what typer takes from a function, and those that many commands have.

A command is a function whose docstring says under `Args:` what its options are.

The library names its arguments in backticks. Who typed a command knows the option instead.
"""

from __future__ import annotations

import re
import sys
from collections import UserDict
from collections.abc import Callable, Generator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, is_dataclass
from functools import cache, wraps
from importlib import import_module
from importlib.metadata import version
from inspect import Parameter, Signature, getdoc, signature
from math import isnan
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated, Any, Final, get_args, get_origin

import typer
from typer.core import TyperGroup
from typer.main import get_command, get_group

from limo_driver.errors import ConfigError
from limo_driver.runtime.compilation import Compilation, report_to
from limo_driver.runtime.parameters import ARGS, arguments_of

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    import zenoh


_SAME: Final = (  # arguments whose options have their names
    "bound clearance columns connect force into joint_margin log mapping model out region robot "
    "ros sign speed step store table_height topic trajectory trust "
)
OPTIONS: Final = {name: f"--{name.replace('_', '-')}" for name in _SAME.split()} | {
    "Surroundings.self_collision": "--no-self-collision",
    "Workspace.radius": "--workspace-radius",
    "arms": "--arm",
    "config": "--zenoh-config",
    "contact_duration": "--contact-for",
    "contact_torque": "--contact",
    'link["config"]': "--config",
    'link["host"]': "--host",
    'link["port"]': "--port",
    'link["reset_faults"]': "--reset-faults",
    "retraining": "--retrain",
    "ros_domain": "--ros",
    "simulation": "--sim",
}
# What every `--robot` takes.
ROBOTS = "built-in name, URDF, MJCF or USD; joints are chosen as in 'arm.urdf#arm_*,gripper=0.02'"

RobotOption = Annotated[str, typer.Option(help=f"The arm: {ROBOTS}.")]
MappingOption = Annotated[
    Path | None,
    typer.Option(help="What the columns of another format are; `limo inspect` writes one."),
]
RosDomain = Annotated[int, typer.Option(help="ROS_DOMAIN_ID of the ROS 2 nodes.")]


@dataclass(frozen=True, kw_only=True)
class SessionOptions:
    """Options of a session on the network.

    Args:
        connect: Zenoh endpoint to reach, for example tcp/192.168.1.2:7447; several count.
        listen: Zenoh endpoint to be reached at, for example tcp/0.0.0.0:7447.
        config: Zenoh's own configuration (JSON5): routers, TLS, users.
    """

    connect: Annotated[list[str] | None, typer.Option(metavar="ENDPOINT")] = None
    listen: Annotated[list[str] | None, typer.Option(metavar="ENDPOINT")] = None
    config: Annotated[Path | None, typer.Option("--zenoh-config")] = None

    @property
    def ends(self) -> tuple[Sequence[str], Sequence[str], Path | None]:
        """What was given, as functions of the library take it."""
        return self.connect or (), self.listen or (), self.config

    def open(self) -> zenoh.Session:
        """Open the session.

        Raises:
            ConnectionLostError: There is none to be had.
        """
        from limo_driver.network.streaming import open_session

        return open_session(*self.ends)


def describe_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give typer the options of a function, with the help that stands under `Args:`.

    What comes before `*` is an argument, what comes after it an option. A flag that is false by
    default has no `--no-`, and `as_json` is --json. Other names, bounds and a metavar stand in the
    annotation; so does help that several commands share. A parameter whose type is a dataclass is
    an option for each field of that.
    """

    @wraps(command)
    def with_options(**given: object) -> None:
        for name, value in given.items():
            if isinstance(value, float) and isnan(value):  # bounds of options let it pass
                raise ConfigError(f"{_option_of(command, name)} is nan, expected a number")
        command(**_gather(command, given))

    with_options.__dict__["__signature__"] = Signature([*_described(command)])
    return with_options


def without_args(doc: str) -> str:
    """Return a docstring without what it says of the arguments."""
    return ARGS.sub("\n", doc)


def _described(function: Callable[..., Any]) -> Generator[Parameter]:
    """Yield what typer reads of each parameter; by keyword, so that they may come in any order."""
    helps = arguments_of(function.__doc__ or "")
    for item in signature(function, eval_str=True).parameters.values():
        kind: Any = item.annotation
        info = None
        if isinstance(kind, type) and is_dataclass(kind):
            yield from _described(kind)
            continue
        if get_origin(kind) is Annotated:
            kind, info = get_args(kind)
        elif kind is not typer.Context:
            info = _plain_option(item)
        if info is not None and info.help is None:
            info = copy(info)
            info.help = helps.get(item.name)  # none where Python leaves docstrings out
        annotation = kind if info is None else Annotated[kind, info]
        yield item.replace(kind=Parameter.KEYWORD_ONLY, annotation=annotation)


def _option_of(command: Callable[..., Any], name: str) -> str:
    """Return what sets a parameter of a command."""
    kind = next(item.annotation for item in _described(command) if item.name == name)
    first = [str(info.default) for info in get_args(kind)[1:]]  # typer takes it for a default
    return next((x for x in first if x.startswith("--")), f"--{name.replace('_', '-')}")


def _plain_option(item: Parameter) -> Any:  # noqa: ANN401  # typer's
    if item.kind is not Parameter.KEYWORD_ONLY:
        return typer.Argument()
    if item.name == "as_json":
        return typer.Option("--json")
    return (
        typer.Option(f"--{item.name.replace('_', '-')}")
        if item.default is False
        else typer.Option()
    )


def _gather(function: Callable[..., Any], given: dict[str, object]) -> dict[str, object]:
    """Return the arguments of a function: what was given, and the dataclasses that hold some."""
    made: dict[str, object] = {}
    for name, item in signature(function, eval_str=True).parameters.items():
        kind: Any = item.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            made[name] = kind(**_gather(kind, given))
        elif name in given:
            made[name] = given[name]
    return made


def in_options(message: str) -> str:
    """Return a message that names arguments in backticks with the options that set them."""
    return re.sub(r"`([^`\n]+)`", lambda found: OPTIONS.get(found[1], found[0]), message)


def is_on_command_line(context: typer.Context, name: str) -> bool:
    """Say whether a parameter of a command was given, not left at its default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def refuse_options(context: typer.Context, known: Container[str], why: str) -> None:
    """Refuse options that were given, and that something has no use for.

    Args:
        context: Of the command.
        known: Names of the parameters that it has a use for.
        why: Completes the sentence that begins with the option.

    Raises:
        ConfigError: Names one.
    """
    for name in context.params:
        if name not in known and is_on_command_line(context, name):
            raise ConfigError(f"--{name.replace('_', '-')} {why}")


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
