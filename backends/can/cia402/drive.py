"""One CiA 402 drive, as it is heard on the bus; nothing of it is known before it spoke.

Whether joints follow their set-points, as they measure it.

A joint that moves is behind its set-point by the time that its drive takes, so that it is compared
with all set-points of the last three cycles, or of 20 ms: it has to be within reach of one of them,
or between them. One that stands still while it is told to move is out of that 20 ms later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from backends.can.cia402.codec import LAYOUT as EMERGENCY
from backends.can.cia402.codec import (
    MEASURED,
    STATUS,
    TEMPERATURE,
    Controlword,
    State,
    describe,
    mode_words,
    state_of,
)
from backends.can.link import DriveStatus, status_line
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray

BOOTED: Final = 0x00
STOPPED: Final = 0x04
OPERATIONAL: Final = 0x05
PRE_OPERATIONAL: Final = 0x7F
FOLLOWING_ERROR: Final = 1 << 13  # bit of the statusword, in cyclic synchronous position
MOST_DOUBLED: Final = 2  # cycles in a row; CAN itself may repeat a frame after an error
_NMT_WORDS: Final = {
    BOOTED: "restarted",
    STOPPED: "was stopped",
    PRE_OPERATIONAL: "left operation (pre-operational)",
}
LAG: Final = 0.02  # [s] that a joint may take to follow
LAG_PERIODS: Final = 3  # or so many periods, if those are longer


@dataclass(slots=True)
class Drive:
    """Latest values heard from a drive, and the last ones sent to it.

    A position counts only if the joint can have got there: `reach` counts from the last one.
    """

    joint: int  # 1-based
    node: int
    statusword: int | None = None
    state: State = State.UNKNOWN
    lags: bool = False  # it says that it does not follow, where it follows positions
    count: int = 0  # meaningless before `heard_at`
    per_mille: int = 0
    heard: bool = False  # in the cycle that runs
    heard_at: float = -math.inf  # start of the last cycle with a position [s]
    before: tuple[int, float] | None = None  # the position before: count, start of its cycle [s]
    silent: int = 0  # cycles without a position
    answers: int = 0  # in the cycle that runs
    answered: bool = False  # in the cycle before
    doubled: int = 0  # cycles in a row with more than one answer, each after one that had some
    reach: float = math.inf  # counts from the last position that can be true
    speed: int | None = None  # [counts/s], by the drive
    error: int = 0
    mode: int | None = None
    temperature: int | None = None
    nmt: int | None = None
    heartbeat_at: float | None = None  # [s]
    broken: int = 0  # frames of another length than agreed
    implausible: int = 0  # positions out of reach
    controlword: int = Controlword.DISABLE_VOLTAGE
    cycle_at: float = 0.0  # start of the cycle that runs [s]

    @property
    def prompt(self) -> bool:
        """Whether it answered to the last cycle in time."""
        return self.heard and not self.silent

    def refer(self, now: float) -> None:
        """Begin anew with the position it has now [s]; the next ones have to be near."""
        self.heard_at = self.cycle_at = now
        self.before, self.heard, self.silent, self.implausible = None, False, 0, 0
        self.answers, self.answered, self.doubled = 0, False, 0

    def open_cycle(self, now: float, reach: float) -> None:
        """Wait for a position of a new cycle, which started now [s]."""
        if self.heard and self.silent:  # late, in the cycle before
            self.silent = 0
        # One answer may be late, and come together with the next.
        self.doubled = self.doubled + 1 if self.answers > 1 and self.answered else 0
        self.answers, self.answered = 0, self.answers > 0
        self.heard, self.cycle_at, self.reach = False, now, reach

    def close_cycle(self) -> None:
        """Count a cycle without a position."""
        self.silent = 0 if self.heard else self.silent + 1

    def take_measured(self, data: bytes) -> None:
        """Read TPDO1."""
        if len(data) != MEASURED.size:
            self.broken += 1
            return
        self.answers += 1
        statusword, count, per_mille = MEASURED.unpack(data)
        if abs(count - self.count) > self.reach:
            self.implausible += 1
            return
        if self.heard_at != self.cycle_at:
            self.before = (self.count, self.heard_at)
        if statusword != self.statusword:  # seldom
            self.take_statusword(statusword)
        self.count, self.per_mille = count, per_mille
        self.heard, self.heard_at = True, self.cycle_at
        self.nmt = OPERATIONAL  # drives in other states of NMT send no PDO

    def take_statusword(self, statusword: int) -> None:
        """Note in which state it is."""
        self.statusword, self.state = statusword, state_of(statusword)
        self.lags = bool(statusword & FOLLOWING_ERROR)

    def take_status(self, data: bytes) -> None:
        """Read TPDO2."""
        if len(data) != STATUS.size:
            self.broken += 1
            return
        self.speed, self.error, self.mode = STATUS.unpack(data)

    def take_temperature(self, data: bytes) -> None:
        """Read TPDO3."""
        if len(data) != TEMPERATURE.size:
            self.broken += 1
            return
        (self.temperature,) = TEMPERATURE.unpack(data)

    def take_emergency(self, data: bytes) -> None:
        """Read an emergency message; code 0 says that the error is gone."""
        if len(data) != EMERGENCY.size:
            self.broken += 1
            return
        self.error = EMERGENCY.unpack(data)[0]

    def take_heartbeat(self, data: bytes, now: float) -> None:
        """Read a heartbeat, which came now [s]."""
        if len(data) != 1:
            self.broken += 1
            return
        self.nmt, self.heartbeat_at = data[0] & 0x7F, now

    def velocity(self, period: float) -> float:
        """Return the velocity between its last positions [counts/s].

        A cycle that began late may be followed by one that is shorter than a period; drives that
        move by one set-point a cycle would seem too fast there.
        """
        if self.before is None:
            return 0.0
        count, at = self.before
        return (self.count - count) / max(self.heard_at - at, period)

    def told(self, position: float, velocity: float, torque: float, degree: float) -> DriveStatus:
        """Return its latest values.

        Args:
            position: [rad].
            velocity: By the drive [rad/s].
            torque: [N m].
            degree: One count of its temperature [°C]; NaN if it sends none.
        """
        return DriveStatus(
            node=self.node,
            status=self.state.words,
            enabled=self.state is State.ENABLED,
            position=position,
            velocity=velocity,
            torque=torque,
            temperature=math.nan if self.temperature is None else degree * self.temperature,
            mode="" if self.mode is None else mode_words(self.mode),
            error=describe(self.error),
            silent=self.silent,
        )

    @property
    def status(self) -> str:
        """Its condition in words, for example `operation enabled`."""
        if not self.error and not self.silent:
            return self.state.words
        return status_line(self.state.words, describe(self.error), self.silent)

    def complaint(self, hold_after: int, heartbeat_timeout: float, now: float) -> str:
        """Say what keeps this drive from following set-points; empty if nothing does."""
        if self.doubled >= MOST_DOUBLED:
            return f"answers twice, {self.doubled} cycles in a row: a second node has its id"
        if self.nmt in _NMT_WORDS:
            return _NMT_WORDS[self.nmt]
        if self.silent >= hold_after:
            cycles = f"{self.silent} cycle" + ("s" if self.silent > 1 else "")
            jumps = ", its positions jump" if self.implausible else ""
            return f"is silent for {cycles}{jumps}"
        if self.state is not State.ENABLED:
            error = describe(self.error)
            return f"is in state {self.state.words!r}" + (f": {error}" if error else "")
        if self.heartbeat_at is not None and now - self.heartbeat_at > heartbeat_timeout:
            return f"lost its heartbeat for {now - self.heartbeat_at:.3g} s"
        return ""


def longest_lag(period: float) -> float:
    """Return how long a joint may take to follow where cycles have a period, both in [s]."""
    return max(LAG, LAG_PERIODS * period)


class FollowingCheck:
    """Compares what joints measure with what they were told.

    Args:
        n: Number of joints.
        period: Of the cycles [s].
        window: How far a joint may be off [rad].
    """

    def __init__(self, n: int, period: float, window: float) -> None:
        self._commanded = np.zeros((math.ceil(longest_lag(period) / period - 1e-9) + 1, n))
        self._at, self._window = 0, window
        self._off, self._position = 0, np.zeros(n)
        self.judge(self._position)  # compiled before a drive waits for it

    def begin(self, joints: int | slice, position: FloatArray) -> None:
        """Begin anew with some joints, from 0, that stand at a position (n,) [rad]."""
        self._commanded[:, joints] = position[joints]
        self._off = 0

    def note(self, target: FloatArray) -> None:
        """Note the set-point of a cycle, (n,) [rad]."""
        self._at = (self._at + 1) % len(self._commanded)
        self._commanded[self._at] = target

    def judge(self, position: FloatArray) -> None:
        """Judge a position that was measured, (n,) [rad]."""
        self._off, self._position = _first_off(position, self._commanded, self._window), position

    def complaint(self, drives: Sequence[Drive]) -> str:
        """Say which joint does not follow; empty if all do."""
        if not self._off:
            return ""
        drive, j = drives[self._off - 1], self._off - 1
        away = float(np.abs(self._position[j] - self._commanded[:, j]).min())
        return (
            f"joint {drive.joint} (node {drive.node}) does not follow: it is {away:.3g} rad off "
            f"its latest set-points, at most {self._window:g} rad (following_error)"
        )


@compiled(reads=("position",))
def _first_off(position: FloatArray, commanded: FloatArray, window: float) -> int:
    """Return the first joint, from 1, that is off all that it was told; 0 if none."""
    for j in range(position.size):
        lower, upper = commanded[0, j], commanded[0, j]
        for k in range(1, commanded.shape[0]):
            lower, upper = min(lower, commanded[k, j]), max(upper, commanded[k, j])
        if not lower - window <= position[j] <= upper + window:
            return j + 1
    return 0
