"""FriRobot: a KUKA LBR iiwa on its Fast Robot Interface, as a client of its controller."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.fri import wire_limits
from backends.fri.answers import Lead, check_taken, sent_as
from backends.fri.codec.messages import DEFAULT_PORT, FriVersion, Monitoring, Quality, SessionState
from backends.fri.codec.template import MonitoringTemplate
from backends.fri.connection import Connection, connect, incomplete, pace, unusable
from backends.fri.replies import Outputs, Replies
from backends.fri.session import LinkFigures, Order, RobotSession, Visit, why_not_ready
from limo_driver.errors import (
    BackendError,
    ConfigError,
    ConnectionLostError,
    CycleTimeoutError,
    WireFormatError,
)
from limo_driver.model import RobotModel
from limo_driver.robot.realtime import excuse
from limo_driver.robot.robot import LISTENS, READY_TIMEOUT, Robot
from limo_driver.robot.safety import START_TOLERANCE, warm_up
from limo_driver.types import JointState, RobotSpec, WrenchLimits, readonly

if TYPE_CHECKING:
    from collections.abc import Mapping

    from backends.fri.codec.messages import Generation
    from backends.fri.connection import Datagram
    from limo_driver.robot.realtime import LatencyHistogram
    from limo_driver.types import FloatArray, JointCommand

WRENCH_LIMITS: Final = WrenchLimits(
    wrench=np.array([50.0, 50.0, 50.0, 10.0, 10.0, 10.0]),
    rate=np.array([500.0, 500.0, 500.0, 100.0, 100.0, 100.0]),
)
PATIENCE: Final = 0.01  # [s] beyond a period in which a late packet is waited for
HEEDING: Final = 0.1  # [s] of waiting, after which a signal that came meanwhile is acted on
STALL: Final = 5e-3  # [s] of waiting to be read, from which on this computer has stalled
EXCUSED: Final = 0.2  # [s] after a stall of this computer, in which a hold may come from it
MOST_WAITING: Final = 2000  # datagrams that are read in one cycle, where they are of no use
_ACTIVE: Final = SessionState.COMMANDING_ACTIVE  # quicker than by its class


class FriRobot(Robot):
    """An arm behind FRI: it speaks first, in every send period, and the driver answers.

    One cycle of `receive` is one answer: send period times receive multiplier. In every state but
    COMMANDING_ACTIVE the driver answers by itself, mirroring what the protocol asks for, and `send`
    is refused; `wait_until_ready` waits for COMMANDING_ACTIVE. Commands are of the kind that the
    robot's application named: `PositionCommand`, `TorqueCommand` (added to joint impedance control)
    or `WrenchCommand` (added to Cartesian impedance control).

    Commands start from where the robot's application has the arm (its ipo position), not from the
    measured pose, so that an arm that was pushed aside does not jump. Leaving COMMANDING_ACTIVE is
    a hold, which ends only by `resume`. Where packets stay away for longer than a period and 10 ms,
    states are stale, and what is sent then reaches nobody: the set-point waits for the next packet.
    One sender is the robot, an address and a port; what others send is counted and has no effect,
    and a robot that restarted on another port has to be opened again.
    While it is commanded, a pose that the arm cannot have got to since the last one is ignored,
    too: a jump needs a new session. Where this machine is late, packets that others have followed
    already are not answered: two set-points in one interval of the robot would be a jump. What was
    not sent, or is not confirmed by the robot in time, had no effect: the next set-point follows
    from the last one that had.

    FRI measures no velocity. It is the difference of positions over the robot's own time through a
    causal low-pass of first order with a time constant of 5 ms, so it lags by about that much.

    Args:
        host: Address of the controller; if not given, whoever sends the first valid packet.
        port: UDP port to listen on, the one that the robot's application names.
        robot: Built-in name or URDF of an arm with seven joints.
        version: FRI version, for example `1.15`; told from the first packet if not given.
        connect_timeout: Longest wait for the first packet [s].
        start_tolerance: How far the first position may be from the measured pose [rad].
        wrench_limits: Limits of wrenches; those of the class docstring's module if not given.
        listen_only: Answer while the session is monitored, and nothing else: no session becomes
            active by it, and commands are refused.

    Raises:
        ConfigError: The arm has no seven joints, or host, port or version are none.
        BackendError: The port is taken.
        SilentRobotError: Nobody sent a usable packet in time; says what came instead.
    """

    def __init__(
        self,
        host: str | None = None,
        port: int = DEFAULT_PORT,
        robot: str | None = None,
        *,
        version: str | None = None,
        connect_timeout: float = 10.0,
        start_tolerance: float = START_TOLERANCE,
        wrench_limits: WrenchLimits = WRENCH_LIMITS,
        listen_only: bool = False,
    ) -> None:
        model = self.model_for(robot=robot)
        if model.n != 7:  # noqa: PLR2004  # FRI's arrays
            raise ConfigError(f"FRI arms have 7 joints, but {model.name} has {model.n}")
        asked = None if version is None else FriVersion.named(version)
        names, limits = model.joint_names, model.limits
        _warm_up(RobotSpec(model.name, names, limits, 1e-3, wrench_limits, jerk=model.jerk))
        self._link: Connection = connect(host, port, asked, connect_timeout)
        spec = RobotSpec(
            model.name,
            model.joint_names,
            model.limits,
            self._link.period,
            wrench_limits,
            jerk=model.jerk,
        )
        self._listen_only = listen_only
        super().__init__(spec, start_tolerance)
        self._reader = MonitoringTemplate(self._link.generation)
        self._session = RobotSession(1e-3 * self._link.send_period, self._link.multiplier)
        self._wire = wire_limits.WireLimits(spec)
        self._plausible = wire_limits.Plausibility(spec.limits, 1e-3 * self._link.send_period)
        self._lead = Lead(
            self._contract, self._wire, self._session, self._plausible, self._hold_for
        )
        self._velocity = wire_limits.VelocityFilter(spec.n)
        self._outputs = Outputs()
        self._replies = Replies(
            self._link,
            self._session,
            self._contract,
            self._wire,
            self._lead,
            self._outputs,
            listen_only=listen_only,
        )
        self._message: Monitoring | None = None  # the last one
        self._asks: Monitoring | None = None  # the last one that is to be answered
        self._familiar: object = object()  # connection of a message whose pace was checked
        self._position = self._torque = readonly(np.zeros(spec.n))
        self._arrived = 0.0  # [s], of this machine's monotonic clock
        self._answered_packet = -1
        self._replied = True  # the last message, as far as it is to be answered
        self._missed = 0  # cycles in a row
        self._stall = (0.0, -math.inf)  # how long this machine stalled last [s], and when it ended
        self.malformed: str = ""  # what was wrong with the last datagram that was no message

    @classmethod
    def model_for(cls, *, robot: str | None = None, **_link: Any) -> RobotModel:  # noqa: ANN401
        """Return the arm."""
        return RobotModel.load(robot or "iiwa14")

    @property
    def generation(self) -> Generation:
        """The versions whose messages the robot speaks."""
        return self._link.generation

    @property
    def send_period(self) -> int:
        """Time from one packet to the next [ms]."""
        return self._link.send_period

    @property
    def monitoring(self) -> Monitoring:
        """All that the robot said last.

        Raises:
            BackendError: Nothing was received yet.
        """
        if self._message is None:
            raise BackendError("nothing was received yet; call receive() first")
        return self._message

    @property
    def session_state(self) -> SessionState | None:
        """State of the session; None before the first `receive`."""
        return self._session.state

    @property
    def visits(self) -> tuple[Visit, ...]:
        """The session states so far, with the robot's time [s] at which each was entered."""
        return tuple(self._session.visits)

    @property
    def quality(self) -> Quality | None:
        """Connection quality as the controller judges it; None before the first `receive`."""
        message = self._message
        return None if message is None or message.connection is None else message.connection.quality

    @property
    def figures(self) -> LinkFigures:
        """Counts of the link."""
        return self._session.figures

    @property
    def lost(self) -> int:
        """Packets of the robot that never came."""
        return self._session.figures.lost

    @property
    def latency(self) -> LatencyHistogram:
        """How long answers took, from the arrival of a packet."""
        return self._replies.latency

    @property
    def unconfirmed(self) -> int:
        """Answers in a row that the robot has not received, as far as it said, 1024 at most."""
        return self._session.unconfirmed

    @property
    def foreign(self) -> int:
        """Datagrams from anybody but the robot."""
        return self._link.endpoint.foreign

    @property
    def limited_at_wire(self) -> int:
        """Commands that had to be changed on their very way out."""
        return self._wire.changed

    @property
    def external_torque(self) -> FloatArray:
        """Measured torque minus the robot's own model, of the last packet, (n,) [N m]."""
        return self._of_data("external_torque")

    @property
    def commanded_torque(self) -> FloatArray:
        """Torque that the robot's own control commands, of the last packet, (n,) [N m]."""
        return self._of_data("commanded_torque")

    @property
    def ios(self) -> Mapping[str, bool | int | float | None]:
        """Inputs and outputs that the robot's application named, by `Group.Name`."""
        data = self.monitoring.data
        return {} if data is None else {io.name: io.value for io in data.io}

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the link, and how fast packets were answered."""
        return {
            **self.figures.as_json(),
            "foreign": self.foreign,
            "last_foreign": self._link.endpoint.last_foreign,
            "limited_at_wire": self.limited_at_wire,
            "answer": self.latency.as_json(),
        }

    def set_output(self, name: str, value: float | bool) -> None:
        """Set an output with the next answers, until the robot has received one of them.

        Raises:
            ConfigError: No such output, or a value of another type.
        """
        data = self.monitoring.data
        self._outputs.set(name, value, () if data is None else data.io)

    def wait_until_ready(self, timeout: float = READY_TIMEOUT) -> None:
        """Answer the robot until the session takes commands.

        Args:
            timeout: Longest wait [s].

        Raises:
            BackendError: It did not in time; says what to do about it.
        """
        deadline = time.monotonic() + timeout
        while not self._takes_commands():
            if time.monotonic() > deadline:
                last = None if self._missed else self._message
                raise BackendError(why_not_ready(last, timeout, self.malformed or self._others()))

    def _takes_commands(self) -> bool:
        """Wait for a cycle; say whether the session is active in it."""
        try:
            fresh = not self.receive().stale
        except CycleTimeoutError:  # since it was opened: it may well come later
            return False
        return fresh and self._session.state is _ACTIVE

    def _others(self) -> str:
        """Say who else sent; empty if nobody did."""
        if not self.foreign:
            return ""
        (host, port), last = self._link.endpoint.peer or ("", 0), self._link.endpoint.last_foreign
        return (
            f"{self.foreign} datagrams came from others, the last from {last}, and {host}:{port} "
            "is the robot; if it restarted on another port, open it again"
        )

    def _of_data(self, name: str) -> FloatArray:
        values = getattr(self.monitoring.data, name, None)
        if values is None:
            raise BackendError(f"the robot does not send its {name.replace('_', ' ')}")
        return np.array(values)

    def _check(self, command: JointCommand) -> None:
        if self._listen_only:
            raise BackendError(LISTENS)
        check_taken(self._message or self.monitoring, command, self._lead.trouble)

    def _send(self, command: JointCommand) -> JointCommand:
        if self._missed or not self._lead.leads:
            self._contract.withhold()  # there is no packet that could be answered with it
            return self._sent_as(command, sent=False)
        self._lead.commanded = True
        if self._replied:  # one answer to each packet: this one goes on with the next
            self._contract.withhold(self._replies.carried)
            return self._sent_as(command)
        changed = self._wire.changed
        if not self._reply(command):  # nothing left
            self._contract.withhold()
            return self._sent_as(command, sent=False)
        if self._wire.changed == changed and self._lead.said is not None:
            return command
        return self._sent_as(command)

    def _sent_as(self, command: JointCommand, *, sent: bool = True) -> JointCommand:
        return sent_as(command, self._lead.said, self._contract.setpoint, sent=sent)

    def _receive(self, timeout: float | None) -> JointState | None:
        if not self._replied:
            self._reply(None)
        message = self._next(timeout)
        if message is None:
            self._missed += 1
            self._session.figures.stale += 1
            return None
        self._missed, self._replied, self._asks = 0, False, message
        if not self._lead.leads:
            self._asks = None if self._lead.doubts else message
            self._reply(None)
        elif self._session.waits:
            self._replies.settle(self._hold_for)
        return JointState.trusted(
            time=self._session.time,
            position=self._position,
            velocity=self._velocity.velocity,
            torque=self._torque,
            sequence=self._session.packets // self._link.multiplier,
        )

    def _close(self) -> None:
        self._link.endpoint.close()

    def _next(self, timeout: float | None) -> Monitoring | None:
        """Return the next message that is to be answered; None if none came in time.

        One that waited for too long is passed over for one behind it.
        """
        if timeout is None:
            timeout = self.spec.period + (0.0 if self._missed else PATIENCE)
        deadline, newest = time.monotonic() + timeout, None
        for _ in range(MOST_WAITING):
            datagram = self._wait(timeout if newest is None else 0.0, deadline)
            if datagram is None:
                break
            if datagram.age > max(STALL, self.spec.period):
                self._note_stall(datagram.age)
            if (message := self._accept(datagram)) is not None:
                self._session.figures.outdated += newest is not None
                newest = message
                if datagram.age <= self.spec.period:
                    break
            timeout = max(deadline - time.monotonic(), 0.0)
        return newest

    def _note_stall(self, late: float) -> None:
        """Note how late this machine reads what came [s]; of what piled up, the oldest says."""
        before, ended = self._stall
        goes_on = self._session.time <= ended + EXCUSED
        self._stall = (max(late, before) if goes_on else late), self._session.time

    def _excuse(self) -> str:
        late, ended = self._stall
        if self._session.time <= ended + EXCUSED:
            return excuse(late)
        if self._session.time <= self._session.came_late + EXCUSED:
            return "; commands had just come to it late or never: a link or computer is too slow"
        return ""

    def _hold_for(self, reason: str) -> None:
        """Hold, and say what this machine has to do with it."""
        self._contract.hold(reason + self._excuse())

    def _reached(self, state: JointState) -> bool:
        return not (state.stale or self._session.overdue or self._session.refused)

    def _wait(self, timeout: float, deadline: float) -> Datagram | None:
        """Return the next datagram; None after the deadline, or soon after a signal came."""
        while timeout > HEEDING:
            datagram = self._link.endpoint.receive(HEEDING)
            if datagram is not None or self.interrupted:
                return datagram
            timeout = max(deadline - time.monotonic(), 0.0)
        return self._link.endpoint.receive(timeout)

    def _accept(self, datagram: Datagram) -> Monitoring | None:
        """Note a datagram; return its message if that is to be answered."""
        try:
            message: Monitoring = self._reader.decode(datagram.data)
        except WireFormatError as error:
            return self._refuse(str(error))
        # Most often it says of the connection what the one before said, with the very same object.
        familiar, measured = message.connection is self._familiar, _measured(message)
        problem = "" if familiar and measured is not None else incomplete(message)
        if problem or measured is None:
            return self._refuse(problem)
        if not familiar:
            if not self._link.fits(message):
                return self._refuse_pace(message)
            self._familiar = message.connection
        position, torque = measured
        if not self._plausible.fine(message, position, torque):
            return self._refuse_measured(message)
        return self._take(message, datagram, position, torque)

    def _take(
        self, message: Monitoring, datagram: Datagram, position: FloatArray, torque: FloatArray
    ) -> Monitoring | None:
        """Note a message of the robot; return it if it is to be answered."""
        before, arrived = self._session.state, time.monotonic() - datagram.age
        order = self._session.take(message, arrived)
        if order is Order.OLD:
            return None
        self._arrived, self._message = arrived, message
        self._position, self._torque = position, torque
        self._velocity.update(self._session.time, position)
        self._outputs.note_received(message.header.reflected)
        self._plausible.take(message, position)
        self._lead.follow(message, order, (before, self._session.state), self._position)
        if self._session.packets - self._answered_packet < self._link.multiplier:
            return None
        self._answered_packet = self._session.packets
        return message

    def _refuse_measured(self, message: Monitoring) -> None:
        """Refuse a message that no arm has sent, or not this one."""
        if problem := unusable(message):
            return self._refuse(problem)
        self._session.figures.implausible += 1
        self.malformed = self._plausible.problem(message)
        return None

    def _refuse(self, problem: str) -> None:
        self._session.figures.malformed += 1
        self.malformed = problem

    def _refuse_pace(self, message: Monitoring) -> None:
        """Refuse a message of another pace: a session that was opened anew is another robot."""
        period, multiplier = pace(message)
        reason = (
            f"the session has a send period of {period} ms and a receive multiplier of "
            f"{multiplier}, but began with {self._link.send_period} ms and {self._link.multiplier}"
        )
        state = None if message.connection is None else message.connection.session_state
        if state is _ACTIVE:
            return self._refuse(reason)
        self._hold_for(reason)
        raise ConnectionLostError(f"{reason}; open the robot again")

    def _reply(self, command: JointCommand | None) -> bool:
        """Answer the last message that asks for it; say whether anything left.

        One that the next has followed is not: the robot would take both answers in one interval,
        and what is two steps for the arm would have the time of one.
        """
        self._replied, message = True, self._asks
        if message is None:
            return False
        late = time.monotonic() - self._arrived > self.spec.period
        if late and self._link.endpoint.waits:
            self._session.figures.outdated += 1
            return False
        return self._replies.reply(message, self._arrived, command)


def _measured(message: Monitoring) -> tuple[FloatArray, FloatArray] | None:
    """Return position and torque of a message, (7,) each [rad, N m]; None if it lacks one."""
    data = message.data
    if data is None or data.measured_position is None or data.measured_torque is None:
        return None
    position, torque = np.array(data.measured_position), np.array(data.measured_torque)
    position.setflags(write=False)  # else they are copied on their way into the state
    torque.setflags(write=False)
    return position, torque


def _warm_up(spec: RobotSpec) -> None:
    """Load what is compiled, before a robot waits for an answer."""
    warm_up(spec)
    velocity, middle = wire_limits.VelocityFilter(spec.n), readonly(np.zeros(spec.n))
    wire_limits.warm_up_plausibility(middle)
    wire_limits.warm_up_wire_limits(spec)
    for cycle in range(3):  # from no velocity, and from one
        velocity.update(cycle * spec.period, middle)
