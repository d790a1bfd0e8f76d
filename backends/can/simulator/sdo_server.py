"""SDO server of a simulated CANopen node: expedited and segmented transfers (CiA 301)."""

from __future__ import annotations

import struct
from typing import Final

from backends.can.simulator.objects import (
    TOGGLE_NOT_ALTERNATED,
    UNKNOWN_COMMAND,
    WRONG_LENGTH,
    ObjectDictionary,
    SdoAbort,
)

FRAME: Final = 8  # [bytes], of every SDO
LONGEST: Final = 64  # [bytes] that a client may write; the longest variable has 4
_MULTIPLEXER = struct.Struct("<BHB")
_ABORT = struct.Struct("<BHBI")
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORTED = 0, 1, 2, 3, 4


class SdoServer:
    """Answers one client.

    Args:
        objects: What it reads and writes.
    """

    def __init__(self, objects: ObjectDictionary) -> None:
        self._objects = objects
        self.reset()

    def reset(self) -> None:
        """Forget a transfer that is under way."""
        self._at = (0, 0)
        self._to_send: bytes | None = None
        self._received: bytearray | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """Return the answer to a request; None if it needs none."""
        if len(request) != FRAME:
            return None
        command = request[0] >> 5
        if command == _ABORTED:
            self.reset()
            return None
        if command in {_DOWNLOAD, _UPLOAD}:
            self.reset()
            _, index, subindex = _MULTIPLEXER.unpack_from(request)
            self._at = (index, subindex)
        try:
            return self._answer(command, request)
        except SdoAbort as abort:
            at = self._at
            self.reset()
            return _ABORT.pack(0x80, *at, abort.code)

    def _answer(self, command: int, request: bytes) -> bytes:
        if command == _UPLOAD:
            return self._upload()
        if command == _DOWNLOAD:
            return self._download(request)
        if command == _UPLOAD_SEGMENT:
            return self._upload_segment(request[0])
        if command == _DOWNLOAD_SEGMENT:
            return self._download_segment(request)
        raise SdoAbort(UNKNOWN_COMMAND)

    def _upload(self) -> bytes:
        data = self._objects.find(*self._at).encode()
        if len(data) <= 4:  # noqa: PLR2004  # bytes of an expedited transfer
            head = 0x43 | (4 - len(data)) << 2
            return _MULTIPLEXER.pack(head, *self._at) + data.ljust(4, b"\0")
        self._to_send = data
        return _MULTIPLEXER.pack(0x41, *self._at) + struct.pack("<I", len(data))

    def _upload_segment(self, head: int) -> bytes:
        if self._to_send is None:
            raise SdoAbort(UNKNOWN_COMMAND)
        self._check_toggle(head)
        part, rest = self._to_send[:7], self._to_send[7:]
        answer = self._toggle << 4 | (7 - len(part)) << 1 | (not rest)
        self._toggle ^= 1
        self._to_send = rest or None
        return bytes([answer]) + part.ljust(7, b"\0")

    def _download(self, request: bytes) -> bytes:
        head = request[0]
        if head & 2:  # expedited
            size = 4 - (head >> 2 & 3) if head & 1 else self._objects.find(*self._at).size
            self._objects.write(*self._at, request[4 : 4 + size])
        else:
            self._objects.find(*self._at)
            self._received = bytearray()
        return _MULTIPLEXER.pack(0x60, *self._at).ljust(FRAME, b"\0")

    def _download_segment(self, request: bytes) -> bytes:
        if self._received is None:
            raise SdoAbort(UNKNOWN_COMMAND)
        head = request[0]
        self._check_toggle(head)
        self._received += request[1 : 8 - (head >> 1 & 7)]
        if len(self._received) > LONGEST:
            raise SdoAbort(WRONG_LENGTH)
        answer = 0x20 | self._toggle << 4
        self._toggle ^= 1
        if head & 1:
            data, self._received = bytes(self._received), None
            self._objects.write(*self._at, data)
        return bytes([answer]).ljust(FRAME, b"\0")

    def _check_toggle(self, head: int) -> None:
        if head >> 4 & 1 != self._toggle:
            raise SdoAbort(TOGGLE_NOT_ALTERNATED)
