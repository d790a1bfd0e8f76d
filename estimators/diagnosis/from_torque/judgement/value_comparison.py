"""A given simulation, what was proven and what fits: how values differ, and what that takes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import surely_less
from estimators.diagnosis.from_torque.fitting.entries import entries_of, found_in
from estimators.diagnosis.from_torque.fitting.linearised import Linearised
from estimators.diagnosis.from_torque.judgement.conclusion import above_floor
from estimators.diagnosis.from_torque.judgement.judged_set import places_of
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.judgement import VALUES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.verdict import Finding
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class ValueComparison:
    """A given, a proven and a fitted simulation, and what is known of their values."""

    judged: JudgedSet
    improved: Observations
    stated: Simulation
    findings: tuple[Finding, ...]
    around: Linearised
    deviation: FloatArray  # (c,) of the coefficients of what may move within its tolerance
    found: dict[tuple[int, str], float]  # deviations of sizes of what was found, by effect and name

    @classmethod
    def of(
        cls,
        judged: JudgedSet,
        improved: Observations,
        stated: Simulation,
        findings: tuple[Finding, ...],
    ) -> Self:
        """Linearise around the improved simulation, whose values were known as they are stated."""
        own = [
            found_in(improved.simulation, effect, on, missing=missing)
            for effect, on, missing in places_of(judged.problem, judged.solution)
        ]
        found = tuple({id(effect): effect for effect in own if effect is not None}.values())
        around = Linearised.of(improved, found, (), stated)
        deviation, of_found = around.deviations()
        spread = {
            (id(effect), entry.name): sigma
            for effect, sigmas in zip(found, of_found, strict=True)
            for entry, sigma in zip(entries_of(effect), sigmas.tolist(), strict=True)
        }
        return cls(judged, improved, stated, findings, around, deviation, spread)

    @property
    def proof(self) -> Observations:
        """The recordings and a simulation that was fitted to no row held out."""
        return self.judged.beside

    @cached_property
    def before(self) -> FloatArray:
        """Held-out RMSE of the given simulation, (n,) [N m]."""
        problem = self.judged.problem
        return rmse(problem.observed.residual, problem.split.held_out)

    @cached_property
    def above(self) -> NDArray[np.bool_]:
        """Mark the joints (n,) at which the given simulation surely errs by more than noise."""
        problem, floor = self.judged.problem, self.judged.remaining.floor
        found = above_floor(problem, problem.observed.residual, floor)
        return np.isin(np.arange(self.improved.n), found)

    @cached_property
    def tolerated(self) -> dict[tuple[str, tuple[int, ...], str], int]:
        """Which coefficient each value has that may move, by effect, joints (0-based) and name."""
        every = enumerate(self.around.nuisance.parameters)
        return {(*x.place, x.known.name): k for k, x in every if x.known is not None}

    def names(self, joints: Sequence[int]) -> tuple[str, ...]:
        """Return the names of some joints, 1-based."""
        return tuple(self.stated.model.joint_names[j - 1] for j in joints)

    def taken(
        self, change: FloatArray, acts: NDArray[np.bool_], *, doubtless: bool = False
    ) -> tuple[float, bool]:
        """Return which part of a joint's reducible error a change takes, and whether that counts.

        Args:
            change: Torque by which the proven simulation differs from another, (K, n) [N m].
            acts: Joints at which it acts, (n,).
            doubtless: Whether it counts also where the given simulation errs hardly more than
                noise.
        """
        judged, rows = self.judged, self.judged.problem.split.held_out
        after, floor = judged.proven, judged.remaining.floor
        lost = rmse(after + change, rows) ** 2 - rmse(after, rows) ** 2
        reducible = self.before**2 - floor**2
        some = acts & (self.above | doubtless) & rows.any(axis=0)
        part = np.divide(lost, reducible, out=np.zeros_like(lost), where=some & (reducible > 0))
        joint = int(np.argmax(part))
        if part[joint] < VALUES.share:
            return max(float(part[joint]), 0.0), False
        own = [joint]
        sure = surely_less(
            after[:, own],
            (after + change)[:, own],
            floor[own],
            judged.problem.observed,
            rows[:, own],
        )
        return min(float(part[joint]), 1.0), sure
