"""How joints count: signs and zeros, stated or found.

Signs and zeros of recorded joints against those of the robot's description: gravity tells.

A servo of finite gain lags its command by load over gain. Only where positions are counted as in
the description does the gravity of its masses explain that lag with a gain above zero.

Stated zeros of encoders: taken off recordings, so that gravity is that of where links are.

Everything else then counts as the robot's description does, and what is found of zeros adds to
what is stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import nnls

from estimators.diagnosis.from_motion.fitting.identification import gives_scale
from estimators.diagnosis.from_motion.fitting.joint import GLANCE, GLANCED, fit_joint
from estimators.diagnosis.from_motion.fitting.starts import (
    DELAYS,
    MOVING,
    choose_start,
    typical_start,
)
from estimators.diagnosis.from_motion.simulation.constants import LEAST
from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.headline import likelier
from estimators.diagnosis.quantities import of_joints
from estimators.diagnosis.settings import MATTERS, TINY
from estimators.diagnosis.settings.fitting import CANDIDATES, CONTRIBUTION
from estimators.diagnosis.settings.residuals import MISTAKES
from limo_driver.physics import EncoderOffset
from limo_driver.physics.effects.sensing import FARTHEST_ZERO
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.channels import POSITION, VELOCITY, commanded_by

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_INDEPENDENT: Final = 2.0  # errors in a second
_MOST_SIGNS: Final = 5  # joints that gravity loads, of which all signs are tried
_DESCRIBED: Final = np.log(100.0)  # prior odds of a sign or zero as described against another
_TURNS: Final = (np.pi / 2, -np.pi / 2, np.pi)  # [rad], zeros of other conventions


@dataclass(frozen=True)
class Convention:
    """How recorded positions are counted: link position = sign * position + zero."""

    sign: tuple[int, ...]  # of each joint
    zero: tuple[float, ...]  # of each joint [rad]

    @property
    def changes(self) -> int:
        """How many signs and zeros are not those of the description."""
        return sum(s < 0 for s in self.sign) + sum(z != 0.0 for z in self.zero)

    def linked(self, position: FloatArray) -> FloatArray:
        """Return positions as the description counts them, (T, n) [rad]."""
        return position * np.array(self.sign) + np.array(self.zero)


@dataclass(frozen=True)
class Conventions:
    """The convention that gravity speaks for, and how surely."""

    best: Convention
    joints: tuple[int, ...]  # 1-based, those that gravity loads
    odds: tuple[float, ...]  # natural logarithms, of each as described against all else
    log_odds: float  # of the best against the description, or of that against the next one
    as_described: bool  # whether the best counts as the description does
    confirmed: bool = False  # whether joints simulated forward speak for another one, too

    def sentence(self) -> str:
        """Say it in one sentence or two."""
        if not self.joints:
            return "Gravity loads no joint enough to tell signs and zeros of the joints."
        if self.confirmed:
            sure = f"{likelier(max(self.log_odds, 0.0))} than as described"
            return f"By gravity, positions are counted otherwise: {self._changes()} ({sure})."
        determined, open_ = self.determined, [j for j in self.joints if j not in self.determined]
        sentences = list[str]()
        if determined:
            least = min(self.odds[self.joints.index(j)] for j in determined)
            sentences.append(
                f"Signs and zeros of {of_joints(determined)} are those of the description "
                f"({likelier(least)} than others)."
            )
        if open_:
            verb = "are" if len(open_) > 1 else "is"
            sentences.append(f"Gravity does not decide how {of_joints(open_)} {verb} counted.")
        return " ".join(sentences)

    @property
    def determined(self) -> tuple[int, ...]:
        """Joints that surely count as the description does, 1-based."""
        pairs = zip(self.joints, self.odds, strict=True)
        return tuple(j for j, odds in pairs if odds > CONTRIBUTION.tellable)

    def _changes(self) -> str:
        return "; ".join(
            f"joint {j}"
            + (" with the other sign" if s < 0 else "")
            + (f" with its zero {z:+.2f} rad elsewhere" if z else "")
            for j, s, z in zip(range(1, 99), self.best.sign, self.best.zero, strict=False)
            if s < 0 or z
        )


@dataclass(frozen=True)
class _Rows:
    """Moving rows of all recordings."""

    position: FloatArray  # (K, n) [rad]
    velocity: FloatArray  # (K, n) [rad/s]
    error: FloatArray  # (K, n) command minus position [rad]; velocity or nothing of others


def conventions_of(
    body: RobotModel, recordings: Sequence[Recording], delay: float = DELAYS[1]
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
    loaded = np.flatnonzero(gives_scale(load))[:_MOST_SIGNS]
    joints = [int(j) for j in loaded if np.any(np.abs(rows.velocity[:, j]) > MOVING)]
    described = Convention((1,) * body.n, (0.0,) * body.n)
    if not joints:
        return Conventions(described, (), (), 0.0, as_described=True)
    independent = _INDEPENDENT * sum(recording.duration for recording in recordings)
    scores = {
        convention: _score(body, rows, convention, joints, independent)
        for convention in _conventions(body.n, joints)
    }
    scores = {one: score - float(_DESCRIBED) * one.changes for one, score in scores.items()}
    ranked = sorted(scores, key=lambda item: -scores[item])
    odds = scores[ranked[0]] - scores[ranked[1] if ranked[0] == described else described]
    own = tuple(_odds_of(scores, j) for j in joints)
    determined = tuple(j + 1 for j in joints)
    return Conventions(ranked[0], determined, own, odds, as_described=ranked[0] == described)


def confirmed(
    simulation: Simulation, recordings: Sequence[Recording], found: Conventions
) -> Conventions:
    """Return conventions, and whether the likeliest, if another, also predicts motion better.

    What explains the lag of a servo, row by row, may be friction that mimics gravity. So joints are
    fitted and simulated forward both ways.

    Args:
        simulation: With a position servo for each joint.
        recordings: With commands; the first few are simulated.
        found: By the lag alone.
    """
    if found.as_described or found.log_odds < CANDIDATES.missing:
        return found
    chosen, stated = list(recordings[:GLANCED]), rows_of(simulation)
    other = ArmChange(
        tuple(-s * z for s, z in zip(found.best.sign, found.best.zero, strict=True)),
        found.best.sign,
    )
    loads, away = ArmLoads(simulation.body, chosen), np.zeros(2)
    for k, change in enumerate((ArmChange.none(simulation.model.n), other)):
        parts = loads.parts(change)
        for j in (joint - 1 for joint in found.joints):
            begun = choose_start(parts[j], typical_start(stated[j]))
            fit = fit_joint(parts[j], begun, evaluations=GLANCE)
            away[k] += np.log(max(fit.mean_error, LEAST))
    gain = float(away[0] - away[1]) / len(found.joints)
    return replace(found, confirmed=gain > MATTERS)


def _odds_of(scores: Mapping[Convention, float], j: int) -> float:
    """Return how much likelier a joint counts as described than otherwise, all else free."""
    as_described_scores = [
        score for one, score in scores.items() if one.sign[j] > 0 and not one.zero[j]
    ]
    other = [score for one, score in scores.items() if one.sign[j] < 0 or one.zero[j]]
    return max(as_described_scores) - max(other)


def likeliest_order(body: RobotModel, recordings: Sequence[Recording]) -> tuple[int, ...]:
    """Return the column of each joint that gravity speaks for, with two exchanged at most.

    Args:
        body: With the masses that are known.
        recordings: With commands.

    Returns:
        Column of each joint, 0-based, (n,).
    """
    rows = _rows(recordings, DELAYS[1])
    described = Convention((1,) * body.n, (0.0,) * body.n)
    independent = _INDEPENDENT * sum(recording.duration for recording in recordings)
    scores = dict[tuple[int, ...], float]()
    channels = recordings[0].channels
    pairs = [(j, k) for j, k in combinations(range(body.n), 2) if channels[j] == channels[k]]
    for j, k in [(0, 0), *pairs]:
        order = list(range(body.n))
        order[j], order[k] = k, j
        own = _Rows(rows.position[:, order], rows.velocity[:, order], rows.error[:, order])
        moving = [m for m in order if np.any(np.abs(own.velocity[:, m]) > MOVING)]
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
        moving = np.abs(rows.velocity[:, j]) > MOVING
        pace, error = rows.velocity[moving, j], rows.error[moving, j]
        columns = np.stack([load[moving, j], np.sign(pace), pace], axis=1)
        _, left = nnls(columns, error)
        share = float(moving.mean()) * independent
        total -= share * float(np.log(max(left, TINY) / np.sqrt(error.size)))
    return total


def _rows(recordings: Sequence[Recording], delay: float) -> _Rows:
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for recording in recordings:
        motion = recording.motion(bandwidth_for([recording]))
        since = recording.time - delay
        at = np.maximum(np.searchsorted(recording.time, since, side="right") - 1, 0)
        followed = np.where(commanded_by(POSITION, recording.channels), motion.position, 0.0)
        followed += np.where(commanded_by(VELOCITY, recording.channels), motion.velocity, 0.0)
        error = commands_of(recording)[at] - followed
        parts.append((motion.position, motion.velocity, error))
    position, velocity, error = (np.concatenate(x) for x in zip(*parts, strict=True))
    moving = np.flatnonzero((np.abs(velocity) > MOVING).any(axis=1))
    every = moving[:: max(1, moving.size // MISTAKES.rows)] if moving.size else np.arange(1)
    return _Rows(position[every], velocity[every], error[every])


def zeros_of(simulation: Simulation) -> FloatArray:
    """Return what the encoders of a simulation read where links are at zero, (n,) [rad]."""
    zero = np.zeros(simulation.model.n)
    for effect in simulation.effects:
        if isinstance(effect, EncoderOffset):
            zero[effect.joint - 1] += effect.offset
    return zero


def without_zeros(simulation: Simulation) -> Simulation:
    """Return the same with encoders that read where the links are."""
    kept = tuple(one for one in simulation.effects if not isinstance(one, EncoderOffset))
    return replace(simulation, effects=kept)


def with_zeros(simulation: Simulation, zero: FloatArray) -> Simulation:
    """Return the same with zeros (n,) [rad] added to those of its encoders."""
    total = (zeros_of(simulation) + zero).clip(-FARTHEST_ZERO, FARTHEST_ZERO)
    own = [EncoderOffset(joint=j, offset=x) for j, x in enumerate(total.tolist(), start=1) if x]
    bare = without_zeros(simulation)
    return replace(bare, effects=(*bare.effects, *own))


def from_zeros(recording: Recording, zero: FloatArray) -> Recording:
    """Return a recording whose positions, and set-points of these, count from the links' zeros.

    Args:
        recording: With commands.
        zero: Of its encoders, (n,) [rad].
    """
    if not zero.any():
        return recording
    command = commands_of(recording)
    determined = np.where(commanded_by(POSITION, recording.channels), command - zero, command)
    return replace(recording, position=recording.position - zero, command=determined, extras={})


def as_counted(zero: FloatArray, change: ArmChange) -> FloatArray:
    """Return the zeros (n,) [rad] of encoders whose recordings `as_described` has changed.

    Args:
        zero: As they were recorded, (n,) [rad].
        change: How the arm that was recorded differs.
    """
    return zero[list(change.order or range(zero.size))] * np.array(change.sign)
