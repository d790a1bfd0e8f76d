"""What has changed since an earlier fit: weights are those of before, and a change by the new data.

What a short motion does not show stays where longer motion had it. First comes a load at the
flange, ten parameters that all joints feel alike: of few poses one joint alone tells little of
them, and all joints enough. The weights of each joint may then differ from those of before as its
own data say, with priors of the change by their evidence, as of weights that were never fitted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.joint_physics.calibration import lower_root
from estimators.regression.definite import inverse_root, jackknife
from estimators.regression.empirical_bayes import LEAST_NOISE, RegionalFit, WeightPosterior

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from estimators.joint_physics.columns import JointColumns
    from estimators.joint_physics.normal_equations import MotionEquations, Sums
    from estimators.regression.evidence import NormalEquations
    from limo_driver.types import FloatArray

_LOAD: Final = np.array([5.0, *(1.0,) * 3, *(0.1,) * 6])  # [kg, kg m, kg m²], 1 sigma of a new one
_ROUNDS: Final = 5
_WORTH: Final = 0.03  # of a row, beside an independent one


def fit_change(
    before: Sequence[WeightPosterior],
    sums: MotionEquations,
    columns: JointColumns,
    fit: Callable[[MotionEquations, int], RegionalFit],
) -> tuple[MotionEquations, list[RegionalFit]]:
    """Return what is left to the change, and each joint's fit after it.

    With a load at the flange where poses left out confirm it, over all joints.

    Args:
        before: Weights of each joint.
        sums: Of the new motion.
        columns: The columns.
        fit: Fits a joint (0-based).
    """
    found: list[tuple[MotionEquations, list[RegionalFit]]] = []
    for known in (before, _with_new_load(before, sums, columns)):
        left = sums.beyond(np.stack([own.weights for own in known]))
        parts = enumerate(known)
        fits = [_after_change(own, fit(left, j), left.folds.equations(j)) for j, own in parts]
        found.append((left, fits))
    return min(found, key=lambda one: sum(np.log(own.held_out) for own in one[1]))


def _with_new_load(
    before: Sequence[WeightPosterior], sums: MotionEquations, columns: JointColumns
) -> list[WeightPosterior]:
    """Return the weights of each joint with what is new at the flange.

    Args:
        before: Of each joint.
        sums: Of the new motion.
        columns: The columns.
    """
    rigid, own = columns.of_family("rigid"), columns.last_link
    left = sums.regions.beyond(np.stack([joint.weights for joint in before]))
    found = _load_of(left, rigid, own)
    without = [_load_of(left, rigid, own, part).weights for part in range(len(left.count))]
    load, spread = np.zeros(columns.count), np.zeros((len(without) + _LOAD.size, columns.count))
    load[rigid] = own @ found.weights
    spread[:, rigid] = np.concatenate([jackknife(without), found.root]) @ own.T
    return [
        WeightPosterior(joint.weights + load, lower_root(np.concatenate([joint.root, spread])))
        for joint in before
    ]


def _load_of(
    left: Sums, rigid: slice, own: FloatArray, without: int | None = None
) -> WeightPosterior:
    """Return the parameters (10,) of a load, by what weights leave of the torque of all joints."""
    use = np.arange(len(left.count)) != without
    gram, product = left.gram[use].sum(axis=0), left.product[use].sum(axis=0)
    G, b = own.T @ gram[:, rigid, rigid] @ own, product[:, rigid] @ own  # (n, 10, 10), (n, 10)
    energy, count = left.energy[use].sum(axis=0), left.count[use].sum(axis=0)
    load, root = np.zeros(_LOAD.size), np.diag(_LOAD)
    for _ in range(_ROUNDS):  # each joint counts by what the load leaves of its torque
        error = np.maximum((energy + (G @ load - 2.0 * b) @ load) / count, LEAST_NOISE)
        worth = _WORTH / error
        root = inverse_root(np.diag(_LOAD**-2) + np.tensordot(worth, G, axes=1))
        load = root.T @ (root @ (worth @ b))
    return WeightPosterior(load, root)


def _after_change(
    before: WeightPosterior, change: RegionalFit, equations: NormalEquations
) -> RegionalFit:
    """Return the fit of a joint after a change, which was fitted to what its weights left.

    Of an error e of the weights before, the change makes up for all that the data show: what is
    left is S L e, with the covariance S of the change and the precision L of its prior.

    Args:
        before: The weights.
        change: Of them.
        equations: That it was fitted to.
    """
    prior, found = change.prior, change.again(equations)
    seen = np.isfinite(prior.scale)
    precision = prior.precision * np.where(seen, prior.scale, 0.0) ** 2
    left = np.where(seen, (before.root * precision) @ found.root.T @ found.root, before.root)
    weights = before.weights + change.posterior.weights
    root = lower_root(np.concatenate([change.posterior.root, left]))
    spread = np.concatenate([change.spread, left])
    return replace(change, posterior=WeightPosterior(weights, root), spread=spread)
