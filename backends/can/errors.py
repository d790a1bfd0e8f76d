"""Errors of one CAN drive, named by joint and node."""

from __future__ import annotations

from limo_driver.errors import BackendError


class DriveError(BackendError):
    """One drive of an arm does not do what it has to.

    Args:
        joint: 1-based joint.
        node: Node id of its drive.
        message: What is wrong, and what to do about it.
    """

    def __init__(self, joint: int, node: int, message: str) -> None:
        self.joint, self.node = joint, node
        super().__init__(f"joint {joint} (node {node}) {message}")


class SdoAbortError(DriveError):
    """A drive refuses to read or write one of its objects.

    Args:
        joint: 1-based joint.
        node: Node id of its drive.
        index: Object.
        subindex: Its part.
        code: Abort code of CiA 301.
    """

    def __init__(self, joint: int, node: int, index: int, subindex: int, code: int) -> None:
        self.index, self.subindex, self.code = index, subindex, code
        text = _ABORTS.get(code, "a reason of its own")
        super().__init__(
            joint, node, f"refuses object {index:04X}:{subindex:02X}: {text} ({code:08X})"
        )

    @property
    def is_absent(self) -> bool:
        """Whether the drive has no such object."""
        return self.code in {0x06020000, 0x06090011}


# Source: CiA 301, table 22.
_ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "protocol timed out",
    0x05040001: "command unknown",
    0x06010000: "unsupported access",
    0x06010001: "object can only be written",
    0x06010002: "object can only be read",
    0x06020000: "object does not exist",
    0x06040041: "object cannot be mapped to a PDO",
    0x06040042: "mapped objects are longer than a PDO",
    0x06040043: "parameters do not fit together",
    0x06060000: "hardware error",
    0x06070010: "length of the value is wrong",
    0x06070012: "value is too long",
    0x06070013: "value is too short",
    0x06090011: "subindex does not exist",
    0x06090030: "value is out of range",
    0x06090031: "value is too high",
    0x06090032: "value is too low",
    0x08000000: "general error",
    0x08000020: "value cannot be stored",
    0x08000021: "local control has the drive",
    0x08000022: "the present state of the drive does not allow it",
}
