"""How well inertias and friction are known once recordings have been fitted.

Inertia: D is ½ δᵀ M δ for a small change δ of a link's ten parameters (M from `body_metric`), so
tr(M Σ) / 10 is the mean relative variance of a body whose parameters have the covariance Σ. Before
the data that is the tolerance of the fit squared; what the motion reveals makes it smaller. The
tolerance written is its root, over all links.

Friction: along the recorded motion, with a joint's friction columns y and parameters beta,

    relative variance = tr(G Σ) / betaᵀ G beta,    G = Σ_t y_t y_tᵀ / T.

So a viscous part that hardly shows beside dry friction does not make the friction unknown. The
tolerance is the root of its mean over the joints that have friction; no joint counts beyond 1.

Neither falls below the default of `Tolerances`: the deviations are those of a model, and no model
of friction holds better from one day to the next.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.consistent import body_metric
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics import Tolerances

if TYPE_CHECKING:
    from estimators.rigid_body.consistent import ConsistentFit
    from estimators.rigid_body.terms import JointTerms
    from limo_driver.types import FloatArray

_DIGITS = 3  # a deviation is not known to more


def tolerances_of(fit: ConsistentFit, gram: FloatArray, terms: JointTerms) -> Tolerances:
    """Return the relative standard deviations of inertias and friction.

    Args:
        fit: Bodies and joint terms.
        gram: Mean outer product of each joint's regressor, (n, p, p).
        terms: The joint terms fitted.
    """
    default = Tolerances()
    return Tolerances(
        max(default.inertia, round(_of_inertias(fit, len(gram)), _DIGITS)),
        max(default.friction, round(_of_friction(fit, gram, terms), _DIGITS)),
    )


def _of_inertias(fit: ConsistentFit, links: int) -> float:
    variance = 0.0
    for i in range(links):
        at = slice(PER_LINK * i, PER_LINK * (i + 1))
        variance += float(np.sum(body_metric(fit.parameters[at]) * fit.covariance[at, at]))
    return float(np.sqrt(variance / (PER_LINK * links)))


def _of_friction(fit: ConsistentFit, gram: FloatArray, terms: JointTerms) -> float:
    n = len(gram)
    kinds = [k for k, term in enumerate(terms.all()) if term.effect.endswith("friction")]
    found: list[float] = []
    for j in range(n):
        at = PER_LINK * n + n * np.array(kinds) + j
        G, beta = gram[j][np.ix_(at, at)], fit.parameters[at]
        energy = float(beta @ G @ beta)  # [N² m²]
        if energy > 0:
            variance = float(np.sum(G * fit.covariance[np.ix_(at, at)]))
            found.append(min(1.0, variance / energy))
    return float(np.sqrt(np.mean(found))) if found else 0.0
