"""One joint simulated forward in an arm whose other joints move as recorded.

A thousand times faster than the whole arm, for fits: what the other joints do enters as the load of
the rigid body, computed once along the recorded motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from estimators.diagnosis.from_motion.simulation.joint_step import (
    begins_anew,
    caught_up,
    commanded,
    derated,
    error_of,
    heated,
    held,
    integrated,
    keeps_pace,
    led,
    longest_step,
    next_velocity,
    sent_again,
    slack,
)
from estimators.diagnosis.from_motion.simulation.plant import (
    DELAY,
    DERATING,
    GAIN,
    KV,
    NAMES,
    geared,
)
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FIT_STEP: Final = 0.01  # [s]; the whole arm takes shorter ones
LONGER: Final = 0.1  # of it, that steps may be longer: rows come a little late more often than not
_COLUMNS: Final = len(NAMES)


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
    begins: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(1, dtype=np.int64), kw_only=True
    )

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
        return _advance(
            geared(row),
            self.begins,
            self.time,
            self.command,
            self.position,
            self.velocity,
            self.load,
            self.inertia,
            self.supply,
        )


def lag(part: LoadedJoint, row: FloatArray) -> FloatArray:
    """Return by how much a joint lags what its servo is told (T,): [rad], or of velocity [rad/s].

    Of a drive that closes no loop, what it is told [N m].

    Args:
        part: A recorded stretch.
        row: The constants of the joint.
    """
    if row[GAIN] > 0.0:
        return part.command
    return part.command - (part.velocity if row[KV] > 0.0 else part.position)


_BY_ROW: Final = ("time", "command", "position", "velocity", "load", "inertia", "supply")


def loaded_joints(body: RobotModel, recordings: Sequence[Recording]) -> list[list[LoadedJoint]]:
    """Return the stretches of each joint.

    Args:
        body: The rigid body.
        recordings: With commands.

    Returns:
        For each joint (0-based), its stretches without a gap.
    """
    found: list[list[LoadedJoint]] = [[] for _ in range(body.n)]
    for recording in recordings:
        command = commands_of(recording)
        motion = recording.motion(bandwidth_for([recording]))
        total = body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
        for j in range(body.n):
            inertia = body.inertia_of(motion.position, j)[:, j]
            load = total[:, j] - inertia * motion.acceleration[:, j]
            for rows in recording.segments:
                parts = (
                    recording.time,
                    command[:, j],
                    recording.position[:, j],
                    motion.velocity[:, j],
                    load,
                    inertia,
                    np.ones_like(load),
                )
                found[j].append(LoadedJoint(*(np.ascontiguousarray(x[rows]) for x in parts)))
    return found


@compiled(
    reads=(
        "constants",
        "begins",
        "time",
        "command",
        "position",
        "velocity",
        "load",
        "inertia",
        "supply",
    ),
    nogil=True,
)
def _advance(
    constants: FloatArray,
    begins: NDArray[np.int64],
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    load: FloatArray,
    inertia: FloatArray,
    supply: FloatArray,
) -> FloatArray:
    """Return the positions (T,) [rad] of all stretches."""
    result = np.empty(time.size)
    for k in range(begins.size):
        end = begins[k + 1] if k + 1 < begins.size else time.size
        own = slice(begins[k], end)
        result[own] = _advance_one(
            constants,
            time[own],
            command[own],
            position[own],
            velocity[own],
            load[own],
            inertia[own],
            supply[own],
        )
    return result


@compiled(
    reads=("constants", "time", "command", "position", "velocity", "load", "inertia", "supply"),
    nogil=True,
)
def _advance_one(
    constants: FloatArray,
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    load: FloatArray,
    inertia: FloatArray,
    supply: FloatArray,
) -> FloatArray:
    """Return the positions (T,) [rad] of one stretch."""
    # scalars: views of arrays are counted at each call, which takes as long as the step itself
    row = to_fixed_tuple(constants, _COLUMNS)  # pyright: ignore[reportCallIssue]  # an intrinsic
    result = np.empty(time.size)
    start, ahead = position[0], slack(row, load[0])
    q, v, integral, at = start + ahead, 0.0, held(row, start, load[0]), 0
    target, pace, delay, heat = command[0], 0.0, row[DELAY], 0.0
    result[0], begun = start, -math.inf
    longest = longest_step(row, FIT_STEP)
    for i in range(time.size - 1):
        if begins_anew(row, begun, time[i]):
            q, begun = position[i] + ahead, time[i]
            if i == 0 or not keeps_pace(row):
                v = velocity[i]
        steps = max(1, math.ceil((time[i + 1] - time[i]) / longest - LONGER))
        h = (time[i + 1] - time[i]) / steps
        for s in range(steps):
            begin = time[i] + h * s - delay
            before = at
            wanted, at = commanded(time, command, at, begin, begin + h)
            again = sent_again(command, before, at)
            target, pace = led(row, wanted, again, target, pace, h)
            error = error_of(row, target, q)
            integral = integrated(row, integral, error, h)
            part = (s + 0.5) / steps
            now = load[i] + part * (load[i + 1] - load[i])
            volts = supply[i]
            if row[DERATING] > 0.0:
                volts = derated(row, volts, heat)
                heat = heated(row, heat, error, v, h)
            after, mean = next_velocity(row, q, v, error, integral, inertia[i], now, volts, h)
            integral = caught_up(row, integral, error, mean, h)
            ahead = slack(row, now + inertia[i] * (after - v) / h)
            v = after
            q += h * mean
        result[i + 1] = q - ahead
    return result
