"""Options shared by the commands of `limo models`: where versions are, and how to print them."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limo_driver.app.console.arguments import SessionOptions
from limo_driver.app.console.terminal import terminal
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Generator

    from rich.table import Table

    from estimators.service.store.served_models import RemoteStore
    from estimators.service.store.store import ModelStore
    from limo_driver.network.model_client import ModelClient

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
        "--trust",
        metavar="KEY",
        help="Public key (PEM); versions that none of these signed are refused.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
WhichArgument = Annotated[str, typer.Argument(help="Number, champion or challenger.")]
ReasonOption = Annotated[str, typer.Option(help="Why; kept with the change.")]

MODELS = Path("models")


def opened(store: Path, robot: str | None, trust: list[Path] | None = None) -> ModelStore:
    """Open a store."""
    from estimators.service.store.store import ModelStore

    return ModelStore(store, robot, trust or ())


@dataclass(frozen=True)
class VersionSource:
    """Source of versions: a store, or the running service of an arm."""

    store: StoreOption = MODELS
    robot: RobotOption = None
    trust: TrustOption = None
    arm: ArmOption = None
    network: SessionOptions = field(default_factory=SessionOptions)

    @contextmanager
    def reached(self) -> Generator[ModelStore | RemoteStore]:
        """Open the store, or reach that of the running service.

        Raises:
            ConfigError: Options of the one and of the other are given.
            ConnectionLostError: There is no session to be had.
        """
        if self.arm is None:
            yield self.opened()
            return
        from estimators.service.store.served_models import RemoteStore

        with self.asked() as client:
            yield RemoteStore(client)

    def opened(self) -> ModelStore:
        """Open the store.

        Raises:
            ConfigError: Options of a running service are given.
        """
        if any(self.network.ends):
            raise ConfigError("--connect, --listen and --zenoh-config reach a service: give --arm")
        return opened(self.store, self.robot, self.trust)

    @contextmanager
    def asked(self) -> Generator[ModelClient]:
        """Open a session to ask the running service of the arm, which has to be named.

        Raises:
            ConfigError: Options of a store are given.
            ConnectionLostError: There is no session to be had.
        """
        assert self.arm is not None  # noqa: S101  # else there is nobody to ask
        if self.store != MODELS or self.robot or self.trust:
            raise ConfigError(
                f"--arm {self.arm} asks a running service, which has its own store and keys: "
                "leave out --store, --robot and --trust"
            )
        with asked(self.arm, self.network) as client:
            yield client


@contextmanager
def asked(arm: str, network: SessionOptions) -> Generator[ModelClient]:
    """Open a session to ask the running service of an arm."""
    from limo_driver.network.model_client import ModelClient

    with network.open() as session:
        yield ModelClient(session, arm)


def print_found(values: Any, table: Table | str, *, as_json: bool) -> None:  # noqa: ANN401  # JSON
    """Print values as JSON, or else the table."""
    if as_json:
        terminal().print_json(data=values)
    else:
        terminal(soft_wrap=isinstance(table, str)).print(table)
