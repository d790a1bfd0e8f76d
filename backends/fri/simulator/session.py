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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from backends.fri.codec.messages import Quality, SessionState
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
