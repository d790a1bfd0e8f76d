"""The log of a recording that is being made: an Arrow stream whose batches are sealed.

Each batch carries a checksum (CRC 32) of its values, begun with that of the batch before it. So
what is read back says where bits have changed, where batches are missing, and that the end is. Any
program that reads Arrow streams reads the log; those without seals are read as they are.
"""

# pyright: reportUnknownParameterType=false
# pyarrow ships no stubs.

from __future__ import annotations

import re
import zlib
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import pyarrow as pa

from limo_driver.errors import RecordingError
from limo_driver.runtime.given_files import Spent, check_file

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import BinaryIO

    from limo_driver.types import FloatArray

_SEAL: Final = b"limo.seal"
_SEALED: Final = re.compile(rb"limo crc32 ([0-9a-f]{8}) ([0-9a-f]{8})")
_BEGIN: Final = b"\xff\xff\xff\xff"  # of every message of a stream
_END: Final = _BEGIN + bytes(4)
_STEP: Final = 8  # bytes, at whose multiples messages begin
_BLOCK: Final = 1 << 20  # bytes that are searched at once for what follows damage
_DAMAGE: Final = (pa.ArrowException, OSError, EOFError, ValueError, MemoryError)


class LogStream:
    """Writes the log, batch by batch.

    Args:
        file: That it is written to.
        schema: Columns of numbers, and the header in its metadata.
    """

    def __init__(self, file: BinaryIO, schema: pa.Schema) -> None:
        self._schema, self._sum = schema, _sum_of(schema)
        self._stream = pa.ipc.new_stream(file, schema)
        self._write(np.zeros((len(schema), 0)), self._sum)  # the header waits for a first batch

    def write(self, columns: FloatArray) -> None:
        """Write rows.

        Args:
            columns: (k, T); NaN where there is no value.
        """
        before, self._sum = self._sum, _sum(columns, self._sum)
        self._write(columns, before)

    def close(self) -> None:
        """Write its end."""
        self._stream.close()

    def _write(self, columns: FloatArray, before: int) -> None:
        arrays = [pa.array(values, mask=np.isnan(values)) for values in columns]
        batch = pa.record_batch(arrays, schema=self._schema)
        seal = f"limo crc32 {before:08x} {self._sum:08x}".encode()
        self._stream.write_batch(batch, custom_metadata={_SEAL: seal})


def _sum(columns: FloatArray, before: int) -> int:
    """Return the checksum of columns (k, T); values that are missing are all the same NaN."""
    return zlib.crc32(np.where(np.isnan(columns), np.nan, columns).tobytes(), before)


def _sum_of(schema: pa.Schema) -> int:
    about = sorted((schema.metadata or {}).items())
    return zlib.crc32(repr((schema.names, about)).encode())


class StoredLog:
    """A log that is read, also one that is cut off or damaged.

    Batches that are damaged are left out, those behind them are read.

    Args:
        path: Of the log.

    Raises:
        RecordingError: It is none, or ends before its header.
    """

    def __init__(self, path: Path) -> None:
        check_file(path, RecordingError)
        try:
            self._size = path.stat().st_size
            self._source = pa.OSFile(str(path))
            self.schema: pa.Schema = pa.ipc.read_schema(self._source)
        except FileNotFoundError as error:
            raise RecordingError(f"cannot be read: {error.strerror}", path=path) from None
        except _DAMAGE as error:
            reason = str(error).splitlines()[0] if str(error) else "it is empty"
            raise RecordingError(f"is no log of limo's: {reason}", path=path) from None
        self._spent = Spent(path, RecordingError)
        self._rows, self._ended = 0, False
        self._places = list[int]()  # bytes at which it is damaged

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield what can be read, once."""
        is_sealed, last = False, _sum_of(self.schema)
        for piece in self._spent.metered(self._pieces()):
            is_sealed |= piece.seal is not None
            is_next = last in {None, piece.before}
            last = piece.seal
            is_right = piece.batch is not None
            if piece.batch is not None and is_sealed:
                is_right = piece.seal == _sum(_values(piece.batch), piece.before or 0)
            if not is_right or (is_sealed and not is_next):
                self._places.append(piece.at)
            if is_right and piece.batch is not None:
                self._rows += piece.batch.num_rows
                yield piece.batch

    def describe_losses(self) -> str:
        """Say what is lost, once all is read; nothing for a log that is whole."""
        notes = list[str]()
        if places := self._places:
            many = "one place" if len(places) == 1 else f"{len(places)} places, first"
            notes.append(
                f"is damaged in {many} at byte {places[0]} of {self._size}, and the rows there are "
                "left out"
            )
        if not self._ended:
            notes.append(f"lacks its end: whatever came after its {self._rows} rows is lost")
        return "; it ".join(notes)

    def _pieces(self) -> Iterator[_Piece]:
        """Yield batches, one after the other; after damage, from the next one on."""
        at, source = self._source.tell(), self._source
        while 0 <= at < self._size:
            source.seek(at)
            if self._size - at == len(_END) and source.read(len(_END)) == _END:
                self._ended = True
                return
            source.seek(at)
            try:
                message = pa.ipc.read_message(source)
                batch = pa.ipc.read_record_batch(message, self.schema)
                batch.validate(full=True)
            except _DAMAGE:
                if (following := self._following(at)) >= 0:
                    yield _Piece(at)
                at = following
                continue
            self._spent.take(unpacked=max(batch.nbytes - message.body.size, 0))
            seal = _SEALED.search(message.metadata.to_pybytes())
            yield _Piece(at, batch, *(() if seal is None else (int(x, 16) for x in seal.groups())))
            at = source.tell()

    def _following(self, at: int) -> int:
        """Return where the next message may begin; -1 where there is none."""
        start = at + _STEP
        while start < self._size:
            self._source.seek(start)
            block, found = self._source.read(_BLOCK), -_STEP
            while (found := block.find(_BEGIN, found + _STEP)) >= 0:
                if found % _STEP == 0:
                    return start + found
                found -= found % _STEP
            start += _BLOCK
        return -1


class _Piece(NamedTuple):
    """What stands at a place of a log: a batch, or something that is none."""

    at: int  # byte
    batch: pa.RecordBatch | None = None
    before: int | None = None  # checksum of the batch before it
    seal: int | None = None  # its own


def _values(batch: pa.RecordBatch) -> FloatArray:
    """Return the values of a batch, (k, T); NaN where there are none."""
    columns = [column.to_numpy(zero_copy_only=False) for column in batch.columns]
    return np.array(columns, dtype=np.float64)
