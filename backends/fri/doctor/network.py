"""Network of this machine: whether it reaches a robot without a gateway, from its own tables."""

from __future__ import annotations

import socket
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path
from typing import Final

_ROUTES: Final = Path("/proc/net/route")
_DISCARD: Final = 9  # the port that a route is asked for; nothing is sent


def networks() -> tuple[IPv4Network, ...]:
    """Return the networks that this machine is directly in; none where the tables cannot be read.

    Linux keeps addresses as hexadecimal numbers in the byte order of the machine.
    """
    try:
        lines = _ROUTES.read_text().splitlines()[1:]
    except OSError:
        return ()
    found: list[IPv4Network] = []
    for columns in (line.split() for line in lines):
        try:
            target, gateway, mask = (
                IPv4Address(int(columns[k], 16).to_bytes(4, "little")) for k in (1, 2, 7)
            )
            if int(gateway) == 0 and int(mask) != 0:
                found.append(IPv4Network(f"{target}/{mask}"))
        except (ValueError, IndexError):
            continue
    return tuple(found)


def near(address: str) -> bool:
    """Say whether an address is reached without a gateway; loopback always is."""
    given = IPv4Address(address)
    return given.is_loopback or any(given in network for network in networks())


def own_address(towards: str) -> str | None:
    """Return this machine's address towards another; None if there is no way to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((towards, _DISCARD))
        except OSError:
            return None
        return str(probe.getsockname()[0])
