"""What the file of an arm states, and how far what was identified may be from it.

Tolerances of inertias and friction after a fit, as relative standard deviations.

The torque does not depend on what a motion does not reveal. So the question is not how well each
parameter of each link is known, but how far the torque of the recorded motion could be off for what
is not known of them. With the regressor rows y_j of joint j and its errors e_j,

    loss(Σ) = Σ_j tr(G_j Σ) / mean(e_j²),    G_j = mean of y_j y_jᵀ,

is the mean square of that torque, in units of each joint's error, if the parameters have the
covariance Σ. Here Σ is that of the fit (noise, and what only the description fixes) plus that of
the `jackknife` (what a wrong model pulls the parameters to; it holds part of the noise once more,
which errs to the safe side).

Inertia: bodies that are known to a relative deviation s have the covariance s² M⁻¹, since the
prior of the fit is ½ δᵀ M δ / s² for a small change δ of a link's ten parameters (M of
`metric_root`). The tolerance is the s at which such bodies would be as far off as the fit is:

    s² = loss(Σ) / loss(M⁻¹).

A motion that reveals nothing leaves s at the tolerance that the description had. One number stands
for all links: masses that carry large torques are known better, the lightest links less well.

Friction: of each joint that has some, with its friction's parameters beta, the relative variance
tr(G Σ) / betaᵀ G beta, at most 1; the tolerance is the root of its mean over these joints. So a
viscous part that hardly shows beside dry friction does not make the friction unknown.

Neither falls below the default of `Tolerances`: the deviations are those of one day, and no model
of friction holds better on the next.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.regression.definite import RegularisedInverse
from estimators.rigid_body.fitting.consistent import metric_root
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics import Armature, Effect, GravityDirection, Simulation, Tolerances
from limo_driver.physics.described import described_effects

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.rigid_body.fitting.normal_equations import ArmEquations
    from estimators.rigid_body.terms import JointTerms
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_DIGITS = 3  # a deviation is not known to more
_LEAST_ERROR = 1e-9  # [N m], so that exact data keep finite weights


def tolerances_of(
    parameters: FloatArray, covariance: FloatArray, equations: ArmEquations, terms: JointTerms
) -> Tolerances:
    """Return the relative standard deviations of inertias and friction.

    Args:
        parameters: Full parameters (p,) of the bodies and joint terms.
        covariance: Of those parameters, (p, p).
        equations: What they were fitted to.
        terms: The joint terms fitted.
    """
    default = Tolerances()
    error = np.maximum(equations.rmse(parameters), _LEAST_ERROR)
    gram, links = equations.mean_gram(), equations.chain.width
    n = len(gram)
    inertia = _of_inertias(
        parameters, covariance, np.tensordot(error**-2, gram, 1), equations.chain.links
    )
    kinds = [k for k, term in enumerate(terms.all()) if term.effect.endswith("friction")]
    found: list[float] = []
    for j in range(n):
        at = links + n * np.array(kinds) + j
        G, beta = gram[j][np.ix_(at, at)], parameters[at]
        energy = float(beta @ G @ beta)  # [N² m²]
        if energy > 0:
            variance = float(np.sum(G * covariance[np.ix_(at, at)]))
            found.append(min(1.0, max(variance, 0.0) / energy))  # rounding of none
    friction = float(np.sqrt(np.mean(found))) if found else 0.0
    return Tolerances(
        max(default.inertia, round(inertia, _DIGITS)),
        max(default.friction, round(friction, _DIGITS)),
    )


def _of_inertias(phi: FloatArray, covariance: FloatArray, G: FloatArray, links: int) -> float:
    at = slice(0, PER_LINK * links)
    known_to_one = np.zeros((PER_LINK * links, PER_LINK * links))  # covariance at s = 1
    for i in range(links):
        own = slice(PER_LINK * i, PER_LINK * (i + 1))
        nothing = np.zeros((PER_LINK, PER_LINK))
        known_to_one[own, own] = RegularisedInverse.of(nothing, metric_root(phi[own])).matrix
    return float(np.sqrt(np.sum(G[at, at] * covariance[at, at]) / np.sum(G[at, at] * known_to_one)))


def stated_armatures(model: RobotModel, terms: JointTerms) -> FloatArray:
    """Return parameters (p,) that are zero but for the armatures that the description states."""
    phi = np.zeros(PER_LINK * model.linkage.links + model.n * len(terms.all()))
    for effect in described_effects(model) if terms.armature else ():
        if isinstance(effect, Armature):
            phi[effect.joint - 1 - model.n] = effect.inertia
    return phi


def stated_beside(model: RobotModel, terms: JointTerms) -> tuple[Effect, ...]:
    """Return the effects of a description that are no friction, and none of the terms."""
    modelled = {term.effect for term in terms.all()}
    return tuple(
        effect
        for effect in described_effects(model)
        if not effect.is_friction and effect.name not in modelled
    )


def mounting_of(model: RobotModel) -> tuple[GravityDirection, ...]:
    """Return the gravity of a robot, where its description states another; else nothing."""
    stated = Simulation(model.name, inertials=model.inertials).model.gravity
    x, y, z = model.gravity
    return () if stated == model.gravity else (GravityDirection(gravity=(x, y, z)),)


def bare(model: RobotModel) -> Simulation:
    """Return a simulation of the bodies of a robot alone, as it hangs."""
    return Simulation(model.name, mounting_of(model), model.inertials)


def without_stated(
    model: RobotModel,
    recordings: Sequence[Recording],
    effects: tuple[Effect, ...],
    bandwidth: float,
) -> Sequence[Recording]:
    """Return recordings whose torque lacks that of some effects.

    Args:
        model: The robot.
        recordings: Measured motions and torques.
        effects: Whose torque is taken away.
        bandwidth: Of the filter on the motion that the effects are evaluated on [Hz].
    """
    if not effects:
        return recordings
    with_them, bare = Simulation(model.name, effects), Simulation(model.name)
    found: list[Recording] = []
    for recording in recordings:
        motion = recording.motion(bandwidth)
        added = [
            simulation.predict_stretches(motion, recording.segments, bandwidth)
            for simulation in (with_them, bare)
        ]
        found.append(replace(recording, torque=recording.torque - (added[0] - added[1])))
    return found
