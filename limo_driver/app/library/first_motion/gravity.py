"""What torques at rest say of an arm: is it the one described, mounted so, with this tool?

At rest a torque sensor shows gravity alone. Where it shows something else, each usual mistake is
undone in turn: joints exchanged, a turned base, a sensor with an offset, another tool, signs, zeros
and units. What then fits within the tolerance, with the fewest numbers to fit, is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_torque.residuals.mistakes import (
    RowSample,
    mistakes,
    mounted_otherwise,
)
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.runtime.display import shortened
from limo_driver.types import FloatArray, Motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.robot.registry import Examination

NO_TORQUE: Final = "no-torque"  # kind of a cause
TOLERANCE: Final = 0.02  # of a joint's torque limit, of sensors and of dry friction at rest
_FLOOR: Final = 0.05  # of the tolerance, below which no fit is better than another
_DECISIVE: Final = 6.0  # by which the score of one cause has to be better than another's
_MOST_LEFT: Final = 0.1  # of the RMS, by a cause that leaves more than the tolerance somewhere
_SEEN: Final = 2.0  # tolerances that a mistake has to make, to be noticed among errors of sensors
_NONE: Final = 0.1  # of the tolerance, up to which a torque may be none at all
_SIZE: Final = 1.1  # factor by which a gravity that is fitted may differ in size
_LEAST_TURN: Final = 2.0  # [°]
_HEAVIEST: Final = 1e3  # [kg], tool that anybody would look for


@dataclass(frozen=True)
class StillPose:
    """A pose in which the arm was at rest."""

    position: FloatArray  # (n,) [rad]
    torque: FloatArray  # (n,) [N m]


@dataclass(frozen=True)
class GravityCause:
    """One single mistake that explains the torques."""

    kind: str  # a word for programs
    text: str
    worst: float  # that it leaves, in tolerances
    score: float  # smaller is better


@dataclass(frozen=True)
class GravityJudgement:
    """Torques of K poses at rest against gravity."""

    poses: tuple[StillPose, ...]
    expected: FloatArray  # (K, n) [N m]
    tolerance: FloatArray  # (n,) [N m]
    causes: tuple[GravityCause, ...]  # the best of each kind that explains them; none if they fit
    unseen: tuple[str, ...]  # mistakes that torques in these poses would not have shown,
    unseen_mounting: tuple[str, ...]  # and directions in which gravity could act unnoticed
    lightest: float  # [kg], tool at the flange that they would have shown

    @property
    def rest(self) -> FloatArray:
        """Torque that gravity leaves, (K, n) [N m]."""
        return np.array([pose.torque for pose in self.poses]) - self.expected

    @property
    def fits(self) -> bool:
        """Whether all torques are gravity, within the tolerance."""
        return bool((np.abs(self.rest) <= self.tolerance).all())

    def judge(self, found: Examination, share: float) -> None:
        """Add what the torques say of the arm to an examination; the tolerance is a share."""
        if self.causes:
            text = "; or ".join(cause.text for cause in self.causes)
            found.add(self.causes[0].kind, text)
        elif not self.fits:
            rest = np.abs(self.rest) / self.tolerance
            k, j = np.unravel_index(int(np.argmax(rest)), rest.shape)
            found.add(
                "unexplained",
                f"in pose {k + 1}, joint {j + 1} shows {self.poses[k].torque[j]:.3g} N m where "
                f"gravity makes {self.expected[k, j]:.3g} N m, and no single mistake in "
                "description, mounting, tool or wiring explains all poses",
            )
        else:
            shown = self.lightest < _HEAVIEST
            tool = f"a tool of {self.lightest:.2g} kg more or less" if shown else "no tool at all"
            few = f", and not {shortened(self.unseen, 3)}" if self.unseen else ""
            found.add(
                "gravity",
                f"torques in {len(self.poses)} pose{'s' * (len(self.poses) > 1)} are gravity "
                f"within {share:.0%} of the limits; {tool} would have shown{few}",
                problem=False,
            )


def judge_gravity(
    model: RobotModel, poses: Sequence[StillPose], tolerance: FloatArray
) -> GravityJudgement:
    """Compare torques at rest with gravity, and name the mistake that explains a difference.

    Args:
        model: The arm as it is described, with its tool and mounting.
        poses: In which it was at rest.
        tolerance: Of each joint's torque, (n,) [N m].

    Raises:
        ConfigError: A link of the arm has no mass.
    """
    model.check_masses()
    position, torque = (np.array([getattr(p, x) for p in poses]) for x in ("position", "torque"))
    still = np.zeros_like(position)
    rows = Motion(np.arange(len(position), dtype=float), position, still, still)
    sample = RowSample(model, rows, torque, np.ones(position.shape, dtype=bool))
    judged = GravityJudgement(
        tuple(poses), sample.load, tolerance, (), *_unseen(sample, tolerance), 0.0
    )
    flange = model.last_frames[model.flange][:3, 3]
    heaviest = np.abs(_load(model, position, flange) / tolerance).max()
    judged = replace(judged, lightest=_SEEN / max(float(heaviest), 1e-12))
    return judged if judged.fits else replace(judged, causes=_causes(sample, tolerance))


def _causes(sample: RowSample, tolerance: FloatArray) -> tuple[GravityCause, ...]:
    """Return what explains the torques, the best first, one cause of each kind."""
    expected, rest = sample.load, (sample.torque - sample.load) / tolerance
    if np.abs(sample.torque / tolerance).max() < _NONE:
        most = float(np.abs(expected).max())
        text = (
            f"all torques read zero where gravity makes up to {most:.3g} N m: drives that measure "
            "torque only while they have power, or sensors that are not connected"
        )
        return (GravityCause(NO_TORQUE, text, float(np.abs(rest).max()), -math.inf),)
    size = float(np.sqrt(np.mean(rest**2)))
    found = [
        GravityCause(kind, text, worst, score)
        for kind, text, left, fitted in _candidates(sample, tolerance)
        for worst, rms, score in [_figures(left, fitted)]
        if worst <= 1.0 or rms < _MOST_LEFT * size
    ]
    found.sort(key=lambda cause: cause.score)
    best = {cause.kind: cause for cause in reversed(found)}
    alike = (c for c in best.values() if c.score < found[0].score + _DECISIVE)
    return tuple(sorted(alike, key=lambda cause: cause.score))


def _figures(left: FloatArray, fitted: int) -> tuple[float, float, float]:
    """Return worst and RMS of what a cause leaves, in tolerances, and its score (BIC)."""
    mean = float(np.mean(left**2))
    score = left.size * math.log(mean + _FLOOR**2) + fitted * math.log(left.size)
    return float(np.abs(left).max()), math.sqrt(mean), score


def _candidates(
    sample: RowSample, tolerance: FloatArray
) -> Iterator[tuple[str, str, FloatArray, int]]:
    """Yield kind and text of each cause, what it leaves in tolerances, and numbers it fits."""
    n, rest = sample.torque.shape[1], (sample.torque - sample.load) / tolerance
    for mistake in mistakes(sample.body.sliding):
        undone, text = mistake.undo(sample), mistake.message
        if mistake.kind == "mounting":
            text += f": turned by {_turn(sample.body.gravity, undone.body.gravity):.0f}°"
        yield mistake.kind, text, (undone.torque - undone.load) / tolerance, 1
    for i, j in combinations(range(n), 2):
        text = (
            f"joints {i + 1} and {j + 1} are exchanged: position and torque of each are reported "
            "as those of the other"
        )
        yield "exchanged-joints", text, _exchanged(sample, i, j) / tolerance, 1
    yield _offset(rest, tolerance)
    yield _tool(sample, rest, tolerance)
    yield from _turned_base(sample, tolerance)


def _exchanged(sample: RowSample, i: int, j: int) -> FloatArray:
    """Return what gravity leaves of torques once two joints are put right, (K, n) [N m]."""
    order = np.arange(sample.torque.shape[1])
    order[[i, j]] = j, i
    undone = sample.torques(np.eye(len(order))[order]).positions(np.eye(len(order))[order])
    return undone.torque - undone.load


def _offset(rest: FloatArray, tolerance: FloatArray) -> tuple[str, str, FloatArray, int]:
    """Return the cause that sensors of some joints have an offset."""
    joints = np.flatnonzero(np.abs(rest).max(axis=0) > 1.0)
    offset = np.zeros(rest.shape[1])
    offset[joints] = rest[:, joints].mean(axis=0)
    each = ", ".join(f"joint {j + 1} by {offset[j] * tolerance[j]:+.2g} N m" for j in joints)
    text = f"torque sensors are off by the same in every pose: {each}; set them to zero anew"
    return "sensor-offset", text, rest - offset, len(joints)


def _tool(
    sample: RowSample, rest: FloatArray, tolerance: FloatArray
) -> tuple[str, str, FloatArray, int]:
    """Return the cause that the tool is another than described."""
    columns = _loads(sample.body, sample.motion.position) / tolerance[:, None]  # (K, n, 4)
    flat = columns.reshape(-1, columns.shape[2])
    fit = np.linalg.lstsq(flat, rest.ravel())[0]
    mass = float(fit[0])
    more = "more" if mass > 0 else "less"
    text = (
        f"the arm carries {abs(mass):.2g} kg {more} than described: state the tool that is mounted "
        "(a payload in a sim.yaml), or mount the one that is stated"
    )
    return "tool-mass", text, rest - (flat @ fit).reshape(rest.shape), flat.shape[1]


def _turned_base(
    sample: RowSample, tolerance: FloatArray
) -> Iterator[tuple[str, str, FloatArray, int]]:
    """Yield the cause that gravity acts along another direction than described, if it is one."""
    body, position = sample.body, sample.motion.position
    columns = [body.with_gravity(axis.tolist()).gravity_torque(position) for axis in np.eye(3)]
    flat = (np.stack(columns, axis=-1) / tolerance[:, None]).reshape(-1, 3)
    measured = sample.torque / tolerance
    fit, _, rank, _ = np.linalg.lstsq(flat, measured.ravel())
    gravity = fit.astype(np.float64)
    size, found = float(np.linalg.norm(body.gravity)), float(np.linalg.norm(gravity))
    if rank < len(gravity) or not size or not 1 / _SIZE < found / size < _SIZE:
        return
    if (turn := _turn(body.gravity, gravity)) < _LEAST_TURN:
        return
    text = f"{mounted_otherwise(gravity)}: turned by {turn:.0f}°"
    yield "mounting", text, measured - (flat @ gravity).reshape(measured.shape), len(gravity)


def _turn(one: Sequence[float] | FloatArray, other: Sequence[float] | FloatArray) -> float:
    """Return the angle between two gravities, (3,) each [°]; 0 where one is none."""
    a, b = np.array(one), np.array(other)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return math.degrees(math.acos(float(np.clip(a @ b / size, -1.0, 1.0)))) if size else 0.0


def _loads(model: RobotModel, position: FloatArray) -> FloatArray:
    """Return the torque of 1 kg at the last link's frame, and of 1 kg m along x, y and z of it.

    Returns:
        (K, n, 4) [N m/kg, N m/(kg m)].
    """
    at_frame = _load(model, position, np.zeros(3))
    along = [_load(model, position, axis) - at_frame for axis in np.eye(3)]
    return np.stack([at_frame, *along], axis=-1)


def _load(model: RobotModel, position: FloatArray, com: FloatArray) -> FloatArray:
    """Return the torque of 1 kg at a place (3,) [m] in the frame of the last link, (K, n) [N m]."""
    last = model.link_names[-1]
    x, y, z = com.tolist()
    laden = model.inertials[last].joined(Inertial(1.0, (x, y, z), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    return model.with_inertials({last: laden}).gravity_torque(position) - model.gravity_torque(
        position
    )


def _unseen(sample: RowSample, tolerance: FloatArray) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the mistakes that gravity would not have shown in these poses, mounting apart."""
    as_described, n = replace(sample, torque=sample.load), sample.torque.shape[1]
    unseen: list[str] = []
    for i, j in combinations(range(n), 2):
        if np.abs(_exchanged(as_described, i, j) / tolerance).max() < _SEEN:
            unseen.append(f"joints {i + 1} and {j + 1} exchanged")
    for j in range(n):
        turned = np.eye(n) - 2.0 * np.diag(np.eye(n)[j])
        undone = as_described.torques(turned).positions(turned)
        if np.abs((undone.torque - undone.load) / tolerance).max() < _SEEN:
            unseen.append(f"joint {j + 1} turning the other way")
    mounting: list[str] = []
    for mistake in mistakes(sample.body.sliding):
        undone = mistake.undo(as_described)
        is_mounting = mistake.kind == "mounting" and undone.body.gravity != sample.body.gravity
        if is_mounting and np.abs((undone.torque - undone.load) / tolerance).max() < _SEEN:
            text = mounted_otherwise(np.array(undone.body.gravity))
            mounting.append(text.partition(",")[0])
    return tuple(unseen), tuple(mounting)
