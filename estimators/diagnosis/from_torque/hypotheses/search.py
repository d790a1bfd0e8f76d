"""Search for the set of effects of most evidence.

Greedy addition fails: two effects together can explain what neither does alone, and the first one
chosen is often a blend of both. So a beam of the best sets is grown, then every member is tried
out of it and every member is swapped for every other candidate.

Base friction: Coulomb and viscous friction of joints that the simulation gives none.

A bare robot description says nothing of friction, which is not to say that there is none. Beside
friction that is not in, what is missing besides would not show: so the search starts with Coulomb
and viscous friction at those joints, and keeps them where the recordings speak for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.candidates import (
    BASE,
    Candidate,
    entered,
    without_friction,
)
from estimators.diagnosis.from_torque.hypotheses.nuisance import nuisance_of
from estimators.diagnosis.from_torque.hypotheses.responses import Improvement
from estimators.diagnosis.from_torque.residuals.noise import (
    ColumnTable,
    Noise,
    normal_equations,
    roughness,
)
from estimators.diagnosis.held_out import Split, rmse
from estimators.diagnosis.settings import FEW
from estimators.diagnosis.settings.fitting import SEARCH, SOLVING
from estimators.diagnosis.stages import end_if_late
from estimators.regression.definite import best_first, first_best, is_more, ranked
from estimators.regression.evidence import Evidence, Posterior, Prior, Priors
from limo_driver.physics import CoulombFriction, ViscousFriction
from limo_driver.physics.catalogue import known_as
from limo_driver.physics.effects.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray, IntArray

# [rad/s], of friction that a bare description lacks: wider is viscous friction by another name
SIGN_WIDTHS = tuple((SIGN_WIDTH * 2.0 ** np.arange(-FEW, FEW)).tolist())


@dataclass(frozen=True)
class Explained:
    """A set of candidates, by index, and its log evidence against none, less its rarity."""

    members: tuple[int, ...]
    gain: float


class Search:
    """Finds the best set.

    Args:
        candidates: What competes.
        evidence: How sets compare.
        base: Candidates, by index, of the set that is grown; what brings nothing is taken out.
    """

    def __init__(
        self, candidates: Sequence[Candidate], evidence: Evidence, base: tuple[int, ...] = ()
    ) -> None:
        self.candidates, self.evidence, self.base = candidates, evidence, base
        self._known: dict[tuple[int, ...], float] = {(): 0.0}
        self._priors = Priors.of_each([item.prior for item in candidates])
        self._prices = np.array([item.price for item in candidates])
        slots = {item.slot: i for i, item in enumerate(candidates)}  # one effect has each of them
        self._slots = np.array([slots[item.slot] for item in candidates], dtype=np.int64)

    def gain(self, members: Iterable[int]) -> float:
        """Return the log evidence of a set, less its rarity."""
        key = tuple(sorted(members))
        if key not in self._known:
            end_if_late()
            price = float(self._prices[list(key)].sum())
            self._known[key] = self.evidence.gain(self.prior(key)) - price
        return self._known[key]

    def prior(self, members: Sequence[int]) -> Prior:
        """Return the columns of a set, in the order of its members."""
        return self._priors.together.of(self._priors.rows(members))

    def best(self) -> Explained:
        """Return the best set."""
        return self._settled(self._grown_from(self._needed(self.base)))

    def around(self, members: Iterable[int]) -> Explained:
        """Return the best set near a given one: others may be added, and idle members removed."""
        return self._needed(self._grown_from(self._needed(tuple(members))).members)

    def _grown_from(self, best: Explained) -> Explained:
        beam = [best.members]
        for _ in range(SEARCH.largest + len(self.base) - len(best.members)):
            grown = self._grown(beam, SEARCH.width)
            if not grown or not is_more(grown[0].gain, best.gain):
                break
            best = grown[0]
            beam = [item.members for item in grown]
        return best

    def _needed(self, members: tuple[int, ...]) -> Explained:
        """Take out of a set what the recordings do not speak for, one after the other."""
        best = Explained(tuple(sorted(members)), self.gain(members))
        while best.members:
            options = [best.members[:k] + best.members[k + 1 :] for k in range(len(best.members))]
            smaller = first_best(options, self.gain)
            if not is_more(self.gain(smaller), best.gain):
                break
            best = Explained(smaller, self.gain(smaller))
        return best

    def ranked(self, base: Sequence[int], limit: int) -> list[Explained]:
        """Return the best single additions to a set."""
        return self._grown([tuple(base)], limit)

    def _grown(self, beam: Sequence[tuple[int, ...]], width: int) -> list[Explained]:
        found: set[tuple[int, ...]] = set()
        for members in beam:
            some, gains = self._with_one_more(members)
            most = some[best_first(gains)[:width]].tolist()
            found |= {tuple(sorted((*members, i))) for i in most}
        return [Explained(key, self.gain(key)) for key in ranked(sorted(found), self.gain)[:width]]

    def _with_one_more(self, members: tuple[int, ...]) -> tuple[IntArray, FloatArray]:
        """Return the candidates that fit next to a set, (p,), and the gain less their prices."""
        taken = np.isin(self._slots, self._slots[list(members)])
        taken[list(members)] = True
        some = np.flatnonzero(~taken)
        gains = self.evidence.gains(self._priors, members, some)
        return some, gains - self._prices[some]

    def _settled(self, best: Explained) -> Explained:
        """Take members out and swap them while that helps: each time the set is likelier."""
        while True:
            options = [best.members[:k] + best.members[k + 1 :] for k in range(len(best.members))]
            trials = [Explained(option, self.gain(option)) for option in options]
            trials += self._grown(options, SEARCH.width) if options else []
            better = first_best([best, *trials], lambda item: item.gain)
            if better is best:
                return best
            best = better


def is_friction(effect: str) -> bool:
    """Say whether an effect is a law of a joint's friction."""
    known = known_as(effect)
    return known is not None and known.is_friction


def base_of(candidates: Sequence[Candidate], simulation: Simulation) -> tuple[int, ...]:
    """Return the candidates, by index, that the search has to start with."""
    bare = without_friction(simulation)
    return tuple(
        i
        for i, candidate in enumerate(candidates)
        if candidate.effect in BASE and candidate.joints[0] in bare
    )


def with_friction(observed: Observations) -> Observations:
    """Take columns around a simulation that has Coulomb and viscous friction at every joint.

    Its size follows from all joints together beside what tolerances allow, and the width of its
    sign, which all dry friction of a joint shares, is the likeliest of `SIGN_WIDTHS`.
    """
    bare = without_friction(observed.simulation)
    if not bare:
        return observed
    residual, rows = observed.residual, Split.of(observed).fitted
    columns, rough = (
        ColumnTable(*residual.shape),
        roughness(residual, observed.moving, observed.least_noise),
    )
    nuisance = nuisance_of(observed, columns, rough).prior
    level = level_of(observed, rough)
    tried = [
        hypothesis
        for j in bare
        for hypothesis in (
            *(CoulombFriction.of_unit_size(j + 1, width) for width in SIGN_WIDTHS),
            ViscousFriction.of_unit_size(j + 1),
        )
    ]
    found = (entered(hypothesis, observed, columns, level) for hypothesis in tried)
    candidates = [candidate for candidate in found if candidate is not None]

    def fit(noise: Noise) -> tuple[tuple[int, ...], Posterior]:
        evidence = Evidence(normal_equations(columns, residual, noise, rows), nuisance)
        search = Search(candidates, evidence)
        members = _likeliest(search)
        return members, evidence.posterior(search.prior(members))

    members, fitted = fit(Noise.independent(rough, rows))
    for _ in range(SOLVING.rounds):
        left = residual - columns.apply(fitted.index, fitted.mean)
        members, fitted = fit(Noise.of(left, rows, observed.segment, observed.least_noise))
    improvement = Improvement(observed.simulation)
    for member, size in zip(members, fitted.mean[nuisance.index.size :], strict=True):
        candidates[member].enter(improvement, np.array([size]))
    return observed.under(observed.simulation, around=improvement.simulation())


def level_of(observed: Observations, rough: FloatArray) -> FloatArray:
    """Return the plausible RMS of a missing torque at each joint, above rough noise (n,) [N m]."""
    return np.maximum(rmse(observed.residual, observed.moving), 3 * rough)


def _likeliest(search: Search) -> tuple[int, ...]:
    """Return one candidate of each place, each the likeliest beside the others."""
    variants: dict[object, list[int]] = {}
    for i, candidate in enumerate(search.candidates):
        variants.setdefault(candidate.place, []).append(i)
    chosen = {place: indices[len(indices) // 2] for place, indices in variants.items()}
    for _ in range(SOLVING.rounds):
        for place, indices in variants.items():
            rest = [i for other, i in chosen.items() if other != place]
            chosen[place] = first_best(indices, lambda i: search.gain((*rest, i)))  # noqa: B023  # at once
    return tuple(chosen.values())
