"""Tell from answers that a client was built for another version of FRI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from backends.fri.codec.decoding import decode
from backends.fri.codec.layouts import LAYOUTS
from backends.fri.codec.version import Generation
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from backends.fri.codec.messages import Command
    from backends.fri.codec.version import FriVersion


def spoken(data: bytes, version: FriVersion) -> str:
    """Say whose command a datagram is that is none of this version; empty if nobody's."""
    for generation in Generation:
        if generation is version.generation:
            continue
        try:
            decode(data, LAYOUTS[generation].command, generation)
        except WireFormatError:
            continue
        framing = "framed" if generation.framed else "not framed"
        return _said(f"is {framing}, as those of FRI {generation.value}", version)
    return ""


def monitored_as_of(command: Command, version: FriVersion) -> str:
    """Say for which version a client was built that answers so while it is monitored.

    Clients of 1.x send back the commanded position; later ones send the header alone.
    """
    mirrors = command.data is not None and command.data.joint_position is not None
    if version.generation is Generation.ONE:
        return "" if mirrors else _said("has no position, as those of FRI 2.5 and later", version)
    return _said("has a position, as those of FRI 1.x", version) if mirrors else ""


def _said(what: str, version: FriVersion) -> str:
    return (
        f"version mismatch: an answer {what}, but this controller speaks {version.value}: "
        "build the client for that, or choose --fri"
    )
