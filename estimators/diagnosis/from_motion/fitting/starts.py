"""Where fits start, and within which limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.optimize import nnls

from estimators.diagnosis.from_motion.fitting.joint import errors
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint, lag
from limo_driver.types import FloatArray

_USUAL: Final = {c.COULOMB: 0.2, "delay": 0.02, "inertia": 0.03}
TYPICAL: Final = {  # by gain: of servos of position, of velocity, and of no servo
    "kp": {"kp": 15.0, c.DAMPING: 1.0, **_USUAL},
    "kv": {"kv": 3.0, c.DAMPING: 0.3, **_USUAL},
    "gain": {"gain": 1.0, c.DAMPING: 0.1, **_USUAL},
}
# A lag is a delay or damping over gain: what a fit finds depends on which of them it begins with.
# With a servo of velocity, it is inertia over gain, and damping over gain is how much is lacking.
LAGS: Final = {
    "kp": ({"delay": 0.004, c.DAMPING: 1.0 / 15.0}, {"delay": 0.04, c.DAMPING: 0.4 / 15.0}),
    "kv": ({"delay": 0.004, "inertia": 0.02}, {"delay": 0.04, "inertia": 0.005}),
    "gain": ({"delay": 0.002}, {"delay": 0.02}),
}
DELAYS: Final = (0.0, 0.02, 0.06)  # [s], tried
MOVING: Final = 0.05  # [rad/s], from which on friction has the sign of the motion
_ENOUGH: Final = 50  # moving rows
_LEAST_GAIN: Final = 1e-3  # [N m/rad]
_NONE_AT_FIRST: Final = ("kd", "stribeck", "by_load", "offset", "dead_band", "play")
_LOST: Final = 10.0  # [rad], of a joint that constants tried make unstable
LIMITS: Final = ("speed", "acceleration", "torque_limit")
_SHARES: Final = (0.3, 0.5, 0.7, 0.9)  # of what was done at most, or of a known limit, tried as one
_MORE: Final = (1.0, 1.3, 1.8, 2.5)  # times what was seen at most, tried as a limit
_LIGHTER: Final = (1.0, 0.2)  # times the inertia, which mimics a profile, tried beside one
_RARE: Final = 0.995  # quantile of what it did, taken for the most


def typical_start(row: FloatArray) -> FloatArray:
    """Return constants to start from: a hobby servo's, with the limits that were stated.

    Args:
        row: The stated constants of a joint.
    """
    none = dict.fromkeys(_NONE_AT_FIRST, 0.0)
    return c.with_values(row, {**none, **TYPICAL[c.gain_of(row)], "speed": np.inf})


def with_gain(row: FloatArray, gain: float) -> FloatArray:
    """Return constants to start from with another gain.

    Gain, damping, dry friction and inertia times one factor move a joint alike where nothing but
    the drive acts on it: so all of them are scaled.

    Args:
        row: The constants of a joint.
        gain: Another one [N m/rad], of velocity [N m s/rad], or of torque.
    """
    own = c.gain_of(row)
    factor = gain / c.value_in(row, own)
    scaled = {
        name: factor * c.value_in(row, name) for name in (own, c.DAMPING, c.COULOMB, "inertia")
    }
    return c.with_values(row, scaled)


def with_lag(row: FloatArray, lag: dict[str, float]) -> FloatArray:
    """Return constants to start from with one of `LAGS`.

    Args:
        row: The constants of a joint.
        lag: Delay [s], and damping or inertia over gain [s].
    """
    gain = c.value_in(row, c.gain_of(row))
    own = {name: part * gain for name, part in lag.items() if name != "delay"}
    return c.with_values(row, {"delay": lag["delay"], **own})


def choose_start(parts: Sequence[LoadedJoint], row: FloatArray) -> FloatArray:
    """Return constants to start from: typical ones, or those of the joint's own motion.

    A servo far from typical, of a tenth of the torque or of ten times as much, is lost from a
    typical start: the joint does not move there, or follows at once, and slopes say nothing.

    Args:
        parts: Recorded stretches of a joint that gravity loads.
        row: Typical constants.

    Returns:
        Those that, simulated forward, stay nearer to the recorded joint.
    """
    gain = _gain(parts, row)
    if gain is None:
        return row
    other = with_gain(row, gain)
    return other if mean_distance(parts, other) < mean_distance(parts, row) else row


def mean_distance(parts: Sequence[LoadedJoint], row: FloatArray) -> float:
    """Return how far a simulated joint is from the recorded one in the mean [rad].

    Args:
        parts: Recorded stretches.
        row: The constants of the joint.
    """
    error = np.nan_to_num(errors(parts, row), nan=_LOST).clip(-_LOST, _LOST)
    return float(np.abs(error).mean())


def _gain(parts: Sequence[LoadedJoint], row: FloatArray) -> float | None:
    """Return the gain by which the lag of moving rows explains their load best."""
    found = [regressed(parts, row, delay) for delay in DELAYS]
    left, gain = min(found)
    return gain if np.isfinite(left) and gain > _LEAST_GAIN else None


def regressed(parts: Sequence[LoadedJoint], row: FloatArray, delay: float) -> tuple[float, float]:
    """Return what is left of the load of moving rows, and the gain, of a drive of some delay.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint; they say what its drive acts on.
        delay: From a command to its effect [s]; below 0, of a command that is recorded too late.

    Returns:
        Norm of the torque that gain, friction and inertia do not explain [N m], infinite where too
        few rows move; and the gain.
    """
    columns, loads = list[FloatArray](), list[FloatArray]()
    for part in parts:
        at = np.maximum(np.searchsorted(part.time, part.time - delay, side="right") - 1, 0)
        moving = np.abs(part.velocity) > MOVING
        pace = part.velocity[moving]
        change = np.gradient(part.velocity, part.time)[moving]
        late = replace(part, command=part.command[at])
        error, one = lag(late, row)[moving], np.ones_like(pace)
        columns.append(np.stack([error, -pace, -np.sign(pace), -change, one, -one], axis=1))
        loads.append((part.load + part.inertia * np.gradient(part.velocity, part.time))[moving])
    load = np.concatenate(loads)
    if load.size < _ENOUGH:
        return np.inf, 0.0
    gains, left = nnls(np.concatenate(columns), load)
    return float(left), float(gains[0])


@dataclass(frozen=True)
class LimitStart:
    """Where the fit of a limit begins, and how far the joint is from the recorded one there."""

    values: Mapping[str, float]
    away: float  # [rad], in the mean
    bent: Mapping[str, float] = field(default_factory=dict)  # others, which a fit without it bends


def start_of_limit(
    limit: str,
    parts: Sequence[LoadedJoint],
    row: FloatArray,
) -> LimitStart:
    """Return the limit to start a fit from: of those tried, the one that comes nearest.

    Args:
        limit: One of `LIMITS`.
        parts: Recorded stretches.
        row: The constants without it.
    """
    most = most_of(limit, parts, row)
    limits = [share * most for share in _SHARES]
    if limit == "torque_limit":
        limits += [times * _most_load(parts) for times in _MORE]
    if limit == "acceleration":
        limits += [times * most for times in _MORE]
    if np.isfinite(known := c.value_in(row, limit)):
        limits += [share * known for share in _SHARES]
    tried = [{limit: x} for x in limits if x > 0.0]
    if limit != "acceleration":
        return _nearest(parts, row, tried)
    weights = [{"inertia": share * c.value_in(row, "inertia")} for share in _LIGHTER]
    found = [replace(_nearest(parts, c.with_values(row, own), tried), bent=own) for own in weights]
    return min(found, key=lambda own: own.away)


def start_of_motor(parts: Sequence[LoadedJoint], row: FloatArray) -> LimitStart:
    """Return stall torque and speed without load to start a fit of a motor from.

    Args:
        parts: Recorded stretches.
        row: The constants without it.
    """
    limit = c.value_in(row, "torque_limit")
    shares = [share * most_of("torque_limit", parts, row) for share in _SHARES]
    stalls = [limit] if np.isfinite(limit) else [*shares, 2.0 * _most_load(parts)]
    fastest = most_of("speed", parts, row)
    pairs = [(x, y * fastest) for x in stalls for y in _MORE]
    tried = [{"stall": x, "free_speed": y} for x, y in pairs if min(x, y) > 0.0]
    return _nearest(parts, row, tried)


def _nearest(
    parts: Sequence[LoadedJoint], row: FloatArray, tried: Sequence[Mapping[str, float]]
) -> LimitStart:
    found = [LimitStart(one, mean_distance(parts, c.with_values(row, one))) for one in tried]
    return min(found, key=lambda own: own.away, default=LimitStart({}, np.inf))


def most_of(name: str, parts: Sequence[LoadedJoint], row: FloatArray) -> float:
    """Return the most of what a limit limits, along recorded motion.

    Args:
        name: The limit: of torque [N m], speed [rad/s] or acceleration [rad/s²].
        parts: Recorded stretches.
        row: The constants without it.
    """
    if name == "torque_limit":
        error = [np.abs(lag(part, row)) for part in parts]
        return c.value_in(row, c.gain_of(row)) * float(np.quantile(np.concatenate(error), _RARE))
    pace = [part.velocity for part in parts]
    if name == "acceleration":
        pace = [np.gradient(part.velocity, part.time) for part in parts]
    return float(np.quantile(np.abs(np.concatenate(pace)), _RARE))


def _most_load(parts: Sequence[LoadedJoint]) -> float:
    """Return the most torque of the rigid body along recorded motion [N m]."""
    load = [
        np.abs(part.load + part.inertia * np.gradient(part.velocity, part.time)) for part in parts
    ]
    return float(np.quantile(np.concatenate(load), _RARE))
