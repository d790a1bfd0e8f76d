"""`limo models retrain` and `compare`: a challenger, and whether it is better.

Options shared by the commands of `limo models`: where versions are, and how to print them.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limo_driver.app.console.command_line import MappingOption, SessionOptions, describe_options
from limo_driver.app.console.terminal import table_of, terminal
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import require_file, whole

if TYPE_CHECKING:
    from collections.abc import Generator

    from rich.table import Table

    from estimators.service.gate import Comparison
    from estimators.service.store.served_models import RemoteStore
    from estimators.service.store.store import ModelStore
    from estimators.service.store.version import Version
    from limo_driver.network.readiness import ModelClient

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
    from limo_driver.network.readiness import ModelClient

    with network.open() as session:
        yield ModelClient(session, arm)


def print_found(values: Any, table: Table | str, *, as_json: bool) -> None:  # noqa: ANN401  # JSON
    """Print values as JSON, or else the table."""
    if as_json:
        terminal().print_json(data=values)
    else:
        terminal(soft_wrap=isinstance(table, str)).print(table)


_NAME = re.compile(r"(.+)_\d{8}T\d{6}\.\d{6}Z")


@describe_options
def retrain(
    *,
    reason: ReasonOption = "by hand",
    log: Path | None = None,
    name: str | None = None,
    seconds: Annotated[float, typer.Option(min=0.0)] = 300.0,
    kind: str = "same",
    delay: float = 0.1,
    sign: Path | None = None,
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """Train a challenger from the newest motion in logs, outside of contact.

    With --arm, the running service does it: it judges the challenger on live states, and promotes
    it if it is better. With --log, the version is added to a store and compared with its champion
    on the last part of the motion; nothing serves by that.

    Args:
        log: Folder of a service's logs to learn from, without --arm.
        name: Of the arm in the logs, if they are of several.
        seconds: Of the newest motion.
        kind: Same as the champion, joint-physics, or a network, for example lstm-fcl.
        delay: Delay of the live estimate [s].
        sign: Private key (PEM), with which the version is signed.

    Examples:
        limo models retrain --arm iiwa14 --reason "the tool was changed"
        limo models retrain --store models/ --log logs/ --seconds 600
    """
    if (place.arm is None) == (log is None):
        raise ConfigError("give --arm to ask a running service, or --log to learn without one")
    if place.arm is not None:
        if name is not None or sign is not None or kind != "same":
            raise ConfigError(
                "--name, --sign and --kind are for training from --log; the service has its own"
            )
        with place.asked() as client:
            stage = client.retrain(reason)
        print_found(stage, f"a challenger will be trained: {reason}", as_json=as_json)
        return
    assert log is not None  # noqa: S101  # checked above
    store = place.opened()
    from estimators.service.retraining.logged_motion import Span, newest_motion
    from estimators.service.retraining.trainer import check_kind, train
    from estimators.service.store.aliases import check_signing
    from estimators.service.store.store import ModelStore

    check_kind(kind)
    if sign is not None:
        check_signing(sign, store.trusted_keys)
    joints = store.open("champion").joints
    motion = newest_motion(log, name or _only_arm(log), joints, Span(seconds))
    signing = ModelStore(store.root, store.robot, store.trusted_keys, sign)
    found = train(signing, motion, delay, kind)
    print_found(found, _describe(found), as_json=as_json)


def _only_arm(folder: Path) -> str:
    """Return the arm that the logs of a folder are of.

    Raises:
        ConfigError: There are none, or of several arms.
    """
    found = sorted({m[1] for path in folder.glob("*.mcap") if (m := _NAME.fullmatch(path.stem))})
    if len(found) != 1:
        text = f"of {', '.join(found)}; say which with --name" if found else "of no arm"
        raise ConfigError(f"holds logs {text}", path=folder)
    return found[0]


def _describe(found: dict[str, Any]) -> str:
    against = found["metrics"]["against_champion"]
    return (
        f"version {found['version']}, trained on {found['data']['samples']} states: "
        f"{against['reason']}, beside version {found['parent']}"
    )


@describe_options
def compare(
    champion: WhichArgument,
    challenger: WhichArgument,
    *,
    data: Path,
    block: float = 5.0,
    out: Path | None = None,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
    trust: TrustOption = None,
    mapping: MappingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the errors of two versions joint by joint, with intervals.

    The intervals are of paired errors, averaged over blocks. The last line says whether the second
    version would be promoted over the first: better on average, and worse on no joint.

    Args:
        data: Recording that neither was trained on.
        block: Length of a block [s]; longer than errors remember.
        out: Where to write a picture (PNG).

    Example:
        limo models compare champion 2 --data test.parquet --out difference.png
    """
    from estimators.service.comparison import compare_versions, difference_figure
    from limo_driver.app.library.reading import read

    if out is not None:
        require_file(out, [data])
    models = opened(store, robot, trust)
    versions = models.open(champion), models.open(challenger)
    found = compare_versions(*versions, read(data, mapping=mapping), block)
    if out is not None:
        from estimators.evaluation_page import png

        names = [f"version {version.number}" for version in versions]
        with whole(out) as draft:
            draft.write_bytes(png(difference_figure(found, versions[0].joints, names)))
    print_found(found.as_values(), _table(found, versions), as_json=as_json)


def _table(found: Comparison, versions: tuple[Version, Version]) -> Table:

    first, second = (f"version {version.number}" for version in versions)
    table = table_of(
        "joint", first, second, "difference", "95 % interval", "ratio\nof MSE",
        title=f"RMSE [N m] of {first} and {second}, {found.blocks} blocks",
        caption=("promote: " if found.promote else "do not promote: ") + found.reason,
    )  # fmt: skip
    for j, name in enumerate(versions[0].joints):
        table.add_row(
            name,
            f"{found.champion[j]:.4f}",
            f"{found.challenger[j]:.4f}",
            f"{found.difference.value[j]:+.4f}",
            f"{found.difference.low[j]:+.4f} to {found.difference.high[j]:+.4f}",
            f"{found.ratio.value[j]:.3g}",
        )
    return table
