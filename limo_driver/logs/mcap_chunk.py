"""Chunks of MCAP files, unpacked within bounds: no small file can ask for all memory."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

LARGEST_CHUNK: Final = 1 << 28  # bytes when unpacked
ALWAYS_FINE: Final = 1 << 22  # bytes when unpacked, however small they were packed
MOST_PACKED: Final = 1000  # times that a larger chunk may be packed
_HEAD: Final = struct.Struct("<BQ")  # opcode and length of a record


def unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk, checked against its checksum, if it has one.

    Raises:
        ValueError: Too large, or not what it says it is.
    """
    size, packed = chunk.uncompressed_size, len(chunk.data)
    if size > LARGEST_CHUNK or (size > ALWAYS_FINE and size > MOST_PACKED * packed):
        raise ValueError(f"a chunk of {packed} bytes that would unpack to {size}")
    data = _plain(chunk, size)
    if len(data) != size:
        raise ValueError(f"a chunk of {len(data)} bytes, not {size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk whose checksum is another")
    return data


def _plain(chunk: Chunk, size: int) -> bytes:
    match chunk.compression:
        case "":
            return chunk.data
        case "zstd":
            # What a frame says of itself is allocated at once.
            if zstandard.frame_content_size(chunk.data) not in {-1, size}:
                raise ValueError("a chunk that would unpack to more than it says")
            return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        case "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        case other:
            raise ValueError(f"a chunk packed with {other!r}")


def records_in(data: bytes) -> Iterator[Schema | Channel | Message]:
    """Yield the records of a chunk that was unpacked.

    Raises:
        ValueError: Not a record that chunks hold, or one that is cut off.
    """
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            raise ValueError("a record that is cut off")
        stream = ReadDataStream(BytesIO(data[at : at + length]))
        at += length
        match opcode:
            case Opcode.MESSAGE:
                yield Message.read(stream, length)
            case Opcode.CHANNEL:
                yield Channel.read(stream)
            case Opcode.SCHEMA:
                yield Schema.read(stream)
            case _:
                raise ValueError(f"a record of kind {opcode} in a chunk")
