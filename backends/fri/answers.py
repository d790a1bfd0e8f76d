"""Answer of the FRI client in each session state and command mode.

| session state     | answer                                                                  |
|-------------------|-------------------------------------------------------------------------|
| IDLE              | none                                                                    |
| MONITORING_*      | 1.x: the commanded position, mirrored; from 2.5 on: the header only     |
| COMMANDING_WAIT   | the position of the robot's application, mirrored; no torque, no wrench |
| COMMANDING_ACTIVE | the set-point, or that position with a torque or wrench                 |

Just after COMMANDING_ACTIVE, other states are not answered like that yet (`Lead.doubts`): the hold
goes on in MONITORING_*, and COMMANDING_WAIT has no answer.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from backends.fri.codec.messages import (
    Command,
    CommandData,
    CommandMode,
    Generation,
    Header,
    SessionState,
)
from backends.fri.session import Order, advice, why_not_commanded
from backends.fri.wire_limits import numbers
from limo_driver.errors import BackendError
from limo_driver.types import PositionCommand, TorqueCommand, WrenchCommand

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.fri.codec.messages import IoValue, Joints, Monitoring
    from backends.fri.session import Effect, RobotSession
    from backends.fri.wire_limits import Plausibility, WireLimits
    from limo_driver.robot.safety import SafetyContract
    from limo_driver.types import FloatArray, JointCommand

# Quicker than by their classes.
_ACTIVE: Final = SessionState.COMMANDING_ACTIVE
_POSITION, _TORQUE, _WRENCH = CommandMode.POSITION, CommandMode.TORQUE, CommandMode.WRENCH
_TAKEN: Final = {_POSITION: PositionCommand, _TORQUE: TorqueCommand, _WRENCH: WrenchCommand}
_WAIT: Final = SessionState.COMMANDING_WAIT
MONITORING: Final = (SessionState.MONITORING_WAIT, SessionState.MONITORING_READY)
FLICKER: Final = 3  # packets, in which no robot gets from COMMANDING_ACTIVE to COMMANDING_WAIT
DOUBTED: Final = 0.1  # [s] without an answer, after which no robot is active any more
_NEXT: Final = Order.NEXT


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
    reported = None if message.ipo is None else message.ipo.joint_position
    return reported if reported is not None and wire.usable(reported) else None


def left_position(message: Monitoring, wire: WireLimits) -> Joints | None:
    """Return where the client before this one left the arm [rad]; None if that is not said.

    Only 1.x says so.
    """
    reported = None if message.data is None else message.data.commanded_position
    return reported if reported is not None and wire.usable(reported) else None


def answer_to(
    message: Monitoring,
    sequence: int,
    generation: Generation,
    wire: WireLimits,
    setpoint: FloatArray,
    command: JointCommand | None,
    outputs: tuple[IoValue, ...],
    entered: CommandMode,
    *,
    leads: bool,
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
        leads: It may be taken for a command.
    """
    state = SessionState.IDLE if message.connection is None else message.connection.session_state
    mode, header = command_mode(message), Header(sequence, message.header.sequence)
    if leads and entered in _TAKEN:
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
    reported = data.commanded_position
    usable = reported is not None and wire.usable(reported)
    return CommandData(reported if usable else data.measured_position, io=outputs)


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
    reported = application_position(message, wire)
    position = None if reported is None else wire.position(reported)
    if position is None:
        return None
    if mode is _TORQUE:
        return CommandData(position, joint_torque=wire.torque(None), io=outputs)
    if mode is _WRENCH:
        return CommandData(position, wrench=wire.wrench(None), io=outputs)
    return CommandData(position, io=outputs)


def sent_as(
    command: JointCommand, said: CommandData | None, setpoint: FloatArray, *, sent: bool = True
) -> JointCommand:
    """Return a command as the robot was told it last, with the limits that changed it.

    Args:
        command: Within the limits.
        said: To the robot, last; None for nothing: it has no torque then.
        setpoint: Where the arm stands if nothing was said, (n,) [rad].
        sent: Whether there was a packet that could be answered with the command.
    """
    name = _SAID_AS[type(command)]
    values: Joints | None = None if said is None else getattr(said, name[1])
    given: FloatArray = getattr(command, name[0])
    if sent and values is not None and values == numbers(given):
        return command
    if values is None:
        last = setpoint if isinstance(command, PositionCommand) else np.zeros_like(given)
    else:
        last = np.array(values)
    return replace(command, limited_by=(*command.limited_by, "link"), **{name[0]: last})


_SAID_AS: Final[dict[type[JointCommand], tuple[str, str]]] = {
    PositionCommand: ("position", "joint_position"),
    TorqueCommand: ("torque", "joint_torque"),
    WrenchCommand: ("wrench", "wrench"),
}


class _Left(NamedTuple):
    """How an active session was left, and where the arm has been since."""

    packet: int  # count of the one that said so
    seen: int  # count of the last one
    measured: FloatArray  # by the last one, (n,) [rad]


class Lead:
    """Keeps the contract, and what leaves for the robot, in step with the session.

    Args:
        contract: Of the robot.
        wire: Limits between commands.
        session: Of the robot.
        plausible: Where the arm can have got to.
        hold: Holds for a reason.
    """

    def __init__(
        self,
        contract: SafetyContract,
        wire: WireLimits,
        session: RobotSession,
        plausible: Plausibility,
        hold: Callable[[str], None],
    ) -> None:
        self._contract, self._wire, self._session = contract, wire, session
        self._plausible, self._hold = plausible, hold
        self._joined = False  # COMMANDING_ACTIVE while it was so already
        self._measured: FloatArray = np.zeros(0)  # by the message before
        self._packets = 0  # send periods until then
        self._left: _Left | None = None  # lately, and maybe not really
        self._familiar: tuple[object, object] = (None, None)  # robot and connection, examined
        self.commanded = False  # by this client, since COMMANDING_ACTIVE was entered
        self.said: CommandData | None = None  # to the robot, last
        self.mode = CommandMode.NONE  # what may be commanded, since COMMANDING_ACTIVE was entered
        self.trouble = ""  # why nothing may be, although the session is active

    def follow(
        self,
        message: Monitoring,
        order: Order,
        states: tuple[SessionState | None, SessionState | None],
        measured: FloatArray,
    ) -> None:
        """Take a message into account.

        Args:
            message: What the robot says.
            order: How it stands to those before it.
            states: Of the session, before this message and since.
            measured: Where the arm is, (n,) [rad].
        """
        before, state = states
        if self.commanded and before is state is _ACTIVE and order is _NEXT and self._wire.anchored:
            ipo, (robot, connection) = message.ipo, self._familiar
            self._measured, self._packets = measured, self._session.packets
            same = message.robot is robot and message.connection is connection
            if not (same and ipo is not None and ipo.command_mode is self.mode):
                self._examine(message)
            return  # most often
        if before is _ACTIVE:
            self._note_end(message, order, state)
        self._measured, self._packets = measured, self._session.packets
        if self._goes_on(states, measured):
            if state is _ACTIVE:
                self._left = None
                self._examine(message)
            return
        self._left = None
        goes_on = self._joined and order is not Order.RESTARTED
        enters = before is None or before < SessionState.COMMANDING_WAIT
        self._joined = state is _ACTIVE and (enters or goes_on)
        if state is not _ACTIVE or enters or not self._wire.anchored:
            self._begin(self._leading(message), numbers(measured))
        elif not self.commanded and self._contract.at_rest:
            # Once commanded, the arm stays where that took it, not where the application would be;
            # nor does it follow a measurement: an arm told to be where it is would sink.
            reported = self._leading(message) or numbers(self._contract.setpoint)
            self._contract.lead(np.array(self._wire.reachable(reported)))
        if state is _ACTIVE:
            if not self.commanded:
                self.mode = command_mode(message)
            self._examine(message)

    def _examine(self, message: Monitoring) -> None:
        """Hold where an active session says something that does not go with commands."""
        self._familiar = message.robot, message.connection  # most often the very same say the same
        self.trouble = why_not_commanded(message)
        if not self._wire.anchored:
            self.trouble = "the arm and the robot's application stand outside the joints' ranges"
        if (mode := command_mode(message)) is not self.mode:
            self.trouble = f"the command mode changed from {self.mode.name} to {mode.name}"
        if self.trouble and not self._contract.at_rest:
            self._hold(f"in COMMANDING_ACTIVE, {self.trouble}")

    def _note_end(self, message: Monitoring, order: Order, state: SessionState | None) -> None:
        """Hold where an active session ends, or may have begun anew unseen."""
        if state is not _ACTIVE and state is not None:
            self._left = _Left(self._session.packets, self._packets, self._measured)
            reasons = "".join(f"; {text}" for text in advice(message)[:1])
            self._hold(f"the session left COMMANDING_ACTIVE for {state.name}{reasons}")
        elif order is Order.RESTARTED:
            now, last = message.header.sequence, self._session.before_restart
            self._hold(
                f"in COMMANDING_ACTIVE, the robot counts its packets anew: {now} came after {last}"
            )

    @property
    def doubts(self) -> bool:
        """Whether the robot may not really have left COMMANDING_ACTIVE, as it says."""
        return self._left is not None

    @property
    def leads(self) -> bool:
        """Whether answers may be taken for commands, and so are those of the contract.

        In MONITORING, a robot that did leave ignores them.
        """
        state = self._session.state
        return state is _ACTIVE or (self.doubts and state in MONITORING)

    def _goes_on(
        self, states: tuple[SessionState | None, SessionState | None], measured: FloatArray
    ) -> bool:
        """Say whether all stays as it was when the session left COMMANDING_ACTIVE, as it said.

        One that did becomes active again only by answers in COMMANDING_WAIT, and gets there by
        MONITORING, not at once: without any, where the arm has not jumped, it never left. One that
        is active takes whatever it is answered for a command; without answers for long, it ends
        the session.
        """
        left, (before, state) = self._left, states
        if left is None:
            return False
        packets, steps = self._session.packets - left.packet, self._session.packets - left.seen
        if (np.abs(measured - left.measured) > self._plausible.reach(steps)).any():
            return False  # from one packet to the next: torque that stays may carry it far
        self._left = left._replace(seen=self._session.packets, measured=measured)
        over = packets * self._session.period >= DOUBTED and packets >= FLICKER
        if state in MONITORING:  # until the arm stands, which it may do by what is answered
            return not over or not self._contract.standing
        in_order = state is _WAIT and before in MONITORING and packets > FLICKER
        return not (over or in_order)  # active again, too

    def take_back(self, effect: Effect) -> None:
        """Let the next answer follow from an earlier one: those since then had no effect."""
        setpoint, self._wire.sent, self.said = effect
        self._contract.take_back(setpoint)

    def _begin(self, reported: Joints | None, measured: Joints) -> None:
        """Begin where the arm is told to be, or where it is; nowhere if neither can be."""
        if reported is None and self._wire.usable(measured):
            reported = measured
        self._wire.begin(reported)
        self.commanded, self.said = False, None
        if reported is not None:
            self._contract.lead(np.array(reported))
        self._session.begin((self._contract.present, self._wire.sent, None))

    def _leading(self, message: Monitoring) -> Joints | None:
        """Return where the arm that nobody commands is told to be; None if nobody says.

        A session that was active before this driver heard of it was another client's: it starts
        where that left the arm, which need not be where the robot's application would have it.
        """
        position_of = left_position if self._joined else application_position
        return position_of(message, self._wire)
