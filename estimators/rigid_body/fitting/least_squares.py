"""Weighted least squares for the base parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.regression.definite import RegularisedInverse, SymmetricSpectrum, jackknife, root_of
from estimators.rigid_body.fitting.effective_rows import FOLDS

if TYPE_CHECKING:
    from estimators.rigid_body.base_parameters import BaseParameters
    from estimators.rigid_body.fitting.normal_equations import ArmEquations
    from estimators.rigid_body.terms import JointTerms
    from limo_driver.types import BoolArray, FloatArray

_ROUNDS = 20  # of reweighting, at most
_ALIKE = 1e-6  # relative difference of errors that does not tell one width from another
_SETTLED = 1e-3  # relative change of the errors that ends it
_WIDEST = 100.0  # standard deviation of any base parameter before the data [SI]
_COARSE = 100.0  # independent rows that a wrong model is worth at most
_NEXT_TO_NOTHING = 1e-3  # of a joint's torque, by its terms at 1 rad/s and 1 rad/s²
_SMALLEST_ERROR = 1e-6  # of the torque's root mean square, so that exact data keep finite weights


@dataclass(frozen=True)
class BaseFit:
    """Base parameters fitted to recordings."""

    parameters: FloatArray  # (b,)
    spread: FloatArray  # D, with Dᵀ D the covariance (b, b): of errors as they last, and of folds
    shown: BoolArray  # (b,), parameters of which the motion says more than the prior
    effective: FloatArray  # (n,), independent rows that each joint's rows are worth
    rmse: FloatArray  # (n,) [N m], in sample
    weight: FloatArray  # (n,) [1/(N m)²], of each row of a joint beside a prior
    row_variance: FloatArray  # (n,) [N² m²], of a row's error, as if rows were independent
    condition: float  # of the column-scaled regressor; inf if a parameter is not excited
    excited: int  # base parameters that the motion reveals

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, (b, b)."""
        return self.spread.T @ self.spread

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of the parameters, (b,)."""
        return np.linalg.norm(self.spread, axis=0)


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
    lasting = 1.0 - effective / np.maximum(equations.thinned.use.sum(axis=0), 1)
    trusted = 1.0 / (1.0 + effective * lasting / _COARSE)
    of_score, _ = equations.weighted(weight**2 * row_variance / trusted)
    of_errors = root_of(of_score[np.ix_(base.independent, base.independent)])
    scale = effective.sum() / float(weight * found.rmse**2 @ effective)
    start = base.reduce(nominal)
    without = [_solve(equations, base, start, weight, fold).parameters for fold in range(FOLDS)]
    spread = np.concatenate([solution.inverse.spread(of_errors), jackknife(without)])
    # Mark the base parameters (b,) that are terms of a joint and known to next to nothing
    links, torque = equations.chain.width, equations.energy / np.maximum(equations.count, 1)
    joint = (base.independent - links) % torque.size
    small = np.linalg.norm(spread, axis=0) < _NEXT_TO_NOTHING * np.sqrt(torque)[joint]
    return BaseFit(
        solution.parameters,
        spread,
        solution.inverse.shown | (small & (base.independent >= links)),
        effective,
        found.rmse,
        weight * share * scale * trusted,
        row_variance,
        solution.condition,
        solution.excited,
    )


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
    as_good = errors <= (1.0 + _ALIKE) * np.min(errors, axis=0)  # where none matters, the first
    choice = tuple(np.argmax(as_good, axis=0).tolist())
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
    inverse: RegularisedInverse  # of the weighted Gram matrix
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
    prior = np.eye(base.rank) / _WIDEST
    inverse = RegularisedInverse.of(A, prior)
    beyond_prior = SymmetricSpectrum.of(A - prior**2, np.diag(A + prior**2))
    return _Solution(
        start + inverse.estimate(product[base.independent] - A @ start),
        inverse,
        SymmetricSpectrum.of(A + prior**2).condition if beyond_prior.rank == base.rank else np.inf,
        beyond_prior.rank,
    )
