"""Arguments and options: what typer takes from a function, and those that many commands have.

A command is a function whose docstring says under `Args:` what its options are.

The library names its arguments in backticks. Who typed a command knows the option instead.
"""

from __future__ import annotations

import re
from copy import copy
from dataclasses import dataclass, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, get_args, get_origin

import typer

from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import ARGS, arguments_of

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Generator, Sequence

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
