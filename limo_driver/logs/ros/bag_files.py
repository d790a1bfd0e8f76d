"""Bags of ROS 1 (`.bag`) and SQLite files of ROS 2 (`.db3`): their messages as those of a log.

The package rosbags reads chunks of a `.bag` and their index. Messages are rewritten in CDR field by
field, by the definition that a bag of ROS 1 always has, so that all that reads ROS 2 reads them.
rosbags can do that with code that it makes of the definition; none is run here of what a stranger's
file says.

A `.db3` holds two plain tables, topics and messages. A bag that was never closed lacks the
metadata.yaml beside it, without which readers of whole bags refuse it; the tables need none.
"""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import quote

import lz4.frame
import zstandard

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.logs.mcap_chunk import ALWAYS_FINE, LARGEST_CHUNK, MOST_PACKED
from limo_driver.logs.mcap_file import CDR, LoggedMessage
from limo_driver.logs.ros.message_layout import CODES, HEADER, STRING, MessageField, MessageLayout
from limo_driver.network.messages.cdr import ENCODING, LITTLE_ENDIAN, padding
from limo_driver.runtime.given_files import Spent, check_file
from limo_driver.runtime.plugins import require_package

_ZSTD = b"\x28\xb5\x2f\xfd"  # begins what is packed, a message or the whole file
_SQLITE = b"SQLite format 3\x00"
_HEADER = 100  # bytes of a SQLite file
_BLOCK = 1 << 20  # bytes that are unpacked at once
_STEPS = 100_000  # of SQLite's machine, after which the time is looked at: some milliseconds
_LARGEST = 1 << 28  # bytes of one message when unpacked; a damaged length may ask for anything
_DAMAGE = (sqlite3.Error, UnicodeDecodeError)  # which quotes names of a damaged file in its errors


def read_db3(path: Path, tell: Callable[[str], None] | None = None) -> Iterator[LoggedMessage]:
    """Read the messages in CDR of a SQLite bag file, in the order in which they were logged.

    Args:
        path: The file, as it is or packed with zstd (`.db3.zstd`).
        tell: Told, once, if the file was not read to its end, and why.

    Raises:
        RecordingError: The file cannot be read, or is no SQLite bag.
    """
    with _unpacked(path) as file, closing(_opened(file, path)) as bag:
        spent = Spent(path, RecordingError)
        bag.set_progress_handler(lambda: spent.is_over, _STEPS)
        try:
            texts = _definitions(bag)
            topics = {
                key: (str(name), str(kind))
                for key, name, kind, encoding in bag.execute(
                    "SELECT id, name, type, serialization_format FROM topics"
                )
                if encoding == CDR
            }
            rows = bag.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
        except _DAMAGE as error:
            spent.check_time()
            broken = "malformed" in str(error) or isinstance(error, UnicodeDecodeError)
            damaged = broken or _is_cut_off(file)
            what = "is damaged or cut off" if damaged else "is no bag of ROS 2"
            why = "a table is computed (a view)" if "not authorized" in str(error) else error
            raise RecordingError(f"{what}: {why}", path=path) from None
        count, odd, why = -1, 0, ""
        try:
            for count, (key, stamp, data) in enumerate(spent.metered(rows)):  # told below
                if key not in topics:
                    continue
                if not (isinstance(data, bytes) and isinstance(stamp, int)):
                    odd += 1
                    continue
                payload = _unpack(data) if data[:4] == _ZSTD else data
                name, kind = topics[key]
                text = texts.get(kind, b"")
                yield LoggedMessage(name, kind, payload, stamp, stamp, count, text)
        except (*_DAMAGE, zstandard.ZstdError) as error:
            spent.check_time()
            why = f"is damaged after {count + 1} messages and was read up to there: {error}"
        if odd:
            why += f"{'; ' * bool(why)}holds {odd} rows that are no messages: bytes and their time"
        if why and tell is not None:
            tell(why)


def _definitions(bag: sqlite3.Connection) -> dict[str, bytes]:
    """Return the definitions of types, which bags hold since ROS 2 Iron."""
    tables = {str(name) for (name,) in bag.execute("SELECT name FROM sqlite_master")}
    if "message_definitions" not in tables:
        return {}
    found: dict[str, bytes] = {}
    try:
        for kind, encoding, text in bag.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ):
            if encoding == ENCODING:
                found[str(kind)] = str(text).encode()
    except _DAMAGE:  # of a file that was cut off, at whose end they stand
        return found
    return found


def _opened(file: Path, path: Path) -> sqlite3.Connection:
    # a file beside it holds what a recorder that was killed has not merged yet
    unmerged = file.with_name(file.name + "-wal").exists()
    how = "mode=ro" if unmerged else "mode=ro&immutable=1"
    try:
        bag = sqlite3.connect(f"file:{quote(str(file.resolve()))}?{how}", uri=True)
        bag.text_factory = partial(str, encoding="utf-8", errors="replace")
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST)
        if _is_cut_off(file):  # of which SQLite otherwise refuses what is there, too
            bag.execute("PRAGMA writable_schema=ON")
        bag.set_authorizer(_reading)
    except _DAMAGE as error:
        raise RecordingError(f"cannot be read: {error}", path=path) from None
    return bag


def _reading(action: int, *_: object) -> int:
    """Let SQLite read tables, and compute nothing: what a view or a column asks for is refused."""
    is_plain = action in {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ}
    return sqlite3.SQLITE_OK if is_plain else sqlite3.SQLITE_DENY


def _is_cut_off(file: Path) -> bool:
    """Say whether a file lacks pages that its header counts."""
    with file.open("rb") as content:
        head = content.read(_HEADER)
    size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    size = 1 << 16 if size == 1 else size
    return len(head) < _HEADER or file.stat().st_size < size * pages


@contextmanager
def _unpacked(path: Path) -> Generator[Path]:
    """Give the file itself, or a copy that is not packed."""
    try:
        with path.open("rb") as file:
            head = file.read(len(_SQLITE))
            if head == _SQLITE:
                yield path
                return
            if head[:4] != _ZSTD:
                raise RecordingError("is no SQLite file of a ROS 2 bag", path=path)
            file.seek(0)
            with TemporaryDirectory() as folder:
                copy = Path(folder) / "bag.db3"
                with copy.open("wb") as target:
                    spent = Spent(path, RecordingError)
                    try:
                        with zstandard.ZstdDecompressor().stream_reader(file) as source:
                            while block := source.read(_BLOCK):
                                spent.take(unpacked=len(block))
                                target.write(block)
                    except zstandard.ZstdError as error:
                        raise RecordingError(f"is damaged: {error}", path=path) from None
                yield copy
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", path=path) from None


def _unpack(data: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=_LARGEST)


_SEPARATOR: Final = f"\n{'=' * 80}\nMSG: "
_SPLIT: Final = re.compile(r"^=+[ \t]*$\n?", re.MULTILINE)
_BUILT_IN: Final = "".join(
    f"{_SEPARATOR}builtin_interfaces/{kind}\nint32 sec\nuint32 nanosec\n"
    for kind in ("Time", "Duration")
)
_OLD_TIMES: Final = re.compile(r"^(\s*)(time|duration)(?=[\s\[])", re.MULTILINE)
_NUMBER: Final = re.compile(r"^\s*uint32\s+seq\b.*$", re.MULTILINE)  # of a header
_NAMES: Final = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_SEQUENCE: Final = 4  # bytes of that number, which ROS 2 has no more
_COUNT: Final = struct.Struct("<I")
_MOST_PARTS: Final = 100_000  # of one message that are rewritten one by one


def read_ros1(path: Path, tell: Callable[[str], None] | None = None) -> Iterator[LoggedMessage]:
    """Read the messages of a bag of ROS 1, in order of their times.

    Args:
        path: The bag.
        tell: Told, once, if the file was not read to its end, and why.

    Raises:
        MissingPackageError: rosbags is not installed.
        RecordingError: The file cannot be read, or is no bag of ROS 1.
    """
    require_package("rosbags", "a bag of ROS 1")
    check_file(path, RecordingError)
    from rosbags.rosbag1 import Reader

    reader, spent, count = Reader(path), Spent(path, RecordingError), -1
    try:
        reader.open()
    except Exception as error:  # noqa: BLE001  # of damaged bytes, whatever it stumbles over
        why = " ".join(str(error).split()) or type(error).__name__
        if "index" in why:
            why += "; was it cut off, or never closed? `rosbag reindex` may make it whole"
        raise RecordingError(f"cannot be read as a bag of ROS 1: {why}", path=path) from None
    with closing(reader):
        for place, chunk in reader.chunks.items():
            bounded = _UNPACKED.get(chunk.decompressor.__module__.partition(".")[0], bytes)
            reader.chunks[place] = chunk._replace(decompressor=bounded)
        definitions = {x.id: _definition(x.msgtype, x.msgdef.data) for x in reader.connections}
        messages = spent.metered(reader.messages())
        while True:
            try:
                source, stamp, data = next(messages)
                count += 1
            except StopIteration:
                return
            except RecordingError:
                raise
            except Exception as error:  # noqa: BLE001  # likewise
                if tell is not None:
                    tell(f"is damaged after {count + 1} messages and was read up to there: {error}")
                return
            text = definitions[source.id]
            payload = _as_cdr(source.msgtype, text, data)
            yield LoggedMessage(source.topic, source.msgtype, payload, stamp, stamp, count, text)


def _unpacked_lz4(data: bytes) -> bytes:
    return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=_most(data) + 1)


def _unpacked_bz2(data: bytes) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, max_length=_most(data) + 1)


def _most(data: bytes) -> int:
    """Return how many bytes a chunk may unpack to; one that has more is read up to there."""
    return min(LARGEST_CHUNK, max(ALWAYS_FINE, MOST_PACKED * len(data)))


_UNPACKED: Final = {"lz4": _unpacked_lz4, "bz2": _unpacked_bz2}


def _definition(kind: str, text: str) -> bytes:
    """Return the definition of a type as ROS 2 has it."""
    parts = _SPLIT.split(text)
    for k, part in enumerate(parts):
        title = part.strip().partition("\n")[0] if k else f"MSG: {kind.replace('/msg/', '/')}"
        if title.strip() == f"MSG: {HEADER}":
            parts[k] = _NUMBER.sub("", part)
    new = _SEPARATOR.removesuffix("MSG: ").join(parts)
    return (_OLD_TIMES.sub(lambda old: old[1] + _NAMES[old[2]], new) + _BUILT_IN).encode()


@cache
def _layout(kind: str, definition: bytes) -> MessageLayout | None:
    try:
        return MessageLayout(kind, definition.decode())
    except WireFormatError:
        return None


def _as_cdr(kind: str, definition: bytes, data: bytes) -> bytes:
    """Return a message of ROS 1 in CDR; nothing where it is malformed, which no reader takes."""
    layout = _layout(kind, definition)
    try:
        return b"" if layout is None else _Rewritten(layout, data).whole()
    except (WireFormatError, struct.error):
        return b""


class _Rewritten:
    """Fields of ROS 1, which follow each other without gaps, written at the places of CDR."""

    def __init__(self, layout: MessageLayout, data: bytes) -> None:
        self._layout, self._data, self._at = layout, data, 0
        self._out, self._parts = bytearray(LITTLE_ENDIAN), 0

    def whole(self) -> bytes:
        self._copy(self._layout.root, is_header=self._layout.root == HEADER)
        if self._at != len(self._data):
            raise WireFormatError(f"{len(self._data) - self._at} bytes too many", self._at)
        return bytes(self._out)

    def _copy(self, kind: str, *, is_header: bool) -> None:
        self._parts += 1
        if self._parts > _MOST_PARTS:
            raise WireFormatError(f"more than {_MOST_PARTS} parts", self._at)
        self._at += _SEQUENCE * is_header
        for own in self._layout.types[kind]:
            self._copy_field(own)

    def _copy_field(self, own: MessageField) -> None:
        many = 1 if own.many is None else own.many or self._count()
        if own.kind in CODES:
            self._copy_bytes(many, struct.calcsize(f"<{CODES[own.kind]}"))
            return
        for _ in range(many):
            if own.kind == STRING:
                size = _COUNT.unpack_from(self._data, self._at)[0]
                self._at += _COUNT.size
                self._put_count(size + 1)
                self._copy_bytes(size, 1)
                self._out += b"\0"
            else:
                self._copy(own.kind, is_header=own.kind == HEADER)

    def _count(self) -> int:
        """Copy the length of an array, and return it."""
        count = _COUNT.unpack_from(self._data, self._at)[0]
        self._at += _COUNT.size
        if count > len(self._data) - self._at:
            raise WireFormatError(f"an array of {count}", self._at)
        self._put_count(count)
        return count

    def _put_count(self, count: int) -> None:
        self._out += bytes(padding(len(self._out), _COUNT.size))
        self._out += _COUNT.pack(count)

    def _copy_bytes(self, many: int, size: int) -> None:
        if many * size > len(self._data) - self._at:
            raise WireFormatError(f"{many} times {size} bytes", self._at)
        if many:
            self._out += bytes(padding(len(self._out), size))
            self._out += self._data[self._at : self._at + many * size]
            self._at += many * size
