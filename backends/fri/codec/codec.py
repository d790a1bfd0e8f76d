"""FRI messages to bytes and back.

```python
state = decode_monitoring(datagram)  # of whatever version the bytes are
answer = encode_command(Command(Header(0, state.header.sequence)), FriVersion.named("1.15"))
```
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from backends.fri.codec.decoding import decode
from backends.fri.codec.encoding import encode
from backends.fri.codec.layouts import LAYOUTS
from backends.fri.codec.version import FriVersion, Generation, detect

if TYPE_CHECKING:
    from backends.fri.codec.messages import Command, Monitoring

Version: TypeAlias = FriVersion | Generation


def decode_monitoring(data: bytes, version: Version | None = None) -> Monitoring:
    """Decode the robot's monitoring message.

    Args:
        data: One datagram.
        version: Told from the bytes if not given; 1.x where they do not say.

    Raises:
        WireFormatError: No monitoring message of that version.
    """
    generation = (detect(data) or Generation.ONE) if version is None else version.generation
    return decode(data, LAYOUTS[generation].monitoring, generation)


def decode_command(data: bytes, version: Version) -> Command:
    """Decode a client's command message.

    Raises:
        WireFormatError: No command of that version.
    """
    return decode(data, LAYOUTS[version.generation].command, version.generation)


def encode_monitoring(message: Monitoring, version: Version) -> bytes:
    """Encode the robot's monitoring message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, LAYOUTS[version.generation].monitoring, version.generation)


def encode_command(message: Command, version: Version) -> bytes:
    """Encode a client's command message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, LAYOUTS[version.generation].command, version.generation)
