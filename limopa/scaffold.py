"""Scaffolds, and how they explore the poses of an arm.

Scaffold configurations: uniform random draws from the feasible part of joint space, or around the
poses of a recording.

Source: the first loop of Algorithm 1 (LIMOPA) of the paper.

Which condition of a request is in the way, and what would have to change.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from itertools import combinations
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.types import FloatArray, IntArray, readonly
from limopa.feasibility import Condition, Feasibility

if TYPE_CHECKING:
    from limopa.feasibility import Feasibility
    from limopa.request import Exploring

# What sets each condition, as functions name it; the commands have an option for each.
SET_BY: Final = {
    Condition.JOINT_LIMITS: "`joint_margin`",
    Condition.TABLE: "`table_height`",
    Condition.SELF_COLLISION: "`clearance`",  # also what is kept from the table
}


class Hindrance(NamedTuple):
    """What of a request cannot be met."""

    condition: Condition
    message: str  # how far it is from being met, and the argument that asks for it


def hindrance(space: Feasibility, position: FloatArray) -> Hindrance:
    """Return the fewest conditions without which one of some configurations would be feasible.

    Args:
        space: The conditions.
        position: Configurations of which none is feasible, (T, n) [rad].
    """
    broken = space.check_scaffold(position).broken
    rows = np.logical_or.reduce(list(broken.values()))
    position, broken = position[rows], {name: found[rows] for name, found in broken.items()}
    for many in range(1, len(broken) + 1):
        freed: dict[tuple[Condition, ...], FloatArray] = {}
        for named in combinations(broken, many):
            others = [found for name, found in broken.items() if name not in named]
            freed[named] = position[~np.logical_or.reduce([np.zeros_like(rows[rows]), *others])]
        most = max(freed, key=lambda named: len(freed[named]))
        if len(freed[most]):
            missed = "; ".join(_missed_by(space, name, freed[most]) for name in most)
            return Hindrance(most[0], missed)
    raise AssertionError("without all conditions every configuration is feasible")


def set_by(condition: str, space: Feasibility) -> str:
    """Return the argument that asks for a condition."""
    if condition == Condition.WORKSPACE:
        return "`region`" if space.workspace.throughout else "`Workspace.radius`"
    return SET_BY[Condition(condition)]


def _missed_by(space: Feasibility, condition: Condition, position: FloatArray) -> str:
    """Say how near a condition the best of some configurations comes, (T, n)."""
    need = space.surroundings.clearance
    gap, lowest = space.clearances(position)
    option = set_by(condition, space)
    if condition == Condition.TABLE:
        height = space.surroundings.table_height
        best = float(lowest.min(axis=1).max())
        missed = f"the table is {height:g} m above the base, expected at most {best - need:.3g} m"
        if best > height:  # it is what is to be kept from it that is too much
            missed = (
                f"links come {best - height:.3g} m off the table, where {need:g} m are asked for"
            )
            option = SET_BY[Condition.SELF_COLLISION]
    elif condition == Condition.SELF_COLLISION:
        best = float(gap.min(axis=1).max())
        apart = "links touch" if best <= 0 else f"links come {best:.3g} m apart at most"
        missed = f"{apart}, where {need:g} m are asked for"
    elif condition == Condition.WORKSPACE:
        best = float(space.outside(position).min())
        missed = f"at best the flange is {best:.3g} m away from {space.workspace.in_words}"
    else:
        over = np.maximum(space.lower - position, position - space.upper)
        nearest = over[over.max(axis=1).argmin()]
        asked = space.surroundings.joint_margin
        best = np.degrees(asked - nearest.max())
        missed = f"joint {nearest.argmax() + 1} is to keep {np.degrees(asked):g} deg from the ends "
        missed += f"of its range, expected at most {best:.3g} deg"
    return f"{missed} ({option})"


BATCH = 512  # candidates checked at once
PROBES = 4096  # that show what is in the way, where none is feasible
NEARBY = np.radians(5.0)  # [rad, m], of a scaffold from a recorded pose, each joint
HOPELESS = 1024  # first draws in vain, after which it is asked whether any draw can help


class ScaffoldSampler:
    """Draw feasible scaffolds and count what rejected the others.

    A candidate counts for the conditions that are found broken first; others are not looked at.

    Args:
        feasibility: Conditions.
        random: Source of the draws.
        candidates: Draws in vain, for one scaffold, before giving up.
        around: Poses to draw around, (K, n) [rad]; in the whole joint space if not given.
    """

    def __init__(
        self,
        feasibility: Feasibility,
        random: np.random.Generator,
        candidates: int,
        around: FloatArray | None = None,
    ) -> None:
        self.feasibility, self.random, self.candidates = feasibility, random, candidates
        self.around = around
        self.drawn = 0
        self.rejections: Counter[str] = Counter()
        self._ready = np.zeros((0, len(feasibility.lower)))

    def draw(self, count: int) -> FloatArray:
        """Draw `count` feasible configurations, (count, n) [rad].

        Raises:
            InfeasiblePathError: None of `candidates` draws in a row is feasible, and the error
                names the condition in the way and the argument that asks for it; or the first
                draws show a link that no motion frees, which the error names.
        """
        in_vain = 0
        while len(self._ready) < count:
            position = self._random(self.random, BATCH)
            verdict = self.feasibility.check_scaffold(position, all_of=False)
            self.drawn += BATCH
            self.rejections.update(
                {str(name): int(rows.sum()) for name, rows in verdict.broken.items()}
            )
            found = position[verdict.feasible]
            in_vain = 0 if len(found) else in_vain + BATCH
            if in_vain >= self.candidates:
                raise self._infeasible(in_vain)
            if in_vain == self.drawn == HOPELESS:
                self._require_hope()
            self._ready = np.concatenate([self._ready, found])
        chosen, self._ready = self._ready[:count], self._ready[count:]
        return chosen

    def _random(
        self, random: np.random.Generator, count: int, margin: FloatArray | float = 0.0
    ) -> FloatArray:
        """Return random configurations, (count, n) [rad], at most a margin beyond the limits."""
        space = self.feasibility
        if self.around is None:
            lower, upper = space.lower - margin, space.upper + margin
            return random.uniform(lower, upper, (count, len(lower)))
        spread = np.minimum(NEARBY, (space.upper - space.lower) / 4)
        middle = self.around[random.integers(len(self.around), size=count)]
        return middle + random.uniform(-spread, spread, middle.shape)

    def _probes(self, count: int, margin: FloatArray | float = 0.0) -> FloatArray:
        """Return configurations that are not of the sampler's own stream, which plans depend on."""
        return self._random(np.random.default_rng(0), count, margin)

    def _require_hope(self) -> None:
        """Refuse a robot that is blocked by what none of its joints moves."""
        if self.around is None and (blocked := self.feasibility.blocked(self._probes(BATCH))):
            condition, what = blocked
            raise InfeasiblePathError(
                condition,
                f"none of {self.drawn} random configurations is a feasible scaffold: {what}, "
                "however the joints move; change that, or choose the joints of the arm "
                "(`robot.urdf#arm_*`)",
            )

    def _infeasible(self, in_vain: int) -> InfeasiblePathError:
        found = hindrance(self.feasibility, self._probes(PROBES, self.feasibility.margin))
        return InfeasiblePathError(
            found.condition,
            f"none of {in_vain} random configurations is a feasible scaffold: {found.message}",
        )


def nearest_first(scaffolds: FloatArray, query: FloatArray) -> IntArray:
    """Return the rows of `scaffolds`, (L, n), from the nearest to `query`, (n,), outwards."""
    return np.argsort(np.linalg.norm(scaffolds - query, axis=1), kind="stable")


@dataclass(frozen=True)
class Exploration:
    """Sinusoidal path that starts at a scaffold; s is nominal time [s].

    q_j(s) = scaffold_j + e_j(s) - e_j(0),  e_j(s) = sum_k A_jk sin(2 pi f_jk s + phi_jk)

    Taking off e(0) lets the path start at the scaffold and leaves every derivative, and so every
    reversal, that of the sinusoids.

    Source: Algorithm 1 (LIMOPA) of the paper and the Fourier series in its text.
    """

    scaffold: FloatArray  # (n,) [rad]
    amplitude: FloatArray  # (n, k) [rad]
    frequency: FloatArray  # (n, k) [Hz] of nominal time
    phase: FloatArray  # (n, k) [rad]
    waypoints: int
    waypoint_period: float  # [s] of nominal time

    def __post_init__(self) -> None:
        for item in fields(self)[:4]:
            object.__setattr__(self, item.name, readonly(getattr(self, item.name)))

    @property
    def length(self) -> float:
        """Nominal time of the last waypoint [s]."""
        return (self.waypoints - 1) * self.waypoint_period

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` with respect to nominal time, (T, n) [rad/s^order]."""
        values = np.zeros((len(s), len(self.scaffold)))
        omega = 2 * np.pi * self.frequency
        for k in range(self.amplitude.shape[1]):
            angle = np.multiply.outer(s, omega[:, k]) + self.phase[:, k] + order * np.pi / 2
            values += self.amplitude[:, k] * omega[:, k] ** order * np.sin(angle)
        if order == 0:
            values += self.scaffold - np.sum(self.amplitude * np.sin(self.phase), axis=1)
        return values

    def peaks(self) -> FloatArray:
        """Return bounds of |q'|, |q''| and |q'''| of each joint, (3, n).

        Between waypoints a sinusoid exceeds its samples by at most 1 - cos(omega period / 2).
        """
        s = np.arange(self.waypoints, dtype=np.float64) * self.waypoint_period
        omega = 2 * np.pi * np.abs(self.frequency)
        missed = 1 - np.cos(np.minimum(omega * self.waypoint_period / 2, np.pi / 2))
        return np.stack(
            [
                np.abs(self.derivative(s, order)).max(axis=0)
                + np.sum(self.amplitude * omega**order * missed, axis=1)
                for order in (1, 2, 3)
            ]
        )


def draw_exploration(
    scaffold: FloatArray, ranges: Exploring, random: np.random.Generator
) -> Exploration:
    """Draw the sinusoids of one exploring phase around `scaffold`, (n,) [rad]."""
    shape = (len(scaffold), ranges.sinusoids)
    return Exploration(
        scaffold=scaffold,
        amplitude=random.uniform(*ranges.amplitude, shape),
        frequency=random.uniform(*ranges.frequency, shape),
        phase=random.uniform(*ranges.phase, shape),
        waypoints=int(random.integers(*ranges.waypoints, endpoint=True)),
        waypoint_period=ranges.waypoint_period,
    )
