"""One MCAP file of profile ros2: written in chunks, and read even if it was cut off.

Foxglove and `ros2 bag` open such files. A file that was never finished lacks its index at the end;
every complete chunk in it can be read all the same.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC, Writer
from zstandard import ZstdError

from limo_driver.errors import RecordingError
from limo_driver.network.messages.schemas import ENCODING, SCHEMAS

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from pathlib import Path
    from typing import BinaryIO

CDR = "cdr"
_SEQUENCE_MASK = 0xFFFFFFFF
_RECORD = struct.Struct("<BQ")  # opcode and length
# bytes of a chunk; packing a larger one would hold up other threads for longer than half a
# millisecond, and does not make the file smaller
_CHUNK_SIZE = 65536
_LARGEST_CHUNK = 1 << 30  # bytes when unpacked; a damaged length may ask for anything
# what the mcap package and its decompressors raise on damaged bytes
_DAMAGE = (
    McapError,
    ValueError,
    KeyError,
    RuntimeError,
    OverflowError,
    MemoryError,
    struct.error,
    ZstdError,
)


class LoggedMessage(NamedTuple):
    """One message of a log."""

    topic: str
    schema: str  # name of its type, such as sensor_msgs/msg/JointState
    payload: bytes
    log_time_ns: int  # Unix time at which it was logged
    publish_time_ns: int
    sequence: int  # modulo 2**32


class McapWriter:
    """Writes one MCAP file; channels and their schemas appear with their first message.

    Args:
        path: To be made.

    Raises:
        OSError: From the constructor and every method, where the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=_CHUNK_SIZE)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        try:
            self._writer.start(profile="ros2", library="limo")
            self.sync()
        except BaseException:  # nothing is in it, and another try begins another
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.tell()

    def add(self, message: LoggedMessage) -> None:
        """Add a message whose schema is one of `SCHEMAS` to the chunk under way."""
        channel = self._channels.get((message.topic, message.schema))
        if channel is None:
            channel = self._new_channel(message.topic, message.schema)
        self._writer.add_message(
            channel,
            message.log_time_ns,
            message.payload,
            message.publish_time_ns,
            message.sequence & _SEQUENCE_MASK,
        )
        self.messages += 1

    def sync(self) -> None:
        """Finish the chunk and wait until it is on the disk."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write the index and close the file."""
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, after it could not be written."""
        try:
            self._file.close()
        except OSError:  # what is still in the buffer cannot be written either
            return

    def _new_channel(self, topic: str, schema: str) -> int:
        if schema not in self._schemas:
            definition = SCHEMAS[schema].encode()
            self._schemas[schema] = self._writer.register_schema(schema, ENCODING, definition)
        channel = self._writer.register_channel(
            topic, CDR, self._schemas[schema], {"offered_qos_profiles": ""}
        )
        self._channels[topic, schema] = channel
        return channel


def read_mcap(path: Path, tell: Callable[[str], None] | None = None) -> Iterator[LoggedMessage]:
    """Read the messages in CDR of a log, in the order in which they were logged.

    A file that was cut off, or has damage in it, is read up to its last complete chunk.

    Args:
        path: Any MCAP file.
        tell: Told, once, if the file was not read to its end, and why.

    Raises:
        RecordingError: The file cannot be read, or is no MCAP file.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordingError("is no MCAP file", path=path)
            stopped = yield from _messages(file, path.stat().st_size)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", path=path) from None
    if stopped and tell is not None:
        tell(stopped)


@dataclass(frozen=True)
class _Record:
    """One record of the file: what it is, and its bytes."""

    opcode: int
    content: bytes


def _messages(file: BinaryIO, size: int) -> Generator[LoggedMessage, None, str]:
    """Yield messages; return what stopped it before the end of the data, or nothing."""
    contents = _Contents()
    while True:
        start = file.tell()
        record = _next_record(file, size)
        if record is None:
            return f"was never finished: read {start} of {size} bytes, the rest is cut off"
        if record.opcode == Opcode.DATA_END:
            return ""
        try:
            messages = contents.messages(record)
        except _DAMAGE as error:
            return f"is damaged at byte {start} of {size} and was read up to there: {error}"
        yield from messages


def _next_record(file: BinaryIO, size: int) -> _Record | None:
    """Return the next record, or none if it is cut off."""
    head = file.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return None
    opcode, length = _RECORD.unpack(head)
    if length > size - file.tell() or opcode == 0:  # no record; blocks never written are zero
        return None
    return _Record(opcode, file.read(length))


class _Contents:
    """Channels of a file, collected record by record."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def messages(self, record: _Record) -> list[LoggedMessage]:
        """Return the messages in a record; an empty list for one that holds none."""
        stream = ReadDataStream(BytesIO(record.content))
        match record.opcode:
            case Opcode.CHUNK:
                chunk = Chunk.read(stream)
                if chunk.uncompressed_size > _LARGEST_CHUNK:
                    raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
                parts = breakup_chunk(chunk, validate_crc=True)
            case Opcode.SCHEMA:
                parts = [Schema.read(stream)]
            case Opcode.CHANNEL:
                parts = [Channel.read(stream)]
            case Opcode.MESSAGE:
                parts = [Message.read(stream, len(record.content))]
            case _:
                return []
        found = (self._take(part) for part in parts)
        return [message for message in found if message is not None]

    def _take(self, part: object) -> LoggedMessage | None:
        match part:
            case Schema():
                self._schemas[part.id] = part
            case Channel():
                self._channels[part.id] = part
            case Message():
                channel = self._channels[part.channel_id]
                if channel.message_encoding == CDR:
                    return LoggedMessage(
                        channel.topic,
                        self._schemas[channel.schema_id].name,
                        part.data,
                        part.log_time,
                        part.publish_time,
                        part.sequence,
                    )
            case _:
                pass
        return None
