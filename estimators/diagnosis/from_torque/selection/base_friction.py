"""Base friction: Coulomb and viscous friction of joints that the simulation gives none.

A bare robot description says nothing of friction, which is not to say that there is none. Beside
friction that is not in, what is missing besides would not show: so the search starts with Coulomb
and viscous friction at those joints, and keeps them where the recordings speak for them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.improvement import Improvement
from estimators.diagnosis.from_torque.residuals.noise import Noise, roughness
from estimators.diagnosis.from_torque.selection.candidates import (
    BASE,
    Candidate,
    entered,
    without_friction,
)
from estimators.diagnosis.from_torque.selection.columns import ColumnTable, normal_equations
from estimators.diagnosis.from_torque.selection.nuisance import nuisance_of
from estimators.diagnosis.from_torque.selection.search import Search
from estimators.diagnosis.held_out import Split, rmse
from estimators.diagnosis.settings.selection import BASE_FRICTION
from estimators.regression.evidence import Evidence, Posterior
from estimators.regression.ties import first_best
from limo_driver.physics import CoulombFriction, ViscousFriction
from limo_driver.physics.catalogue import known_as

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

SIGN_WIDTHS = tuple(  # [rad/s]
    np.geomspace(BASE_FRICTION.narrowest, BASE_FRICTION.widest, BASE_FRICTION.widths).tolist()
)


def rubs(effect: str) -> bool:
    """Say whether an effect is a law of a joint's friction."""
    known = known_as(effect)
    return known is not None and known.rubs


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
    candidates = _competing(observed, columns, bare, rough)

    def fit(noise: Noise) -> tuple[tuple[int, ...], Posterior]:
        evidence = Evidence(normal_equations(columns, residual, noise, rows), nuisance)
        search = Search(candidates, evidence)
        members = _likeliest(search)
        return members, evidence.posterior(search.prior(members))

    members, fitted = fit(Noise.independent(rough, rows))
    for _ in range(BASE_FRICTION.turns):
        left = residual - columns.apply(fitted.index, fitted.mean)
        members, fitted = fit(Noise.of(left, rows, observed.segment, observed.least_noise))
    improvement = Improvement(observed.simulation)
    for member, size in zip(members, fitted.mean[nuisance.index.size :], strict=True):
        candidates[member].enter(improvement, np.array([size]))
    return observed.beside(observed.simulation, around=improvement.simulation())


def _competing(
    observed: Observations, columns: ColumnTable, bare: Sequence[int], rough: FloatArray
) -> list[Candidate]:
    level = np.maximum(rmse(observed.residual, observed.moving), 3 * rough)
    tried = [
        hypothesis
        for j in bare
        for hypothesis in (
            *(CoulombFriction.of_unit_size(j + 1, width) for width in SIGN_WIDTHS),
            ViscousFriction.of_unit_size(j + 1),
        )
    ]
    found = (entered(hypothesis, observed, columns, level) for hypothesis in tried)
    return [candidate for candidate in found if candidate is not None]


def _likeliest(search: Search) -> tuple[int, ...]:
    """Return one candidate of each place, each the likeliest beside the others."""
    variants: dict[object, list[int]] = {}
    for i, candidate in enumerate(search.candidates):
        variants.setdefault(candidate.place, []).append(i)
    chosen = {place: indices[len(indices) // 2] for place, indices in variants.items()}
    for _ in range(BASE_FRICTION.turns):
        for place, indices in variants.items():
            rest = [i for other, i in chosen.items() if other != place]
            chosen[place] = first_best(indices, lambda i: search.gain((*rest, i)))  # noqa: B023  # at once
    return tuple(chosen.values())
