"""Options shared by the commands of `limo models`: where versions are, and how to print them."""

from __future__ import annotations

import inspect
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from limo_driver.network.config import ConfigFile, Connect, Listen  # noqa: TC001  # typer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

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
    connect: Connect = None
    listen: Listen = None
    config: ConfigFile = None

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
        from limo_driver.errors import ConfigError

        if self.connect or self.listen or self.config:
            raise ConfigError("--connect, --listen and --zenoh-config reach a service: give --arm")
        return opened(self.store, self.robot, self.trust)

    @contextmanager
    def asked(self) -> Generator[ModelClient]:
        """Open a session to ask the running service of the arm, which has to be named.

        Raises:
            ConfigError: Options of a store are given.
            ConnectionLostError: There is no session to be had.
        """
        from limo_driver.errors import ConfigError

        assert self.arm is not None  # noqa: S101  # else there is nobody to ask
        if self.store != MODELS or self.robot or self.trust:
            raise ConfigError(
                f"--arm {self.arm} asks a running service, which has its own store and keys: "
                "leave out --store, --robot and --trust"
            )
        with asked(self.arm, self.connect, self.listen, self.config) as client:
            yield client


def with_place(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of a `VersionSource`, which it takes as its first argument.

    Typer reads options from a signature, so that this has all of them: the command's own, those of
    the place, and `as_json` at the end.
    """
    hints = get_type_hints(VersionSource, include_extras=True)
    _, *own = inspect.signature(command, eval_str=True).parameters.values()
    added = [
        inspect.Parameter(
            item.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=item.default,
            annotation=hints[item.name],
        )
        for item in fields(VersionSource)
    ]
    own = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own]
    every = [*own[:-1], *added, own[-1]]

    @wraps(command)
    def with_options(**given: object) -> None:
        place = VersionSource(**{item.name: given.pop(item.name) for item in fields(VersionSource)})  # type: ignore[arg-type]
        command(place, **given)

    with_options.__dict__["__signature__"] = inspect.Signature(every)
    with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in every}
    return with_options


@contextmanager
def asked(
    arm: str, connect: list[str] | None, listen: list[str] | None, config: Path | None
) -> Generator[ModelClient]:
    """Open a session to ask the running service of an arm."""
    from limo_driver.network.model_client import ModelClient
    from limo_driver.network.streaming import open_session

    with open_session(connect or (), listen or (), config) as session:
        yield ModelClient(session, arm)


def print_found(values: Any, table: Table | str, *, as_json: bool) -> None:  # noqa: ANN401  # JSON
    """Print values as JSON, or else the table."""
    import json

    from limo_driver.app.console.terminal import terminal

    if as_json:
        terminal().print_json(json.dumps(values))
    else:
        terminal(soft_wrap=isinstance(table, str)).print(table)
