"""One MCAP file of profile ros2: written in chunks, and read even if it was cut off.

Foxglove and `ros2 bag` open such files. A file that was never finished lacks its index at the end;
every complete chunk in it can be read all the same. A damaged byte costs the chunk that it is in.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Message, MessageIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC, Writer
from zstandard import ZstdError

from limo_driver.errors import RecordingError
from limo_driver.logs.mcap_chunk import records_in, unpacked
from limo_driver.network.messages.cdr import ENCODING, SCHEMAS
from limo_driver.runtime import written_by
from limo_driver.runtime.given_files import check_file

CDR = "cdr"
_SEQUENCE_MASK = 0xFFFFFFFF
_RECORD = struct.Struct("<BQ")  # opcode and length
# bytes of a chunk; packing a larger one would hold up other threads for longer than half a
# millisecond, and does not make the file smaller
_CHUNK_SIZE = 65536
_LENGTHS = {int(Opcode.DATA_END): 4, int(Opcode.FOOTER): 20}  # of records of one length [bytes]
_FOOTER = _RECORD.size + _LENGTHS[Opcode.FOOTER]
_SEARCHED = 1 << 20  # bytes that are searched at once for what follows damage
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


_NONE = Schema(id=0, name="", encoding="", data=b"")  # of messages that need none, as in JSON


class LoggedMessage(NamedTuple):
    """One message of a log."""

    topic: str
    schema: str  # name of its type, such as sensor_msgs/msg/JointState
    payload: bytes
    log_time_ns: int  # Unix time at which it was logged
    publish_time_ns: int
    sequence: int  # modulo 2**32
    definition: bytes = b""  # of its type, as the log has it
    encoding: str = CDR  # of the payload


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
            self._writer.start(profile="ros2", library=f"limo {written_by.installed()}")
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


def read_mcap(
    path: Path,
    tell: Callable[[str], None] | None = None,
    encodings: Sequence[str] = (CDR,),
) -> Iterator[LoggedMessage]:
    """Read the messages of a log, in the order in which they were logged.

    A file that was cut off is read up to its last complete chunk; of one with damage in it, the
    chunks that are damaged are left out.

    Args:
        path: Any MCAP file.
        tell: Told, once, if not all of the file was read: how much, and why.
        encodings: Of messages that are wanted.

    Raises:
        RecordingError: The file cannot be read, or is no MCAP file.
    """
    check_file(path, RecordingError)
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordingError("is no MCAP file", path=path)
            stopped = yield from _messages(file, path.stat().st_size, _Contents(encodings))
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", path=path) from None
    if stopped and tell is not None:
        tell(stopped)


@dataclass(frozen=True)
class _Record:
    """One record of the file: what it is, and its bytes."""

    opcode: int
    content: bytes


@dataclass
class _Losses:
    """What of a file could not be read."""

    size: int  # of the file [bytes]
    places: int = 0
    first: int = 0  # byte
    why: str = ""

    def note(self, at: int, why: str) -> None:
        """Note a place at which something is damaged."""
        if not self.places:
            self.first, self.why = at, why
        self.places += 1

    def said(self, read: int, whole: int | None) -> str:
        """Say what is lost; empty for nothing.

        Args:
            read: Messages that were read.
            whole: Messages that the file says it has, if it does.
        """
        missing = "" if whole is None or whole <= read else f"; {read} of {whole} messages are left"
        if not self.places:
            return missing and f"is damaged, and does not say where{missing}"
        places = "one place" if self.places == 1 else f"{self.places} places, first"
        return (
            f"is damaged in {places} at byte {self.first} of {self.size}: {self.why}; the chunk "
            f"there is left out{missing}"
        )


def _messages(
    file: BinaryIO, size: int, contents: _Contents
) -> Generator[LoggedMessage, None, str]:
    """Yield messages; return what of the file could not be read, or nothing."""
    losses, count = _Losses(size), 0
    while True:
        start = file.tell()
        record = _next_record(file, size)
        if record is None:
            if not _find_chunk(file, start + 1, size):
                cut = f"was never finished: read {start} of {size} bytes, the rest is cut off"
                return f"{said}; it {cut}" if (said := losses.said(count, None)) else cut
            losses.note(start, "no record")
            contents.complete(file, size)
            continue
        if record.opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return losses.said(count, _count_of(file, size))
        try:
            messages = contents.messages(record)
        except _DAMAGE as error:
            losses.note(start, str(error))
            after = file.tell()
            if not _is_record(file, after, size) and not _find_chunk(file, start + 1, size):
                file.seek(after)
            contents.complete(file, size)
            continue
        count += len(messages)
        yield from messages


def _next_record(file: BinaryIO, size: int) -> _Record | None:
    """Return the next record, or none if it is cut off, or not one."""
    head = file.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return None
    opcode, length = _RECORD.unpack(head)
    if length > size - file.tell() or opcode == 0:  # no record; blocks never written are zero
        return None
    if opcode in _LENGTHS and length != _LENGTHS[opcode]:
        return None
    return _Record(opcode, file.read(length))


def _is_record(file: BinaryIO, at: int, size: int) -> bool:
    """Say whether a record can begin at a byte; the file stands there afterwards."""
    file.seek(at)
    head = file.read(_RECORD.size)
    file.seek(at)
    if len(head) < _RECORD.size:
        return False
    opcode, length = _RECORD.unpack(head)
    known = 0 < opcode <= Opcode.DATA_END and length <= size - at - _RECORD.size
    return known and _LENGTHS.get(opcode, length) == length


def _find_chunk(file: BinaryIO, start: int, size: int) -> bool:
    """Go on to the next chunk after a byte that can be read; say whether there is one."""
    at, block = start, b""
    while at < size:
        file.seek(at)
        block = file.read(_SEARCHED)
        for place in _places_of(block, bytes([Opcode.CHUNK])):
            if _is_record(file, at + place, size) and _is_sound(file, size):
                file.seek(at + place)
                return True
        at += _SEARCHED
    file.seek(start)
    return False


def _places_of(block: bytes, byte: bytes) -> Iterator[int]:
    place = block.find(byte)
    while place >= 0:
        yield place
        place = block.find(byte, place + 1)


def _is_sound(file: BinaryIO, size: int) -> bool:
    """Say whether the record that begins here is a chunk that can be unpacked."""
    record = _next_record(file, size)
    try:
        return record is not None and bool(unpacked(Chunk.read(_stream(record))))
    except _DAMAGE:
        return False


def _stream(record: _Record) -> ReadDataStream:
    return ReadDataStream(BytesIO(record.content))


def _summary(file: BinaryIO, size: int) -> Iterator[_Record]:
    """Yield the records of the summary at the end of a file that was finished."""
    end = size - _FOOTER - len(MCAP0_MAGIC)
    if end <= 0:
        return
    file.seek(end)
    footer = _next_record(file, size)
    if footer is None or footer.opcode != Opcode.FOOTER:
        return
    start = Footer.read(_stream(footer)).summary_start
    if not 0 < start < end:
        return
    file.seek(start)
    while file.tell() < end and (record := _next_record(file, size)) is not None:
        yield record


def _count_of(file: BinaryIO, size: int) -> int | None:
    """Return the number of messages that the file says it has; None if it does not."""
    try:
        for record in _summary(file, size):
            if record.opcode == Opcode.STATISTICS:
                return Statistics.read(_stream(record)).message_count
    except _DAMAGE:
        pass
    return None


class _Contents:
    """Channels of a file, collected record by record."""

    def __init__(self, encodings: Sequence[str]) -> None:
        self._encodings = encodings
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def messages(self, record: _Record) -> list[LoggedMessage]:
        """Return the messages in a record; an empty list for one that holds none."""
        match record.opcode:
            case Opcode.CHUNK:
                parts = records_in(unpacked(Chunk.read(_stream(record))))
            case Opcode.SCHEMA:
                parts = [Schema.read(_stream(record))]
            case Opcode.CHANNEL:
                parts = [Channel.read(_stream(record))]
            case Opcode.MESSAGE:
                parts = [Message.read(_stream(record), len(record.content))]
            case Opcode.MESSAGE_INDEX:
                MessageIndex.read(_stream(record))  # so that no damaged chunk passes for one
                return []
            case _:
                return []
        found = (self._take(part) for part in parts)
        return [message for message in found if message is not None]

    def complete(self, file: BinaryIO, size: int) -> None:
        """Add the channels that stood in a chunk that is lost, from the end of the file."""
        at = file.tell()
        known = self._schemas.copy(), self._channels.copy()
        with suppress(*_DAMAGE):
            for record in _summary(file, size):
                if record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self.messages(record)
        self._schemas |= known[0]
        self._channels |= known[1]
        file.seek(at)

    def _take(self, part: object) -> LoggedMessage | None:
        match part:
            case Schema():
                self._schemas[part.id] = part
            case Channel():
                self._channels[part.id] = part
            case Message():
                channel = self._channels[part.channel_id]
                encoding = channel.message_encoding
                if encoding in self._encodings:
                    schema = self._schemas[channel.schema_id] if channel.schema_id else _NONE
                    return LoggedMessage(
                        channel.topic,
                        schema.name,
                        part.data,
                        part.log_time,
                        part.publish_time,
                        part.sequence,
                        schema.data if schema.encoding in {ENCODING, encoding} else b"",
                        encoding,
                    )
            case _:
                pass
        return None
