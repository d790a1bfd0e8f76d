"""Signs and zeros of recorded joints against those of the robot's description: gravity tells.

A servo of finite gain lags its command by load over gain. Only where positions are counted as in
the description does the gravity of its masses explain that lag with a gain above zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import nnls

from estimators.diagnosis.wording import likelier
from estimators.drives.simulation.free_run import commands_of
from limo_driver.recordings.bandwidth import bandwidth_for

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_ROWS: Final = 6000  # that are compared, at most
_MOVING: Final = 0.05  # [rad/s], from which on friction has the sign of the motion
_INDEPENDENT: Final = 2.0  # errors in a second
_MOST_SIGNS: Final = 5  # joints that gravity loads, of which all signs are tried
_DESCRIBED: Final = np.log(100.0)  # prior odds of the description against each other convention
_SURELY: Final = 10.0  # natural logarithm of odds; friction that holds a joint mimics some gravity
_TURNS: Final = (np.pi / 2, -np.pi / 2, np.pi)  # [rad], zeros of other conventions


@dataclass(frozen=True)
class Convention:
    """How recorded positions are counted: link position = sign * position + zero."""

    sign: tuple[int, ...]  # of each joint
    zero: tuple[float, ...]  # of each joint [rad]

    def linked(self, position: FloatArray) -> FloatArray:
        """Return positions as the description counts them, (T, n) [rad]."""
        return position * np.array(self.sign) + np.array(self.zero)


@dataclass(frozen=True)
class Conventions:
    """The convention that gravity speaks for, and how surely."""

    best: Convention
    joints: tuple[int, ...]  # 1-based, those that gravity can tell
    log_odds: float  # of the best against the next one, natural logarithm
    as_described: bool  # whether the best counts as the description does

    def sentence(self) -> str:
        """Say it in one sentence."""
        if not self.joints:
            return "Gravity loads no joint enough to tell signs and zeros of the joints."
        named = ", ".join(map(str, self.joints))
        sure = f"{likelier(max(self.log_odds, 0.0))} than the next ones tried"
        if self.as_described:
            return f"Signs and zeros of joints {named} are those of the description ({sure})."
        changes = [
            f"joint {j}"
            + (" with the other sign" if s < 0 else "")
            + (f" with its zero {z:+.2f} rad elsewhere" if z else "")
            for j, s, z in zip(range(1, 99), self.best.sign, self.best.zero, strict=False)
            if s < 0 or z
        ]
        if self.log_odds > _SURELY:
            return f"By gravity, positions are counted otherwise: {'; '.join(changes)} ({sure})."
        return (
            "Gravity does not decide how positions are counted; as well as the description fits "
            f"{'; '.join(changes)} ({sure})."
        )


@dataclass(frozen=True)
class _Rows:
    """Moving rows of all recordings."""

    position: FloatArray  # (K, n) [rad]
    velocity: FloatArray  # (K, n) [rad/s]
    error: FloatArray  # (K, n) command minus position [rad]


def conventions_of(
    body: RobotModel, recordings: Sequence[Recording], delay: float = 0.02
) -> Conventions:
    """Compare signs and zeros by how well gravity explains the lag of each servo.

    Args:
        body: With the masses that are known.
        recordings: With commands.
        delay: Of the drives [s].

    Returns:
        The best of all signs of loaded joints, with at most one joint's zero a quarter or half a
        turn elsewhere.
    """
    rows = _rows(recordings, delay)
    load = np.abs(body.gravity_torque(rows.position)).max(axis=0)
    loaded = np.flatnonzero(load > 0.05 * load.max())[:_MOST_SIGNS] if load.max() > 0 else []
    joints = [int(j) for j in loaded if np.any(np.abs(rows.velocity[:, j]) > _MOVING)]
    described = Convention((1,) * body.n, (0.0,) * body.n)
    if not joints:
        return Conventions(described, (), 0.0, as_described=True)
    independent = _INDEPENDENT * sum(recording.duration for recording in recordings)
    scores = {
        convention: _score(body, rows, convention, joints, independent)
        for convention in _conventions(body.n, joints)
    }
    scores[described] += float(_DESCRIBED)
    ranked = sorted(scores, key=lambda item: -scores[item])
    odds = scores[ranked[0]] - scores[ranked[1]]
    told = tuple(j + 1 for j in joints)
    return Conventions(ranked[0], told, odds, as_described=ranked[0] == described)


def likeliest_order(
    body: RobotModel, recordings: Sequence[Recording], delay: float = 0.02
) -> tuple[int, ...]:
    """Return the column of each joint that gravity speaks for, with two exchanged at most.

    Args:
        body: With the masses that are known.
        recordings: With commands.
        delay: Of the drives [s].

    Returns:
        Column of each joint, 0-based, (n,).
    """
    rows = _rows(recordings, delay)
    described = Convention((1,) * body.n, (0.0,) * body.n)
    independent = _INDEPENDENT * sum(recording.duration for recording in recordings)
    scores = dict[tuple[int, ...], float]()
    for j, k in [(0, 0), *combinations(range(body.n), 2)]:
        order = list(range(body.n))
        order[j], order[k] = k, j
        own = _Rows(rows.position[:, order], rows.velocity[:, order], rows.error[:, order])
        moving = [m for m in order if np.any(np.abs(own.velocity[:, m]) > _MOVING)]
        scores[tuple(order)] = _score(body, own, described, moving, independent)
    return max(scores, key=lambda order: scores[order])


def _conventions(n: int, joints: Sequence[int]) -> Iterator[Convention]:
    nowhere = (0.0,) * n
    for signs in product((1, -1), repeat=len(joints)):
        sign = [1] * n
        for j, own in zip(joints, signs, strict=True):
            sign[j] = own
        yield Convention(tuple(sign), nowhere)
        for j in joints:
            for turn in _TURNS:
                yield Convention(tuple(sign), (*nowhere[:j], turn, *nowhere[j + 1 :]))


def _score(
    body: RobotModel,
    rows: _Rows,
    convention: Convention,
    joints: Sequence[int],
    independent: float,
) -> float:
    """Return the log likelihood of a convention, up to a constant."""
    load = body.gravity_torque(convention.linked(rows.position)) * np.array(convention.sign)
    total = 0.0
    for j in joints:
        moving = np.abs(rows.velocity[:, j]) > _MOVING
        pace, error = rows.velocity[moving, j], rows.error[moving, j]
        columns = np.stack([load[moving, j], np.sign(pace), pace], axis=1)
        _, left = nnls(columns, error)
        share = float(moving.mean()) * independent
        total -= share * float(np.log(max(left, 1e-12) / np.sqrt(error.size)))
    return total


def _rows(recordings: Sequence[Recording], delay: float) -> _Rows:
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for recording in recordings:
        motion = recording.motion(bandwidth_for([recording]))
        since = recording.time - delay
        at = np.maximum(np.searchsorted(recording.time, since, side="right") - 1, 0)
        error = commands_of(recording)[at] - motion.position
        parts.append((motion.position, motion.velocity, error))
    position, velocity, error = (np.concatenate(x) for x in zip(*parts, strict=True))
    moving = np.flatnonzero((np.abs(velocity) > _MOVING).any(axis=1))
    every = moving[:: max(1, moving.size // _ROWS)] if moving.size else np.arange(1)
    return _Rows(position[every], velocity[every], error[every])
