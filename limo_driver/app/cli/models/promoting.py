"""`limo models load`, `promote` and `rollback`: which version serves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from limo_driver.app.cli.models.options import (
    JsonOption,
    ReasonOption,
    VersionSource,
    WhichArgument,
    asked,
    print_found,
    with_place,
)
from limo_driver.network.options import ConfigFile, Connect, Listen  # noqa: TC001  # typer

if TYPE_CHECKING:
    from estimators.service.store.aliases import Aliases


def load(
    which: WhichArgument,
    arm: Annotated[str, typer.Option(help="Whose running service is asked.")],
    connect: Connect = None,
    listen: Listen = None,
    config: ConfigFile = None,
    as_json: JsonOption = False,
) -> None:
    """Let a version serve in a running service until that ends; the champion stays what it is.

    The service vets it first, which takes some seconds; the old version serves on meanwhile, and
    also where the new one is refused.

    Example:
        limo models load 2 --arm iiwa14
    """
    with asked(arm, connect, listen, config) as client:
        facts = client.load(which)
    text = f"version {facts['version']} serves instead of {facts['before']}"
    print_found(facts, text, as_json=as_json)


@with_place
def promote(
    place: VersionSource,
    which: WhichArgument,
    reason: ReasonOption = "by hand",
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


@with_place
def rollback(
    place: VersionSource,
    reason: ReasonOption = "by hand",
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
