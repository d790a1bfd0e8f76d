"""A motion in parts, each from rest to rest, feasible and within the limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.model import RobotModel
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray
from limopa.feasibility import Condition, Feasibility
from limopa.path import JointBounds, Line, Path, TimedPath, joined, retime
from limopa.request import Surroundings, Workspace
from limopa.scaffold import Exploration

_Option = TypeVar("_Option")
PERIOD = 1e-3  # [s]
_TRANSIT = 0.3  # share of the velocity limits between poses
_ACCELERATION = 0.4  # share of the limits
_RAMP = 0.2  # [s] in which a slow move gets up to speed: no jolt that shakes what is measured


class MotionChain:
    """Parts of a motion, each from rest to rest, the next where the last one ended."""

    def __init__(self, model: RobotModel, start: FloatArray) -> None:
        self.model, self.here = model, np.array(start, dtype=float)
        self.feasibility = Feasibility(model, Surroundings(), Workspace())
        self._parts: list[tuple[str, TimedPath]] = []

    @property
    def kinds(self) -> set[str]:
        """Kinds of the parts, by name."""
        return {kind for kind, _ in self._parts}

    def move(self, to: FloatArray, speed: float | None = None, kind: str = "transit") -> None:
        """Move straight to a pose, no joint faster than `speed` [rad/s]."""
        if np.abs(to - self.here).max() < 1e-9:  # noqa: PLR2004  # [rad], rounding
            return
        limits = self.model.limits
        share = np.full(self.model.n, _TRANSIT)
        acceleration = np.full(self.model.n, _ACCELERATION)
        if speed is not None:
            share = np.minimum(speed / limits.velocity, 1.0)
            acceleration = np.minimum(speed / _RAMP / limits.acceleration, _ACCELERATION)
        self._add(kind, Line(self.here, to), share, acceleration)

    def visit(self, poses: Iterable[FloatArray], speed: float, kind: str) -> None:
        """Move straight from pose to pose, no joint faster than `speed` [rad/s]."""
        for pose in poses:
            self.move(pose, speed, kind)

    def swing(self, amplitude: FloatArray, frequency: float, cycles: int, kind: str) -> None:
        """Swing around the pose as A sin(2 π f t), (n,) [rad] at `frequency` [Hz]."""
        count = round(cycles / frequency / PERIOD) + 1
        n = self.model.n
        path = Exploration(
            self.here, amplitude[:, None], np.full((n, 1), frequency), np.zeros((n, 1)), count,
            PERIOD,
        )  # fmt: skip
        fastest = np.maximum(np.abs(amplitude), 1e-6) * 2 * np.pi * frequency
        share = np.minimum(fastest / self.model.limits.velocity, 1.0)
        self._add(kind, path, share, np.ones(n))

    def hold(self, seconds: float) -> None:
        """Stay at rest."""
        count = round(seconds / PERIOD) + 1
        rest = np.zeros((count, self.model.n))
        self._parts.append(("hold", TimedPath(np.zeros(count), rest + self.here, rest, rest)))

    def broken_by(self, path: Path) -> tuple[Condition, ...]:
        """Return the conditions that a path breaks."""
        return self.feasibility.check_path(path)

    def trajectory(self) -> Trajectory:
        """Return all parts as one motion."""
        if not self._parts:
            raise InfeasiblePathError(Condition.JOINT_LIMITS, "nothing is left to move")
        return joined(self._parts, PERIOD, self.model.name)

    def _add(self, kind: str, path: Path, share: FloatArray, acceleration: FloatArray) -> None:
        broken = self.broken_by(path)
        if broken:
            raise InfeasiblePathError(
                broken[0], f"a {kind} from {np.round(self.here, 3).tolist()} rad is not feasible"
            )
        bounds = JointBounds.of(self.model.limits, PERIOD, share, acceleration)
        self._parts.append((kind, retime(path, bounds, PERIOD)))
        self.here = path.derivative(np.array([path.length]), 0)[0]


def first_feasible(
    motion: Callable[[_Option], Trajectory], options: Iterable[_Option]
) -> Trajectory:
    """Return the motion of the first option that is feasible.

    Raises:
        InfeasiblePathError: None is; says what the last one lacks.
    """
    refused = InfeasiblePathError("options", "there is nothing to try")
    for option in options:
        try:
            return motion(option)
        except InfeasiblePathError as error:
            refused = error
    raise refused
