"""Answer of the FRI client in each session state and command mode.

| session state     | answer                                                                  |
|-------------------|-------------------------------------------------------------------------|
| IDLE              | none                                                                    |
| MONITORING_*      | 1.x: the commanded position, mirrored; from 2.5 on: the header only     |
| COMMANDING_WAIT   | the position of the robot's application, mirrored; no torque, no wrench |
| COMMANDING_ACTIVE | the set-point, or that position with a torque or wrench                 |
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.codec.messages import Command, CommandData, CommandMode, Header, SessionState
from backends.fri.codec.version import Generation
from backends.fri.wire_limits import numbers
from limo_driver.errors import BackendError
from limo_driver.types import PositionCommand, TorqueCommand, WrenchCommand

if TYPE_CHECKING:
    from backends.fri.codec.messages import IoValue, Joints, Monitoring
    from backends.fri.wire_limits import WireLimits
    from limo_driver.types import FloatArray, JointCommand

# Quicker than by their classes.
_ACTIVE: Final = SessionState.COMMANDING_ACTIVE
_POSITION, _TORQUE, _WRENCH = CommandMode.POSITION, CommandMode.TORQUE, CommandMode.WRENCH
_TAKEN: Final = {_POSITION: PositionCommand, _TORQUE: TorqueCommand, _WRENCH: WrenchCommand}


def command_mode(message: Monitoring) -> CommandMode:
    """Return the quantity that the robot's application lets the client command."""
    ipo = message.ipo
    return CommandMode.NONE if ipo is None or ipo.command_mode is None else ipo.command_mode


def check_taken(message: Monitoring, command: JointCommand, trouble: str = "") -> None:
    """Refuse a command that the session does not take.

    Args:
        message: What the robot said last.
        command: For it.
        trouble: Why nothing may be commanded, although the session is active.

    Raises:
        BackendError: The session is not active, in trouble, or in another command mode.
    """
    connection = message.connection
    if connection is None or connection.session_state is not _ACTIVE:
        name = "no state" if connection is None else connection.session_state.name
        raise BackendError(
            f"the session is in {name}; commands are taken in COMMANDING_ACTIVE, "
            "for which wait_until_ready() waits"
        )
    if trouble:
        raise BackendError(f"nothing may be commanded now: {trouble}")
    mode = command_mode(message)
    taken = _TAKEN.get(mode)
    if taken is None:
        raise BackendError(f"the session's command mode is {mode.name}, which limo cannot command")
    if not isinstance(command, taken):
        raise BackendError(
            f"the session takes {taken.__name__} (command mode {mode.name}), "
            f"not {type(command).__name__}"
        )


def application_position(message: Monitoring, wire: WireLimits) -> Joints | None:
    """Return where the robot's own application has the arm [rad]; None if it does not say.

    A position that is not finite, or out of the arm's range, is none.
    """
    told = None if message.ipo is None else message.ipo.joint_position
    return told if told is not None and wire.usable(told) else None


def left_position(message: Monitoring, wire: WireLimits) -> Joints | None:
    """Return where the client before this one left the arm [rad]; None if that is not said.

    Only 1.x says so.
    """
    told = None if message.data is None else message.data.commanded_position
    return told if told is not None and wire.usable(told) else None


def answer_to(
    message: Monitoring,
    sequence: int,
    generation: Generation,
    wire: WireLimits,
    setpoint: FloatArray,
    command: JointCommand | None,
    outputs: tuple[IoValue, ...],
    entered: CommandMode,
) -> Command | None:
    """Return what to answer; None for no answer.

    Args:
        message: What the robot said.
        sequence: Of the answer.
        generation: Of its messages.
        wire: Limits between commands.
        setpoint: Position that is commanded, or at which the arm is held, (n,) [rad].
        command: What the user wants, within the limits; None to hold.
        outputs: To be set.
        entered: Command mode with which COMMANDING_ACTIVE was entered.
    """
    state = SessionState.IDLE if message.connection is None else message.connection.session_state
    mode, header = command_mode(message), Header(sequence, message.header.sequence)
    if state is _ACTIVE and entered in _TAKEN:
        active = _active(message, (entered, mode), wire, setpoint, command, outputs)
        return None if active is None else Command(header, active)
    if state is SessionState.IDLE:
        return None
    if state < SessionState.COMMANDING_WAIT:
        return Command(header, _monitored(message, generation, wire, outputs))
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
    usable = told is not None and wire.usable(told)
    return CommandData(told if usable else data.measured_position, io=outputs)


def _active(
    message: Monitoring,
    modes: tuple[CommandMode, CommandMode],
    wire: WireLimits,
    setpoint: FloatArray,
    command: JointCommand | None,
    outputs: tuple[IoValue, ...],
) -> CommandData | None:
    """Return a command; None where the arm and its application stand outside the range.

    It goes on in the mode that COMMANDING_ACTIVE was entered with, the first; where the robot says
    another by now, the second, it has what that asks for, too.
    """
    entered, mode = modes
    if entered is _POSITION:
        position = wire.setpoint(setpoint)
    else:
        position = wire.position(application_position(message, wire) or numbers(setpoint))
        mode = entered
    if position is None:
        return None
    if mode is _TORQUE:
        torque = numbers(command.torque) if isinstance(command, TorqueCommand) else None
        return CommandData(position, joint_torque=wire.torque(torque), io=outputs)
    if mode is _WRENCH:
        wrench = numbers(command.wrench) if isinstance(command, WrenchCommand) else None
        return CommandData(position, wrench=wire.wrench(wrench), io=outputs)
    return CommandData(position, io=outputs)


def _mirrored(
    message: Monitoring, mode: CommandMode, wire: WireLimits, outputs: tuple[IoValue, ...]
) -> CommandData | None:
    """Return the position of the robot's application; None if there is none to mirror."""
    ipo = message.ipo
    if mode is CommandMode.CARTESIAN_POSE and ipo is not None and ipo.pose is not None:
        if not all(map(math.isfinite, ipo.pose.elements)):
            return None
        return CommandData(pose=ipo.pose, redundancy=ipo.redundancy, io=outputs)
    told = application_position(message, wire)
    position = None if told is None else wire.position(told)
    if position is None:
        return None
    if mode is _TORQUE:
        return CommandData(position, joint_torque=wire.torque(None), io=outputs)
    if mode is _WRENCH:
        return CommandData(position, wrench=wire.wrench(None), io=outputs)
    return CommandData(position, io=outputs)


def sent_as(command: JointCommand, said: CommandData | None, *, sent: bool = True) -> JointCommand:
    """Return a command as the robot was told it last, with the limits that changed it.

    Args:
        command: Within the limits.
        said: To the robot, last; None for nothing.
        sent: Whether there was a packet that could be answered with the command.
    """
    name = _SAID_AS[type(command)]
    values: Joints | None = None if said is None else getattr(said, name[1])
    given: FloatArray = getattr(command, name[0])
    if sent and values is not None and values == numbers(given):
        return command
    last = given if values is None else np.array(values)
    return replace(command, limited_by=(*command.limited_by, "link"), **{name[0]: last})


_SAID_AS: Final[dict[type[JointCommand], tuple[str, str]]] = {
    PositionCommand: ("position", "joint_position"),
    TorqueCommand: ("torque", "joint_torque"),
    WrenchCommand: ("wrench", "wrench"),
}
