"""LIMOPA, the locally isotropic motion path algorithm: scaffolds, reaching and exploring phases.

Source: Algorithm 1 (LIMOPA) of the paper.

Statistics of a plan: range covered, number of reversals, share of the limits used.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.runtime.display import Displayed
from limopa.distances import near_work, ways
from limopa.feasibility import Condition, Feasibility
from limopa.path import JointBounds, Line, Path, TimedPath, joined, retime
from limopa.request import PlanRequest
from limopa.scaffold import Exploration, ScaffoldSampler, draw_exploration, nearest_first, set_by

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray


REACHING, EXPLORING = "reaching", "exploring"


@dataclass(frozen=True)
class PlanPhase:
    """One phase of a plan: its path, and its parameter at each sample of its segment."""

    kind: str  # reaching or exploring
    path: Path
    parameter: FloatArray  # (T,)


@dataclass(frozen=True, repr=False)
class Plan(Displayed):
    """A planned motion and how it came about; phase i is segment i of the trajectory."""

    request: PlanRequest
    seed: int
    trajectory: Trajectory
    scaffolds: FloatArray  # (L, n) [rad], in the order of the motion
    phases: tuple[PlanPhase, ...]
    candidates: int  # random configurations drawn
    rejections: Mapping[str, Mapping[str, int]]  # stage → condition → count
    unchecked_pairs: tuple[tuple[str, str], ...]  # links that touch by construction

    def headline(self) -> str:
        """Say how many poses it explores, and how long that takes."""
        return f"{len(self.scaffolds)} poses explored, {self.trajectory.headline()}"

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the range and the peaks of each joint."""
        return self.trajectory.figures()


def plan(
    model: RobotModel,
    request: PlanRequest | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    near: Recording | None = None,
) -> Plan:
    """Plan locally isotropic motion; the same request and seed give the same plan.

    Args:
        model: The robot.
        request: What to plan; the paper's values by default.
        seed: Seed of every random draw.
        progress: Called with the number of scaffolds done and wanted.
        near: Work of this robot: scaffolds are drawn around its poses, not all over a workspace,
            and the flange is no faster than there. A region or a speed that is asked for is kept.

    Raises:
        InfeasiblePathError: No such motion; names the condition that fails.
        ConfigError: The robot's collision shapes cannot be read, or nothing moves in `near`.
        RecordingError: `near` is of another robot.

    Source: Algorithm 1 (LIMOPA) of the paper.
    """
    wanted, around = request or PlanRequest(), None
    if near is not None:
        near.check_robot(model)
        wanted, around = near_work(model, wanted, near)
    planner = _Planner(model, wanted, seed, around)
    return planner.run(progress or (lambda _done, _wanted: None))


class _Planner:
    """State of one run of the algorithm."""

    def __init__(
        self, model: RobotModel, request: PlanRequest, seed: int, around: FloatArray | None
    ) -> None:
        self.model, self.request, self.seed = model, request, seed
        self.period = 1.0 / request.rate
        self.feasibility = Feasibility(model, request.surroundings, request.workspace)
        streams = np.random.default_rng(seed).spawn(3)
        scaffold_random, self.exploring_random, self.speed_random = streams
        self.sampler = ScaffoldSampler(
            self.feasibility, scaffold_random, request.candidates, around
        )
        self.rejections = {REACHING: Counter[str](), EXPLORING: Counter[str]()}
        self.paths: list[tuple[str, Path]] = []
        self.timed: list[TimedPath] = []
        self.scaffolds: list[FloatArray] = []
        self.dead_ends = 0

    def run(self, progress: Callable[[int, int], None]) -> Plan:
        wanted = self.request.scaffolds
        pool = self.sampler.draw(wanted)
        while len(self.scaffolds) < wanted:
            pool = self._visit_next(pool)
            progress(len(self.scaffolds), wanted)
        kinds = [kind for kind, _ in self.paths]
        parts = list(zip(kinds, self.timed, strict=True))
        return Plan(
            request=self.request,
            seed=self.seed,
            trajectory=joined(parts, self.period, self.model.name),
            scaffolds=np.array(self.scaffolds),
            phases=tuple(
                PlanPhase(kind, path, timed.parameter)
                for (kind, path), timed in zip(self.paths, self.timed, strict=True)
            ),
            candidates=self.sampler.drawn,
            rejections={"scaffold": dict(self.sampler.rejections)}
            | {stage: dict(counts) for stage, counts in self.rejections.items()},
            unchecked_pairs=self.feasibility.overlapping_pairs,
        )

    def _visit_next(self, pool: FloatArray) -> FloatArray:
        """Reach and explore the nearest scaffold that allows it; return the rest of the pool.

        A scaffold that cannot be explored is replaced by a new draw; one that no straight line
        reaches stays in the pool for later, and if that holds for all of them, one more is drawn.
        Where none of these helps either, the last scaffold is a dead end, and given up.
        """
        known: dict[tuple[int, bool], tuple[Condition, ...]] = {}  # what ways to rows break
        for _ in range(self.request.repairs):
            row, line = self._nearest_reachable(pool, known)
            if row is None:
                pool = np.concatenate([pool, self.sampler.draw(1)])
                continue
            exploration = self._explore(pool[row])
            if exploration is None:
                pool = np.concatenate([np.delete(pool, row, axis=0), self.sampler.draw(1)])
                known.clear()
                continue
            limits, random = self.model.limits, self.speed_random
            if line is not None:
                reaching = self.request.reaching
                velocity = random.uniform(*reaching.velocity, self.model.n)
                acceleration = random.uniform(*reaching.acceleration, self.model.n)
                bounds = JointBounds.of(limits, self.period, velocity, acceleration)
                self._add(REACHING, line, bounds)
            share = random.uniform(*self.request.exploring.velocity)
            self._add(EXPLORING, exploration, JointBounds.of(limits, self.period, share))
            self.scaffolds.append(exploration.scaffold)
            return np.delete(pool, row, axis=0)
        if not self.scaffolds or self.dead_ends == self.request.repairs:
            raise self._stuck()
        self.dead_ends += 1
        del self.scaffolds[-1]
        first = max(2 * len(self.scaffolds) - 1, 0)  # no way leads to the first scaffold
        del self.paths[first:], self.timed[first:]
        return pool

    def _nearest_reachable(
        self, pool: FloatArray, known: dict[tuple[int, bool], tuple[Condition, ...]]
    ) -> tuple[int | None, Line | None]:
        """Return a row of the pool that a straight line reaches, and the line.

        Where there is none, a pose is tried as joints come to it by the fewest turns.
        """
        if not self.scaffolds:
            return 0, None
        here = self.paths[-1][1]
        start = here.derivative(np.array([here.length]), 0)[0]
        order = nearest_first(pool, self.scaffolds[-1]).tolist()
        turned = self.feasibility.turned_to(start, pool)
        moved = (turned != pool).any(axis=1)
        goals = [(row, False) for row in order] + [(row, True) for row in order if moved[row]]
        for goal in goals:
            row, nearer = goal
            line = Line(start, turned[row] if nearer else pool[row])
            if goal not in known:
                known[goal] = self.feasibility.check_path(line)
            self.rejections[REACHING].update(map(str, known[goal]))
            if not known[goal]:
                pool[row] = line.end
                return row, line
        return None, None

    def _explore(self, scaffold: FloatArray) -> Exploration | None:
        """Draw exploring phases until one is feasible; None if none of the tries is."""
        for _ in range(self.request.exploring_tries):
            path = draw_exploration(scaffold, self.request.exploring, self.exploring_random)
            broken = self.feasibility.check_path(path)
            self.rejections[EXPLORING].update(map(str, broken))
            if not broken:
                return path
        return None

    def _add(self, kind: str, path: Path, bounds: JointBounds) -> None:
        bounds = bounds.slowed(path, partial(ways, self.feasibility.chain), self.request.speed)
        self.paths.append((kind, path))
        self.timed.append(retime(path, bounds, self.period))

    def _stuck(self) -> InfeasiblePathError:
        total = sum(self.rejections.values(), Counter[str]())
        condition = total.most_common(1)[0][0]
        counts = "; ".join(
            f"{stage} phases rejected by "
            + (", ".join(f"{name} {count}" for name, count in found.most_common()) or "nothing")
            for stage, found in self.rejections.items()
        )
        option = set_by(condition, self.feasibility)
        narrow = self.request.workspace != PlanRequest().workspace  # a wider one may have ways
        if narrow and condition != Condition.WORKSPACE:
            option += f" or {set_by(Condition.WORKSPACE, self.feasibility)}"
        return InfeasiblePathError(
            condition,
            f"no next scaffold after {len(self.scaffolds)} of {self.request.scaffolds}, "
            f"{self.request.repairs} replacements tried; {counts}; in the way is {option}",
        )


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
