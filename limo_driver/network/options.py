"""Options of every command that goes on the network."""

from __future__ import annotations

from pathlib import Path  # typer reads the annotations
from typing import Annotated, TypeAlias

import typer

Connect: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ENDPOINT",
        help="Zenoh endpoint to reach, for example tcp/192.168.1.2:7447; several count.",
    ),
]
Listen: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ENDPOINT",
        help="Zenoh endpoint to be reached at, for example tcp/0.0.0.0:7447.",
    ),
]
ConfigFile: TypeAlias = Annotated[
    Path | None,
    typer.Option("--zenoh-config", help="Zenoh's own configuration (JSON5): routers, TLS, users."),
]
RosDomain: TypeAlias = Annotated[
    int,
    typer.Option(help="ROS_DOMAIN_ID of the ROS 2 nodes."),
]
