"""A simulated CANopen node: NMT, SYNC, heartbeat both ways, PDO, SDO and emergencies (CiA 301).

A node hears frames and the time, and gives frames back through `send`; it knows no bus.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final

from backends.can import port
from backends.can.simulator.objects import (
    TEXT,
    TOGGLE_NOT_ALTERNATED,
    U8,
    U16,
    U32,
    UNKNOWN_COMMAND,
    WRONG_LENGTH,
    ObjectDictionary,
    SdoAbort,
    SimulatedPdo,
    Variable,
)

REMEMBERED: Final = 8  # errors in 1003
VENDOR: Final = 0  # none: a simulated drive has no vendor's number
PRODUCT: Final = 0x402
# Emergency codes of CiA 301.
SOFT_RESET: Final = 0x0000
HEARTBEAT_LOST: Final = 0x8130
BUS_OFF_RECOVERED: Final = 0x8140
PDO_TOO_SHORT: Final = 0x8210
RPDO_LATE: Final = 0x8250
GENERIC, COMMUNICATION = 0x01, 0x10  # bits of the error register
_EMERGENCY = struct.Struct("<HB5x")
FRAME: Final = 8  # [bytes], of every SDO
LONGEST: Final = 64  # [bytes] that a client may write; the longest variable has 4
_MULTIPLEXER = struct.Struct("<BHB")
_ABORT = struct.Struct("<BHBI")
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORTED = 0, 1, 2, 3, 4


class NmtState(IntEnum):
    """States of a node, as its heartbeat says them."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class CanopenNode:
    """Base class of CANopen nodes; a subclass adds its device profile.

    Args:
        node: Its id.
        send: Puts a frame on the bus.
        name: Device name, object 1008.
        device: Device type, object 1000.
        identity: Vendor, product, revision and serial number, object 1018.
    """

    def __init__(
        self,
        node: int,
        send: Callable[[int, bytes], None],
        name: str,
        device: int,
        identity: Sequence[int],
    ) -> None:
        self.node, self._send = node, send
        self.state = NmtState.BOOT_UP
        self.objects = objects = ObjectDictionary()
        self._sdo = SdoServer(objects)
        objects.add(0x1000, 0, Variable(U32, device))
        self._register = objects.add(0x1001, 0, Variable(U8, mappable=True))
        objects.array(0x1003, *(Variable(U32) for _ in range(REMEMBERED)))
        history = objects.find(0x1003, 0)
        history.value, history.writable, history.bounds = 0, True, (0, 0)  # 0 clears it
        only = (port.SYNC, port.SYNC)  # it makes no SYNC, and hears no other
        objects.add(0x1005, 0, Variable(U32, port.SYNC, writable=True, bounds=only))
        self._sync_period = objects.add(0x1006, 0, Variable(U32, writable=True))
        objects.add(0x1008, 0, Variable(TEXT, name))
        objects.add(0x1014, 0, Variable(U32, port.EMERGENCY + node))
        self._guarded = Variable(U32, writable=True, changed=self._guard_anew)
        objects.array(0x1016, self._guarded)
        self._heartbeat = objects.add(0x1017, 0, Variable(U16, writable=True))
        objects.array(0x1018, *(Variable(U32, number) for number in identity))
        self.rpdos: list[SimulatedPdo] = []
        self.tpdos: list[SimulatedPdo] = []
        self._now = 0.0
        self._beat_at = 0.0  # [s] last heartbeat sent
        self._heard: float | None = None  # [s] last heartbeat of the guarded node
        self._fed: dict[int, float] = {}  # [s] when each RPDO last took effect

    def start(self, now: float) -> None:
        """Boot: say so, and be pre-operational."""
        self._now = now
        self.reset_communication()

    def reset_communication(self) -> None:
        """Go back to the defaults of the communication objects, and boot."""
        for pdo in (*self.rpdos, *self.tpdos):
            pdo.reset()
        for variable in (self._sync_period, self._guarded, self._heartbeat):
            variable.value = 0
        self._sdo.reset()
        self._heard = None
        self._fed.clear()
        self.state = NmtState.BOOT_UP
        self._send(port.HEARTBEAT + self.node, bytes([NmtState.BOOT_UP]))
        self.state, self._beat_at = NmtState.PRE_OPERATIONAL, self._now

    @property
    def sync_period(self) -> float:
        """Communication period [s]; 0 where it was not told (object 1006)."""
        return 1e-6 * int(self._sync_period.value)

    def hear(self, frame_id: int, data: bytes, now: float) -> None:
        """Take a frame that may be for this node; SYNC is told by `synchronise`."""
        self._now = now
        if frame_id == port.NMT:
            if len(data) == 2 and data[1] in {0, self.node}:  # noqa: PLR2004  # command and node
                self._command(data[0])
        elif frame_id == port.SDO_REQUEST + self.node:
            if self.state is not NmtState.STOPPED and (answer := self._sdo.answer(data)):
                self._send(port.SDO_REPLY + self.node, answer)
        elif port.HEARTBEAT < frame_id <= port.HEARTBEAT + 0x7F:
            if len(data) == 1 and frame_id - port.HEARTBEAT == int(self._guarded.value) >> 16:
                self._heard = now
        elif self.state is NmtState.OPERATIONAL:
            for pdo in self.rpdos:
                if pdo.on and pdo.cob_id == frame_id:
                    self._receive(pdo, data)

    def synchronise(self, now: float) -> None:
        """Hear a SYNC: received set-points count, and what is measured is sent."""
        self._now = now
        if self.state is not NmtState.OPERATIONAL:
            return
        for pdo in self.rpdos:
            if pdo.pending is not None:
                data, pdo.pending = pdo.pending, None
                self._put_in_force(pdo, data)
        for pdo in self.tpdos:
            if not (pdo.on and pdo.synchronous):
                continue
            pdo.syncs += 1
            if pdo.syncs >= max(pdo.transmission, 1):
                pdo.syncs = 0
                self._send(pdo.cob_id, pdo.pack())

    def tick(self, now: float) -> None:
        """Let time pass: heartbeats, event timers, and watchdogs."""
        self._now = now
        if self._heartbeat.value and now - self._beat_at >= 1e-3 * int(self._heartbeat.value):
            self._beat_at = now
            self._send(port.HEARTBEAT + self.node, bytes([self.state]))
        self._watch_heartbeat()
        if self.state is NmtState.OPERATIONAL:
            for k, pdo in enumerate(self.rpdos):
                fed = self._fed.get(k)
                if fed is not None and pdo.event_time and now - fed > pdo.event_time:
                    del self._fed[k]  # once, until it is fed again
                    self.communication_lost(RPDO_LATE)

    def emergency(self, code: int, bits: int = GENERIC) -> None:
        """Send an emergency and remember it; code 0 says that all errors are gone."""
        register = int(self._register.value) | bits | GENERIC if code else 0
        self._register.value = register
        if code:
            count = self.objects.find(0x1003, 0)
            count.value = min(int(count.value) + 1, REMEMBERED)
            for k in range(REMEMBERED, 1, -1):
                self.objects.find(0x1003, k).value = self.objects.find(0x1003, k - 1).value
            self.objects.find(0x1003, 1).value = code
        if self.state is not NmtState.STOPPED:
            self._send(port.EMERGENCY + self.node, _EMERGENCY.pack(code, register))

    def communication_lost(self, code: int) -> None:
        """React to a master that is gone; `code` is of the emergency."""
        self.emergency(code, COMMUNICATION)

    def reset_application(self) -> None:
        """Go back to what the device is when it is switched on."""

    def _receive(self, pdo: SimulatedPdo, data: bytes) -> None:
        if len(data) < pdo.length:
            self.emergency(PDO_TOO_SHORT, COMMUNICATION)
        elif pdo.synchronous:
            pdo.pending = data
        else:
            self._put_in_force(pdo, data)

    def _put_in_force(self, pdo: SimulatedPdo, data: bytes) -> None:
        pdo.unpack(data)
        # The deadline is of set-points in force: of a synchronous RPDO, SYNC keeps it too.
        self._fed[self.rpdos.index(pdo)] = self._now

    def _command(self, command: int) -> None:
        """Obey an NMT command; one that does not exist is not heard."""
        if command == 0x81:  # noqa: PLR2004  # reset node
            self.reset_application()
            self.reset_communication()
            return
        if command == 0x82:  # noqa: PLR2004  # reset communication
            self._leave_operational()
            self.reset_communication()
            return
        states = {
            0x01: NmtState.OPERATIONAL,
            0x02: NmtState.STOPPED,
            0x80: NmtState.PRE_OPERATIONAL,
        }
        if (state := states.get(command)) is None or state is self.state:
            return
        self._leave_operational()
        self.state = state
        for pdo in (*self.rpdos, *self.tpdos):
            pdo.pending, pdo.syncs = None, 0

    def _leave_operational(self) -> None:
        if self.state is NmtState.OPERATIONAL:
            self._fed.clear()
            self.left_operational()

    def left_operational(self) -> None:
        """React to set-points that will not come any more, since the master said so."""

    def _guard_anew(self, _value: int) -> None:
        self._heard = None  # watched from the first heartbeat on, as the standard says

    def _watch_heartbeat(self) -> None:
        patience = 1e-3 * (int(self._guarded.value) & 0xFFFF)
        if self._heard is not None and patience and self._now - self._heard > patience:
            self._heard = None
            self.communication_lost(HEARTBEAT_LOST)


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
