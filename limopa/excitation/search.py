"""Persistently exciting motion: Fourier series of the least condition number.

Each joint moves on harmonics of its own (`descent.py`). Pose and coefficients are found by L-BFGS
from several random starts, on a thinned sampling: a smooth bound of the condition number, which the
caller gives, plus the squares of what exceeds a limit, weighed more from stage to stage. The
amplitude is then reduced until the motion is strictly inside of all limits on a dense sampling.

Source: Çallar and Böttger, "Hybrid Learning of Time-Series Inverse Dynamics Models for Locally
Isotropic Robot Motion", RA-L 2022, sec. III-A: joint-wise disjunct sinusoidal dynamic excitation
trajectories that minimise cond(K).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.trajectory import Segment, Trajectory
from limopa.excitation.descent import EvaluatedMotion, Excess, Fourier, IterationProgress, allot
from limopa.feasibility import Condition, Feasibility
from limopa.request import EVERYWHERE, Surroundings, Workspace
from limopa.scaffold import ScaffoldSampler

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray
    from limopa.excitation.descent import Criterion, Harmonics

EXCITATION = "excitation"
HIGHEST = 2.0  # [Hz] of any harmonic; above, slow arms are neither rigid nor fast enough
MOST_HARMONICS = 20  # of one joint
MOST_STARTS = 1000
LONGEST = 3600.0  # [s]
STRICTLY = 0.999  # share of each limit that the motion may use
_SPARE = 0.005  # [m] of clearance kept beyond the wanted while optimising
_PER_PERIOD = 8  # samples of the fastest harmonic
_DENSER = 3  # times as many where limits are looked at
_START = 0.15  # of the size that the limits allow, of random coefficients
_SHARES = (1.0, 0.99, 0.98, 0.96, 0.93, 0.88, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)  # tried
_DRAWS = 20_000  # random poses tried in vain before giving up
_BLOCK = 16_384  # samples at once
_CHECKED = 1e-3  # [s], the control cycle


@dataclass(frozen=True)
class ExcitationRequest(Declared):
    """Request for an exciting motion.

    Args:
        duration: Of the motion, one period of the base frequency [s].
        harmonics: Of each joint, 2 to 20; no two joints share any.
        rate: Of the trajectory's samples [Hz], 50 to 1000.
        surroundings: Margins, clearance [m] and table that every configuration keeps away from.
        workspace: Where the flange may be, all the time [m].
        starts: Random motions to begin with, of which the best are refined.
        iterations: Of each of the last two refinements; 0 leaves a random motion.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.excite("iiwa14", limo.ExcitationRequest(duration=30.0, harmonics=4), seed=1)
    """

    duration: float = parameter("s", lower=0.0, above=True, upper=LONGEST, default=60.0)
    harmonics: int = parameter(  # of which one alone cannot start and end at rest
        "", lower=2, upper=MOST_HARMONICS, default=5
    )
    rate: float = parameter("Hz", lower=50, upper=1e3, default=250.0)
    surroundings: Surroundings = field(default_factory=Surroundings)
    workspace: Workspace = EVERYWHERE  # of the flange, all the time
    starts: int = parameter("", lower=1, upper=MOST_STARTS, default=16)
    iterations: int = parameter("", lower=0, default=250)

    @property
    def frequency(self) -> float:
        """Base frequency [Hz]."""
        return 1.0 / self.duration


@dataclass(frozen=True, repr=False)
class Excitation(Displayed):
    """Result of a search."""

    request: ExcitationRequest
    seed: int
    harmonics: Harmonics  # of each joint, multiples of the base frequency
    trajectory: Trajectory
    unchecked_pairs: tuple[tuple[str, str], ...]  # links that touch by construction

    def headline(self) -> str:
        """Say its base frequency, and how long it is."""
        return f"base frequency {self.request.frequency:.4g} Hz, {self.trajectory.headline()}"

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the range and the peaks of each joint."""
        return self.trajectory.figures()


def excite(
    model: RobotModel,
    criterion: Criterion,
    request: ExcitationRequest | None = None,
    seed: int = 0,
    progress: Callable[[int, int, float], None] | None = None,
) -> Excitation:
    """Find the motion of the least condition number; the same request and seed give the same one.

    Args:
        model: The robot.
        criterion: The condition number, of a regressor that the caller chooses.
        request: Request for an exciting motion.
        seed: Seed of every random draw.
        progress: Called with the iterations done, those at most, and the condition number.

    Raises:
        ConfigError: The duration is too short for the harmonics, or the robot's collision shapes
            cannot be read.
        InfeasiblePathError: No pose is feasible, or no motion around one.
    """
    search = _Search(model, criterion, request or ExcitationRequest(), seed)
    return search.run(progress or (lambda _done, _most, _condition: None))


@dataclass(frozen=True)
class _Stage:
    """A descent of the best motions so far."""

    kept: int  # motions that take part
    sharpness: float  # of the smooth bound of the condition number
    weight: float  # of what exceeds a limit
    share: float  # of the iterations of a refinement

    def iterations(self, request: ExcitationRequest) -> int:
        return ceil(self.share * request.iterations)


_STAGES = (
    _Stage(MOST_STARTS, 4.0, 1e2, 0.16),
    _Stage(4, 8.0, 1e3, 0.4),
    _Stage(1, 16.0, 1e4, 1.0),
    _Stage(1, 16.0, 1e5, 1.0),
)


class _Search:
    """Problem of a search: the arm, its limits and the objective."""

    def __init__(
        self, model: RobotModel, criterion: Criterion, request: ExcitationRequest, seed: int
    ) -> None:
        _require_long_enough(model.n, request)
        self.model, self.criterion, self.request, self.seed = model, criterion, request, seed
        around = request.surroundings
        self.feasibility = Feasibility(model, around, request.workspace)
        spare = replace(around, clearance=min(around.clearance + _SPARE, 1.0))
        self.roomier = Feasibility(model, spare, request.workspace)
        self.excess = Excess(model.limits, self.roomier)

    def run(self, progress: Callable[[int, int, float], None]) -> Excitation:
        random = np.random.default_rng(self.seed)
        request = self.request
        poses = ScaffoldSampler(self.roomier, random, _DRAWS).draw(request.starts)
        motions = [self._random_motion(pose, random) for pose in poses]
        each = [min(stage.kept, len(motions)) * stage.iterations(request) for stage in _STAGES]
        watch = IterationProgress(progress, sum(each))
        for stage in _STAGES:
            motions = [
                motion.refined(stage.sharpness, stage.weight, stage.iterations(request), watch)
                for motion in motions[: stage.kept]
            ]
            motions.sort(key=lambda motion: motion.value)
        best = motions[0]
        return Excitation(
            request,
            self.seed,
            best.fourier.harmonics,
            self._inside(best),
            self.feasibility.overlapping_pairs,
        )

    def _random_motion(self, pose: FloatArray, random: np.random.Generator) -> EvaluatedMotion:
        """Return a motion around a pose with random harmonics and coefficients."""
        request = self.request
        harmonics = allot(self.model.n, request.harmonics, random)
        fourier = Fourier.of(harmonics, request.duration, self.model.limits)
        count = _PER_PERIOD * self.model.n * request.harmonics
        time = np.arange(_DENSER * count) / (_DENSER * count) * request.duration
        seen = time[_DENSER // 2 :: _DENSER]
        x = np.concatenate([pose, _START * random.standard_normal(fourier.size - self.model.n)])
        return EvaluatedMotion(
            fourier,
            seen,
            fourier.sampled(seen),
            fourier.sampled(time),
            self.criterion,
            self.excess,
            x,
        )

    def _inside(self, found: EvaluatedMotion) -> Trajectory:
        """Return a motion as it is or, if it is not strictly within the limits, a smaller one."""
        whole = self._trajectory(found.fourier, found.x)
        used = whole.peaks().over(self.model.limits)
        largest = min(1.0, STRICTLY / np.max([used.velocity, used.acceleration, used.jerk]))
        broken = tuple(Condition)
        for share in _SHARES:
            x = found.fourier.scaled(found.x, largest * share)
            motion = self._trajectory(found.fourier, x)
            broken = self._broken(motion)
            if not broken:
                return motion
        raise InfeasiblePathError(
            broken[0], "no motion around the pose that was found keeps it; try another seed"
        )

    def _trajectory(self, fourier: Fourier, x: FloatArray) -> Trajectory:
        """Return one period, at rest at both ends."""
        request = self.request
        count = round(request.duration * request.rate) + 1
        time = np.linspace(0.0, request.duration, count)
        blocks = np.array_split(time, range(_BLOCK, count, _BLOCK))
        states = np.concatenate([fourier.sampled(block).states(x) for block in blocks], axis=1)
        position, velocity, acceleration, _ = states
        position[-1] = position[0]
        for derivative in (velocity, acceleration):
            derivative[[0, -1]] = 0.0  # free of rounding
        segments = (Segment(EXCITATION, 0, count),)
        return Trajectory(
            time, position, velocity, acceleration, robot=self.model.name, segments=segments
        )

    def _broken(self, motion: Trajectory) -> tuple[Condition, ...]:
        """Return what a motion breaks in any control cycle."""
        time = np.append(np.arange(0.0, motion.duration, _CHECKED), motion.duration)
        for start in range(0, len(time), _BLOCK):
            position = motion.evaluate(time[start : start + _BLOCK]).position
            broken = self.feasibility.check_scaffold(position).conditions()
            if broken:
                return broken
        return ()


def _require_long_enough(n: int, request: ExcitationRequest) -> None:
    top = n * request.harmonics
    if top / request.duration > HIGHEST * (1 + 1e-9):
        raise ConfigError(
            f"duration {request.duration:g} s is too short for {request.harmonics} harmonics of "
            f"each of {n} joints: they reach {top / request.duration:.3g} Hz, expected up to "
            f"{HIGHEST:g} Hz; take {top / HIGHEST:g} s or more, or fewer harmonics"
        )
