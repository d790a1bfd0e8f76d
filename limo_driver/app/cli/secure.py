"""`limo secure`: certificates, passwords and access control for a network that others can reach."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limo_driver.app.console.command_line import describe_options
from limo_driver.app.console.terminal import say

DRIVER_PORT = 7447
SERVICE_PORT = 7448


@describe_options
def command(
    *,
    out: Path,
    driver: Annotated[str, typer.Option(metavar="HOST[:PORT]")],
    service: Annotated[str, typer.Option(metavar="HOST[:PORT]")],
    days: int = 365,
    force: bool = False,
) -> None:
    """Make an authority, and for each role a certificate, a password and a Zenoh configuration.

    Roles are driver, service, operator (may send commands and change models) and viewer (may only
    read). Whoever holds a role's folder has the role: copy each to where it is used, and keep
    `authority/` to yourself.

    Args:
        out: Folder to write, one folder in it for each role.
        driver: Where `limo run` is reached; port 7447 if none.
        service: Where `limo serve` is reached; port 7448 if none.
        days: For which the certificates are valid.
        force: Write over an earlier folder; its certificates end there.

    Examples:
        limo secure --out trust/ --driver robot.local --service 192.168.1.3
        limo run --stream --zenoh-config trust/driver/zenoh.json5 ...
        limo watch --zenoh-config trust/viewer/zenoh.json5
    """
    from limo_driver.network.trust import write_trust
    from limo_driver.network.trust.roles import ROLES, Host

    hosts = {
        "driver": Host.parse(driver, DRIVER_PORT),
        "service": Host.parse(service, SERVICE_PORT),
    }
    written = write_trust(out, hosts, days, force=force)
    for name, path in written.configurations.items():
        say(f"{path}: {ROLES[name].purpose}")
