"""Measurements that can be believed: finite, within reach of the last one, on limo's own clock."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limo_driver.compiled import compiled
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits, JointState

SLACK = 0.01  # [rad] that a joint may be moved beyond what its velocity allows
CONSISTENT = 3  # measurements in a row, elsewhere than expected, that are believed after all
SHORTEST_STEP = (
    0.8  # of a period, by which time goes on in a cycle, whatever the robot's clock says
)
_FINE, _FAR, _UNREADABLE = 0, 1, 2


class Pose(NamedTuple):
    """Where an arm is and how it moves; each array has shape (n,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s^2], of the last cycle
    time: float  # of limo's own clock [s]


class Belief(NamedTuple):
    """All that is remembered of measurements."""

    time: float = 0.0  # limo's own, which goes on in every cycle [s]
    ahead: float = 0.0  # of it, before the robot's clock [s]
    pose: Pose | None = None  # the last one that was believed
    doubt: Pose | None = None  # the last one that was not
    doubts: int = 0  # in a row, consistent with each other
    anywhere: bool = True  # the next one is believed wherever it has the arm
    jumped: bool = False  # the pose was believed only because it insisted


class Measured:
    """Tells measurements from what cannot be one.

    Args:
        limits: Limits of the joints.
        period: Cycle [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self._fastest = VELOCITY_TOLERANCE * limits.velocity
        self._period = period
        self._still = np.zeros(limits.velocity.size)

    def take(self, state: JointState, before: Belief) -> tuple[Belief, bool]:
        """Return what is believed since a state, and whether that state is."""
        pose, shown = before.pose, state.time
        if not math.isfinite(shown):
            shown = before.time - before.ahead
        own = before.time + self._period
        if state.stale:
            return before._replace(time=own, jumped=False), False
        known = state.position if pose is None else pose.position
        if pose is None:
            own = shown
        elif shown + before.ahead >= before.time + SHORTEST_STEP * self._period:
            own = shown + before.ahead
        since = 0.0 if pose is None else own - pose.time
        reach = self._fastest, since + self._period, SLACK  # a cycle may begin a little late
        fine = _judge(state.position, state.velocity, state.torque, known, *reach)
        if fine == _UNREADABLE:
            return before._replace(time=own, doubts=0, jumped=False), False
        ahead = own - shown
        if before.anywhere or fine == _FINE:
            acceleration = self._still
            if pose is not None and since > 0.0 and not before.anywhere:
                acceleration = (state.velocity - pose.velocity) / since
            fresh = Pose(state.position, state.velocity, acceleration, own)
            return Belief(own, ahead, fresh, anywhere=False), True
        return self._doubted(state, before, own, ahead)

    def _doubted(
        self, state: JointState, before: Belief, own: float, ahead: float
    ) -> tuple[Belief, bool]:
        """Take a measurement that is out of reach: it is believed once others agree with it."""
        doubts, last = 1, before.doubt
        if last is not None and before.doubts:
            reach = self._fastest * (own - last.time + self._period) + SLACK
            doubts += before.doubts * bool((np.abs(state.position - last.position) <= reach).all())
        fresh = Pose(state.position, state.velocity, self._still, own)
        if doubts >= CONSISTENT:
            return Belief(own, ahead, fresh, anywhere=False, jumped=True), True
        return before._replace(
            time=own, ahead=ahead, doubt=fresh, doubts=doubts, jumped=False
        ), False

    def now(self, belief: Belief) -> Pose | None:
        """Return where the arm is in this cycle; a lost measurement is carried on by its motion."""
        pose = belief.pose
        if pose is None or belief.time <= pose.time:
            return pose
        since = belief.time - pose.time
        velocity = pose.velocity + since * pose.acceleration
        position = pose.position + 0.5 * since * (pose.velocity + velocity)
        return Pose(position, velocity, pose.acceleration, belief.time)


@compiled(reads=("position", "velocity", "torque", "known", "fastest"))
def _judge(
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
    known: FloatArray,
    fastest: FloatArray,
    since: float,
    slack: float,
) -> int:
    """Return whether a measurement is fine, out of reach of the one before, or unreadable."""
    fine = _FINE
    for j in range(position.size):
        total = position[j] + velocity[j] + torque[j]
        if not -np.inf < total < np.inf:  # a NaN compares false
            return _UNREADABLE
        if not abs(position[j] - known[j]) <= fastest[j] * since + slack:
            fine = _FAR
    return fine
