"""Mistakes that a log can hold about a whole joint, such as a wrong sign, and how to undo each.

Columns in the wrong order, signs, units and zeros of another convention are no missing physics, but
a search for physics would name some.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.optimize import nnls

from estimators.diagnosis.settings import FEW, MOST, TINY
from estimators.diagnosis.settings.residuals import MISTAKES
from limo_driver.model.units import unit_of
from limo_driver.types import BoolArray, FloatArray, Motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model import RobotModel

ANGLES = np.linspace(-np.pi, np.pi, MISTAKES.angles, endpoint=False)  # [rad]
_DEGREES = float(np.rad2deg(1.0))


@dataclass(frozen=True)
class RowSample:
    """Some rows of all recordings, perhaps with a mistake undone: K rows of n joints."""

    body: RobotModel
    motion: Motion
    torque: FloatArray  # (K, n) less springs, rotors and what else is known beside friction [N m]
    moving: BoolArray  # (K, n)
    constant: tuple[int, ...] = ()  # joints (0-based) whose encoder gives one value throughout

    @classmethod
    def of(cls, observed: Observations) -> RowSample:
        """Thin the slow rows."""
        rows = slice(None, None, max(1, len(observed.slow) // MISTAKES.rows))
        body = observed.simulation.body
        return cls(
            body,
            observed.slow[rows],
            (observed.measured - observed.beyond_load)[rows],
            observed.moving[rows],
            constant_joints(observed),
        )

    @cached_property
    def load(self) -> FloatArray:
        """Nominal rigid-body torque, (K, n) [N m]."""
        motion = self.motion
        return self.body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)

    @cached_property
    def judged(self) -> BoolArray:
        """Mark the joints that move on enough rows to be judged, (n,)."""
        return self.moving.sum(axis=0) >= MISTAKES.least_moving

    @cached_property
    def misfit(self) -> FloatArray:
        """Part of each joint's torque that neither load nor any friction explains, (n,).

        RMS over RMS, without the means. Joints that are not judged count as fitting.
        """
        result = np.zeros(self.torque.shape[1])
        for joint in np.flatnonzero(self.judged).tolist():
            torque = self.torque[self.moving[:, joint], joint]
            size = float(np.linalg.norm(torque - torque.mean()))
            result[joint] = float(np.linalg.norm(self.rest(joint))) / max(size, TINY)
        return result

    def rest(self, joint: int) -> FloatArray:
        """Return a joint's torque beyond load and friction on its moving rows [N m].

        Friction is fitted, since it is known less well than the body, but it cannot drive.
        """
        use = self.moving[:, joint]
        v = self.motion.velocity[use, joint]
        left = self.torque[use, joint] - self.load[use, joint]
        friction = dry_and_viscous(v)
        friction -= friction.mean(axis=0)
        left -= left.mean()
        size, _ = nnls(friction, left)
        return left - friction @ size

    @cached_property
    def friction(self) -> FloatArray:
        """Friction that fits best beside the load, (K, n) [N m]; zero where a joint rests."""
        result = np.zeros_like(self.torque)
        for joint in np.flatnonzero(self.moving.any(axis=0)).tolist():
            use = self.moving[:, joint]
            friction = dry_and_viscous(self.motion.velocity[use, joint])
            size, _ = nnls(friction, self.torque[use, joint] - self.load[use, joint])
            result[use, joint] = friction @ size
        return result

    def thinned(self, most: int) -> RowSample:
        """Return at most so many of the rows."""
        rows = slice(None, None, -(-len(self.torque) // most))
        return replace(
            self, motion=self.motion[rows], torque=self.torque[rows], moving=self.moving[rows]
        )

    def at(self, position: FloatArray) -> RowSample:
        """Return the sample at other positions (K, n) [rad], as fast as before."""
        return replace(self, motion=replace(self.motion, position=position))

    def positions(self, matrix: FloatArray, turn: FloatArray | float = 0.0) -> RowSample:
        """Return the sample with positions q → q Aᵀ + turn; A is (n, n), turn (n,) [rad]."""
        motion = self.motion
        moved = Motion(
            motion.time,
            motion.position @ matrix.T + turn,
            motion.velocity @ matrix.T,
            motion.acceleration @ matrix.T,
        )
        moving = (self.moving.astype(float) @ np.abs(np.sign(matrix)).T) > 0
        return replace(self, motion=moved, moving=moving)

    def torques(self, matrix: FloatArray) -> RowSample:
        """Return the sample with torques τ → τ Aᵀ; A is (n, n)."""
        return replace(self, torque=self.torque @ matrix.T)


def constant_joints(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) of which the encoder gives one value in each recording."""
    varies = np.any([np.ptp(item.position, axis=0) for item in observed.recordings], axis=0)
    return tuple(np.flatnonzero(~varies).tolist())


def dry_and_viscous(v: FloatArray) -> FloatArray:
    """Return what friction of either kind is in proportion to, (K, 2), at speeds (K,) [rad/s]."""
    return np.stack([np.sign(v), v / max(float(np.abs(v).max()), TINY)], axis=1)


def without_friction(values: FloatArray, v: FloatArray) -> FloatArray:
    """Return what a constant and friction leave of values (K, ...), at speeds (K,) [rad/s]."""
    columns = np.column_stack([np.ones(v.size), dry_and_viscous(v)])
    return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]


Undo: TypeAlias = Callable[[RowSample], RowSample]


@dataclass(frozen=True)
class Mistake:
    """Mistake in a log, in words, and the function that undoes it."""

    message: str
    undo: Undo
    is_of_data: bool = True  # not of how the arm is mounted, which is physics
    is_of_all: bool = False  # made at each joint or at none
    kind: str = ""  # in a word or two


def mistakes(sliding: Sequence[bool]) -> Iterator[Mistake]:
    """Yield what can be wrong with the log of joints that turn or slide, the more usual first."""
    n = len(sliding)
    one = np.eye(n)
    yield Mistake(
        "all torques have the other sign than expected, which is positive along the axis",
        lambda sample: sample.torques(-one),
        is_of_all=True,
        kind="sign",
    )
    for j in range(n):
        yield from _of_joint(j, n, turns=not sliding[j])
    for i, j in combinations(range(n), 2):
        exchange = one[[j if k == i else i if k == j else k for k in range(n)]]
        yield Mistake(
            f"torque_{i + 1} belongs to joint {j + 1} and torque_{j + 1} to joint {i + 1}",
            _torques(exchange),
            kind="exchanged-joints",
        )
        yield Mistake(
            f"position_{i + 1} belongs to joint {j + 1} and position_{j + 1} to joint {i + 1}",
            _positions(exchange),
            kind="exchanged-joints",
        )
    yield Mistake(
        "gravity is taken out of the torques, expected all that is measured",
        _weighed,
        is_of_all=True,
        kind="no-gravity",
    )
    yield Mistake(
        "the positions of all joints are 57.3 times too small, as if converted from degrees twice",
        _positions(np.diag(np.where(sliding, 1.0, _DEGREES))),
        is_of_all=True,
        kind="unit",
    )
    for axis in range(3):
        for sign in (1.0, -1.0):
            along = sign * np.eye(3)[axis]
            yield Mistake(
                mounted_otherwise(along),
                _gravity(along),
                is_of_data=False,
                kind="mounting",
            )


def _of_joint(j: int, n: int, *, turns: bool) -> Iterator[Mistake]:
    one, own = np.eye(n), np.eye(n)[j]
    turned = one - 2 * np.diag(own)
    yield Mistake(
        f"torque_{j + 1} has the other sign than expected, which is positive along the axis",
        _torques(turned),
        kind="sign",
    )
    yield Mistake(
        f"position_{j + 1} has the other sign than the axis of joint {j + 1}",
        _positions(turned),
        kind="sign",
    )
    yield Mistake(
        f"position_{j + 1} and torque_{j + 1} have the other sign than the axis of joint {j + 1}",
        lambda sample: sample.torques(turned).positions(turned),
        kind="sign",
    )
    if not turns:
        return
    yield Mistake(
        f"position_{j + 1} is 57.3 times too small, as if converted from degrees twice",
        _positions(one + (_DEGREES - 1) * np.diag(own)),
        kind="unit",
    )
    for degrees in (90, -90, 180):
        yield Mistake(
            f"the zero of position_{j + 1} is {abs(degrees)}° away from that of the model",
            _positions(one, np.deg2rad(degrees) * own),
            kind="zero",
        )


def stuck(sample: RowSample) -> Iterator[Mistake]:
    """Yield encoders that may be stuck: those that give one value throughout.

    A joint that stands still may do so, too; but then the torques fit as they are.
    """
    for j in sample.constant:
        value = float(sample.motion.position[0, j])
        yield Mistake(
            f"position_{j + 1} is {value:.4g} {unit_of('rad', sample.body.sliding, j)} in all "
            f"rows although the torques are those of an arm whose joint {j + 1} moves, "
            "as if its encoder were stuck",
            partial(_turning, j),
        )


def _turning(j: int, sample: RowSample) -> RowSample:
    """Turn a joint in each row to where the torques of all others fit best."""
    sample = sample.thinned(MISTAKES.rows_to_turn)
    own, n = sample.motion, sample.torque.shape[1]
    position = np.repeat(own.position[None], ANGLES.size, axis=0)  # (angles, K, n)
    position[:, :, j] = ANGLES[:, None]
    motion = (
        position,
        *(np.broadcast_to(x, position.shape) for x in (own.velocity, own.acceleration)),
    )
    load = sample.body.inverse_dynamics(*(x.reshape(-1, n) for x in motion)).reshape(position.shape)
    weight = (np.arange(n) != j) / np.maximum(sample.torque.std(axis=0), TINY)
    for _ in range(FEW):  # of friction and angles
        error = weight * (load - (sample.torque - sample.friction))
        best = np.argmin(np.sum(error**2, axis=2), axis=0)
        sample = sample.at(position[best, np.arange(best.size)])
    return sample


def _torques(matrix: FloatArray) -> Undo:
    return lambda sample: sample.torques(matrix)


def _positions(matrix: FloatArray, turn: FloatArray | float = 0.0) -> Undo:
    return lambda sample: sample.positions(matrix, turn)


def _weighed(sample: RowSample) -> RowSample:
    """Put gravity back, unless what was recorded is lost in it: then it fits all by itself."""
    still = np.zeros_like(sample.torque)
    gravity = sample.body.inverse_dynamics(sample.motion.position, still, still)
    weighed = replace(sample, torque=sample.torque + gravity)
    left, recorded = weighed.misfit * weighed.torque.std(axis=0), sample.torque.std(axis=0)
    return weighed if np.linalg.norm(left) < MOST * np.linalg.norm(recorded) else sample


def mounted_otherwise(gravity: FloatArray) -> str:
    """Say along which direction of the base gravity (3,) acts, where a description has another."""
    unit = gravity / np.linalg.norm(gravity)
    axis = int(np.argmax(np.abs(unit)))
    is_along = np.count_nonzero(unit) == 1
    sign = "+" if unit[axis] > 0 else "-"
    along = f"{sign}{'xyz'[axis]}" if is_along else f"({', '.join(f'{x:.2g}' for x in unit)})"
    return (
        f"gravity acts along {along} of the base, so the arm is mounted otherwise than its "
        "description says"
    )


def _gravity(direction: FloatArray) -> Undo:
    def undo(sample: RowSample) -> RowSample:
        size = float(np.linalg.norm(sample.body.gravity))
        return replace(sample, body=sample.body.with_gravity((size * direction).tolist()))

    return undo
