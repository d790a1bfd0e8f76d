"""Weighted least squares for the base parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.fitting.folds import FOLDS, jackknife

if TYPE_CHECKING:
    from estimators.rigid_body.dynamics.base_parameters import BaseParameters
    from estimators.rigid_body.fitting.normal_equations import ArmEquations
    from estimators.rigid_body.terms import JointTerms
    from limo_driver.types import FloatArray

_ROUNDS = 20  # of reweighting, at most
_SETTLED = 1e-3  # relative change of the errors that ends it
_WIDEST = 100.0  # standard deviation of any base parameter before the data [SI]
_COARSE = 100.0  # independent rows that a wrong model is worth at most
_SMALLEST_ERROR = 1e-6  # of the torque's root mean square, so that exact data keep finite weights


@dataclass(frozen=True)
class BaseFit:
    """Base parameters fitted to recordings."""

    parameters: FloatArray  # (b,)
    covariance: FloatArray  # (b, b), of errors as they last, and of fits without each fold
    effective: FloatArray  # (n,), independent rows that each joint's rows are worth
    rmse: FloatArray  # (n,) [N m], in sample
    weight: FloatArray  # (n,) [1/(N m)²], of each row of a joint beside a prior
    row_variance: FloatArray  # (n,) [N² m²], of a row's error, as if rows were independent
    condition: float  # of the column-scaled regressor; inf if a parameter is not excited
    excited: int  # base parameters that the motion reveals


def fit_base(equations: ArmEquations, base: BaseParameters, nominal: FloatArray) -> BaseFit:
    """Fit base parameters, with the joints weighted as the equations say.

    Combinations that the motion does not excite stay at their nominal value. The covariance is the
    sum of two: that of errors that last as they do, worth no more rows than `_trusted` says, and
    that of what a wrong model pulls the parameters to, as far as it changes with the motion, by the
    jackknife. It holds part of the noise twice, which errs to the safe side.

    Args:
        equations: Sums over the recordings.
        base: Base parameters of the robot.
        nominal: Full parameters (p,) known beforehand, for example from CAD.
    """
    found = _reweighted(equations, base, nominal)
    solution, weight = found.solution, found.weight
    effective = equations.effective_rows(base.expand(solution.parameters))
    share = np.maximum(effective, 1e-300) / np.maximum(equations.count, 1)
    row_variance = found.rmse**2 / share
    trusted = _trusted(effective, equations.thinned.use.sum(axis=0))
    of_score, _ = equations.weighted(weight**2 * row_variance / trusted)
    spread = of_score[np.ix_(base.independent, base.independent)] + np.eye(base.rank) / _WIDEST**2
    scale = effective.sum() / float(weight * found.rmse**2 @ effective)
    start = base.reduce(nominal)
    without = [_solve(equations, base, start, weight, fold).parameters for fold in range(FOLDS)]
    return BaseFit(
        solution.parameters,
        solution.inverse @ spread @ solution.inverse + jackknife(without),
        effective,
        found.rmse,
        weight * share * scale * trusted,
        row_variance,
        solution.condition,
        solution.excited,
    )


def _trusted(effective: FloatArray, thinned: FloatArray) -> FloatArray:
    """Return the power at which each joint's likelihood stands beside a prior, (n,).

    Errors that last are what the model lacks, and no number of rows makes the model right: a
    likelihood of N rows that holds only up to a small relative entropy counts as one of
    alpha N / (alpha + N). Errors that do not last leave N as it is.

    Source: Miller and Dunson, "Robust Bayesian inference via coarsening", JASA 2019, eq. (3).
    """
    lasting = 1.0 - effective / np.maximum(thinned, 1)
    return 1.0 / (1.0 + effective * lasting / _COARSE)


@dataclass(frozen=True)
class WidthChoice:
    """The equations and terms with the sign width that fits each joint best."""

    equations: ArmEquations
    terms: JointTerms


def choose_sign_widths(
    equations: ArmEquations, terms: JointTerms, base: BaseParameters, nominal: FloatArray
) -> WidthChoice:
    """Fit with each width for all joints, and take the best of each joint."""
    n = equations.count.size
    errors = [
        _reweighted(equations.choose(terms, [index] * n), base, nominal).rmse
        for index in range(len(terms.sign_widths))
    ]
    choice = tuple(np.argmin(errors, axis=0).tolist())
    return WidthChoice(equations.choose(terms, choice), terms.with_choice(choice))


@dataclass(frozen=True)
class _Weighted:
    solution: _Solution
    weight: FloatArray  # (n,) [1/(N m)²]
    rmse: FloatArray  # (n,) [N m]


def _reweighted(equations: ArmEquations, base: BaseParameters, nominal: FloatArray) -> _Weighted:
    """Solve, and where joints count by their errors, solve again until these settle."""
    start = base.reduce(nominal)
    scale_of_torque = np.sqrt(equations.energy / np.maximum(equations.count, 1))
    # Torque that reads zero throughout is below what the drive can tell, and no exact measurement.
    silent = equations.energy == 0
    scale_of_torque[silent] = max(float(scale_of_torque.max()), 1e-12)
    floor = np.where(silent, scale_of_torque, _SMALLEST_ERROR * scale_of_torque)
    weight = 1.0 / scale_of_torque**2
    solution = _solve(equations, base, start, weight)
    rmse = np.maximum(equations.rmse(base.expand(solution.parameters)), floor)
    for _ in range(_ROUNDS if equations.weighting == "error" else 0):
        weight = 1.0 / rmse**2
        solution = _solve(equations, base, start, weight)
        before, rmse = rmse, np.maximum(equations.rmse(base.expand(solution.parameters)), floor)
        if np.all(np.abs(rmse - before) <= _SETTLED * before):
            break
    return _Weighted(solution, weight, rmse)


@dataclass(frozen=True)
class _Solution:
    parameters: FloatArray  # (b,)
    inverse: FloatArray  # (b, b), of the weighted Gram matrix
    condition: float
    excited: int


def _solve(
    equations: ArmEquations,
    base: BaseParameters,
    start: FloatArray,
    weight: FloatArray,
    without: int | None = None,
) -> _Solution:
    """Solve with a prior so wide that it decides only what the motion does not reveal.

    With all rows, or without those of a fold.
    """
    gram, product = equations.weighted(weight, without)
    A = gram[np.ix_(base.independent, base.independent)]
    prior = np.full(base.rank, _WIDEST**-2)
    b = product[base.independent] - A @ start
    scale = 1.0 / np.sqrt(np.diag(A) + prior)
    values, vectors = np.linalg.eigh((A + np.diag(prior)) * np.outer(scale, scale))
    inverse = (vectors / values) @ vectors.T
    excited = int((np.linalg.eigvalsh(A) > 1.0 / _WIDEST**2).sum())
    is_known = excited == base.rank and values[0] > 0.0  # rounding may leave less than nothing
    return _Solution(
        start + scale * (inverse @ (scale * b)),
        inverse * np.outer(scale, scale),
        float(np.sqrt(values[-1] / values[0])) if is_known else np.inf,
        excited,
    )
