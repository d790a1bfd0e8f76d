"""Mutations of files: bits, blocks, counts and words, each drawn from a seed.

What is packed is mutated inside, too, and packed again: else checksums would refuse nearly all.
"""

from __future__ import annotations

import gzip
import io
import re
import zipfile
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

_NUMBER: Final = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD: Final = re.compile(rb"[A-Za-z_][A-Za-z_0-9]{2,}")
_EXTREME: Final = (
    *(b"0", b"-1", b"1e308", b"-1e-308", b"nan", b"inf", b"1e9", b"1000000000000", b"65536"),
    *(b"9" * 5000, b"-0.0", b"0x7fffffff", b"1e", b""),
)
_WORDS: Final = (
    *(
        b"\x1b[31m",
        b"*/",
        b'"""',
        b"</a>",
        b"$(x)",
        b"\xe2\x80\xae",
        b"\xff\xfe",
        b"\x00",
        b"a" * 9000,
    ),
    *(
        b"[" * 2000,
        b"{" * 2000,
        b"<a>" * 2000,
        b"&amp;",
        b"null",
        b"true",
        b"../../x",
        b"/dev/zero",
    ),
)
_COUNTS: Final = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 1 << 31, (1 << 31) - 1, (1 << 32) - 1,
                  1 << 40, (1 << 63) - 1, (1 << 64) - 1)  # fmt: skip
_MOST: Final = 1 << 22  # bytes of a mutation


def mutated(data: bytes, random: Random) -> bytes:
    """Return a mutation of the bytes of a file."""
    if data[:2] == b"\x1f\x8b" and random.random() < 0.7:
        return gzip.compress(_plain(gzip.decompress(data), random), 1)
    if data[:2] == b"PK" and random.random() < 0.7:
        return _repacked(data, random)
    return _plain(data, random)


def _plain(data: bytes, random: Random) -> bytes:
    """Return bytes with one or a few changes."""
    changes = _IN_BYTES + _IN_TEXT * (2 if _is_text(data) else 0)
    for _ in range(random.choice((1, 1, 1, 2, 3, 6))):
        data = random.choice(changes)(data, random)[:_MOST]
    return data


def _repacked(data: bytes, random: Random) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(packed, "w") as target:
        names = source.namelist()
        chosen = random.choice(names)
        for name in names:
            content = source.read(name)
            target.writestr(name, _plain(content, random) if name == chosen else content)
    return packed.getvalue()


def _is_text(data: bytes) -> bool:
    head = data[:2000]
    return sum(32 <= byte < 127 or byte in b"\n\r\t" for byte in head) > 0.9 * len(head)


def _span(data: bytes, random: Random) -> tuple[int, int]:
    start = random.randrange(len(data) + 1)
    return start, min(len(data), start + int(2 ** random.uniform(0, 10)))


def _flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8, 32)) if data else 0):
        changed[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _count(data: bytes, random: Random) -> bytes:
    size = random.choice((1, 2, 4, 8))
    value = random.choice(_COUNTS) & ((1 << 8 * size) - 1)
    at = random.randrange(len(data) + 1)
    at -= at % random.choice((1, size))
    new = value.to_bytes(size, random.choice(("little", "big")))
    return data[:at] + new + data[at + size :]


def _cut(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _delete(data: bytes, random: Random) -> bytes:
    start, stop = _span(data, random)
    return data[:start] + data[stop:]


def _repeat(data: bytes, random: Random) -> bytes:
    start, stop = _span(data, random)
    return data[:stop] + data[start:stop] * random.choice((1, 2, 50)) + data[stop:]


def _swap(data: bytes, random: Random) -> bytes:
    (a, b), (c, d) = sorted((_span(data, random), _span(data, random)))
    b = min(b, c)
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _insert(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data) + 1)
    size = random.choice((1, 3, 8, 200))
    new = random.choice((random.randbytes(size), bytes(size), b"\xff" * size))
    return data[:at] + new + data[at:]


def _instead(
    pattern: re.Pattern[bytes], words: tuple[bytes, ...]
) -> Callable[[bytes, Random], bytes]:
    def change(data: bytes, random: Random) -> bytes:
        at = random.randrange(len(data) + 1)
        found = pattern.search(data, at) or pattern.search(data)
        if found is None:
            return data
        return data[: found.start()] + random.choice(words) + data[found.end() :]

    return change


def _other(data: bytes, random: Random) -> bytes:
    """Put a word of the file where another stands."""
    words = _WORD.findall(data)[:1000]
    return _instead(_WORD, (random.choice(words),))(data, random) if words else data


def _lines(data: bytes, random: Random) -> bytes:
    """Repeat, drop or move lines."""
    lines = data.split(b"\n")
    at, to = random.randrange(len(lines)), random.randrange(len(lines))
    many = random.choice((0, 2, 300))
    block = lines[at : at + random.choice((1, 1, 5))]
    rest = lines[:at] + lines[at + len(block) :] if random.random() < 0.5 else lines
    return b"\n".join([*rest[:to], *block * many, *rest[to:]])


_IN_BYTES: Final = (_flip, _flip, _count, _count, _cut, _delete, _repeat, _swap, _insert)
_IN_TEXT: Final = (
    _instead(_NUMBER, _EXTREME), _instead(_NUMBER, _EXTREME), _instead(_WORD, _WORDS), _other,
    _lines,
)  # fmt: skip
