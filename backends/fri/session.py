"""Track an FRI session: packets, the robot's time, states, answers; nothing is commanded here."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from backends.fri.codec.messages import (
    CommandMode,
    DriveState,
    OperationMode,
    Quality,
    SafetyState,
    SessionState,
)

if TYPE_CHECKING:
    from backends.fri.codec.messages import CommandData, Monitoring
    from backends.fri.wire_limits import Sent
    from limo_driver.robot.output import Setpoint

# What an answer leaves behind, from which the next one follows: set-point of the contract, numbers
# at the wire, and all that was said to the robot. Plain tuples, since each cycle makes some.
Effect: TypeAlias = "tuple[Setpoint, Sent, CommandData | None]"

_MODULUS: Final = 1 << 32
_LONGEST_JUMP: Final = 1.0  # [s] beyond the expected step that a robot's clock is believed
_REORDERED: Final = 1000  # packets; further back is a new session
_MOST_STRAYS: Final = 20  # packets
_LONGEST_GAP: Final = 100_000  # packets; further ahead is a new session
_LEAP: Final = 0.02  # [s] by which packets may have been lost faster than time went by
_LEAPT_PERIODS: Final = 3  # or so many periods, if those are longer
PATIENCE: Final = 0.01  # [s] in which the robot says that it received a command
PATIENT_PERIODS: Final = 3  # or so many periods, if those are longer
_LAST_DIGITS: Final = 1e-9
MOST_VISITS: Final = 256  # of states that are remembered
MOST_UNCONFIRMED: Final = 1024  # commands of which an answer is still awaited
LONGEST_COMMANDING: Final = 10  # [ms] between answers
LONGEST_FORCE_CONTROL: Final = 5  # [ms], where torques or wrenches are commanded

_ADVICE: Final = {
    SessionState.IDLE: "no FRI session is open: start the robot application that opens one",
    SessionState.MONITORING_WAIT: (
        "the controller does not find the connection good enough: answers come late or not at all; "
        "check the cable, the switch and what else this machine computes"
    ),
    SessionState.MONITORING_READY: (
        "the robot application opened the session but commands no overlay yet: "
        "start the motion with the FRI joint overlay"
    ),
    SessionState.COMMANDING_WAIT: (
        "the controller waits for the motion to begin: enable the drives, press the start key, "
        "and let the client answer with the positions it is sent"
    ),
    SessionState.COMMANDING_ACTIVE: "the session takes commands",
}


class Order(Enum):
    """Order of a packet relative to those before it."""

    NEXT = "next"
    OLD = "old"  # a copy, or overtaken by a later one
    RESTARTED = "restarted"  # the first of a new session


_NEXT, _OLD, _RESTARTED = Order  # quicker than by their class


@dataclass
class LinkFigures:
    """Counts since the driver was opened."""

    received: int = 0  # valid packets, in order
    lost: int = 0  # packets of the robot that never came
    old: int = 0  # copies, and packets that others had overtaken
    malformed: int = 0  # datagrams that are no message, or none that can be used
    implausible: int = 0  # messages with a pose that the arm cannot have got to
    outdated: int = 0  # not answered: others had followed already
    answered: int = 0  # commands sent
    unsent: int = 0  # commands that the network did not take
    late: int = 0  # commands that the robot had not received one answer later
    unreceived: int = 0  # commands that the robot passed over: lost or overtaken on their way
    stale: int = 0  # cycles without a measurement
    restarts: int = 0  # sessions after the first
    clock_steps: int = 0  # of the robot's clock that were left out

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return dict(vars(self))


@dataclass(frozen=True)
class Visit:
    """A session state and when it was entered."""

    state: SessionState
    time: float  # [s] of the robot, since the first packet


@dataclass(slots=True)
class _Command:
    """A command that the robot has not confirmed; they stand in the order of their sequence."""

    packet: int  # count of the packet that it answers
    effect: Effect | None  # that it has once it is received
    left: float  # when it left, by this machine's clock [s]
    waited: int  # packets that had come by then


@dataclass
class RobotSession:
    """Follows one robot through its sessions.

    Args:
        period: Send period [s].
        multiplier: Packets to an answer.
    """

    period: float
    multiplier: int = 1
    figures: LinkFigures = field(default_factory=LinkFigures)
    time: float = 0.0  # [s] of the robot, monotonic, 0 at the first packet
    packets: int = 0  # send periods of the robot since the first packet
    state: SessionState | None = None
    visits: deque[Visit] = field(default_factory=lambda: deque(maxlen=MOST_VISITS))
    _last: int | None = None  # sequence of the packet last taken
    _stamp: int | None = None  # its time [ns]
    _arrived: float | None = None  # when it came, by this machine's clock [s]
    before_restart: int | None = None  # sequence of the last packet before the counter restarted
    _strays: int = 0  # packets in a row that stood behind it, in an order of their own
    _last_stray: int = 0
    _sequence: int = 0  # of the next command
    _unconfirmed: deque[_Command] = field(default_factory=lambda: deque(maxlen=MOST_UNCONFIRMED))
    confirmed: Effect | None = None  # of the last command that the robot has received, as it said
    came_late: float = -math.inf  # [s], when a command last had, or was seen to be lost
    _refused_since: int | None = None  # count of the packet that could not be answered first

    def take(self, message: Monitoring, arrived: float | None = None) -> Order:
        """Note a packet, and when it arrived [s], by this machine's clock."""
        data = message.data
        time = None if data is None else data.timestamp
        stamp = None if time is None else time.nanoseconds_since_epoch
        order = self._order(message.header.sequence, stamp, arrived)
        if order is _OLD:
            self.figures.old += 1
            return order
        self.figures.received += 1
        self._keep_time(message.header.sequence, stamp, order)
        if arrived is not None:
            self._note_waited(arrived)
        self._confirm(message.header.reflected, order)
        self._last, self._stamp, self._strays = message.header.sequence, stamp, 0
        self._arrived = arrived
        if message.connection is not None and message.connection.session_state is not self.state:
            self.state = message.connection.session_state
            self.visits.append(Visit(self.state, self.time))
        return order

    def next_sequence(self) -> int:
        """Return the sequence of the command that is about to be sent."""
        return self._sequence

    def note_answer(self, effect: Effect | None = None, left: float = -math.inf) -> None:
        """Note that the command left, when [s], and what effect it has once it is received."""
        self._unconfirmed.append(_Command(self.packets, effect, left, self.figures.received))
        self._sequence = (self._sequence + 1) % _MODULUS
        self._refused_since = None
        self.figures.answered += 1

    def note_refusal(self) -> None:
        """Note that the network did not take the command."""
        self.figures.unsent += 1
        if self._refused_since is None:
            self._refused_since = self.packets

    def begin(self, effect: Effect) -> None:
        """Begin anew: until commands are received, the arm is as `effect` says."""
        self.confirmed = effect
        for command in self._unconfirmed:
            command.effect = effect

    @property
    def unconfirmed(self) -> int:
        """Commands that the robot has not received yet, as far as it said."""
        return len(self._unconfirmed)

    @property
    def waits(self) -> bool:
        """Whether a command is not confirmed yet, or could not be sent."""
        return bool(self._unconfirmed) or self._refused_since is not None

    @property
    def patience(self) -> int:
        """Packets after which a command is overdue that the robot has not received."""
        return max(self._least, math.ceil(PATIENCE / self.period - _LAST_DIGITS))

    @property
    def _least(self) -> int:
        """Packets that say so at least, which came after it left: one answer may be lost."""
        return max(PATIENT_PERIODS, self.multiplier + 1)

    @property
    def overdue(self) -> bool:
        """Whether the robot does not say in time that it received a command."""
        return bool(self._unconfirmed) and self._is_overdue(0)

    @property
    def all_overdue(self) -> bool:
        """Whether it says so of none of them: the last one had its time, too."""
        return bool(self._unconfirmed) and self._is_overdue(-1)

    def _is_overdue(self, which: int) -> bool:
        command, heard = self._unconfirmed[which], self.figures.received
        late = self.packets - command.packet >= self.patience  # or its count lies, for one packet
        return late and heard - command.waited >= self._least

    @property
    def refused(self) -> bool:
        """Whether the network has taken no command for that long."""
        since = self._refused_since
        return since is not None and self.packets - since >= self.patience

    def _order(self, sequence: int, stamp: int | None, arrived: float | None) -> Order:
        last = self._last
        if last is None:
            return _NEXT
        ahead = (sequence - last) % _MODULUS
        if ahead == 1 or (0 < ahead <= _LONGEST_GAP and not self._leaps(ahead, stamp, arrived)):
            return _NEXT
        if 0 < ahead <= _LONGEST_GAP:
            restarted = True
        elif stamp is not None and self._stamp is not None:
            restarted = stamp > self._stamp  # it counts anew, but later than what came before
        else:
            restarted = -ahead % _MODULUS > _REORDERED
        if not restarted and not self._strays_on(sequence):
            return _OLD
        self.figures.restarts += 1
        self.before_restart = last
        return _RESTARTED

    def _leaps(self, ahead: int, stamp: int | None, arrived: float | None) -> bool:
        """Say whether a packet is further ahead than the time that went by; False if none is known.

        It went by on the robot's clock, or on this machine's: either may stand, or be set.
        """
        passed: list[float] = []
        if stamp is not None and self._stamp is not None:
            passed += [1e-9 * (stamp - self._stamp)] if stamp >= self._stamp else []
        if arrived is not None and self._arrived is not None:
            passed.append(arrived - self._arrived)
        slack = max(_LEAP, _LEAPT_PERIODS * self.period)
        return bool(passed) and ahead * self.period > max(passed) + slack

    def _strays_on(self, sequence: int) -> bool:
        """Say whether packets that look old go on and on: then the robot's clock was set back."""
        follows = 0 < (sequence - self._last_stray) % _MODULUS <= _REORDERED
        self._strays = self._strays + 1 if follows else 1
        self._last_stray = sequence
        return self._strays > _MOST_STRAYS

    def _keep_time(self, sequence: int, stamp: int | None, order: Order) -> None:
        """Advance time by the robot's clock, or by its send period where that does not fit."""
        if self._last is None:
            return
        restarted = order is _RESTARTED
        steps = 1 if restarted else (sequence - self._last) % _MODULUS
        self.packets += steps
        self.figures.lost += steps - 1
        expected = steps * self.period
        if stamp is None or self._stamp is None:
            self.time += expected
            return
        passed = 1e-9 * (stamp - self._stamp)
        if passed > 0.0 and (restarted or passed <= expected + _LONGEST_JUMP):
            self.time += passed
        else:
            self.figures.clock_steps += 1
            self.time += expected

    def _note_waited(self, arrived: float) -> None:
        """Note a packet that came before commands left: it cannot say that they were received."""
        for command in reversed(self._unconfirmed):
            if command.left <= arrived:
                return
            command.waited = self.figures.received

    def _confirm(self, reflected: int, order: Order) -> None:
        """Settle the commands up to the one that the robot received last."""
        waiting = self._unconfirmed
        behind = (self._sequence - 1 - reflected) % _MODULUS  # commands sent since then
        # A counter that leaps says nothing of commands where the other goes on.
        if order is _RESTARTED and waiting and behind > len(waiting):
            self.confirmed = waiting[-1].effect  # nobody knows; it may well have had effect
            waiting.clear()
        if behind >= len(waiting):
            return
        passed_over = len(waiting) - 1 - behind
        for _ in range(passed_over):
            waiting.popleft()
        self.confirmed = waiting.popleft().effect
        self.figures.unreceived += passed_over
        self.figures.late += behind > 0
        if passed_over or behind > 0:
            self.came_late = self.time


def advice(message: Monitoring) -> list[str]:
    """Return what keeps a session from taking commands, the most likely first."""
    robot, connection = message.robot, message.connection
    sentences = [text for text in (safety_stop(message), drives_off(message)) if text]
    if robot is not None and robot.operation_mode in {OperationMode.T1, OperationMode.T2}:
        mode = OperationMode(robot.operation_mode).name
        sentences.append(
            f"the cell is in {mode}: the motion stops when the enabling switch or the start "
            "key is let go"
        )
    if connection is None:
        return [*sentences, "the robot does not say how the session stands"]
    sentences += [text for text in (low_quality(message), long_period(message)) if text]
    if connection.session_state is not SessionState.COMMANDING_ACTIVE:
        sentences.append(_ADVICE[connection.session_state])
    return sentences


def why_not_ready(message: Monitoring | None, waited: float, malformed: str) -> str:
    """Say why a session took no commands, and what to do about it.

    Args:
        message: The robot's last one; None if it is silent.
        waited: How long was waited [s].
        malformed: What was wrong with the last datagram that could not be used, or who sent it.
    """
    if message is None or message.connection is None:
        why = f": {malformed}" if malformed else ""
        return f"the robot sent nothing usable any more when {waited:g} s were over{why}"
    state = message.connection.session_state
    reasons = "; ".join(advice(message)[:3])
    return f"the session is still in {state.name} after {waited:g} s: {reasons}"


def why_not_commanded(message: Monitoring) -> str:
    """Say what does not go with commands, whatever state the session is in; empty for nothing."""
    return safety_stop(message) or drives_off(message) or low_quality(message)


def low_quality(message: Monitoring) -> str:
    """Say that the connection is too bad to command; empty if it is not."""
    connection = message.connection
    if connection is None or connection.quality >= Quality.GOOD:
        return ""
    return (
        f"the connection is {connection.quality.name}; commanding needs GOOD: answer every packet "
        "within its period, on a cable of its own"
    )


def safety_stop(message: Monitoring) -> str:
    """Say which safety stop is in force; empty for none."""
    state = None if message.robot is None else message.robot.safety_state
    if state in {None, SafetyState.NORMAL}:
        return ""
    stop = SafetyState(state or 0).name.replace("_", " ")
    return f"a safety stop is in force ({stop}): acknowledge it on the smartPAD"


def drives_off(message: Monitoring) -> str:
    """Say which drives are not active; empty for none."""
    states = () if message.robot is None else message.robot.drive_states
    off = [str(j) for j, state in enumerate(states, 1) if state != DriveState.ACTIVE]
    if not off:
        return ""
    return (
        f"the drives of joints {', '.join(off)} are not active: hold the enabling switch in T1 or "
        "T2, or start the program in AUT"
    )


def long_period(message: Monitoring) -> str:
    """Say that a session of this period cannot be commanded; empty if it can."""
    connection, ipo = message.connection, message.ipo
    if connection is None or connection.send_period is None:
        return ""
    between = connection.send_period * max(connection.receive_multiplier or 1, 1)
    mode = None if ipo is None else ipo.command_mode
    most = LONGEST_COMMANDING
    if mode in {CommandMode.WRENCH, CommandMode.TORQUE}:
        most = LONGEST_FORCE_CONTROL
    if between <= most:
        return ""
    return (
        f"answers are {between} ms apart (send period x receive multiplier), and commanding needs "
        f"at most {most} ms: shorten the send period in the robot application"
    )
