"""One SQLite file of a ROS 2 bag (`.db3`), read even where the recorder was killed.

The file holds two plain tables, topics and messages. A bag that was never closed lacks the
metadata.yaml beside it, without which readers of whole bags refuse it; the tables need none.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from urllib.parse import quote

import zstandard

from limo_driver.errors import RecordingError
from limo_driver.logs.mcap_file import CDR, LoggedMessage
from limo_driver.network.messages.cdr import ENCODING
from limo_driver.runtime.given_files import Spent

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

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
