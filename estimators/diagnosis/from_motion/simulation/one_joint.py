"""One joint simulated forward in an arm whose other joints move as recorded.

A thousand times faster than the whole arm, for fits: what the other joints do enters as the load of
the rigid body, computed once along the recorded motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation import joint_step as step
from estimators.diagnosis.settings import MATTERS
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray, IntArray

FIT_STEP: Final = 0.01  # [s]; the whole arm takes shorter ones
LONGER: Final = MATTERS  # of it, that steps may be longer: more often than not rows are late

_STILL: Final = 0.02  # [rad/s], below which a joint is at rest, and friction is what it has to be
_INSTANT: Final = 1e-3  # [s], in which torque shows as a change of velocity
_COLUMNS: Final = len(c.CONSTANTS)
_BY_ROW: Final = ("time", "command", "position", "velocity", "load", "inertia", "supply")


class RowErrors(NamedTuple):
    """Errors of one joint, at each row but the last of its stretches."""

    step: FloatArray  # (K,) [rad], simulated from a row to the next, minus recorded
    torque: FloatArray  # (K,) [N m], of drive and friction, minus what the motion needs


@dataclass(frozen=True)
class LoadedJoint:
    """Recorded motion of one joint over T samples, and what loads it."""

    time: FloatArray  # (T,) [s]
    command: FloatArray  # (T,) [rad]; [rad/s] of a servo of velocity, [N m] without a servo
    position: FloatArray  # (T,) [rad]
    velocity: FloatArray  # (T,) [rad/s], zero-phase
    load: FloatArray  # (T,) [N m], rigid body without the joint's own acceleration
    inertia: FloatArray  # (T,) [kg m²], rigid body about the joint
    supply: FloatArray  # (T,), voltage over that of a supply without load
    # rows at which stretches without a gap begin; one, if not given
    begins: IntArray = field(default_factory=lambda: np.zeros(1, dtype=np.int64), kw_only=True)

    @classmethod
    def joined(cls, parts: Sequence[LoadedJoint]) -> LoadedJoint:
        """Return stretches as one, which one call simulates.

        Calls for many short ones take as long as their steps.

        Args:
            parts: One or more.
        """
        first = np.cumsum([0, *(part.time.size for part in parts)])
        begins = [part.begins + at for part, at in zip(parts, first, strict=False)]
        arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in _BY_ROW]
        return cls(*arrays, begins=np.concatenate(begins))

    def between(self, first: int, end: int) -> LoadedJoint:
        """Return some rows of one stretch.

        Args:
            first: The first of them.
            end: The one behind the last.
        """
        return replace(self, **{name: getattr(self, name)[first:end] for name in _BY_ROW})

    def simulate(self, row: FloatArray) -> FloatArray:
        """Return the positions that a joint of these constants takes, (T,) [rad].

        It begins at rest where the recorded one was, in each stretch anew; behind a servo of
        velocity as fast as that was, and is put back where that was each time that its errors begin
        anew. Behind a drive that closes no loop it then has the velocity of the recorded one, too.
        """
        return self._advance(row, self.velocity, anew=False)[0]

    def errors_of_rows(self, row: FloatArray) -> RowErrors:
        """Return the errors of one stretch that is simulated from each row to the next."""
        change = np.gradient(self.velocity, self.time)
        position, torque = self._advance(row, change, anew=True)
        return RowErrors(position[1:] - self.position[1:], torque[:-1])

    def _advance(self, row: FloatArray, acceleration: FloatArray, *, anew: bool) -> FloatArray:
        of_rows = (getattr(self, name) for name in _BY_ROW)
        known = (c.geared(row), self.begins, *of_rows, acceleration, anew)
        return _advance(*known)  # pyright: ignore[reportCallIssue]  # as many as `_BY_ROW` says


def lag(part: LoadedJoint, row: FloatArray) -> FloatArray:
    """Return by how much a joint lags what its servo is told (T,): [rad], or of velocity [rad/s].

    Of a drive that closes no loop, what it is told [N m].

    Args:
        part: A recorded stretch.
        row: The constants of the joint.
    """
    if row[c.GAIN] > 0.0:
        return part.command
    return part.command - (part.velocity if row[c.KV] > 0.0 else part.position)


@compiled(reads=("constants", "begins", *_BY_ROW, "acceleration"), nogil=True)
def _advance(
    constants: FloatArray,
    begins: IntArray,
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    load: FloatArray,
    inertia: FloatArray,
    supply: FloatArray,
    acceleration: FloatArray,
    anew: bool,
) -> FloatArray:
    """Return positions [rad] and errors of torque [N m] of all stretches, (2, T).

    Each goes on from row to row; or each row is begun anew as recorded, and only then torque is
    compared with what the recorded acceleration needs.
    """
    result = np.empty((2, time.size))
    # scalars: views of arrays are counted at each call, which takes as long as the step itself
    row = to_fixed_tuple(constants, _COLUMNS)  # pyright: ignore[reportCallIssue]  # an intrinsic
    delay, longest = row[c.DELAY], step.longest_step(row, FIT_STEP)
    for k in range(begins.size):
        first, end = begins[k], begins[k + 1] if k + 1 < begins.size else time.size
        start, ahead = position[first], step.slack(row, load[first])
        q, v, integral, at = start + ahead, 0.0, step.held(row, start, load[first]), first
        target, pace, heat = command[first], 0.0, 0.0
        result[0, first], begun = start, -math.inf
        own, orders = time[:end], command[:end]
        for i in range(first, end - 1):
            if anew:
                v = velocity[i] if abs(velocity[i]) > _STILL else 0.0
                ahead = step.slack(row, load[i] + inertia[i] * acceleration[i])
                q = position[i] + ahead
            elif step.begins_anew(row, begun, time[i]):
                q, begun = position[i] + ahead, time[i]
                if i == first or not step.keeps_pace(row):
                    v = velocity[i]
            steps = max(1, math.ceil((time[i + 1] - time[i]) / longest - LONGER))
            h = (time[i + 1] - time[i]) / steps
            for s in range(steps):
                begin = time[i] + h * s - delay
                target, pace, at = step.follow_command(row, own, orders, at, begin, h, target, pace)
                error = step.error_of(row, target, q)
                integral = step.position_integral(row, integral, error, h)
                volts, heat = step.warm_motor(row, supply[i], heat, error, v, h)
                if anew and s == 0:
                    after, _ = step.next_velocity(
                        row, q, v, error, integral, inertia[i], load[i], volts, _INSTANT
                    )
                    change = (after - v) / _INSTANT
                    result[1, i] = (inertia[i] + row[c.INERTIA]) * (change - acceleration[i])
                now = load[i] + (s + 0.5) / steps * (load[i + 1] - load[i])
                after, mean = step.next_velocity(
                    row, q, v, error, integral, inertia[i], now, volts, h
                )
                integral = step.velocity_integral(row, integral, error, mean, h)
                ahead = step.slack(row, now + inertia[i] * (after - v) / h)
                v = after
                q += h * mean
            result[0, i + 1] = q - ahead
    return result
