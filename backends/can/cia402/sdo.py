"""Objects of a CANopen node read and written one by one, and which nodes there are.

SDO client: one object of one drive at a time, read or written in one frame.

An answer counts only if it is from the drive that was asked, about the object that was asked for,
and of the kind that was asked for; anything else, also a frame that this program sent itself, is
not an answer.

Source: CiA 301, section 7.2.4.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from backends.can.config import ArmConfig, DriveError, SdoAbortError
from backends.can.port import HEARTBEAT, RPDO1, SDO_REPLY, SDO_REQUEST, SYNC, BusPort, Frame
from limo_driver.errors import BackendError

FRAME: Final = struct.Struct("<BHB4s")
READ, WRITE = 0x40, 0x20
READ_REPLY, WRITE_REPLY, ABORT = 0x40, 0x60, 0x80  # with sizes in the low bits
_KIND: Final = 0xE0
_EXPEDITED, _SIZED = 0x02, 0x01
LONGEST: Final = 4  # bytes in one frame
QUIET: Final = 0.02  # [s] at least, in which nobody else may command this bus
SEARCH_TIME: Final = 0.2  # [s] in which every node that is there answers
NODES: Final = range(1, 128)
DEVICE_TYPE: Final = 0x1000  # object that every node has


@dataclass(frozen=True)
class SdoClient:
    """Reads and writes objects of the drive of one joint.

    Args:
        port: The bus.
        joint: 1-based joint, for messages.
        node: Node id of the drive.
        timeout: How long an answer may take [s].
        others: Told every frame that is no answer.
    """

    port: BusPort
    joint: int
    node: int
    timeout: float
    others: Callable[[Frame], None]

    def read(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """Return a number of up to 32 bits.

        Raises:
            DriveError: No answer, or a value that is no number of one frame.
            SdoAbortError: The drive refuses.
        """
        head, value = self._ask(READ, READ_REPLY, index, subindex, b"")
        if not head & _EXPEDITED:
            raise DriveError(
                self.joint, self.node, f"has no number in object {index:04X}:{subindex:02X}"
            )
        size = LONGEST - (head >> 2 & 0x03) if head & _SIZED else LONGEST
        return int.from_bytes(value[:size], "little", signed=signed)

    def write(
        self, index: int, subindex: int, value: int, size: int, *, signed: bool = False
    ) -> None:
        """Write a number of `size` bytes.

        Raises:
            DriveError: No answer.
            SdoAbortError: The drive refuses.
        """
        head = WRITE | _EXPEDITED | _SIZED | (LONGEST - size) << 2
        data = value.to_bytes(size, "little", signed=signed)
        self._ask(head, WRITE_REPLY, index, subindex, data)

    def _ask(
        self, head: int, expected: int, index: int, subindex: int, data: bytes
    ) -> tuple[int, bytes]:
        self.port.send(SDO_REQUEST + self.node, FRAME.pack(head, index, subindex, data))
        until = self.port.now() + self.timeout
        last = until + self.timeout  # a bus full of other frames is no answer either
        while (now := self.port.now()) < last:
            if (frame := self.port.receive(until)) is None:
                if now >= until:
                    break
                continue
            if frame.id != SDO_REPLY + self.node or len(frame.data) != FRAME.size:
                self.others(frame)
                continue
            reply, about, part, value = FRAME.unpack(frame.data)
            if (about, part) != (index, subindex):
                continue  # a late answer to an earlier question
            if reply == ABORT:
                code = int.from_bytes(value, "little")
                raise SdoAbortError(self.joint, self.node, index, subindex, code)
            if reply & _KIND == expected:
                return reply, value
        raise DriveError(
            self.joint,
            self.node,
            f"does not answer within {self.timeout:g} s (object {index:04X}:{subindex:02X})",
        )


def require_quiet(port: BusPort, config: ArmConfig) -> None:
    """Refuse a bus on which another program commands drives.

    Raises:
        BackendError: Names the frame that was heard.
    """
    told = {SYNC, HEARTBEAT + config.master, *(RPDO1 + joint.node for joint in config.joints)}
    until = port.now() + max(QUIET, 2 / config.rate)
    while (frame := port.receive(until)) is not None:
        if frame.id in told:
            raise BackendError(
                f"another program commands the drives on {port.name}: heard frame {frame.id:03X}; "
                "end it first"
            )
        if port.now() >= until:
            return


def require_answer(sdo: SdoClient, known: Sequence[int]) -> None:
    """Refuse to go on without a drive; says which nodes there are instead.

    Args:
        sdo: The way to the drive.
        known: Nodes of all joints.

    Raises:
        DriveError: It does not answer.
    """
    try:
        sdo.read(DEVICE_TYPE)
    except DriveError as error:
        present = _present(sdo.port)
        if not present:
            raise BackendError(
                f"no drive answers on {sdo.port.name}; is the bus powered, terminated and at the "
                "bitrate of arm.yaml?"
            ) from None
        strangers = [node for node in present if node not in known]
        hint = f"; is its node id {strangers[0]}?" if len(strangers) == 1 else ""
        raise DriveError(
            sdo.joint,
            sdo.node,
            f"does not answer on {sdo.port.name} within {sdo.timeout:g} s; "
            f"nodes that answer: {', '.join(map(str, present)) or 'none'}{hint}",
        ) from error


def _present(port: BusPort) -> list[int]:
    """Return the nodes that answer at all."""
    for node in NODES:
        port.send(SDO_REQUEST + node, FRAME.pack(READ, DEVICE_TYPE, 0, b""))
    found: set[int] = set()
    until = port.now() + SEARCH_TIME
    while port.now() < until:
        frame = port.receive(until)
        if frame is not None and frame.id - SDO_REPLY in NODES:
            found.add(frame.id - SDO_REPLY)
    return sorted(found)
