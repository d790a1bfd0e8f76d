"""What every simulated drive is, the joint that it moves, and the states of one of CiA 402.

Source: IEC 61800-7-201 (CiA 402), "Finite state automaton".

A simulated Damiao motor in MIT mode: one joint of the arm, without a brake.

It makes torque only while commands come: after the time of register 9 without one it switches
itself off, and what hangs on it falls. Until it is first enabled, somebody holds the arm. Torque is
what its current makes, so it tells none without power.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from backends.can.config import DamiaoJoint
from backends.can.damiao import codec as damiao
from limo_driver.errors import WireFormatError

AMBIENT = 25.0  # [°C]


class SimulatedDrive(ABC):
    """One drive on the bus, built into one joint."""

    node: int  # id under which it is spoken to

    @property
    @abstractmethod
    def period(self) -> float:
        """Configured communication period [s]; 0 if none."""

    @property
    @abstractmethod
    def enabled(self) -> bool:
        """Whether it follows set-points."""

    @abstractmethod
    def start(self, now: float) -> None:
        """Be switched on."""

    @abstractmethod
    def hear(self, frame_id: int, data: bytes, now: float) -> None:
        """Take a frame that may be for it; never a SYNC."""

    @abstractmethod
    def synchronise(self, now: float) -> None:
        """Hear a SYNC."""

    @abstractmethod
    def tick(self, now: float) -> None:
        """Let time pass, for heartbeats and watchdogs."""

    @abstractmethod
    def demand(self, period: float) -> None:
        """Tell the joint what to do in the coming period [s]."""

    @abstractmethod
    def fail(self, code: int) -> None:
        """Have a fault, with an error code of its convention."""

    @abstractmethod
    def recover(self) -> None:
        """Be back on the bus after it was off."""


class Actuation(Enum):
    """Way in which a drive acts on its joint."""

    BRAKE = "brake"  # closed without power: keeps the position at which it closed
    FREE = "free"  # no power and no brake: the arm falls
    POSITION = "position"  # the drive's servo follows `position`
    TORQUE = "torque"  # `torque` alone
    IMPEDANCE = "impedance"  # spring and damper around `position` and `velocity`, and `torque`


@dataclass
class JointPort:
    """The cable between one drive and its joint; SI units of the joint, signs of the arm.

    The drive writes what it makes the joint do, the arm writes what the sensors read.
    """

    position: float = 0.0  # to be reached at the end of the current communication period [rad]
    velocity: float = 0.0  # of an impedance [rad/s]
    torque: float = 0.0  # made as such, or beside the servo [N m]
    stiffness: float = 0.0  # [N m/rad]
    damping: float = 0.0  # [N m s/rad]
    actuation: Actuation = Actuation.BRAKE

    measured_position: float = 0.0  # [rad]
    measured_velocity: float = 0.0  # [rad/s]
    measured_torque: float = 0.0  # [N m]
    temperature: float = AMBIENT  # of the winding [°C]


STREAM: Final = 3  # set-points in a row that make a stream
BRIDGED: Final = 1  # periods without set-point in which the joint goes on as it moves
RETURN_RATE: Final = 20.0  # [rad/s], of the critically damped way back to the stream
NEGLIGIBLE: Final = 1e-9  # [rad]


class StatuswordState(IntEnum):
    """States; each value is the statusword's bits that say so."""

    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


POWERED: Final = {
    StatuswordState.ENABLED,
    StatuswordState.QUICK_STOP,
    StatuswordState.FAULT_REACTION,
}
FAULTY: Final = {StatuswordState.FAULT_REACTION, StatuswordState.FAULT}
FAULT_RESET: Final = 0x80

# Bits of the controlword: switch on, enable voltage, quick stop (active low), enable operation.
_DISABLE_VOLTAGE = (0x02, 0x00)  # mask and value of each command
_QUICK_STOP = (0x06, 0x02)
_SHUTDOWN = (0x07, 0x06)
_SWITCH_ON = (0x0F, 0x07)
_ENABLE = (0x0F, 0x0F)

_S = StatuswordState
_OFF = {
    _S.READY: _S.SWITCH_ON_DISABLED,
    _S.SWITCHED_ON: _S.SWITCH_ON_DISABLED,
}
_TRANSITIONS: Final[dict[tuple[int, int], dict[StatuswordState, StatuswordState]]] = {
    _DISABLE_VOLTAGE: {
        **_OFF,
        _S.ENABLED: _S.SWITCH_ON_DISABLED,
        _S.QUICK_STOP: _S.SWITCH_ON_DISABLED,
    },
    _QUICK_STOP: {**_OFF, _S.ENABLED: _S.QUICK_STOP},
    _SHUTDOWN: {
        _S.SWITCH_ON_DISABLED: _S.READY,
        _S.SWITCHED_ON: _S.READY,
        _S.ENABLED: _S.READY,
    },
    _SWITCH_ON: {_S.READY: _S.SWITCHED_ON, _S.ENABLED: _S.SWITCHED_ON},
    # Enabling from `ready` passes `switched on`, as the standard allows.
    _ENABLE: {_S.READY: _S.ENABLED, _S.SWITCHED_ON: _S.ENABLED},
}


def commanded(state: StatuswordState, controlword: int, before: int) -> StatuswordState:
    """Return the state that a controlword leads to.

    Args:
        state: The state it meets.
        controlword: Object 6040 as written now.
        before: The controlword before it: a fault is reset by the rise of bit 7 alone.
    """
    if state is StatuswordState.FAULT:
        rises = controlword & FAULT_RESET and not before & FAULT_RESET
        return StatuswordState.SWITCH_ON_DISABLED if rises else state
    if controlword & FAULT_RESET:
        return state  # the other bits mean nothing then
    for (mask, value), moves in _TRANSITIONS.items():
        if controlword & mask == value:
            return moves.get(state, state)
    return state


def enables(controlword: int) -> bool:
    """Say whether a controlword enables operation."""
    mask, value = _ENABLE
    return controlword & (mask | FAULT_RESET) == value


class SetpointStream:
    """Positions that come once a period [rad].

    A set-point that is missing from a stream is bridged with the velocity that the joint has; where
    more are missing, the joint slows down. Once the stream goes on, the joint returns to it without
    a jolt. A single position that is written, and no stream, is just gone to.
    """

    def __init__(self) -> None:
        self.position = 0.0  # that is demanded now [rad]
        self.velocity = 0.0  # while set-points are missing [rad/s]
        self.start(0.0)

    def start(self, position: float, velocity: float = 0.0) -> None:
        """Begin where the joint is [rad], as it moves [rad/s]."""
        self.position, self.velocity = position, velocity
        self._target, self._rate = position, 0.0  # of the stream [rad], [rad/s]
        self._off, self._off_rate = 0.0, 0.0  # from the stream [rad], [rad/s]
        self._length = self._missing = 0

    def take(self, target: float, period: float) -> None:
        """Take the set-point of a period [s]."""
        if self._missing:
            self._off = self.position - (target - period * self._rate)
            self._off_rate = self.velocity - self._rate
        else:
            self._rate = (target - self._target) / period
        self._target, self._missing, self._length = target, 0, self._length + 1
        self._return(period)
        self.position = target + self._off

    def miss(self, target: float, velocity: float, period: float, deceleration: float) -> None:
        """Go on without a set-point for a period [s].

        Args:
            target: The last one [rad].
            velocity: Of the joint [rad/s].
            period: [s].
            deceleration: With which a stream that ended slows down [rad/s^2].
        """
        if self._length < STREAM:
            self.start(target)
            return
        self._missing += 1
        if self._missing <= BRIDGED:
            self.velocity = velocity
            self.position += period * velocity
        else:
            self.slow_down(period, deceleration)

    def slow_down(self, period: float, deceleration: float) -> bool:
        """Go on for a period [s] along a ramp [rad/s^2]; say whether it has come to rest."""
        slower = max(abs(self.velocity) - deceleration * period, 0.0)
        self.velocity = math.copysign(slower, self.velocity)
        self.position += period * self.velocity
        return slower == 0.0

    def _return(self, period: float) -> None:
        """Come closer to the stream: x'' + 2 w x' + w^2 x = 0, solved over a period [s]."""
        if not self._off:
            return
        w, fading = RETURN_RATE, math.exp(-RETURN_RATE * period)
        slope = self._off_rate + w * self._off
        self._off_rate = (self._off_rate - w * slope * period) * fading
        self._off = (self._off + slope * period) * fading
        if abs(self._off) < NEGLIGIBLE and abs(self._off_rate) < NEGLIGIBLE:
            self._off = self._off_rate = 0.0


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
