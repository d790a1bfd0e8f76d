"""Errors that no feedback of the simulation adds to: of one step, and of inverse dynamics.

A free run from the commands alone adds up what is amiss. Here the joint is simulated from each
recorded row to the next, position and velocity as recorded; and the torque that its recorded
acceleration needs is compared with that of drive and friction there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from estimators.diagnosis.from_motion.simulation.columns import (
    DELAY,
    DERATING,
    INERTIA,
    NAMES,
    geared,
)
from estimators.diagnosis.from_motion.simulation.joint_step import (
    caught_up,
    commanded,
    derated,
    error_of,
    heated,
    held,
    integrated,
    led,
    longest_step,
    next_velocity,
    sent_again,
    slack,
)
from estimators.diagnosis.from_motion.simulation.one_joint import FIT_STEP, LONGER
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray

_STILL: Final = 0.02  # [rad/s], below which a joint is at rest, and friction is what it has to be
_INSTANT: Final = 1e-3  # [s], in which torque shows as a change of velocity
_COLUMNS: Final = len(NAMES)


class RowErrors(NamedTuple):
    """Errors of one joint, at each row but the last of its stretches."""

    step: FloatArray  # (K,) [rad], simulated from a row to the next, minus recorded
    torque: FloatArray  # (K,) [N m], of drive and friction, minus what the motion needs


def row_errors(parts: Sequence[LoadedJoint], row: FloatArray) -> RowErrors:
    """Return the errors of a joint from each recorded row on.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint.
    """
    found = [_each_row(geared(row), *_arrays(part)) for part in parts]
    step, torque = (np.concatenate([own[k] for own in found]) for k in range(2))
    return RowErrors(step, torque)


def _arrays(part: LoadedJoint) -> tuple[FloatArray, ...]:
    change = np.gradient(part.velocity, part.time)
    return (
        part.time, part.command, part.position, part.velocity, change, part.load, part.inertia,
        part.supply,
    )  # fmt: skip


@compiled(
    reads=(
        "constants",
        "time",
        "command",
        "position",
        "velocity",
        "acceleration",
        "load",
        "inertia",
        "supply",
    ),
    nogil=True,
)
def _each_row(
    constants: FloatArray,
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    load: FloatArray,
    inertia: FloatArray,
    supply: FloatArray,
) -> FloatArray:
    """Return the errors of a step [rad] and of torque [N m] of one stretch, (2, T - 1)."""
    row = to_fixed_tuple(constants, _COLUMNS)  # pyright: ignore[reportCallIssue]  # an intrinsic
    found = np.empty((2, time.size - 1))
    integral, at, heat = held(row, position[0], load[0]), 0, 0.0
    target, pace, delay = command[0], 0.0, row[DELAY]
    longest = longest_step(row, FIT_STEP)
    for i in range(time.size - 1):
        v = velocity[i] if abs(velocity[i]) > _STILL else 0.0
        ahead = slack(row, load[i] + inertia[i] * acceleration[i])
        q = position[i] + ahead
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
            volts = supply[i]
            if row[DERATING] > 0.0:
                volts = derated(row, volts, heat)
                heat = heated(row, heat, error, v, h)
            if s == 0:
                after, _ = next_velocity(
                    row, q, v, error, integral, inertia[i], load[i], volts, _INSTANT
                )
                change = (after - v) / _INSTANT
                found[1, i] = (inertia[i] + row[INERTIA]) * (change - acceleration[i])
            part = (s + 0.5) / steps
            now = load[i] + part * (load[i + 1] - load[i])
            after, mean = next_velocity(row, q, v, error, integral, inertia[i], now, volts, h)
            integral = caught_up(row, integral, error, mean, h)
            ahead = slack(row, now + inertia[i] * (after - v) / h)
            v = after
            q += h * mean
        found[0, i] = q - ahead - position[i + 1]
    return found
