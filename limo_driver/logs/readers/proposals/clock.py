"""A clock that runs at half or double, in a log of which no velocity says so.

Gravity is the same however a clock runs, while accelerations of one at double are a quarter. So the
bodies of an arm, whatever their masses, explain its torques best under the gravity that there is,
or under a quarter or four times of it. And no joint turns faster than its drive lets it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.proposals.gravity import usual
from limo_driver.model import RobotModel
from limo_driver.recordings.bandwidth import bandwidth_at
from limo_driver.recordings.filters.differentiation import differentiate, smooth
from limo_driver.recordings.gate.held_values import even_runs
from limo_driver.types import FloatArray

_BANDWIDTH: Final = 5.0  # [Hz], within which arms move
_FEWEST: Final = 500  # rows
_ROWS: Final = 1000  # that are compared
_BETTER: Final = 0.8  # of the squares that are left, where another clock is meant; 0.93 by chance
_SLOW: Final = 0.02  # of a joint's usual speed, over which dry friction changes its sign
_SWINGS: Final = 4  # times that a joint has to turn back, to say anything
_FASTER: Final = 1.4  # times the limit of the drives, that no motion is
_QUANTILE: Final = 0.99
_LEAST: Final = 1e-3  # of a torque, below which none of it is explained
_ROUNDING: Final = 0.1  # of what a fit leaves of measured torques
_SPEEDS: Final = {0.5: "double", 2.0: "half"}  # seconds that pass in one of the log


def clock_question(
    time: FloatArray, position: FloatArray, torque: FloatArray | None, model: RobotModel
) -> str:
    """Return the question whether a clock runs at half or double; nothing where none has to be.

    Args:
        time: (T,) [s].
        position: (T, n) [rad, m].
        torque: In one unit, whichever it is, (T, n); None where that is not known.
        model: The robot.
    """
    rows = _longest_run(time, position, torque)
    if rows is None:
        return ""
    time, position = time[rows], position[rows]
    bandwidth = bandwidth_at((time.size - 1) / float(time[-1] - time[0]), _BANDWIDTH)
    whole = [slice(0, time.size)]
    try:
        motion = differentiate(time, position, bandwidth, whole)
        felt = (
            None if torque is None else smooth(time, torque[rows], bandwidth, [slice(0, time.size)])
        )
    except RecordingError:  # too short, or too slow
        return ""
    every = slice(None, None, max(1, time.size // _ROWS))
    q, v, a = (x[every] for x in (motion.value, motion.first, motion.second))
    found = 1.0 if felt is None else _seconds_by_torque(q, v, a, felt[every], model)
    if found != 1.0:
        return (
            "time: weight and inertia of the arm fit its torques far better at another speed of "
            f"the clock: does it run at {_SPEEDS[found]} (`factor: {found:g}` under `time:`), or "
            "is it right?"
        )
    return _too_fast(motion.first, model)


def _longest_run(
    time: FloatArray, position: FloatArray, torque: FloatArray | None
) -> np.ndarray | None:
    """Return the rows of the longest stretch without gaps; None if it is too short."""
    known = np.isfinite(time) & usual(position)
    if torque is not None:
        known &= usual(torque)
    every = np.flatnonzero(known)
    if every.size < _FEWEST:
        return None
    run = max(even_runs(time[every]), key=lambda rows: rows.stop - rows.start)
    return every[run] if run.stop - run.start >= _FEWEST else None


def _too_fast(speed: FloatArray, model: RobotModel) -> str:
    """Return a question where joints move faster than their drives let them, (T, n) [rad/s]."""
    limit = np.where(model.unlimited_speed, np.inf, model.limits.velocity)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.quantile(np.abs(speed), _QUANTILE, axis=0) / np.where(limit > 0, limit, np.inf)
    j = int(np.argmax(part))
    if not part[j] > _FASTER:
        return ""
    return (
        f"time: joint {j + 1} would move at {part[j]:.2g} times the largest speed of its drive: "
        "does the clock run slower than time (`factor: 2` under `time:` of one at half), or are "
        "clock, units and limit right?"
    )


def _seconds_by_torque(
    position: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    model: RobotModel,
) -> float:
    """Return the seconds that pass in one of the log, by torques (T, n) and motion (T, n)."""
    size = (torque**2).sum(axis=0)
    moving = torque.std(axis=0) > _LEAST * np.abs(torque).max(axis=0, initial=0.0)
    moving &= _reversals(speed) >= _SWINGS  # a slow drift of a few poses fits any clock
    if not moving.any():
        return 1.0
    weight = _regressors(position, 0 * speed, 0 * acceleration, model)
    inertia = _regressors(position, speed, acceleration, model) - weight
    usual_speed = np.maximum(speed.std(axis=0), 1e-12)
    own = np.stack(
        [acceleration, speed, np.tanh(speed / (_SLOW * usual_speed)), np.ones_like(speed)], axis=2
    )
    joints = np.flatnonzero(moving).tolist()
    noise = {
        j: max(_left(np.hstack([inertia[:, j] + weight[:, j], own[:, j]]), torque[:, j]), floor)
        for j, floor in ((j, _LEAST**2 * float(size[j])) for j in joints)
    }

    def left(gravity: float, inertial: float = 1.0) -> float:
        T, n, width = inertia.shape
        A = np.zeros((len(joints), T, width + 4 * n))
        b = np.empty((len(joints), T))
        for k, j in enumerate(joints):
            A[k, :, :width] = inertial * inertia[:, j] + gravity * weight[:, j]
            A[k, :, width + 4 * j : width + 4 * (j + 1)] = own[:, j] * [inertial, 1, 1, 1]
            scale = np.sqrt(T / noise[j])
            A[k], b[k] = A[k] * scale, torque[:, j] * scale
        return _left(A.reshape(-1, A.shape[2]), b.ravel())

    best = min(_SPEEDS, key=lambda seconds: left(seconds**2))
    known = min(left(1.0), left(1.0, inertial=0.0))  # without inertia, any clock fits
    is_noise = known < _ROUNDING * len(joints) * len(torque)
    return best if left(best**2) < _BETTER * known and not is_noise else 1.0


def _reversals(speed: FloatArray) -> NDArray[np.intp]:
    """Return how often each joint turned back, (n,)."""
    fast = np.abs(speed) > _SLOW * speed.std(axis=0)
    signs = [np.sign(own[known]) for own, known in zip(speed.T, fast.T, strict=True)]
    return np.array([np.count_nonzero(np.diff(sign)) for sign in signs])


def _regressors(
    position: FloatArray, speed: FloatArray, acceleration: FloatArray, model: RobotModel
) -> FloatArray:
    """Return the torque that one unit of each inertial parameter makes, (T, n, 10 m)."""
    tree, linkage = model.pin_tree, model.linkage
    data = tree.createData()
    motion = (linkage.positions(position), linkage.rates(speed), linkage.rates(acceleration))
    every = zip(*motion, strict=True)
    found = [np.array(pin.computeJointTorqueRegressor(tree, data, *row)) for row in every]
    links = np.stack(found).reshape(len(found), linkage.links, -1)  # of one link it is flat
    return np.moveaxis(linkage.torques(np.moveaxis(links, 2, 1)), 2, 1)


def _left(A: FloatArray, b: FloatArray) -> float:
    """Return the sum of squares that a fit leaves."""
    scaled = A / np.maximum(np.abs(A).max(axis=0), 1e-12)
    x = np.linalg.lstsq(scaled, b, rcond=1e-9)[0]
    rest = b - scaled @ x
    return float(rest @ rest)
