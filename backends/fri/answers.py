"""What the client answers in each session state and command mode.

| session state     | answer                                                                  |
|-------------------|-------------------------------------------------------------------------|
| IDLE              | none                                                                    |
| MONITORING_*      | 1.x: the commanded position, mirrored; from 2.5 on: the header only     |
| COMMANDING_WAIT   | the position of the robot's application, mirrored; no torque, no wrench |
| COMMANDING_ACTIVE | the set-point, or that position with a torque or wrench                 |
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backends.fri.messages import Command, CommandData, CommandMode, Header, SessionState
from backends.fri.version import Generation
from limo_driver.types import PositionCommand, TorqueCommand, WrenchCommand

if TYPE_CHECKING:
    from backends.fri.messages import IoValue, Monitoring
    from backends.fri.wire_limits import WireLimits
    from limo_driver.types import FloatArray, JointCommand

TAKES = {
    CommandMode.POSITION: PositionCommand,
    CommandMode.TORQUE: TorqueCommand,
    CommandMode.WRENCH: WrenchCommand,
}


def command_mode(message: Monitoring) -> CommandMode:
    """Return what the robot's application lets the client command."""
    ipo = message.ipo
    return CommandMode.NONE if ipo is None or ipo.command_mode is None else ipo.command_mode


def application_position(message: Monitoring, wire: WireLimits) -> FloatArray | None:
    """Return where the robot's own application has the arm, (n,) [rad]; None if it does not say.

    A position that is not finite, or out of the arm's range, is none.
    """
    if message.ipo is None or message.ipo.joint_position is None:
        return None
    position = np.array(message.ipo.joint_position)
    return position if wire.usable(position) else None


def answer_to(
    message: Monitoring,
    sequence: int,
    generation: Generation,
    wire: WireLimits,
    setpoint: FloatArray,
    command: JointCommand | None,
    outputs: tuple[IoValue, ...],
) -> Command | None:
    """Return what to answer; None for no answer.

    Args:
        message: What the robot said.
        sequence: Of the answer.
        generation: Of its messages.
        wire: Limits between commands.
        setpoint: Position at which an arm is held that nobody commands, (n,) [rad].
        command: What the user wants, within the limits; None to hold.
        outputs: To be set.
    """
    state = SessionState.IDLE if message.connection is None else message.connection.session_state
    mode, header = command_mode(message), Header(sequence, message.header.sequence)
    if state is SessionState.IDLE:
        return None
    if state in {SessionState.MONITORING_WAIT, SessionState.MONITORING_READY}:
        return Command(header, _monitored(message, generation, wire, outputs))
    if state is SessionState.COMMANDING_ACTIVE and mode in TAKES:
        return Command(header, _active(message, mode, wire, setpoint, command, outputs))
    mirrored = _mirrored(message, mode, wire, outputs)
    return None if mirrored is None else Command(header, mirrored)


def _monitored(
    message: Monitoring, generation: Generation, wire: WireLimits, outputs: tuple[IoValue, ...]
) -> CommandData | None:
    """Return what the robot asks for and ignores while it is only monitored."""
    data = message.data
    if generation is not Generation.ONE or data is None:
        return CommandData(io=outputs) if outputs else None
    told = data.commanded_position
    usable = told is not None and wire.usable(np.array(told))
    return CommandData(told if usable else data.measured_position, io=outputs)


def _active(
    message: Monitoring,
    mode: CommandMode,
    wire: WireLimits,
    setpoint: FloatArray,
    command: JointCommand | None,
    outputs: tuple[IoValue, ...],
) -> CommandData:
    if mode is CommandMode.POSITION:
        wanted = command.position if isinstance(command, PositionCommand) else setpoint
        return CommandData(_floats(wire.position(wanted)), io=outputs)
    told = application_position(message, wire)
    position = _floats(wire.position(setpoint if told is None else told))
    if mode is CommandMode.TORQUE:
        torque = wire.torque(command.torque if isinstance(command, TorqueCommand) else None)
        return CommandData(position, joint_torque=_floats(torque), io=outputs)
    wrench = wire.wrench(command.wrench if isinstance(command, WrenchCommand) else None)
    return CommandData(position, wrench=_floats(wrench), io=outputs)


def _mirrored(
    message: Monitoring, mode: CommandMode, wire: WireLimits, outputs: tuple[IoValue, ...]
) -> CommandData | None:
    """Return the position of the robot's application; None if there is none to mirror."""
    if mode is CommandMode.CARTESIAN_POSE and message.ipo is not None and message.ipo.pose:
        return CommandData(pose=message.ipo.pose, redundancy=message.ipo.redundancy, io=outputs)
    told = application_position(message, wire)
    if told is None:
        return None
    position = _floats(wire.position(told))
    if mode is CommandMode.TORQUE:
        return CommandData(position, joint_torque=_floats(wire.torque(None)), io=outputs)
    if mode is CommandMode.WRENCH:
        return CommandData(position, wrench=_floats(wire.wrench(None)), io=outputs)
    return CommandData(position, io=outputs)


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(values.tolist())
