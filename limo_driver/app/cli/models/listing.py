"""`limo models list` and `show`: the versions in a store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from limo_driver.app.cli.models.options import (
    JsonOption,
    VersionSource,
    WhichArgument,
    print_found,
    with_place,
)

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.service.store.aliases import Aliases
    from estimators.service.store.version import Version


@with_place
def list_versions(
    place: VersionSource,
    as_json: JsonOption = False,
) -> None:
    """List the versions of a store, and which of them is the champion.

    Examples:
        limo models list --store models/
        limo models list --arm iiwa14
    """
    from estimators.service.store.remote_store import RemoteStore
    from limo_driver.app.console.terminal import terminal

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


@with_place
def show(
    place: VersionSource,
    which: WhichArgument = "champion",
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
