"""A simulated CiA 402 drive: position and torque in step with SYNC, one joint of the arm.

Its brake is closed whenever it is without power. It obeys its own limits and watchdogs, whatever
the master does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from backends.can import port as frames
from backends.can.config import Cia402Joint, Temperature
from backends.can.simulator import node
from backends.can.simulator.drive import (
    FAULTY,
    POWERED,
    Actuation,
    JointPort,
    SetpointStream,
    SimulatedDrive,
    StatuswordState,
    commanded,
    enables,
)
from backends.can.simulator.objects import (
    I8,
    I16,
    I32,
    OUT_OF_RANGE,
    U8,
    U16,
    U32,
    SdoAbort,
    SimulatedPdo,
    Variable,
)

CSP, CST = 8, 10  # modes of operation
SUPPORTED: Final = 1 << 7 | 1 << 9  # object 6502: CSP and CST
SERVO_DRIVE: Final = 0x00020192  # object 1000: servo drive of profile 402
FIRST_SERIAL: Final = 1000  # serial number of joint 1, where the configuration has none
FOLLOWING_ERROR: Final = 0x8611
FOLLOWING_WINDOW: Final = 0.15  # [rad]
QUICK_STOP_DECELERATION: Final = 2.0  # [rad/s^2]
FULL_SCALE_16: Final = 32767
FULL_SCALE_32: Final = 2**31 - 1
# Bits of the statusword beside the state.
VOLTAGE_ENABLED, WARNING, REMOTE, LIMIT_ACTIVE, FOLLOWS = 1 << 4, 1 << 7, 1 << 9, 1 << 11, 1 << 12
# Option codes.
NO_ACTION, FAULT_SIGNAL, DISABLE_VOLTAGE, QUICK_STOP = 0, 1, 2, 3  # 6007
STAYS: Final = (5, 6, 7, 8)  # 605A: stays in quick stop
PDOS: Final = 4  # each way


@dataclass(frozen=True)
class Scale:
    """Units of a drive against those of its joint."""

    joint: Cia402Joint

    def count(self, position: float) -> int:
        """Return the count of a joint position [rad]."""
        count = round((position - self.joint.offset) * self.joint.counts_per_radian)
        return max(-FULL_SCALE_32, min(count, FULL_SCALE_32))

    def position(self, count: int) -> float:
        """Return the joint position [rad] of a count."""
        return self.joint.offset + count / self.joint.counts_per_radian

    def count_rate(self, velocity: float) -> int:
        """Return counts per second of a joint velocity [rad/s]."""
        return round(velocity * self.joint.counts_per_radian)

    def per_mille(self, torque: float) -> int:
        """Return a joint torque [N m] in per mille of the rated torque."""
        value = round(self.joint.direction * torque * 1e3 / self.joint.rated_torque)
        return max(-FULL_SCALE_16, min(value, FULL_SCALE_16))

    def torque(self, per_mille: int) -> float:
        """Return the joint torque [N m] of so many per mille."""
        return self.joint.direction * per_mille * 1e-3 * self.joint.rated_torque


class Cia402Drive(node.CanopenNode, SimulatedDrive):
    """One drive.

    Args:
        number: The joint it is built into, from 1.
        joint: How that joint is geared and rated; its node id is the drive's.
        port: The cable to its joint.
        send: Puts a frame on the bus.
        temperature: Where it keeps its temperature, if anywhere.
    """

    def __init__(
        self,
        number: int,
        joint: Cia402Joint,
        port: JointPort,
        send: Callable[[int, bytes], None],
        temperature: Temperature | None = None,
    ) -> None:
        serial = FIRST_SERIAL + number if joint.serial is None else joint.serial
        vendor = node.VENDOR if joint.vendor is None else joint.vendor
        name = f"limo simulated drive, joint {number}"
        super().__init__(joint.node, send, name, SERVO_DRIVE, (vendor, node.PRODUCT, 1, serial))
        self._port, self._scale = port, Scale(joint)
        self._drive_state = StatuswordState.SWITCH_ON_DISABLED
        self._controlword_before = 0
        self._mode_before = CSP
        self._stream = SetpointStream()
        self._fresh = False  # a position came in this period
        self._limited = False
        self._add_profile(temperature)
        # Add four PDOs each way; what is in them by default is what profile 402 says
        received = [((0x6040, 0),), ((0x6040, 0), (0x6060, 0)), ((0x6040, 0), (0x607A, 0)), ()]
        sent = [((0x6041, 0),), ((0x6041, 0), (0x6061, 0)), ((0x6041, 0), (0x6064, 0)), ()]
        for k in range(PDOS):
            rpdo, tpdo = frames.RPDO1 + 0x100 * k, frames.TPDO1 + 0x100 * k
            on = k == 0
            self.rpdos.append(
                SimulatedPdo(
                    self.objects, 0x1400 + k, 0x1600 + k, rpdo + self.node, received[k], on=on
                )
            )
            self.tpdos.append(
                SimulatedPdo(self.objects, 0x1800 + k, 0x1A00 + k, tpdo + self.node, sent[k], on=on)
            )
        self.reset_application()

    @property
    def period(self) -> float:
        """Configured communication period [s]; 0 if none."""
        return self.sync_period

    @property
    def enabled(self) -> bool:
        """Whether it follows set-points."""
        return self._drive_state is StatuswordState.ENABLED

    @property
    def drive_state(self) -> StatuswordState:
        """State of the drive's state machine."""
        return self._drive_state

    def reset_application(self) -> None:
        """Go back to what the drive is when it is switched on."""
        self._enter(StatuswordState.SWITCH_ON_DISABLED)
        self._controlword_before = 0
        for variable in (self._controlword, self._offset, self._target_torque, self._error):
            variable.value = 0
        self._mode.value = self._mode_before = CSP
        self._register.value = 0

    def fail(self, code: int) -> None:
        """Have a fault: stop, then stay without power until it is reset.

        Args:
            code: Error code of CiA 402, for example 0x4310: too hot.
        """
        if self._drive_state in FAULTY:
            return
        self._error.value = code
        powered = self._drive_state in POWERED
        self.emergency(code)
        stops = powered and self.objects.number(0x605E) != 0
        self._enter(StatuswordState.FAULT_REACTION if stops else StatuswordState.FAULT)

    def recover(self) -> None:
        """Be back on the bus after it was off."""
        self.emergency(node.BUS_OFF_RECOVERED, node.COMMUNICATION)

    def communication_lost(self, code: int) -> None:
        """React as object 6007 says."""
        super().communication_lost(code)
        self._react(code)

    def left_operational(self) -> None:
        """React as object 6007 says; the master meant it, so that it is no error."""
        if self._drive_state is StatuswordState.ENABLED:
            self._react(0)

    def demand(self, period: float) -> None:
        """Tell the joint what to do in the coming period [s]."""
        port = self._port
        if self._drive_state is StatuswordState.ENABLED:
            if self._mode.value == CST:
                port.actuation = Actuation.TORQUE
                port.torque = self._wanted_torque(int(self._target_torque.value))
            else:
                self._follow(period)
        elif self._drive_state in {StatuswordState.QUICK_STOP, StatuswordState.FAULT_REACTION}:
            self._slow_down(period)
        else:
            port.actuation, port.torque = Actuation.BRAKE, 0.0

    def _follow(self, period: float) -> None:
        """Go where the set-points say."""
        port, stream = self._port, self._stream
        if port.actuation is not Actuation.POSITION:
            port.actuation = Actuation.POSITION
            stream.start(port.measured_position, port.measured_velocity)
        # The target within the software limits, where there are any (607D)
        target = int(self._target.value)
        lower, upper = self.objects.number(0x607D, 1), self.objects.number(0x607D, 2)
        limited = max(lower, min(target, upper)) if lower < upper else target  # both 0: none
        self._limited = limited != target
        target = self._scale.position(limited)
        if self._fresh:
            stream.take(target, period)
        else:
            stream.miss(target, port.measured_velocity, period, self._steepest)
        self._fresh = False
        if abs(stream.position - port.measured_position) > self._window():
            stream.start(port.measured_position, port.measured_velocity)
            self.fail(FOLLOWING_ERROR)
            return
        port.position = stream.position
        port.torque = self._wanted_torque(0)

    def _window(self) -> float:
        """Return how far target and joint may part [rad] (6065)."""
        window = int(self._following_window.value)
        if window == 0xFFFFFFFF:  # switched off  # noqa: PLR2004
            return math.inf
        return abs(window / self._scale.joint.counts_per_radian)

    def _wanted_torque(self, target: int) -> float:
        """Return target and offset within object 6072 [N m]."""
        most = int(self._most_torque.value)
        wanted = target + int(self._offset.value)
        return self._scale.torque(max(-most, min(wanted, most)))

    def _slow_down(self, period: float) -> None:
        """Go on along the ramp of a quick stop (6085); at its end, leave the state."""
        port, stream = self._port, self._stream
        if port.actuation is not Actuation.POSITION:  # it made torque, and the joint moved
            port.actuation = Actuation.POSITION
            half = 0.5 * period * port.measured_velocity
            stream.start(port.measured_position + half, port.measured_velocity)
        port.torque = 0.0
        at_rest = stream.slow_down(period, self._steepest)
        port.position = stream.position
        if not at_rest:
            return
        if self._drive_state is StatuswordState.FAULT_REACTION:
            self._enter(StatuswordState.FAULT)
        elif not self._stays:
            self._enter(StatuswordState.SWITCH_ON_DISABLED)

    @property
    def _steepest(self) -> float:
        """Deceleration of a quick stop [rad/s^2] (6085)."""
        return int(self._deceleration.value) / abs(self._scale.joint.counts_per_radian)

    def _react(self, code: int) -> None:
        option = int(self._abort_option.value)
        if self._drive_state is not StatuswordState.ENABLED or option == NO_ACTION:
            return
        if option == FAULT_SIGNAL:
            self._error.value = code
            self._enter(StatuswordState.FAULT_REACTION)
        elif option == DISABLE_VOLTAGE:
            self._enter(StatuswordState.SWITCH_ON_DISABLED)
        else:
            self._enter(StatuswordState.QUICK_STOP)

    def _control(self, controlword: int) -> None:
        """Obey a controlword."""
        before, self._controlword_before = self._controlword_before, controlword
        state = commanded(self._drive_state, controlword, before)
        if self._drive_state is StatuswordState.QUICK_STOP and self._stays and enables(controlword):
            state = StatuswordState.ENABLED
        if state is not self._drive_state:
            if self._drive_state is StatuswordState.FAULT:
                self._error.value = 0
            self._enter(state)
            if self._register.value and state is not StatuswordState.QUICK_STOP:
                self.emergency(node.SOFT_RESET)

    def _enter(self, state: StatuswordState) -> None:
        port = self._port
        if state is StatuswordState.ENABLED:
            # Whatever was written before, a drive starts where the joint is.
            self._target.value = self._scale.count(port.measured_position)
            self._target_torque.value = 0
            self._fresh = False
        elif state in POWERED:
            self._stream.velocity = port.measured_velocity
        elif state is not self._drive_state:
            port.actuation, port.torque = Actuation.BRAKE, 0.0
        self._drive_state = state

    @property
    def _stays(self) -> bool:
        """Whether a quick stop ends in its own state, not without power."""
        return int(self._quick_stop_option.value) in STAYS

    def _statusword(self) -> int:
        word = int(self._drive_state) | REMOTE
        if self._drive_state not in {StatuswordState.SWITCH_ON_DISABLED, StatuswordState.FAULT}:
            word |= VOLTAGE_ENABLED
        if self._register.value:
            word |= WARNING
        if self._drive_state is StatuswordState.ENABLED:
            word |= FOLLOWS | (LIMIT_ACTIVE if self._limited else 0)
        return word

    def _check_mode(self, mode: int) -> None:
        if mode not in {CSP, CST}:
            raise SdoAbort(OUT_OF_RANGE)

    def _change_mode(self, mode: int) -> None:
        """Start positions where the joint is; a torque may have come with the mode, and stays."""
        if mode == CSP and self._mode_before != CSP:
            self._target.value = self._scale.count(self._port.measured_position)
        self._mode_before = mode

    def _note_target(self, _count: int) -> None:
        self._fresh = True

    def _add_profile(self, temperature: Temperature | None) -> None:
        add, port, scale = self.objects.add, self._port, self._scale

        def written(kind: str, value: int = 0, **more: object) -> Variable:
            return Variable(kind, value, writable=True, **more)  # pyright: ignore[reportArgumentType]

        def measured(kind: str, read: Callable[[], int]) -> Variable:
            return Variable(kind, mappable=True, read=read)

        window = round(FOLLOWING_WINDOW * abs(scale.joint.counts_per_radian))
        ramp = round(QUICK_STOP_DECELERATION * abs(scale.joint.counts_per_radian))
        rated = round(1e3 * scale.joint.rated_torque / scale.joint.torque_ratio)  # [mN m]
        self._abort_option = add(0x6007, 0, written(I16, FAULT_SIGNAL, bounds=(0, 3)))
        self._error = add(0x603F, 0, Variable(U16, mappable=True))
        self._controlword = add(0x6040, 0, written(U16, mappable=True, changed=self._control))
        add(0x6041, 0, measured(U16, self._statusword))
        self._quick_stop_option = add(0x605A, 0, written(I16, 2, bounds=(0, 8)))
        add(0x605E, 0, written(I16, 2, bounds=(0, 2)))
        self._mode = add(
            0x6060,
            0,
            written(I8, CSP, mappable=True, check=self._check_mode, changed=self._change_mode),
        )
        add(0x6061, 0, measured(I8, lambda: int(self._mode.value)))
        add(0x6064, 0, measured(I32, lambda: scale.count(port.measured_position)))
        self._following_window = add(0x6065, 0, written(U32, window))
        add(0x606C, 0, measured(I32, lambda: scale.count_rate(port.measured_velocity)))
        self._target_torque = add(0x6071, 0, written(I16, mappable=True))
        self._most_torque = add(0x6072, 0, written(U16, 1000, mappable=True))
        add(0x6076, 0, Variable(U32, rated))
        add(0x6077, 0, measured(I16, lambda: scale.per_mille(port.measured_torque)))
        self._target = add(0x607A, 0, written(I32, mappable=True, changed=self._note_target))
        self.objects.array(0x607D, written(I32), written(I32))
        self._deceleration = add(0x6085, 0, written(U32, ramp, bounds=(1, 0xFFFFFFFF)))
        self._offset = add(0x60B2, 0, written(I16, mappable=True))
        self.objects.array(0x60C2, written(U8, 1), written(I8, -3, bounds=(-6, 0)))
        add(0x6502, 0, Variable(U32, SUPPORTED))
        if temperature is not None:
            step = temperature.step
            add(
                temperature.object,
                temperature.subindex,
                measured(I16, lambda: round(port.temperature / step)),
            )
