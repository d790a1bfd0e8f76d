"""Check the CAN bus: every drive answers, and no other program commands drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from backends.can.cia402.sdo import FRAME, READ
from backends.can.errors import DriveError
from backends.can.frames import HEARTBEAT, RPDO1, SDO_REPLY, SDO_REQUEST, SYNC
from limo_driver.errors import BackendError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.can.cia402.sdo import SdoClient
    from backends.can.config import ArmConfig
    from backends.can.port import BusPort

QUIET: Final = 0.02  # [s] at least, in which nobody else may command this bus
SEARCH_TIME: Final = 0.2  # [s] in which every node that is there answers
NODES: Final = range(1, 128)
DEVICE_TYPE: Final = 0x1000  # object that every node has


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
