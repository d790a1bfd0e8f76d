"""Limits of servos: felt where they are reached and nowhere else, so that fits begin near one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.constants import gain_of, value_in, with_values
from estimators.diagnosis.from_motion.fitting.starts import away
from estimators.diagnosis.from_motion.simulation.one_joint import lag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray

LIMITS: Final = ("speed", "acceleration", "torque_limit")
_SHARES: Final = (0.3, 0.5, 0.7, 0.9)  # of what was done at most, or of a known limit, tried as one
_LIFTED: Final = (1.0, 1.3, 1.7)  # times the most load that was moved, tried as a torque limit
_QUICKER: Final = (1.0, 1.3, 1.8, 2.5)  # times the acceleration of a joint, tried as its profile's
_LIGHTER: Final = (1.0, 0.2)  # times the inertia, which mimics a profile, tried beside one
_FREE: Final = (1.0, 1.3, 1.8)  # times the fastest motion, tried as a speed without load
_RARE: Final = 0.995  # quantile of what it did, taken for the most


@dataclass(frozen=True)
class LimitStart:
    """Where the fit of a limit begins, and how far the joint is from the recorded one there."""

    values: Mapping[str, float]
    away: float  # [rad], in the mean
    bent: Mapping[str, float] = field(default_factory=dict)  # others, which a fit without it bends


def begun_at(
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
        limits += [times * _most_load(parts) for times in _LIFTED]
    if limit == "acceleration":
        limits += [times * most for times in _QUICKER]
    if np.isfinite(known := value_in(row, limit)):
        limits += [share * known for share in _SHARES]
    tried = [{limit: x} for x in limits if x > 0.0]
    if limit != "acceleration":
        return _nearest(parts, row, tried)
    weights = [{"inertia": share * value_in(row, "inertia")} for share in _LIGHTER]
    found = [replace(_nearest(parts, with_values(row, own), tried), bent=own) for own in weights]
    return min(found, key=lambda own: own.away)


def motor_begun_at(parts: Sequence[LoadedJoint], row: FloatArray) -> LimitStart:
    """Return stall torque and speed without load to start a fit of a motor from.

    Args:
        parts: Recorded stretches.
        row: The constants without it.
    """
    limit = value_in(row, "torque_limit")
    shares = [share * most_of("torque_limit", parts, row) for share in _SHARES]
    stalls = [limit] if np.isfinite(limit) else [*shares, 2.0 * _most_load(parts)]
    fastest = most_of("speed", parts, row)
    pairs = [(x, y * fastest) for x in stalls for y in _FREE]
    tried = [{"stall": x, "free_speed": y} for x, y in pairs if min(x, y) > 0.0]
    return _nearest(parts, row, tried)


def _nearest(
    parts: Sequence[LoadedJoint], row: FloatArray, tried: Sequence[Mapping[str, float]]
) -> LimitStart:
    found = [LimitStart(one, away(parts, with_values(row, one))) for one in tried]
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
        return value_in(row, gain_of(row)) * float(np.quantile(np.concatenate(error), _RARE))
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
