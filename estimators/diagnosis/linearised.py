"""Linearised: the torque around a simulation, as a sum over all of its parameters.

The numbers of what was found are free, settings that shape it among them, and everything else may
move within its tolerance. One such sum takes a fit to its end, by Gauss-Newton, and gives the
covariance of the numbers. Where errors are not what the noise model says, scores summed over blocks
of time show it, and the larger of the two variances counts.

Source: White, "Maximum likelihood estimation of misspecified models", Econometrica 1982.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.columns import Columns, Products
from estimators.diagnosis.evidence import Prior, joined, posterior
from estimators.diagnosis.improvement import Improvement
from estimators.diagnosis.noise import Noise, roughness
from estimators.diagnosis.nuisance import Nuisance, nuisance_of
from estimators.diagnosis.responses import difference, seen_before
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import ConfigError
from limo_driver.physics.effect import JOINT, TEXT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.observations import Observations
    from limo_driver.physics import Effect, Parameter, Simulation
    from limo_driver.types import FloatArray

_STEP = 1e-3  # prior deviations, for derivatives
_BLOCK = 2.0  # [s], over which scores are summed
_CHOSEN = {"positions", "times", "windows", "wrench", "ratio", "reference"}
_FREE_INERTIA = 0.4  # relative deviation of a body that is simply wrong
_OF_LISTS = {"com": 0.2, "inertia": 0.02, "gravity": 1.0, "phase": 1.0}  # prior deviation
_ANGLE = 1.0  # [rad], prior deviation of a rest position
_ROUNDS = 5  # of Gauss-Newton, at most
_ENOUGH = 1e-3  # part of the sum of squared whitened errors that a round has to take off
_SHORTER = (1.0, 0.5, 0.2)  # parts of a step that are tried


@dataclass(frozen=True)
class Entry:
    """One number among the parameters of an effect."""

    name: str
    at: int | None  # place in a list
    value: float
    deviation: float  # before any data
    within: tuple[float, float]

    @property
    def span(self) -> float:
        """How far two steps for a derivative, one either way, lie apart inside the bounds."""
        ahead, behind = (self.value + sign * _STEP * self.deviation for sign in (1, -1))
        return float(np.clip(ahead, *self.within) - np.clip(behind, *self.within))

    def moved(self, effect: Any, by: float) -> Effect:  # noqa: ANN401  # of any class
        """Return the effect with this number moved, inside its bounds."""
        value = float(np.clip(self.value + by, *self.within))
        if self.at is None:
            return replace(effect, **{self.name: value})
        values = list(getattr(effect, self.name))
        values[self.at] = value
        return replace(effect, **{self.name: tuple(values)})


def entries_of(effect: Effect) -> tuple[Entry, ...]:
    """Return the numbers of an effect that are estimated; a zero is a part that it lacks."""
    return tuple(
        Entry(known.name, at, value, deviation, (known.lower, known.upper))
        for known in effect.parameters()
        for at, value in numbers_of(effect, known)
        if (deviation := _deviation(known, value))
    )


def numbers_of(effect: Any, known: Parameter) -> Iterator[tuple[int | None, float]]:  # noqa: ANN401
    """Yield place in a list and value of the numbers of a parameter that are not chosen."""
    value = getattr(effect, known.name)
    if value is None or known.unit in {TEXT, JOINT} or known.name in _CHOSEN:
        return
    if known.is_list:
        yield from enumerate(map(float, value))
    else:
        yield None, float(value)


def _deviation(known: Parameter, value: float) -> float:
    """Return how far a number may be off before any data, in its unit."""
    if known.is_list and known.name in _OF_LISTS:
        return _OF_LISTS[known.name]
    return _ANGLE if known.name == "rest" else abs(value)


def found_in(
    simulation: Simulation, effect: str, joints: Sequence[int], *, missing: bool
) -> Effect | None:
    """Return the effect of an improved simulation that a finding is about.

    Args:
        simulation: The improved simulation.
        effect: Identifier.
        joints: 1-based; of the whole arm all or none.
        missing: Whether it was added, rather than changed.
    """
    same = [
        item
        for item in simulation.effects
        if item.name == effect and set(item.joints) <= set(joints)
    ]
    return (same[-1] if missing else same[0]) if same else None


@dataclass(frozen=True)
class Linearised:
    """Columns of everything around a simulation."""

    observed: Observations  # beside that simulation
    found: tuple[Effect, ...]  # of it, whose numbers only data determine
    columns: Columns
    nuisance: Nuisance
    known: Prior  # of the nuisance
    own: tuple[Prior, ...]  # of the numbers of each effect found

    @classmethod
    def of(
        cls, observed: Observations, found: Sequence[Effect], bodies: Sequence[int] = ()
    ) -> Linearised:
        """Lay out the columns.

        Args:
            observed: The recordings beside the simulation.
            found: Effects of that simulation.
            bodies: Links (0-based) of which nothing is known before the data.
        """
        given = observed.simulation
        rest = tuple(item for item in given.effects if not any(item is f for f in found))
        columns = Columns(len(observed.kept), observed.n)
        nuisance = nuisance_of(
            replace(observed, simulation=replace(given, effects=rest), around=given),
            columns,
            roughness(observed.residual, observed.moving),
        )
        deviation = nuisance.prior.deviation.copy()
        for link in bodies:
            deviation[PER_LINK * link : PER_LINK * (link + 1)] = _FREE_INERTIA
        own = tuple(_entered(effect, observed, columns) for effect in found)
        known = Prior.free(nuisance.prior.index, deviation)
        return cls(observed, tuple(found), columns, nuisance, known, own)

    def step(self, split: NDArray[np.bool_]) -> Simulation | None:
        """Return the simulation that fits the rows of a split (K, n) better; None if none does."""
        residual = self.observed.residual
        noise = Noise.of(residual, split, self.observed.segment)
        products = Products.of(self.columns, residual, noise, split)
        mean = posterior(products, self.known, joined(*self.own)).mean
        for part in _SHORTER:
            try:
                moved = self._moved(part * mean)
            except ConfigError:  # a combination that no such part has
                continue
            left = replace(self.observed, simulation=moved).residual
            if _energy(left, noise, split) < (1 - _ENOUGH) * products.energy:
                return moved
        return None

    def _moved(self, coefficients: FloatArray) -> Simulation:
        given, count = self.observed.simulation, self.known.index.size
        others = tuple(item for item in given.effects if not any(item is f for f in self.found))
        improvement = Improvement(replace(given, effects=others))
        self.nuisance.enter(improvement, coefficients[:count])
        changed = improvement.simulation()
        found, at = list(self.found), count
        for place, effect in enumerate(self.found):
            for entry in entries_of(effect):
                found[place] = entry.moved(found[place], float(coefficients[at]))
                at += 1
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

    def _variance(self) -> FloatArray:
        """Return the variance of each coefficient, in its own unit squared."""
        observed, prior = self.observed, joined(self.known, *self.own)
        use, residual = observed.moving, observed.residual
        s, size = prior.deviation, prior.index.size
        noise, block = Noise.of(residual, use, observed.segment), _blocks(observed)
        gram, scores = np.zeros((size, size)), np.zeros((int(block.max()) + 1, size))
        for joint in range(observed.n):
            values, at = self.columns.of_joint(joint)
            rows = use[:, joint]
            A = noise.whiten(values, joint)[rows] * s[at]
            y = noise.whiten(residual[:, joint], joint)[rows]
            gram[np.ix_(at, at)] += A.T @ A
            np.add.at(scores, np.ix_(block[rows], at), A * y[:, None])
        inverse = np.linalg.inv(gram + np.eye(size))
        spread = inverse @ (scores.T @ scores + np.eye(size)) @ inverse
        return np.maximum(np.diag(inverse), np.diag(spread)) * s**2


def polished(
    observed: Observations,
    simulation: Simulation,
    split: NDArray[np.bool_],
    places: Sequence[tuple[str, Sequence[int], bool]],
) -> Simulation:
    """Fit all parameters once more, linearised where they are now.

    The first fit is linear around the given simulation; widths of signs, bodies and stiffnesses
    that moved far from it, and effects that act on one another, need more steps.

    Args:
        observed: The recordings.
        simulation: The simulation to start from.
        split: Rows to fit to, (K, n).
        places: Of what was found: effect, joints (1-based), and whether it was missing.
    """
    for _ in range(_ROUNDS):
        own = [found_in(simulation, effect, on, missing=missing) for effect, on, missing in places]
        around = replace(observed, simulation=simulation, around=None)
        found = {id(effect): effect for effect in own if effect is not None}
        better = Linearised.of(around, tuple(found.values())).step(split)
        if better is None:
            break
        simulation = better
    return simulation


def _energy(residual: FloatArray, noise: Noise, use: NDArray[np.bool_]) -> float:
    white = (noise.whiten(residual[:, j], j)[use[:, j]] for j in range(residual.shape[1]))
    return float(sum(values @ values for values in white))


def _entered(effect: Effect, observed: Observations, columns: Columns) -> Prior:
    """Add what each number of an effect adds to the torque, to first order."""
    entries = entries_of(effect)
    around = seen_before(effect, observed)
    parts = [
        difference(
            e.moved(effect, _STEP * e.deviation), e.moved(effect, -_STEP * e.deviation), around
        )
        for e in entries
    ]
    joints = sorted({joint for part in parts for joint in part.joints})
    values = np.zeros((len(joints), len(observed.kept), len(entries)))
    for k, part in enumerate(parts):
        for joint, row in zip(part.joints, part.values, strict=True):
            values[joints.index(joint), :, k] = row / entries[k].span
    return Prior.free(columns.add(joints, values), np.array([e.deviation for e in entries]))


def _blocks(observed: Observations) -> NDArray[np.int64]:
    """Number the block of time of each row, (K,)."""
    of_time = np.floor(observed.slow.time / _BLOCK).astype(np.int64)
    both = np.stack([observed.segment, of_time], axis=1)
    return np.unique(both, axis=0, return_inverse=True)[1].ravel()
