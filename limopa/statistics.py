"""Statistics of a plan: range covered, number of reversals, share of the limits used."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from limopa.planner import EXPLORING, REACHING
from limopa.scaffold import Exploration

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray
    from limopa.planner import Plan, PlanPhase

BIN = np.radians(5.0)  # width of a bin of joint coverage [rad]
STILL = 1e-9  # [rad/s], below which a joint has no direction of rotation
NEWTON_STEPS = 2


@dataclass(frozen=True)
class Spread:
    """Smallest, mean and largest of some values; NaN if there are none."""

    least: float
    mean: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise `values`."""
        if not values:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(min(values)), float(np.mean(values)), float(max(values)))


@dataclass(frozen=True)
class JointStatistics:
    """Statistics of one joint."""

    joint: int  # 1-based
    reversals: int  # of the direction of rotation, while exploring
    rotation_between_reversals: float  # [rad], median while exploring; NaN without reversals
    coverage: float  # share of the joint's range, in bins of 5 deg, that is visited
    peak_velocity: float  # relative to the limit
    peak_acceleration: float
    peak_jerk: float


@dataclass(frozen=True)
class Statistics:
    """Statistics of a plan."""

    robot: str
    seed: int
    scaffolds: int
    waypoints: int  # of all exploring phases
    samples: int
    duration: float  # [s]
    waypoints_per_phase: Spread
    exploring_duration: Spread  # [s]
    reaching_duration: Spread  # [s]
    exploring_velocity: Spread  # peak of each phase, relative to the leading joint's limit
    joints: tuple[JointStatistics, ...]
    candidates: int  # random configurations drawn for scaffolds
    rejections: Mapping[str, Mapping[str, int]]  # stage → condition → count
    unchecked_pairs: tuple[tuple[str, str], ...]  # links that touch by construction

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON; NaN is None."""
        return asdict(self, dict_factory=_without_nan)


def summarise(plan: Plan, model: RobotModel) -> Statistics:
    """Compute the statistics of a plan.

    Args:
        plan: The plan.
        model: The robot it was planned for.
    """
    motion = plan.trajectory
    relative = np.abs(motion.velocity) / model.limits.velocity
    rows = {
        kind: [slice(s.start, s.stop) for s in motion.segments if s.kind == kind]
        for kind in (REACHING, EXPLORING)
    }
    seconds = {kind: [(r.stop - r.start) / plan.request.rate for r in rows[kind]] for kind in rows}
    waypoints = [p.path.waypoints for p in plan.phases if isinstance(p.path, Exploration)]
    return Statistics(
        robot=motion.robot,
        seed=plan.seed,
        scaffolds=len(plan.scaffolds),
        waypoints=sum(waypoints),
        samples=len(motion),
        duration=motion.duration,
        waypoints_per_phase=Spread.of(waypoints),
        exploring_duration=Spread.of(seconds[EXPLORING]),
        reaching_duration=Spread.of(seconds[REACHING]),
        exploring_velocity=Spread.of([float(relative[r].max()) for r in rows[EXPLORING]]),
        joints=_joints(plan, model, rows[EXPLORING]),
        candidates=plan.candidates,
        rejections=plan.rejections,
        unchecked_pairs=plan.unchecked_pairs,
    )


def path_deviation(plan: Plan, phase: PlanPhase, rows: slice, rate: float = 1000.0) -> float:
    """Return how far the trajectory leaves the path of one phase at most, any joint [rad].

    The trajectory is evaluated at `rate` [Hz], also between its samples; the nearest point of the
    path is found by Newton steps from the parameter of the neighbouring samples.
    """
    motion = plan.trajectory
    first = rows.start if rows.start == 0 else rows.start - 1  # starts where the last one ends
    begin, end = float(motion.time[first]), float(motion.time[rows.stop - 1])
    steps = np.arange(int((end - begin) * rate) + 1)  # whose sum would round beyond the end
    time = np.append(np.minimum(begin + steps / rate, end), end)
    position = motion.evaluate(time).position
    s = np.interp(time, motion.time[first : rows.stop], phase.parameter)
    for _ in range(NEWTON_STEPS):
        tangent = phase.path.derivative(s, 1)
        miss = position - phase.path.derivative(s, 0)
        s = s + np.sum(miss * tangent, axis=1) / np.sum(tangent**2, axis=1)
        s = np.clip(s, 0.0, phase.path.length)
    return float(np.abs(position - phase.path.derivative(s, 0)).max())


def _without_nan(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in items}


def _joints(
    plan: Plan, model: RobotModel, exploring: Sequence[slice]
) -> tuple[JointStatistics, ...]:
    motion, limits = plan.trajectory, model.limits
    peaks = motion.peaks().over(limits)
    rows = []
    for j in range(model.n):
        turned = [rotations(motion.position[r, j], motion.velocity[r, j]) for r in exploring]
        turns = [reversal_rows(motion.velocity[r, j]) for r in exploring]
        between = np.concatenate(turned)
        # The share of the bins of a joint's range that its positions (T,) fall into
        lower = limits.position_min[j]
        upper = limits.position_max[j]
        bins = int(np.ceil((upper - lower) / BIN))
        visited, _ = np.histogram(motion.position[:, j], bins=bins, range=(lower, upper))
        rows.append(
            JointStatistics(
                joint=j + 1,
                reversals=sum(map(len, turns)),
                rotation_between_reversals=float(np.median(between)) if between.size else np.nan,
                coverage=float(np.mean(visited > 0)),
                peak_velocity=float(peaks.velocity[j]),
                peak_acceleration=float(peaks.acceleration[j]),
                peak_jerk=float(peaks.jerk[j]),
            )
        )
    return tuple(rows)


def reversal_rows(velocity: FloatArray) -> NDArray[np.intp]:
    """Return the rows after which one joint's velocity (T,) changes sign; rest is no reversal."""
    moving = np.flatnonzero(np.abs(velocity) > STILL)
    changes = np.flatnonzero(np.diff(np.sign(velocity[moving])))
    return moving[changes]


def rotations(position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return how far one joint turns from each reversal to the next [rad], of samples (T,)."""
    return np.abs(np.diff(position[reversal_rows(velocity)]))
