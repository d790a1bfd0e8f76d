"""Arguments and options: how errors call them, and those that many commands have.

Messages of the library in the words of the command line: options instead of arguments.

The library names its arguments in backticks. Who typed a command knows the option instead.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

if TYPE_CHECKING:
    from collections.abc import Container

OPTIONS: Final = {
    "Surroundings.self_collision": "--no-self-collision",
    "arms": "--arm",
    "bound": "--bound",
    "columns": "--columns",
    "config": "--zenoh-config",
    "connect": "--connect",
    "contact_duration": "--contact-for",
    "contact_torque": "--contact",
    "force": "--force",
    'link["config"]': "--config",
    'link["host"]': "--host",
    'link["port"]': "--port",
    'link["reset_faults"]': "--reset-faults",
    "into": "--into",
    "log": "--log",
    "mapping": "--mapping",
    "model": "--model",
    "out": "--out",
    "retraining": "--retrain",
    "robot": "--robot",
    "ros": "--ros",
    "ros_domain": "--ros",
    "sign": "--sign",
    "simulation": "--sim",
    "store": "--store",
    "table_height": "--table-height",
    "topic": "--topic",
    "trajectory": "--trajectory",
    "trust": "--trust",
}
# What every `--robot` takes.
ROBOTS = "built-in name, URDF, MJCF or USD; joints are chosen as in 'arm.urdf#arm_*,gripper=0.02'"

MappingOption = Annotated[
    Path | None,
    typer.Option(help="What the columns of another format are; `limo inspect` writes one."),
]


def in_options(message: str) -> str:
    """Return a message that names arguments in backticks with the options that set them."""
    return re.sub(r"`([^`\n]+)`", lambda found: OPTIONS.get(found[1], found[0]), message)


def refuse_options(context: typer.Context, known: Container[str], why: str) -> None:
    """Refuse options that were given, and that something has no use for.

    Args:
        context: Of the command.
        known: Names of the parameters that it has a use for.
        why: Completes the sentence that begins with the option.

    Raises:
        ConfigError: Names one.
    """
    from limo_driver.errors import ConfigError

    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in known and source is not None and source.name == "COMMANDLINE":
            raise ConfigError(f"--{name.replace('_', '-')} {why}")
