"""What the commands of `limo models` share: where the versions are, and how they print."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Generator

    from rich.table import Table

    from estimators.service.remote_store import RemoteStore
    from estimators.service.store import ModelStore
    from limo_driver.model_client import ModelClient

StoreOption = Annotated[Path, typer.Option("--store", help="Folder of the store.")]
ArmOption = Annotated[
    str | None,
    typer.Option("--arm", help="Ask the running service of this arm instead of a folder."),
]
RobotOption = Annotated[
    str | None, typer.Option("--robot", help="Whose versions, if the store has those of several.")
]
TrustOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--trust", help="Public key (PEM); versions that none of these signed are refused."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
WhichArgument = Annotated[str, typer.Argument(help="Number, champion or challenger.")]
ReasonOption = Annotated[str, typer.Option(help="Why; kept with the change.")]

MODELS = Path("models")


def opened(store: Path, robot: str | None, trust: list[Path] | None = None) -> ModelStore:
    """Open a store."""
    from estimators.service.store import ModelStore

    return ModelStore(store, robot, trust or ())


@contextmanager
def reached(
    store: Path,
    robot: str | None,
    trust: list[Path] | None,
    arm: str | None,
    connect: list[str] | None,
    listen: list[str] | None,
    config: Path | None,
) -> Generator[ModelStore | RemoteStore]:
    """Open a store, or reach that of the running service of an arm.

    Raises:
        ConfigError: Options of the one and of the other are given.
        ConnectionLostError: There is no session to be had.
    """
    from limo_driver.errors import ConfigError

    if arm is None:
        if connect or listen or config:
            raise ConfigError("--connect, --listen and --zenoh-config reach a service: give --arm")
        yield opened(store, robot, trust)
        return
    if store != MODELS or robot or trust:
        raise ConfigError(
            f"--arm {arm} asks a running service, which has its own store and keys: leave out "
            "--store, --robot and --trust"
        )
    from estimators.service.remote_store import RemoteStore

    with asked(arm, connect, listen, config) as client:
        yield RemoteStore(client)


@contextmanager
def asked(
    arm: str, connect: list[str] | None, listen: list[str] | None, config: Path | None
) -> Generator[ModelClient]:
    """Open a session to ask the running service of an arm."""
    from limo_driver.model_client import ModelClient
    from limo_driver.streaming import open_session

    with open_session(connect or (), listen or (), config) as session:
        yield ModelClient(session, arm)


def print_found(values: Any, table: Table | str, *, as_json: bool) -> None:  # noqa: ANN401  # JSON
    """Print values as JSON, or else the table."""
    import json

    from rich.console import Console

    if as_json:
        Console().print_json(json.dumps(values))
    else:
        Console(highlight=False, soft_wrap=isinstance(table, str)).print(table)
