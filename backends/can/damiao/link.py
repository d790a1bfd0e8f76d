"""DamiaoLink: motors in MIT mode; each command is answered by what the motor measures.

There is no SYNC: set-points act as they arrive, joint after joint, within the 1.9 ms that seven
commands and seven replies take of a bus of 1 Mbit/s. The motors know no arm, so that gravity is
compensated here, by their torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backends.can.damiao import codec as damiao
from backends.can.damiao.codec import MOST_DAMPING, STIFFEST, MitCommand, status_words
from backends.can.damiao.setup import Motor, Setup, check_ids
from backends.can.link import DriveSample, DriveStatus, Link
from backends.can.port import BusLoad, Traffic
from limo_driver.errors import BackendError, JointLimitError
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.can.config import ArmConfig, DamiaoJoint
    from backends.can.port import BusPort
    from limo_driver.robot.output import Setpoint
    from limo_driver.types import FloatArray, JointCommand


class DamiaoLink(Link):
    """The motors of an arm.

    Args:
        config: The arm.
        port: Its bus.
        reset: Whether faults that motors have already may be cleared.

    Raises:
        ConfigError: The bus cannot carry the rate, or ids that collide.
    """

    def __init__(self, config: ArmConfig, port: BusPort, *, reset: bool = False) -> None:
        bus_load(config).require(config.rate)
        super().__init__(port, 1.0 / config.rate, config.model)
        self.config, self._reset = config, reset
        joints: tuple[DamiaoJoint, ...] = config.joints  # type: ignore[assignment]
        self._motors = [Motor(j, joint) for j, joint in enumerate(joints, start=1)]
        check_ids(self._motors)
        self._handlers = self._dispatch()
        self._sign = np.array([joint.direction for joint in joints], dtype=float)
        self._offset = np.array([joint.offset for joint in joints])
        self._stiffness = np.array([joint.stiffness for joint in joints])
        self._damping = np.array([joint.damping for joint in joints])
        self.gains = self._stiffness, self._damping
        self._torque_step = config.model.limits.torque_rate / config.rate  # [N m] in a cycle
        self._setpoint: Setpoint | None = None
        self._moves = False  # the set-point is of this cycle; one that is repeated stands
        self._pinned = np.ones(len(joints), dtype=bool)  # joints that keep the pose they have
        self._powered = False
        self._unsent: list[tuple[int, bytes]] = []  # commands of a cycle that the bus did not take

    @property
    def torque_resolution(self) -> FloatArray:
        """Smallest change that the measured torques show, (n,) [N m]."""
        return np.array([motor.ranges.torque_step for motor in self._motors])

    @property
    def most_torque(self) -> FloatArray:
        """Highest torque that can be said to the motors, (n,) [N m]."""
        return np.array([motor.ranges.torque for motor in self._motors])

    def connect(self) -> None:
        """Find every motor, switch it off, read its ranges, and set its watchdog and mode."""
        Setup(self.config, self.port, self._motors).run()
        self.target = self._sample().position

    def enable(self, *, reset: bool = False) -> None:
        """Let the motors hold the pose that they measure."""
        reset = reset or self._reset
        until = self.port.now() + self.config.answer_timeout
        self._powered, self.port.bus_off, self.intruder = True, False, ""
        self._unsent = []
        self._setpoint = None  # who is enabled holds its pose
        # Somebody may have moved the arm since it was last heard. What is switched off answers to
        # a command too, and obeys nothing.
        self._run_cycle()
        waiting = [motor for motor in self._motors if not motor.enabled]
        while waiting:
            for motor in waiting:
                motor.silent = 0
                if motor.heard:
                    self._switch_on(motor, reset=reset)
            self._run_cycle()
            waiting = [motor for motor in waiting if not motor.enabled]
            if waiting and self.port.now() > until:
                self._give_up(waiting[0], reset=reset)
        self._reset = False

    def check(self, command: JointCommand) -> None:
        """Refuse a command that the motors cannot carry out."""
        if not isinstance(command, (PositionCommand, ImpedanceCommand, TorqueCommand)):
            raise BackendError(f"Damiao motors know no {type(command).__name__}")
        if isinstance(command, ImpedanceCommand):
            _check_gain("stiffness", command.stiffness, STIFFEST, "N m/rad")
            _check_gain("damping", command.damping, MOST_DAMPING, "N m s/rad")

    def command(self, setpoint: Setpoint) -> None:
        """Take the set-points of the coming cycle."""
        self._setpoint, self._moves = setpoint, True
        self.target = np.where(self._pinned, self.target, setpoint.position)

    def begin(self) -> None:
        """Follow commands again."""
        self._pinned[:] = False

    def send(self) -> None:
        """Wait: a motor acts on its command as it arrives, which is when the cycle is due."""

    def measure(self, until: float) -> DriveSample | None:
        """Command all motors and return what they answer; None if one was not heard in time."""
        self._exchange(until)
        self._moves = False
        if not self._all_heard():
            return None
        return self._sample()

    def observe(self, until: float) -> DriveSample | None:
        """Ask motors where they are, which commands nothing."""
        asked = [
            (damiao.REGISTERS, damiao.register_frame(motor.joint.node, damiao.REFRESH))
            for motor in self._motors
        ]
        self._exchange(until, asked)
        return self._sample() if self._all_heard() else None

    def _trouble_of_drives(self) -> str:
        for motor in self._motors:
            if text := motor.complaint(self.config.hold_after):
                return f"joint {motor.number} (node {motor.joint.node}) {text}"
        return ""

    def drives(self) -> tuple[DriveStatus, ...]:
        """Return the latest values of every motor."""
        sample = self._sample()
        return tuple(
            DriveStatus(
                node=motor.joint.node,
                status=status_words(motor.known.status),
                enabled=motor.enabled,
                position=float(sample.position[j]),
                velocity=float(sample.velocity[j]),
                torque=float(sample.torque[j]),
                temperature=motor.temperature,
                mode="MIT",
                error=status_words(motor.known.status) if motor.faulty else "",
                silent=motor.silent,
            )
            for j, motor in enumerate(self._motors)
        )

    def condition(self) -> tuple[FloatArray | None, tuple[str, ...]]:
        """Return temperatures (n,) [°C] and statuses, in every cycle."""
        temperature = np.array([motor.temperature for motor in self._motors])
        return temperature, tuple([motor.status for motor in self._motors])

    def disable(self) -> None:
        """Switch the motors off, the last joint first; without a brake, the arm sinks."""
        if self._powered:
            for motor in reversed(self._motors):
                self.port.send(motor.joint.node, damiao.DISABLE)
        self._powered = False

    # within -------------------------------------------------------------------------------------

    def _switch_on(self, motor: Motor, *, reset: bool) -> None:
        """Enable a motor where it stands."""
        self._pinned[motor.number - 1] = True
        self.target[motor.number - 1] = self._sample().position[motor.number - 1]
        if motor.faulty and reset:
            self.port.send(motor.joint.node, damiao.CLEAR)
        self.port.send(motor.joint.node, damiao.ENABLE)

    def _give_up(self, motor: Motor, *, reset: bool) -> None:
        if not motor.heard:
            motor.fail(f"does not answer within {self.config.answer_timeout:g} s")
        curable = motor.faulty and not reset
        hint = "; open with reset_faults=True (limo run --reset-faults)" if curable else ""
        motor.fail(f"cannot be enabled: {status_words(motor.known.status)}{hint}")

    def _run_cycle(self) -> None:
        """Run one cycle apart from the robot's own."""
        due = self.port.now() + self._period
        self._exchange(due)
        self.listen(due)

    def _exchange(self, until: float, frames: list[tuple[int, bytes]] | None = None) -> None:
        """Send a cycle's frames, by default its commands; hear what motors answer until then."""
        for motor in self._motors:
            motor.open_cycle()
        # One that is switched off answers too, and obeys nothing. What the bus did not take of a
        # cycle is all that is left of it: each motor gets each command once.
        self._unsent, self._started = self._unsent or frames or self._frames(), False
        while self._unsent:
            self.port.send(*self._unsent[0])
            del self._unsent[0]
        self._started = True
        patient = not any(motor.silent for motor in self._motors)
        self._hear_answers(until, self._all_heard, patient=patient)
        for motor in self._motors:
            motor.silent = 0 if motor.heard else motor.silent + 1

    def _all_heard(self) -> bool:
        return all(motor.heard for motor in self._motors)

    def _frames(self) -> list[tuple[int, bytes]]:
        """Return the commands of this cycle as frames."""
        return [
            (motor.joint.node, damiao.encode_command(command, motor.ranges))
            for motor, command in zip(self._motors, self._commands(), strict=True)
        ]

    def _commands(self) -> list[MitCommand]:
        """Return what each motor is told in this cycle."""
        setpoint, pinned, limit = self._setpoint, self._pinned, self._model.limits.torque
        gravity = self.carried = self._gravity_to_add(setpoint)
        velocity = np.zeros(len(self._motors))
        stiffness, damping, torque = self._stiffness, self._damping, gravity
        if setpoint is not None:
            stiffness = np.where(pinned, stiffness, setpoint.stiffness)
            damping = np.where(pinned, damping, setpoint.damping)
            torque = gravity + np.where(pinned, 0.0, setpoint.torque)
            if setpoint.rigid and self._moves:
                velocity = np.where(pinned, 0.0, setpoint.velocity)
        motor_position = self._offset + self._sign * self.target
        torque = self._sign * np.clip(torque, -limit, limit)
        rows = (motor_position, self._sign * velocity, stiffness, damping, torque)
        return [MitCommand(*map(float, row)) for row in zip(*rows, strict=True)]

    def _gravity_to_add(self, setpoint: Setpoint | None) -> FloatArray:
        """Return the gravity of this cycle: what was limited with one is sent with that one."""
        if setpoint is not None and setpoint.gravity is not None:
            return setpoint.gravity
        gravity, carried = self._model.gravity_torque(self._position())[0], self.carried
        if carried is None:
            return gravity
        return np.clip(gravity, carried - self._torque_step, carried + self._torque_step)

    def _position(self) -> FloatArray:
        return self._sample().position

    def _sample(self) -> DriveSample:
        replies = [motor.known for motor in self._motors]
        position = np.array([reply.position for reply in replies])
        return DriveSample(
            position=self._sign * (position - self._offset),
            velocity=self._sign * np.array([reply.velocity for reply in replies]),
            torque=self._sign * np.array([reply.torque for reply in replies]),
        )

    def _dispatch(self) -> dict[int, Callable[[bytes], None]]:
        """Return who takes the frames of each id; those of this program are nobody else's."""
        handlers = {damiao.REGISTERS: self._intrude("registers", damiao.REGISTERS)}
        for motor in self._motors:
            node = motor.joint.node
            handlers[node] = self._intrude(f"a command of joint {motor.number}", node)
        return handlers | {motor.joint.reply_id: motor.take for motor in self._motors}


def bus_load(config: ArmConfig) -> BusLoad:
    """Return the load at the arm's rate, with worst stuffing."""
    n, rate, bus = len(config.joints), config.rate, config.bus
    traffic = (Traffic("commands", n, 8, rate), Traffic("replies", n, 8, rate))
    return BusLoad(traffic, bus.bitrate, bus.data_bitrate if bus.fd else None)


def _check_gain(name: str, given: FloatArray, most: float, unit: str) -> None:
    if (given > most).any():
        j = int(np.argmax(given))
        raise JointLimitError(j + 1, name, float(given[j]), (0.0, most), unit)
