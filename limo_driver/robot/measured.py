"""Measurements that can be believed: finite, within reach of the last one, on limo's own clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limo_driver.robot.setpoints import VELOCITY_TOLERANCE, first_runaway, runs_away
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits, JointState

RANGE_TOLERANCE = 0.01  # [rad], how far outside its range a joint may be carried
SLACK = 0.01  # [rad] that a joint may be moved beyond what its velocity allows
CONSISTENT = 3  # measurements in a row, elsewhere than expected, that are believed after all
SHORTEST_STEP = (
    0.8  # of a period, by which time goes on in a cycle, whatever the robot's clock says
)
_FINE, _FAR, _UNREADABLE, _JUDGED = 0, 1, 2, 3


def farthest_false(limits: JointLimits, period: float) -> FloatArray:
    """Return by how much a pose that is believed may be false at once, (2, n) [rad], [rad/s].

    That is as far as an arm can have got while its measurements were doubted.
    """
    fastest = VELOCITY_TOLERANCE * limits.velocity
    return np.array([fastest * (CONSISTENT + 1) * period + SLACK, fastest])


class Pose(NamedTuple):
    """Where an arm is and how it moves; each array has shape (n,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    time: float  # of limo's own clock [s]
    slower: FloatArray  # the velocity before [rad/s]
    since: float  # and for how long it has been this one [s]
    apart: FloatArray | None = None  # where else it may be, beyond this, after a jump [rad]

    @property
    def acceleration(self) -> FloatArray:  # seldom asked for
        """Of the last cycle, (n,) [rad/s^2]."""
        return (self.velocity - self.slower) / self.since


@dataclass(slots=True)
class Belief:
    """All that is remembered of measurements; written in every cycle."""

    time: float = 0.0  # limo's own, which goes on in every cycle [s]
    ahead: float = 0.0  # of it, before the robot's clock [s]
    pose: Pose | None = None  # the last one that was believed
    doubt: Pose | None = None  # the last one that was not
    doubts: int = 0  # in a row, consistent with each other
    anywhere: bool = True  # the next one is believed wherever it has the arm
    jumped: bool = False  # the pose was believed only because it insisted
    parted: float = 0.0  # when the pose jumped away from where else the arm may be [s]
    runaway: int = 0  # first joint, from 1, measured too fast or on its way out of range


class Measured:
    """Tells measurements from what cannot be one.

    Args:
        limits: Limits of the joints.
        period: Cycle [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        lower, upper = limits.position_min - RANGE_TOLERANCE, limits.position_max + RANGE_TOLERANCE
        self._fastest = VELOCITY_TOLERANCE * limits.velocity
        self._bounds = np.array([lower, upper, self._fastest])
        self._period, self._shortest = period, SHORTEST_STEP * period

    def take(self, state: JointState, belief: Belief) -> bool:
        """Note a state; say whether it is believed."""
        pose, own = belief.pose, state.time + belief.ahead
        belief.jumped = False
        if state.stale:
            belief.time, belief.runaway = belief.time + self._period, 0
            return False
        if pose is None:
            since, known = 0.0, state.position
            own = own if math.isfinite(own) else 0.0
        else:
            if not belief.time + self._shortest <= own < math.inf:  # a NaN compares false
                own = belief.time + self._period
                if math.isfinite(state.time):
                    belief.ahead = own - state.time
            since, known = own - pose.time, pose.position
        belief.time = own
        # A cycle may begin a little late.
        judged = _judge(
            state.position, state.velocity, state.torque, known, self._bounds, since + self._period
        )
        fine, belief.runaway = judged & _JUDGED, judged >> 2
        if fine == _UNREADABLE:
            belief.doubts = 0
            return False
        if pose is None or belief.anywhere:
            belief.pose = Pose(state.position, state.velocity, own, state.velocity, self._period)
            belief.anywhere = False
        elif fine == _FINE:
            belief.pose = Pose(
                state.position, state.velocity, own, pose.velocity, since, pose.apart
            )
        else:
            return self._insists(state, belief)
        belief.doubts = 0
        return True

    def _insists(self, state: JointState, belief: Belief) -> bool:
        """Note a measurement that is out of reach: it is believed once others agree with it."""
        last, own = belief.doubt, belief.time
        near = False
        if last is not None and belief.doubts:
            reach = self._fastest * (own - last.time + self._period) + SLACK
            near = bool((np.abs(state.position - last.position) <= reach).all())
        belief.doubts = belief.doubts + 1 if near else 1
        belief.doubt = Pose(state.position, state.velocity, own, state.velocity, self._period)
        if belief.doubts < CONSISTENT:
            return False
        apart = self._apart(state.position, belief)
        belief.pose, belief.doubts, belief.jumped = belief.doubt._replace(apart=apart), 0, True
        return True

    def _apart(self, position: FloatArray, belief: Belief) -> FloatArray | None:
        """Return where an arm may be whose pose jumps there, beyond that; None if it is back.

        No arm jumps: until it measures again where it can have gone to, both may be true.
        """
        before = self.now(belief)
        if before is None or belief.pose is None:
            return None
        if before.apart is None:
            belief.parted = belief.pose.time
        apart = before.position - position + (0.0 if before.apart is None else before.apart)
        reach = self._fastest * (belief.time - belief.parted + self._period) + SLACK
        return apart if (np.abs(apart) > reach).any() else None

    def all_fine(
        self, position: FloatArray, velocity: FloatArray, torque: FloatArray, belief: Belief
    ) -> bool:
        """Say whether `take` would believe T states of cycles in a row, and find no runaway.

        Args:
            position: (T, n) [rad].
            velocity: (T, n) [rad/s].
            torque: (T, n) [N m].
            belief: Before the first of them; not changed.
        """
        if belief.pose is None or belief.doubts or belief.anywhere:
            return False
        known = belief.pose.position
        return bool(_all_fine(position, velocity, torque, known, self._bounds, 2.0 * self._period))

    def runaway(self, pose: Pose) -> int:
        """Return the first joint, from 1, too fast or on its way out of range; 0 if none."""
        return first_runaway(pose.position, pose.velocity, self._bounds)

    def first_outward(self, pose: Pose, push: FloatArray) -> int:
        """Return the first joint, from 1, that a torque (n,) [N m] pushes further out; 0 if none.

        Of those that are further out of their range than they may be carried.
        """
        above, below = pose.position > self._bounds[1], pose.position < self._bounds[0]
        out = (above & (push > 0.0)) | (below & (push < 0.0))
        return int(np.argmax(out)) + 1 if out.any() else 0

    def now(self, belief: Belief) -> Pose | None:
        """Return where the arm is in this cycle; a lost measurement is carried on by its motion."""
        pose = belief.pose
        if pose is None or belief.time <= pose.time:
            return pose
        since = belief.time - pose.time
        change = since * pose.acceleration
        position = pose.position + since * (pose.velocity + 0.5 * change)
        velocity, slower = pose.velocity + change, pose.slower + change
        return pose._replace(position=position, velocity=velocity, time=belief.time, slower=slower)


@compiled(reads=("position", "velocity", "torque", "known"))
def _judge(
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
    known: FloatArray,
    bounds: FloatArray,
    since: float,
) -> int:
    """Say whether a measurement is fine, and by 4 times its number from 1 who runs away."""
    fine, runaway = _FINE, 0
    for j in range(position.size):
        total = position[j] + velocity[j] + torque[j]
        if not -np.inf < total < np.inf:  # a NaN compares false
            return _UNREADABLE
        if not abs(position[j] - known[j]) <= bounds[2, j] * since + SLACK:
            fine = _FAR
        if runaway == 0 and runs_away(j, position, velocity, bounds):
            runaway = j + 1
    return fine + 4 * runaway


@compiled(reads=("position", "velocity", "torque", "known"), nogil=True)
def _all_fine(
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
    known: FloatArray,
    bounds: FloatArray,
    since: float,
) -> bool:
    """Judge states (T, n) one after the other; `known` is the position before the first."""
    for t in range(position.shape[0]):
        before = known if t == 0 else position[t - 1]
        if _judge(position[t], velocity[t], torque[t], before, bounds, since) != _FINE:
            return False
    return True
