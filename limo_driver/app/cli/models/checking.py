"""`limo models verify` and `sign`: check that a version is unchanged, and sign it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  # typer reads the annotations
from typing import Annotated

import typer

from limo_driver.app.cli.models.options import (
    MODELS,
    JsonOption,
    RobotOption,
    StoreOption,
    TrustOption,
    WhichArgument,
    opened,
    print_found,
)


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


def sign(
    key: Annotated[Path, typer.Argument(help="Private Ed25519 key (PEM, without a password).")],
    which: WhichArgument,
    store: StoreOption = MODELS,
    robot: RobotOption = None,
) -> None:
    """Sign a version with a private key, as `openssl genpkey -algorithm ed25519` makes it.

    Example:
        limo models sign release.pem 2
    """
    models = opened(store, robot)
    models.sign(which, key)
    number = models.number(which)
    print_found(None, f"version {number}: signed with {key}", as_json=False)
