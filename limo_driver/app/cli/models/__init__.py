"""`limo models`: versions of models in a store or a running service, and which of them serves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limo_driver.app.cli.models.retraining import (
    MODELS,
    JsonOption,
    ReasonOption,
    RobotOption,
    StoreOption,
    TrustOption,
    VersionSource,
    WhichArgument,
    asked,
    compare,
    opened,
    print_found,
    retrain,
)
from limo_driver.app.console.command_line import MappingOption, SessionOptions, describe_options
from limo_driver.app.console.terminal import terminal

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.service.store.aliases import Aliases
    from estimators.service.store.version import Version

command = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@describe_options
def add(
    folder: Path,
    *,
    golden: Path,
    test: Path | None = None,
    parent: int | None = None,
    delay: float = 0.1,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
    mapping: MappingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add a model folder to a store as its next version.

    It is loaded, copied, and answers to some seconds of motion, which are kept: whoever loads it
    later sees whether it still answers the same.

    Args:
        folder: Model folder of `limo train`.
        golden: Recording, whose liveliest seconds are kept with the answer.
        test: Recording not trained on, for the errors to keep.
        parent: Version that this one came from.
        delay: Delay of the live estimate [s].

    Example:
        limo models add model/ --golden run.parquet --test test.parquet
    """
    from estimators.service.comparison import metrics
    from limo_driver.app.library.reading import read

    motion = read(golden, mapping=mapping)
    record = {} if test is None else {"metrics": metrics(folder, read(test, mapping=mapping))}
    models = opened(store, robot)
    version = models.add(folder, golden=motion, parent=parent, record=record, delay=delay)
    print_found(dict(version.record), f"{version.path}: version {version.number}", as_json=as_json)


def verify(
    which: WhichArgument = "champion",
    store: StoreOption = MODELS,
    robot: RobotOption = None,
    trust: TrustOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check files and signature of a version, load it, and replay its golden motion.

    Example:
        limo models verify champion --trust release.pub
    """
    models = opened(store, robot, trust)
    number = models.number(which)
    deviation = models.verify(number)
    print_found(
        {"version": number, "deviation": deviation},
        f"version {number}: all files as added; its torque differs by {deviation:.2g} N m at most",
        as_json=as_json,
    )


@describe_options
def sign(
    key: Path,
    which: WhichArgument,
    *,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
) -> None:
    """Sign a version with a private key, as `openssl genpkey -algorithm ed25519` makes it.

    Args:
        key: Private Ed25519 key (PEM, without a password).

    Example:
        limo models sign release.pem 2
    """
    models = opened(store, robot)
    models.sign(which, key)
    number = models.number(which)
    print_found(None, f"version {number}: signed with {key}", as_json=False)


@describe_options
def list_versions(
    *,
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """List the versions of a store, and which of them is the champion.

    Examples:
        limo models list --store models/
        limo models list --arm iiwa14
    """
    from estimators.service.store.served_models import RemoteStore

    left_out: list[str] = []
    with place.reached() as models:
        versions, aliases = models.versions(left_out.append), models.aliases
        serving = models.serving if isinstance(models, RemoteStore) else None
    names = {v.number: aliases.of(v.number) for v in versions}
    names |= {v.number: (*names[v.number], "serves") for v in versions if str(v.number) == serving}
    values = [{**v.record, "aliases": names[v.number]} for v in versions]
    for reason in left_out:
        terminal(stderr=True, soft_wrap=True).print(f"left out: {reason}")
    print_found(values, _table(versions, names), as_json=as_json)


@describe_options
def show(
    which: WhichArgument = "champion",
    *,
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """Show what a version is, what it learned from, and how its aliases changed.

    Example:
        limo models show champion
    """
    from dataclasses import asdict

    with place.reached() as models:
        version, aliases = models.open(which), models.aliases
    changes = [asdict(c) for c in aliases.history if version.number in (c.before, c.after)]
    values = {**version.record, "aliases": aliases.of(version.number), "history": changes}
    print_found(values, _description(version, aliases, changes), as_json=as_json)


def _table(versions: tuple[Version, ...], names: dict[int, tuple[str, ...]]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        title=f"Models of {versions[0].robot}" if versions else "No models",
        caption="step: CPU time of a live step, 99th percentile, on the day it was added",
    )
    for heading in ("version", "parent", "estimator", "created (UTC)", "step [µs]", "alias"):
        table.add_column(heading, justify="right" if heading in {"version", "parent"} else "left")
    for version in versions:
        record = version.record
        table.add_row(
            str(version.number),
            str(record["parent"] or ""),
            version.estimator,
            record["created"][:19].replace("T", " "),
            f"{1e6 * record['latency']['p99']:.0f}",
            ", ".join(names[version.number]),
        )
    return table


def _description(version: Version, aliases: Aliases, changes: list[dict[str, Any]]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    record = version.record
    title = ", ".join((f"Version {version.number} of {version.robot}", *aliases.of(version.number)))
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_header=False, title=title)
    table.add_row("estimator", version.estimator)
    table.add_row("parent", str(record["parent"] or "none"))
    table.add_row("created (UTC)", f"{record['created']}, by limo {record['code']}")
    table.add_row("joints", ", ".join(version.joints))
    table.add_row("filters", f"{record['input']['bandwidth']:g} Hz")
    latency = record["latency"]
    table.add_row(
        "CPU time of a live step",
        f"{1e6 * latency['p50']:.0f} µs, 99th percentile {1e6 * latency['p99']:.0f} µs",
    )
    for item in record["data"]:
        table.add_row("learned from", f"{item['file'] or 'a recording'}, {item['samples']} samples")
    if metrics := record["record"].get("metrics"):
        rows = zip(metrics["rmse"], metrics["low"], metrics["high"], strict=True)
        for name, (rmse, low, high) in zip(version.joints, rows, strict=True):
            interval = "too short for an interval" if low is None else f"{low:.4f} to {high:.4f}"
            table.add_row(f"RMSE of {name}", f"{rmse:.4f} N m ({interval})")
    for change in changes:
        table.add_row(
            f"{change['time'][:19].replace('T', ' ')}",
            f"{change['action']} {change['before'] or 'none'} → {change['after'] or 'none'}: "
            f"{change['reason']}",
        )
    return table


@describe_options
def load(
    which: WhichArgument,
    *,
    arm: str,
    network: SessionOptions,
    as_json: JsonOption = False,
) -> None:
    """Let a version serve in a running service until that ends; the champion stays what it is.

    The service vets it first, which takes some seconds; the old version serves on meanwhile, and
    also where the new one is refused.

    Args:
        arm: Whose running service is asked.

    Example:
        limo models load 2 --arm iiwa14
    """
    with asked(arm, network) as client:
        facts = client.load(which)
    text = f"version {facts['version']} serves instead of {facts['before']}"
    print_found(facts, text, as_json=as_json)


@describe_options
def promote(
    which: WhichArgument,
    *,
    reason: ReasonOption = "by hand",
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """Make a version the champion; its files are checked first.

    With --arm the running service vets it and lets it serve at once.

    Examples:
        limo models promote 2 --reason "better on all joints"
        limo models promote 2 --arm iiwa14
    """
    with place.reached() as models:
        _print(models.promote(which, reason), as_json=as_json)


@describe_options
def rollback(
    *,
    reason: ReasonOption = "by hand",
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """Make the champion before the champion again.

    Examples:
        limo models rollback --reason "worse since the tool was changed"
        limo models rollback --arm iiwa14
    """
    with place.reached() as models:
        _print(models.rollback(reason), as_json=as_json)


def _print(aliases: Aliases, *, as_json: bool) -> None:
    from dataclasses import asdict

    last = aliases.history[-1]
    before = "" if last.before is None else f" instead of {last.before}"
    print_found(asdict(aliases), f"champion: version {last.after}{before}", as_json=as_json)


@command.callback()
def models() -> None:
    """Keep versions of models, compare them, and say which one serves.

    A store is a folder; a version in it never changes. The champion is the version that serves.
    With --arm, a running service is asked.

    Examples:
        limo models add model/ --golden run.parquet
        limo models promote 1 --reason "the first"
        limo models compare champion 2 --data test.parquet
        limo models list --arm iiwa14
    """


command.command(name="list")(list_versions)
for _other in (show, add, load, promote, rollback, retrain, compare, verify, sign):
    command.command()(_other)
