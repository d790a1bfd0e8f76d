"""One Damiao motor, as it is heard on the bus; nothing of it is known before it spoke."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NoReturn

from backends.can.damiao import codec as damiao
from backends.can.damiao.codec import Ranges, Reply, Status, status_words
from backends.can.errors import DriveError
from backends.can.link import status_line
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from backends.can.config import DamiaoJoint

MOST_DOUBLED: Final = 2  # cycles in a row; CAN itself may repeat a frame after an error
UNKNOWN: Final = Ranges(math.nan, math.nan, math.nan)


@dataclass
class Motor:
    """One motor, as it is heard on the bus; nothing of it is known before it spoke."""

    number: int  # of its joint, from 1
    joint: DamiaoJoint
    ranges: Ranges = UNKNOWN
    reply: Reply | None = None
    heard: bool = False  # in the cycle that runs
    silent: int = 0  # cycles since its last reply
    replies: int = 0  # in the cycle that runs
    replied: bool = False  # in the cycle before
    doubled: int = 0  # cycles in a row with more than one reply, each after one that had some
    broken: int = 0  # frames that were no reply

    @property
    def known(self) -> Reply:
        """Its last reply.

        Raises:
            DriveError: It has not spoken.
        """
        if self.reply is None:
            self.fail("has not said where it is")
        return self.reply

    @property
    def enabled(self) -> bool:
        """Whether it follows commands."""
        return self.reply is not None and self.reply.status == Status.ENABLED

    @property
    def faulty(self) -> bool:
        """Whether it said a fault."""
        return self.known.status not in {Status.DISABLED, Status.ENABLED}

    @property
    def temperature(self) -> float:
        """Of its transistors or its winding, whichever is hotter [°C]."""
        return float(max(self.known.transistors, self.known.winding))

    @property
    def status(self) -> str:
        """Its condition in words, for example `enabled`."""
        return status_line(status_words(self.known.status), "", self.silent)

    def take(self, data: bytes) -> None:
        """Read a reply."""
        try:
            reply = damiao.decode_reply(data, self.ranges)
        except WireFormatError:
            self.broken += 1
            return
        if reply.motor != self.joint.node & 0xF:
            self.broken += 1
            return
        self.reply, self.heard = reply, True
        self.replies += 1

    def open_cycle(self) -> None:
        """Wait for the reply to a new command."""
        self.heard = False
        # One reply may be late, and come together with the next.
        self.doubled = self.doubled + 1 if self.replies > 1 and self.replied else 0
        self.replies, self.replied = 0, self.replies > 0

    def complaint(self, hold_after: int) -> str:
        """Say what keeps it from following commands; empty if nothing does."""
        if self.doubled >= MOST_DOUBLED:
            return f"replies twice, {self.doubled} cycles in a row: a second motor has its id"
        if self.silent >= hold_after:
            return f"is silent for {self.silent} cycles"
        return "" if self.enabled else f"is in state {status_words(self.known.status)!r}"

    def fail(self, message: str) -> NoReturn:
        """Raise what is wrong with this motor."""
        raise DriveError(self.number, self.joint.node, message)
