"""A simulated Damiao motor in MIT mode: one joint of the arm, without a brake.

It makes torque only while commands come: after the time of register 9 without one it switches
itself off, and what hangs on it falls. Until it is first enabled, somebody holds the arm. Torque is
what its current makes, so it tells none without power.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from backends.can.config import DamiaoJoint
from backends.can.damiao import codec as damiao
from backends.can.simulator.drive import Actuation, JointPort, SimulatedDrive
from limo_driver.errors import WireFormatError

POSITION_RANGE: Final = 12.5  # [rad], as such motors are delivered
VELOCITY_RANGE: Final = 10.0  # [rad/s]
TORQUE_MARGIN: Final = 1.25  # full scale of the torque, over what the joint may be asked for
WRITABLE: Final = {damiao.Register.TIMEOUT, damiao.Register.MODE}


class DamiaoDrive(SimulatedDrive):
    """One motor.

    Args:
        joint: Its ids and its signs.
        torque_limit: What the joint may be asked for [N m].
        port: The cable to its joint.
        send: Puts a frame on the bus.
    """

    def __init__(
        self,
        joint: DamiaoJoint,
        torque_limit: float,
        port: JointPort,
        send: Callable[[int, bytes], None],
    ) -> None:
        self.node = joint.node
        self._joint, self._port, self._send = joint, port, send
        self._registers: dict[int, float] = {
            damiao.Register.REPLY_ID: joint.reply_id,
            damiao.Register.TIMEOUT: 0,
            damiao.Register.MODE: damiao.MIT_MODE,
            damiao.Register.POSITION_RANGE: POSITION_RANGE,
            damiao.Register.VELOCITY_RANGE: VELOCITY_RANGE,
            damiao.Register.TORQUE_RANGE: TORQUE_MARGIN * torque_limit,
        }
        self.ranges = damiao.Ranges(POSITION_RANGE, VELOCITY_RANGE, TORQUE_MARGIN * torque_limit)
        self.status = damiao.Status.DISABLED
        self._commanded_at: float | None = None  # [s] last command while enabled
        self._zero = 0.0  # set by whoever commissions it [rad]
        self._at_rest = Actuation.BRAKE  # what acts on the joint without power

    @property
    def period(self) -> float:
        """No communication period: these motors know no SYNC."""
        return 0.0

    @property
    def enabled(self) -> bool:
        """Whether it follows set-points."""
        return self.status is damiao.Status.ENABLED

    def start(self, now: float) -> None:  # noqa: ARG002  # nothing is said at power on
        """Be switched on."""
        self._switch(damiao.Status.DISABLED)

    def hear(self, frame_id: int, data: bytes, now: float) -> None:
        """Take a frame that may be for it."""
        with suppress(WireFormatError):
            if frame_id == self.node:
                self._obey(data, now)
            elif frame_id == damiao.REGISTERS:
                self._answer(data)

    def synchronise(self, now: float) -> None:
        """Know no SYNC."""

    def tick(self, now: float) -> None:
        """Switch off when commands cease."""
        patience = damiao.TIMEOUT_UNIT * self._registers[damiao.Register.TIMEOUT]
        late = self._commanded_at is not None and now - self._commanded_at > patience
        if patience and late and self.status is damiao.Status.ENABLED:
            self._switch(damiao.Status.LOST_COMMUNICATION)

    def demand(self, period: float) -> None:  # the command is on the joint already
        """Go on with the last command."""

    def fail(self, code: int) -> None:
        """Have a fault: a status of the motor's, or a hot winding for a code of CiA 402."""
        known = code in {status.value for status in damiao.Status} and damiao.Status(code).is_fault
        self._switch(damiao.Status(code) if known else damiao.Status.HOT_WINDING)

    def recover(self) -> None:
        """Be back on the bus; the motor says nothing until it is asked."""

    def _obey(self, data: bytes, now: float) -> None:
        if data == damiao.ENABLE:
            if not self.status.is_fault:
                self._at_rest = Actuation.FREE
                self._switch(damiao.Status.ENABLED)
                self._commanded_at = now
        elif data == damiao.DISABLE:
            if not self.status.is_fault:
                self._switch(damiao.Status.DISABLED)
        elif data == damiao.CLEAR:
            self._switch(damiao.Status.DISABLED)
        elif data == damiao.ZERO:
            if self.status is damiao.Status.DISABLED:  # what is powered would jump
                self._zero += self._position
        elif self._registers[damiao.Register.MODE] != damiao.MIT_MODE:
            return
        elif self.status is damiao.Status.ENABLED:
            self._follow(damiao.decode_command(data, self.ranges))
            self._commanded_at = now
        self._reply()

    def _follow(self, command: damiao.MitCommand) -> None:
        port, sign = self._port, self._joint.direction
        port.actuation = Actuation.IMPEDANCE
        port.position = sign * (command.position + self._zero - self._joint.offset)
        port.velocity = sign * command.velocity
        port.torque = sign * command.torque
        port.stiffness, port.damping = command.stiffness, command.damping

    @property
    def _position(self) -> float:
        """Position of the motor, from its zero [rad]."""
        joint = self._joint
        return joint.offset + joint.direction * self._port.measured_position - self._zero

    def _switch(self, status: damiao.Status) -> None:
        port = self._port
        self.status, self._commanded_at = status, None
        port.actuation = self._at_rest
        port.torque = port.stiffness = port.damping = port.velocity = 0.0

    def _reply(self) -> None:
        port, sign, warm = self._port, self._joint.direction, round(self._port.temperature)
        reply = damiao.Reply(
            self.status,
            self.node,
            self._position,
            sign * port.measured_velocity,
            sign * port.measured_torque if self.enabled else 0.0,
            warm,
            warm,
        )
        self._send(self._joint.reply_id, damiao.encode_reply(reply, self.ranges))

    def _answer(self, data: bytes) -> None:
        """Answer who asks for registers, or for the state, of this motor."""
        motor, what, register, value = damiao.decode_register(data)
        if motor != self.node:
            return
        if what == damiao.REFRESH:
            self._reply()
        elif register in self._registers and what in {damiao.READ, damiao.WRITE}:
            if what == damiao.WRITE and register in WRITABLE and register not in damiao.FLOATS:
                self._registers[register] = value
            answer = damiao.register_frame(self.node, what, register, self._registers[register])
            self._send(self._joint.reply_id, answer)
