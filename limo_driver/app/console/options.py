"""Options that several commands share, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Container

# What every `--robot` takes.
ROBOTS = "built-in name, URDF, MJCF or USD; joints are chosen as in 'arm.urdf#arm_*,gripper=0.02'"

MappingOption = Annotated[
    Path | None,
    typer.Option(help="What the columns of another format are; `limo inspect` writes one."),
]


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
