"""The session of the simulated controller: which state follows which, and when.

IDLE → MONITORING_WAIT → MONITORING_READY → COMMANDING_WAIT → COMMANDING_ACTIVE, one at a time:

- a session opens in MONITORING_WAIT, and is READY when the quality is at least GOOD;
- the robot's application then asks for an overlay (COMMANDING_WAIT), after `monitor` seconds;
- the client's commands count (COMMANDING_ACTIVE) once it has confirmed the set-point `confirm`
  times in a row;
- bad quality leads back to MONITORING_WAIT, a stop to MONITORING_READY, and a state that is capped
  from outside to that state. The application asks again after `monitor`, or, after a stop, once
  that is over and `restart` seconds have passed.

The times are limo's, as an application on a real controller would choose its own.

Settings of the simulated controller, and whether a client can command with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from backends.fri.codec.messages import CommandMode, ControlMode, IoValue, Quality, SessionState
from backends.fri.codec.version import FriVersion
from backends.fri.simulator.arm import Compliance
from backends.fri.simulator.judge import CommandLimits
from backends.fri.simulator.port import Address, QualityModel
from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import Declared, parameter

MOST_VISITS: Final = 10_000  # remembered; a controller may run for days
_EPSILON: Final = 1e-9  # [s]


@dataclass(frozen=True)
class SessionTimes(Declared):
    """Settings that the robot's application would choose."""

    monitor: float = parameter(
        "s", "in MONITORING_READY before an overlay is asked for", lower=0, default=0.5
    )
    confirm: int = parameter("", "answers in a row, before an overlay begins", lower=1, default=10)
    restart: float = parameter("s", "from a stop to the next overlay", lower=0, default=1.0)
    stop: float = parameter(
        "s", "for which a stop of the controller's own is shown", lower=0, default=0.5
    )


@dataclass(frozen=True)
class ControllerVisit:
    """A session state, and when it was entered."""

    state: SessionState
    at: float  # [s] since the start
    reason: str  # why the session went down; empty if it went up


@dataclass(frozen=True)
class Circumstances:
    """Inputs of the session's state machine in one cycle."""

    quality: Quality
    confirmed: int  # answers in a row that confirm the set-point
    cap: SessionState = SessionState.COMMANDING_ACTIVE  # the highest state allowed,
    cap_reason: str = ""  # and what capped it
    stop: str = ""  # why the arm has to stop; empty if it need not


class ControllerSession:
    """State machine of the session.

    Args:
        times: What the application chose.
    """

    def __init__(self, times: SessionTimes) -> None:
        self.times = times
        self.state = SessionState.IDLE
        self.visits = [ControllerVisit(SessionState.IDLE, 0.0, "")]
        self.forgotten = 0  # visits beyond the most
        self._entered = 0.0
        self._commanding_from = 0.0  # before which no overlay is asked for

    @property
    def commanding(self) -> bool:
        """Whether an overlay was asked for."""
        return self.state >= SessionState.COMMANDING_WAIT

    @property
    def active(self) -> bool:
        """Whether the client's commands move the arm."""
        return self.state is SessionState.COMMANDING_ACTIVE

    def update(self, now: float, given: Circumstances) -> SessionState:
        """Go on by at most one state up, or down to where it has to be.

        Args:
            now: Since the start [s].
            given: What it depends on.
        """
        if given.stop:
            self._commanding_from = now + self.times.restart
        lower, reason = self._lower(given)
        if lower < self.state:
            self._enter(lower, now, reason)
        elif self._may_rise(now, given):
            self._enter(SessionState(self.state + 1), now, "")
        return self.state

    def _lower(self, given: Circumstances) -> tuple[SessionState, str]:
        """Return the highest state that may be kept, and why no higher one."""
        bounds = [(given.cap, given.cap_reason)]
        if given.quality < Quality.GOOD:
            reason = f"the quality of the connection is {given.quality.name}"
            bounds.append((SessionState.MONITORING_WAIT, reason))
        if given.stop:
            bounds.append((SessionState.MONITORING_READY, given.stop))
        return min(bounds, key=lambda bound: bound[0])

    def _may_rise(self, now: float, given: Circumstances) -> bool:
        if self.state >= given.cap or self.active:
            return False
        if self.state is SessionState.IDLE:
            return True
        if self.state is SessionState.MONITORING_WAIT:
            return given.quality >= Quality.GOOD
        if self.state is SessionState.MONITORING_READY:
            since = max(self._entered + self.times.monitor, self._commanding_from)
            return now >= since - _EPSILON and not given.stop
        return given.confirmed >= self.times.confirm

    def _enter(self, state: SessionState, now: float, reason: str) -> None:
        self.state, self._entered = state, now
        if len(self.visits) < MOST_VISITS:
            self.visits.append(ControllerVisit(state, now, reason))
        else:
            self.forgotten += 1


SHORTEST_PERIOD, LONGEST_PERIOD = 1, 100  # [ms]
COMMANDING_INTERVAL: Final = 10  # [ms], longest receive interval in which positions are commanded
COMPLIANT_INTERVAL: Final = 5  # [ms], for torque and wrench
ANYWHERE: Final = Address("0.0.0.0", 0)  # noqa: S104  # as a controller listens
POSE: Final = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)  # [rad], where the arm stands at first
MODES: Final = {
    "position": CommandMode.POSITION,
    "torque": CommandMode.TORQUE,
    "wrench": CommandMode.WRENCH,
}
_CONTROL: Final = {
    CommandMode.POSITION: ControlMode.POSITION,
    CommandMode.TORQUE: ControlMode.JOINT_IMPEDANCE,
    CommandMode.WRENCH: ControlMode.CARTESIAN_IMPEDANCE,
}


@dataclass(frozen=True)
class ControllerSettings(Declared):
    """Settings of one controller.

    Raises:
        ConfigError: Out of bounds.
    """

    client: Address
    version: FriVersion = FriVersion.V1_15
    bind: Address = ANYWHERE
    mode: CommandMode = CommandMode.POSITION
    period_ms: int = parameter("ms", lower=SHORTEST_PERIOD, upper=LONGEST_PERIOD, default=2)
    multiplier: int = parameter(
        "", "packets in one receive interval", lower=1, upper=LONGEST_PERIOD, default=1
    )
    duration: float | None = parameter(
        "s", "until told to stop if None", lower=0, above=True, finite=False, default=None
    )
    late_after: float | None = parameter(
        "s", "answers slower than that are counted as slow", lower=0, default=None
    )
    position: tuple[float, ...] = POSE  # [rad]
    seed: int = 0  # of the sensors' noise
    fifo: bool = False  # ask for SCHED_FIFO
    ios: tuple[IoValue, ...] = ()  # that the application names
    transformations: tuple[str, ...] = ()  # that it requests
    quality: QualityModel = field(default_factory=QualityModel)
    times: SessionTimes = field(default_factory=SessionTimes)
    limits: CommandLimits = field(default_factory=CommandLimits)
    compliance: Compliance = field(default_factory=Compliance)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.client.port == 0:
            raise ConfigError(f"client {self.client} has no port to send to")

    @property
    def interval_ms(self) -> int:
        """Time in which one answer is expected [ms]."""
        return self.period_ms * self.multiplier

    @property
    def note(self) -> str:
        """Remark to print before the first packet, in one line."""
        about = f"{self.mode.name.lower()} mode, every {self.period_ms} ms"
        return f"{about}; {self.monitoring_only}" if self.monitoring_only else about

    @property
    def control(self) -> ControlMode:
        """Control mode of the arm while the client commands it."""
        return _CONTROL[self.mode]

    @property
    def monitoring_only(self) -> str:
        """Why a client cannot command with these settings; empty if it can."""
        most = COMMANDING_INTERVAL if self.mode is CommandMode.POSITION else COMPLIANT_INTERVAL
        if self.interval_ms <= most:
            return ""
        return (
            f"period x multiplier is {self.interval_ms} ms; to command {self.mode.name.lower()} "
            f"it has to be at most {most} ms, so the session stays in MONITORING_READY"
        )
