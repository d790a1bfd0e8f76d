"""Scaffold configurations: uniform random draws from the feasible part of joint space.

Source: the first loop of Algorithm 1 (LIMOPA) of the paper.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import InfeasiblePathError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray
    from limopa.feasibility import Feasibility

BATCH = 512  # candidates checked at once
HOPELESS = 1024  # first draws in vain, after which it is asked whether any draw can help


class ScaffoldSampler:
    """Draw feasible scaffolds and count what rejected the others.

    A candidate that breaks several conditions counts for each of them.

    Args:
        feasibility: Conditions.
        random: Source of the draws.
        candidates: Draws in vain, for one scaffold, before giving up.
    """

    def __init__(
        self, feasibility: Feasibility, random: np.random.Generator, candidates: int
    ) -> None:
        self.feasibility, self.random, self.candidates = feasibility, random, candidates
        self.drawn = 0
        self.rejections: Counter[str] = Counter()
        self._ready = np.zeros((0, len(feasibility.lower)))

    def draw(self, count: int) -> FloatArray:
        """Draw `count` feasible configurations, (count, n) [rad].

        Raises:
            InfeasiblePathError: None of `candidates` draws in a row is feasible, and the error
                names the condition that rejected most; or the first draws show a link that no
                motion frees, which the error names.
        """
        in_vain = 0
        while len(self._ready) < count:
            found = self._batch()
            in_vain = 0 if len(found) else in_vain + BATCH
            if in_vain >= self.candidates:
                raise self._infeasible(in_vain)
            if in_vain == self.drawn == HOPELESS:
                self._require_hope()
            self._ready = np.concatenate([self._ready, found])
        chosen, self._ready = self._ready[:count], self._ready[count:]
        return chosen

    def _batch(self) -> FloatArray:
        space = self.feasibility
        position = self.random.uniform(space.lower, space.upper, (BATCH, len(space.lower)))
        verdict = space.check_scaffold(position)
        self.drawn += BATCH
        self.rejections.update(
            {str(name): int(rows.sum()) for name, rows in verdict.broken.items()}
        )
        return position[verdict.feasible]

    def _require_hope(self) -> None:
        """Refuse a robot that is blocked by what none of its joints moves."""
        space = self.feasibility
        probes = np.random.default_rng(0).uniform(
            space.lower, space.upper, (BATCH, len(space.lower))
        )  # not of the sampler's own stream, so that a plan does not depend on this
        if blocked := space.blocked(probes):
            condition, what = blocked
            raise InfeasiblePathError(
                condition,
                f"none of {self.drawn} random configurations is a feasible scaffold: {what}, "
                "however the joints move; choose the joints of the arm (`robot.urdf#arm_*`), or "
                "change the surroundings",
            )

    def _infeasible(self, in_vain: int) -> InfeasiblePathError:
        condition, _ = self.rejections.most_common(1)[0]
        counts = ", ".join(
            f"{name} {count}" for name, count in self.rejections.most_common() if count
        )
        return InfeasiblePathError(
            condition,
            f"none of {in_vain} random configurations is a feasible scaffold; "
            f"of {self.drawn} drawn, rejected by {counts}",
        )


def nearest_first(scaffolds: FloatArray, query: FloatArray) -> NDArray[np.int64]:
    """Return the rows of `scaffolds`, (L, n), from the nearest to `query`, (n,), outwards."""
    return np.argsort(np.linalg.norm(scaffolds - query, axis=1), kind="stable")
