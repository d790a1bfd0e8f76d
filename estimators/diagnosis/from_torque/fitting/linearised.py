"""Linearised: the torque around a simulation, as a sum over all of its parameters.

The numbers of what was found are free, settings that shape it among them, and everything else may
move within its tolerance. One such sum takes a fit to its end, by Gauss-Newton, and gives the
covariance of the numbers. Where errors are not what the noise model says, scores show it, summed
over blocks of time. And physics that nobody knows errs alike at its joint for as long as the arm
moves: it shows where joints disagree about what loads them all, such as a payload's mass, which is
then as much less sure as measurements are that disagree.

Sources: White, "Maximum likelihood estimation of misspecified models", Econometrica 1982; Birge,
"The calculation of errors by the method of least squares", Physical Review 40, 1932.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.stats import chi2

from estimators.diagnosis.from_torque.hypotheses.catalogue import (
    entries_of,
    found_in,
    off,
    possible,
    sides,
)
from estimators.diagnosis.from_torque.hypotheses.nuisance import (
    Nuisance,
    nuisance_of,
    without_sensors,
)
from estimators.diagnosis.from_torque.hypotheses.responses import (
    Improvement,
    beyond,
    difference,
    stacked,
)
from estimators.diagnosis.from_torque.residuals.noise import (
    ColumnTable,
    Noise,
    normal_equations,
    roughness,
)
from estimators.diagnosis.held_out import block_of, blocks_of_time, rmse
from estimators.diagnosis.settings import FINE, LEVEL
from estimators.diagnosis.settings.fitting import CANDIDATES, NEWTON
from estimators.regression.definite import inverse_root
from estimators.regression.evidence import Prior, joined, posterior
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Effect, Simulation
    from limo_driver.types import BoolArray, FloatArray, IntArray

Place: TypeAlias = "tuple[str, Sequence[int], bool]"  # effect, joints (1-based), if missing


@dataclass(frozen=True)
class Linearised:
    """Columns of everything around a simulation."""

    observed: Observations  # with that simulation
    found: tuple[Effect, ...]  # of it, whose numbers only data determine
    columns: ColumnTable
    nuisance: Nuisance
    known: Prior  # of the nuisance, around what the given simulation states
    own: tuple[Prior, ...]  # of the numbers of each effect found

    @classmethod
    def of(
        cls,
        observed: Observations,
        found: Sequence[Effect],
        bodies: Sequence[int] = (),
        stated: Simulation | None = None,
    ) -> Linearised:
        """Lay out the columns.

        Args:
            observed: The recordings with the simulation.
            found: Effects of that simulation.
            bodies: Links (0-based) of which nothing is known before the data.
            stated: The simulation whose values are known to its tolerances, if not this one.
        """
        given = observed.simulation
        rest = _without(given.effects, found)
        columns = ColumnTable(len(observed.kept), observed.n)
        floor = roughness(observed.residual, observed.moving, observed.least_noise)
        lacking = observed.under(replace(given, effects=rest), around=given)
        nuisance = nuisance_of(lacking, columns, floor, stated or given)
        nuisance = nuisance.certain(nuisance.contained_in(found))
        deviation = nuisance.prior.deviation.copy()
        for link in bodies:
            deviation[PER_LINK * link : PER_LINK * (link + 1)] = CANDIDATES.wrong_inertia
        own = tuple(_enter_columns(effect, lacking, columns) for effect in found)
        known = Prior.free(nuisance.prior.index, deviation)
        return cls(observed, tuple(found), columns, nuisance, known, own)

    def step(self, split: BoolArray) -> Observations | None:
        """Find a simulation that fits the rows of a split (K, n) better.

        First with everything free, and no joint may err more. Errors that are alike in time would
        let slow physics grow for a little less of noise, and bend what lies within tolerances
        towards it. Where that is all that such a step does, values stay, and only what was found
        moves: what was linear around another simulation may be far off at one joint, and to mend
        that may cost another a little. Lags and offsets of sensors, which no simulation has, are
        out of what is compared, so that no value has to make up for them.

        Returns:
            The recordings with it; None if there is none.
        """
        residual = self.observed.residual
        noise = Noise.of(residual, split, self.observed.segment, self.observed.least_noise)

        def left(trial: Observations) -> FloatArray:
            return without_sensors(trial.residual, noise, split, self.columns, self.nuisance)

        known = left(self.observed)
        size = rmse(known, split)
        enough = (1 - FINE) * _energy(known, noise, split)
        # tolerances count from what is stated, not from where we are
        start = self.nuisance.start
        for trial in self._shorter(self._newton(residual, noise, split, start, self.known)):
            its = left(trial)
            better = _energy(its, noise, split) < enough
            if better and (rmse(its, split) <= NEWTON.slack * size).all():
                return trial
        some = size > 0  # a joint without any torque errs by nothing, whatever is tried
        held = replace(self.known, deviation=np.zeros_like(self.known.deviation))
        for trial in self._shorter(self._newton(residual, noise, split, np.zeros(0), held)):
            its = left(trial)
            parts = rmse(its, split)[some] / size[some]
            if _energy(its, noise, split) < enough and np.mean(parts**2) <= 1.0:
                return trial
        return None

    def learned_from(self, split: BoolArray, given: Simulation) -> Observations:
        """Return the recordings with what a part of the rows (K, n) would have taught.

        By one step from what all of them did. What those rows say nothing of is as it is given: so
        count the numbers of what was found from there, as tolerances do.
        """
        residual = self.observed.residual
        noise = Noise.of(residual, split, self.observed.segment, self.observed.least_noise)
        start = np.concatenate([self.nuisance.start, *(off(own, given) for own in self.found)])
        most = (1 + FINE) * _energy(residual, noise, split)
        for trial in self._shorter(self._newton(residual, noise, split, start, self.known)):
            if _energy(trial.residual, noise, split) <= most:
                return trial
        return self.observed

    def _newton(
        self, residual: FloatArray, noise: Noise, split: BoolArray, start: FloatArray, known: Prior
    ) -> FloatArray:
        """Return the changes (c,) of all coefficients that fit a residual best.

        The first coefficients start where they are, counted from where their priors expect them.
        """
        found = joined(*self.own)
        index = joined(known, found).index[: start.size]
        off_by = residual + self.columns.apply(index, start)
        products = normal_equations(self.columns, off_by, noise, split)
        mean = posterior(products, known, found).mean
        mean[: start.size] -= start
        return mean

    def _shorter(self, step: FloatArray) -> Iterator[Observations]:
        """Yield the recordings with the simulation a step ahead, and parts of a step ahead."""
        for part in 0.5 ** np.arange(NEWTON.shorter + 1):
            try:
                yield self.observed.under(self._moved(part * step))
            except ConfigError:  # a combination that no such part has
                continue

    def _moved(self, coefficients: FloatArray) -> Simulation:
        given, count = self.observed.simulation, self.known.index.size
        others = _without(given.effects, self.found)
        extents = self.observed.extents
        improvement = Improvement(replace(given, effects=others), extents)
        self.nuisance.enter(improvement, coefficients[:count])
        changed = improvement.simulation()
        found, at = [], count
        for effect in self.found:
            entries = entries_of(effect)
            other = possible(effect, entries, coefficients[at : at + len(entries)])
            leaves = beyond(extents, other) and not beyond(extents, effect)
            found.append(effect if leaves else other)
            at += len(entries)
        rest, own = iter(changed.effects), dict(zip(map(id, self.found), found, strict=True))
        return replace(
            changed,
            effects=tuple(own[id(e)] if id(e) in own else next(rest) for e in given.effects),
        )

    def deviations(self) -> tuple[FloatArray, list[FloatArray]]:
        """Return standard deviations: of the nuisance, and of the numbers of each effect found."""
        spread = np.sqrt(self._variance())
        ends = np.cumsum([self.known.index.size, *(part.index.size for part in self.own)])
        return spread[: ends[0]], [spread[a:b] for a, b in pairwise(ends.tolist())]

    @property
    def entered(self) -> BoolArray:
        """Mark the coefficients (c,) that a simulation has; those of sensors it has not."""
        of_found = np.ones(sum(part.index.size for part in self.own), dtype=bool)
        return np.concatenate([self.nuisance.entered, of_found])

    def root(self) -> FloatArray:
        """Return R (c, c), with Rᵀ R the covariance of all coefficients.

        Were errors as the noise model says.
        """
        return self._information.root * self._prior.deviation

    @cached_property
    def _prior(self) -> Prior:
        return joined(self.known, *self.own)

    @cached_property
    def _information(self) -> _Information:
        return _Information.of(self.observed, self.columns, self._prior)

    def _variance(self) -> FloatArray:
        """Return the variance of each coefficient, in its own unit squared.

        The largest of those that errors have by the noise model, by their scores over blocks of
        time, and, of what several joints show, by how far these disagree.
        """
        known = self._information
        inverse = known.inverse
        scores = known.scores(_blocks(self.observed)) @ inverse
        spread = np.sum(scores**2, axis=0) + np.sum(inverse**2, axis=0)
        several = (np.diagonal(known.gram, axis1=1, axis2=2) > 0).sum(axis=0) > 1
        widened = np.where(several, known.disagreement(), 1.0) * np.diag(inverse)
        return np.maximum(widened, spread) * self._prior.deviation**2

    def deviation_of_sum(self, factors: FloatArray) -> float:
        """Return the standard deviation of a sum over all coefficients, by the same measures.

        Args:
            factors: That each coefficient is multiplied by, (c,).
        """
        known = self._information
        along = known.inverse @ (factors * self._prior.deviation)
        scores = known.scores(_blocks(self.observed)) @ along
        spread = float(scores @ scores + along @ along)
        by_model = float(along @ (factors * self._prior.deviation))
        return float(np.sqrt(max(known.disagreement() * by_model, spread)))


@dataclass(frozen=True)
class _Information:
    """What each joint tells of c coefficients, in units of their prior deviations."""

    gram: FloatArray  # (n, c, c)
    product: FloatArray  # (n, c)
    white: tuple[tuple[BoolArray, IntArray, FloatArray, FloatArray], ...]
    # of each joint: rows (K,), which coefficients, their columns on those rows, the residual there

    @classmethod
    def of(cls, observed: Observations, columns: ColumnTable, prior: Prior) -> _Information:
        use, size = observed.moving, prior.index.size
        noise = Noise.of(observed.residual, use, observed.segment, observed.least_noise)
        gram, product = np.zeros((observed.n, size, size)), np.zeros((observed.n, size))
        white: list[tuple[BoolArray, IntArray, FloatArray, FloatArray]] = []
        for joint in range(observed.n):
            values, at = columns.of_joint(joint)
            rows = use[:, joint]
            own = noise.whiten(values, joint, rows) * prior.deviation[at]
            y = noise.whiten(observed.residual[:, joint], joint, rows)
            gram[joint][np.ix_(at, at)] = own.T @ own
            product[joint, at] = own.T @ y
            white.append((rows, at, own, y))
        return cls(gram, product, tuple(white))

    @cached_property
    def root(self) -> FloatArray:
        """Root R (c, c) of the covariance Rᵀ R of the coefficients by all joints together."""
        return _root(self.gram.sum(axis=0))

    @cached_property
    def inverse(self) -> FloatArray:
        """Covariance of the coefficients by all joints together, (c, c)."""
        return self.root.T @ self.root

    @cached_property
    def best(self) -> FloatArray:
        """Coefficients by all joints together, (c,): where scores, which count, sum to none."""
        return self.inverse @ self.product.sum(axis=0)

    def scores(self, block: IntArray) -> FloatArray:
        """Return scores beside the best coefficients, summed over blocks of time, (blocks, c)."""
        result = np.zeros((int(block.max()) + 1, self.best.size))
        for rows, at, own, y in self.white:
            errors = y - own @ self.best[at]
            np.add.at(result, np.ix_(block[rows], at), own * errors[:, None])
        return result

    def disagreement(self) -> float:
        """Return how far joints disagree, over how far those that err by chance do; else 1.

        That is what the fits would gain if each joint had coefficients of its own, over the
        effective number of coefficients that this would add; 1 where chance may bring as much.
        """
        gained = added = 0.0
        for gram, product in zip(self.gram, self.product, strict=True):
            root = _root(gram)
            off = root @ (product - gram @ self.best)
            gained += float(off @ off)
            added += float(np.sum((root @ gram) * root))
        added -= float(np.sum(self.gram.sum(axis=0) * self.inverse))
        if added < 1.0:  # no two joints show the same
            return 1.0
        return gained / added if gained > float(chi2.ppf(LEVEL, added)) else 1.0


def _root(gram: FloatArray) -> FloatArray:
    return inverse_root(gram + np.eye(len(gram)))  # in units of prior deviations


def polished(
    around: Observations, given: Simulation, split: BoolArray, places: Sequence[Place]
) -> Observations:
    """Fit all parameters once more, linearised where they are now.

    The first fit is linear around the given simulation; widths of signs, bodies and stiffnesses
    that moved far from it, and effects that act on one another, need more steps.

    Args:
        around: The recordings with the simulation to start from.
        given: The simulation whose tolerances hold.
        split: Rows to fit to, (K, n).
        places: Of what was found: effect, joints (1-based), and whether it was missing.

    Returns:
        The recordings with the fitted simulation.
    """
    for _ in range(NEWTON.rounds):
        if (better := linearised(around, given, places).step(split)) is None:
            break
        around = better
    return around


def linearised(around: Observations, given: Simulation, places: Sequence[Place]) -> Linearised:
    """Lay out the columns around a simulation, of all that was found.

    Args:
        around: The recordings with the simulation.
        given: The simulation whose tolerances hold.
        places: Of what was found: effect, joints (1-based), and whether it was missing.
    """
    bodies = [on[0] - 1 for effect, on, _ in places if effect == "link_inertia"]
    return Linearised.of(around, effects_at(around.simulation, places), bodies, given)


def effects_at(simulation: Simulation, places: Sequence[Place]) -> tuple[Effect, ...]:
    """Return the effects of a simulation that were found at some places."""
    own = (found_in(simulation, effect, on, missing=missing) for effect, on, missing in places)
    return tuple({id(effect): effect for effect in own if effect is not None}.values())


def _without(effects: Sequence[Effect], some: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects but some of them: the very same, since two may be alike."""
    return tuple(effect for effect in effects if not any(effect is other for other in some))


def _energy(residual: FloatArray, noise: Noise, use: BoolArray) -> float:
    white = (noise.whiten(residual[:, j], j, use[:, j]) for j in range(residual.shape[1]))
    return float(sum(values @ values for values in white))


def _enter_columns(effect: Effect, observed: Observations, columns: ColumnTable) -> Prior:
    """Add what each number of an effect adds to the torque, to first order."""
    entries = entries_of(effect)
    ends = [sides(effect, entry) for entry in entries]
    parts = [difference(ahead, behind, observed) for ahead, behind, _ in ends]
    joints, values = stacked(parts, columns.rows)
    values /= np.array([span for _, _, span in ends])
    return Prior.free(columns.add(joints, values), np.array([e.deviation for e in entries]))


def _blocks(observed: Observations) -> IntArray:
    """Number the block of time of each row, (K,)."""
    length = block_of(observed, NEWTON.block)
    return blocks_of_time(observed.slow.time, observed.segment, length)
