"""Find the Damiao motors of an arm, read their ranges, and set their watchdogs and modes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NoReturn

from backends.can.config import ArmConfig, DamiaoJoint, DriveError
from backends.can.damiao import codec as damiao
from backends.can.damiao.codec import (
    MIT_MODE,
    TIMEOUT_UNIT,
    Ranges,
    Register,
    Reply,
    Status,
    status_words,
)
from backends.can.link import status_line
from backends.can.port import BusPort
from limo_driver.errors import ConfigError, WireFormatError

ATTEMPTS: Final = 3  # to ask a motor, within the time for an answer
SEARCH_TIME: Final = 0.1  # [s] in which motors with other ids answer
RANGES: Final = (Register.POSITION_RANGE, Register.VELOCITY_RANGE, Register.TORQUE_RANGE)
MOST_DOUBLED: Final = 2  # cycles in a row; CAN itself may repeat a frame after an error
UNKNOWN: Final = Ranges(math.nan, math.nan, math.nan)


def check_ids(motors: Sequence[Motor]) -> None:
    """Refuse ids on which a command would be taken for a reply."""
    nodes = {motor.joint.node: motor.number for motor in motors}
    replies: dict[int, int] = {}
    for motor in motors:
        reply = motor.joint.reply_id
        other = nodes.get(reply) or replies.get(reply)
        if other is not None:
            raise ConfigError(
                f"joint {motor.number} replies on {reply:#x}, which joint {other} uses; "
                "give another `reply`"
            )
        replies[reply] = motor.number


@dataclass(frozen=True)
class Setup:
    """Speaks with motors that are switched off.

    Args:
        config: The arm.
        port: Its bus.
        motors: Its motors.
    """

    config: ArmConfig
    port: BusPort
    motors: Sequence[Motor]

    def run(self) -> None:
        """Find every motor and leave it configured, with its state known.

        Raises:
            DriveError: Names the joint, its node, and what is wrong.
        """
        for motor in self.motors:
            self.port.send(motor.joint.node, damiao.DISABLE)
        for motor in self.motors:
            motor.ranges = Ranges(*(self._range(motor, register) for register in RANGES))
            self._check_range(motor)
            self._set(motor, Register.MODE, MIT_MODE)
            self._set(motor, Register.TIMEOUT, round(self.config.watchdog / TIMEOUT_UNIT))
            self._refresh(motor)

    def _range(self, motor: Motor, register: Register) -> float:
        value = self._ask(motor, damiao.READ, register)
        if not 0.0 < value < math.inf:
            motor.fail(f"has {value:g} in register {int(register)}, which is no range")
        return value

    def _check_range(self, motor: Motor) -> None:
        """Refuse a motor that cannot be told all positions of its joint."""
        joint, limits, j = motor.joint, self.config.model.limits, motor.number - 1
        range_ = (float(limits.position_min[j]), float(limits.position_max[j]))
        ends = [joint.offset + joint.direction * end for end in range_]
        if max(map(abs, ends)) > motor.ranges.position:
            motor.fail(
                f"spans {motor.ranges.position:g} rad each way (register 21), but its joint needs "
                f"{min(ends):.4g} to {max(ends):.4g} rad"
            )

    def _set(self, motor: Motor, register: Register, value: int) -> None:
        if self._ask(motor, damiao.WRITE, register, value) != value:
            motor.fail(f"does not take {value} in register {int(register)}; not used")

    def _ask(self, motor: Motor, what: int, register: Register, given: int = 0) -> float:
        """Return the value that a motor answers with."""
        request = damiao.register_frame(motor.joint.node, what, register, given)
        answer: float | None = None
        for _ in range(ATTEMPTS):
            self.port.send(damiao.REGISTERS, request)
            until = self.port.now() + self.config.answer_timeout / ATTEMPTS
            while answer is None and (frame := self.port.receive(until)) is not None:
                if frame.id == motor.joint.reply_id and len(frame.data) == damiao.FRAME:
                    *about, value = damiao.decode_register(frame.data)
                    answer = value if about == [motor.joint.node, what, register] else None
            if answer is not None:
                return answer
        return self._miss(motor)

    def _refresh(self, motor: Motor) -> None:
        """Ask a motor where it is."""
        for _ in range(ATTEMPTS):
            self.port.send(
                damiao.REGISTERS, damiao.register_frame(motor.joint.node, damiao.REFRESH)
            )
            until = self.port.now() + self.config.answer_timeout / ATTEMPTS
            while (frame := self.port.receive(until)) is not None:
                if frame.id == motor.joint.reply_id:
                    motor.take(frame.data)
                if motor.heard:
                    return
        self._miss(motor)

    def _miss(self, motor: Motor) -> NoReturn:
        """Say that a motor does not answer, and which ids do."""
        for node in range(1, 0x80):
            self.port.send(damiao.REGISTERS, damiao.register_frame(node, damiao.REFRESH))
        known, found = {motor.joint.reply_id for motor in self.motors}, set[int]()
        until = self.port.now() + SEARCH_TIME
        while (frame := self.port.receive(until)) is not None:
            if frame.id != damiao.REGISTERS and len(frame.data) == damiao.FRAME:
                found.add(frame.id)
        strangers = sorted(found - known)
        hint = f"; ids that reply and are no joint's: {strangers}" if strangers else ""
        motor.fail(
            f"does not answer on {self.port.name} within {self.config.answer_timeout:g} s{hint}"
        )


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
