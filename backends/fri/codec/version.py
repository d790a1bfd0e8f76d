"""Versions of FRI: which of them share their messages, and how the bytes tell them apart.

Releases whose messages are the same on the wire form a generation. 1.11 cannot be told from 1.14 to
1.16, nor these from each other, by any byte that is known here: detection names the generation, and
only who started the session knows more.

| generation | versions         | told by                                                        |
|------------|------------------|----------------------------------------------------------------|
| ONE        | 1.11, 1.14-1.16  | bare protobuf, monitor data has field 3 (commanded position)   |
| TWO_FIVE   | 2.5              | bare protobuf, no field 3, but 9 or 10 (Cartesian pose)        |
| TWO_SEVEN  | 2.7              | u32 LE length - 8, protobuf, u32 LE CRC-32 of the protobuf     |
"""

from __future__ import annotations

import zlib
from enum import Enum
from typing import Final

from limo_driver.errors import ConfigError, WireFormatError

FRAME: Final = 8  # bytes around the protobuf of 2.7: length before it, CRC-32 after it
HEADER_TAG: Final = 0x0A  # field 1, length-delimited: every message begins with its header


class Generation(Enum):
    """Versions that share their messages; the value says so to a user."""

    ONE = "1.11 to 1.16"
    TWO_FIVE = "2.5"
    TWO_SEVEN = "2.7"

    @property
    def generation(self) -> Generation:
        """Itself, so that a version and a generation can be given alike."""
        return self

    @property
    def framed(self) -> bool:
        """Whether length and checksum stand around the protobuf."""
        return self is Generation.TWO_SEVEN

    @property
    def versions(self) -> tuple[FriVersion, ...]:
        """The versions of this generation."""
        return tuple(version for version in FriVersion if version.generation is self)


class FriVersion(Enum):
    """A release of FRI that limo speaks."""

    V1_11 = "1.11"
    V1_14 = "1.14"
    V1_15 = "1.15"
    V1_16 = "1.16"
    V2_5 = "2.5"
    V2_7 = "2.7"

    @classmethod
    def named(cls, name: str) -> FriVersion:
        """Return the version of a name such as `1.15`.

        Raises:
            ConfigError: No such version; names those that are known.
        """
        for version in cls:
            if version.value == name:
                return version
        known = ", ".join(version.value for version in cls)
        raise ConfigError(f"FRI version {name!r} is not known; known: {known}")

    @property
    def generation(self) -> Generation:
        """The versions with the same messages."""
        if self is FriVersion.V2_7:
            return Generation.TWO_SEVEN
        return Generation.TWO_FIVE if self is FriVersion.V2_5 else Generation.ONE


def framed(datagram: bytes) -> bool:
    """Say whether a datagram has the length of 2.7 in front and a header after it."""
    return (
        len(datagram) > FRAME
        and int.from_bytes(datagram[:4], "little") == len(datagram) - FRAME
        and datagram[4] == HEADER_TAG
    )


def frame(payload: bytes) -> bytes:
    """Put length and checksum around the protobuf of 2.7."""
    return b"%b%b%b" % (
        len(payload).to_bytes(4, "little"),
        payload,
        zlib.crc32(payload).to_bytes(4, "little"),
    )


def unframed(datagram: bytes) -> bytes:
    """Check the frame of 2.7 and return the protobuf in it.

    Raises:
        WireFormatError: Too short, another length, or a wrong checksum.
    """
    size = len(datagram)
    if size < FRAME:
        raise WireFormatError(f"frame of {size} bytes, expected at least {FRAME}")
    length = int.from_bytes(datagram[:4], "little")
    if length != size - FRAME:
        raise WireFormatError(f"frame says {length} bytes, but {size - FRAME} came")
    payload, given = datagram[4:-4], int.from_bytes(datagram[-4:], "little")
    if given != (computed := zlib.crc32(payload)):
        raise WireFormatError(f"checksum {given:08x}, computed {computed:08x}")
    return payload
