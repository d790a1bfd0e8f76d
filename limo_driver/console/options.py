"""Options that several commands share, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# What every `--robot` takes.
ROBOTS = "built-in name, URDF, MJCF or USD; joints are chosen as in 'arm.urdf#arm_*,gripper=0.02'"

MappingOption = Annotated[
    Path | None,
    typer.Option(help="What the columns of another format are; `limo inspect` writes one."),
]
