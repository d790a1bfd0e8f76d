"""One joint and its drive, fitted so that the joint simulated forward follows the recorded one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
from estimators.diagnosis.settings import FAR, FEW, LITTLE, MATTERS, TAIL, TINY, Z95
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.regression.definite import SymmetricSpectrum, jackknife

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from limo_driver.types import FloatArray, IntArray

_ROBUST: Final = 0.003  # [rad] from which on an error counts in proportion to its size alone
COARSE: Final = FAR  # typical errors, from which on they do at first
_FINER: Final = 7.0  # times smaller in the next fit
GLANCE: Final = 8  # evaluations, of a fit that is not to be the last
GLANCED: Final = FEW  # recordings at most, that such a fit sees
EVALUATIONS: Final = 25
_ENOUGH: Final = 1e-5  # of the cost, and of the constants: steps that gain less are the last
_LEFT_OUT: Final = 6  # steps of linear fits to what is left
_FARTHEST: Final = 1.0  # of a logarithm or in the unit, that a block left out may move a constant


_NOWHERE: Final = 50.0  # of a logarithm or in the unit, beyond which an interval says nothing


@dataclass(frozen=True)
class JointFit:
    """Constants of one joint, and how sure they are."""

    row: FloatArray  # (columns,)
    names: tuple[str, ...]  # what was fitted
    deviation: Mapping[str, float]  # one sigma: of the logarithm, or of a signed value in its unit
    error: FloatArray  # simulated minus recorded position of the rows it was fitted to [rad]

    def value(self, name: str) -> float:
        """Return a fitted value."""
        return c.value_in(self.row, name)

    def interval(self, name: str) -> tuple[float, float]:
        """Return the 95 % interval of a value."""
        value, reach = self.value(name), min(Z95 * self.deviation[name], _NOWHERE)
        if name in c.SIGNED:
            return value - reach, value + reach
        far = float(np.exp(reach))
        return value / far, value * far

    @property
    def mean_error(self) -> float:
        """Mean absolute error [rad]."""
        return float(np.abs(self.error).mean())


def errors(parts: Sequence[LoadedJoint], row: FloatArray) -> FloatArray:
    """Return simulated minus recorded positions of all stretches [rad]."""
    return np.concatenate([part.simulate(row) - part.position for part in parts])


class _Latest:
    """A value at the constants that were asked for last."""

    def __init__(self) -> None:
        self._at, self._value = b"", np.empty(0)

    def of(self, constants: FloatArray, make: Callable[[], FloatArray]) -> FloatArray:
        """Return the value, made anew where the constants are others."""
        if constants.tobytes() != self._at:
            self._at, self._value = constants.tobytes(), make()
        return self._value.copy()  # scipy scales what it is given


def fit_joint(
    parts: Sequence[LoadedJoint],
    row: FloatArray,
    names: Sequence[str] | None = None,
    priors: Mapping[str, c.BelievedValue] | None = None,
    evaluations: int = EVALUATIONS,
) -> JointFit:
    """Fit some constants of a joint to its recorded motion.

    Errors beyond `_ROBUST` count less than their square: contact, somebody's hand and what else no
    constant explains are rare and large.

    Args:
        parts: Recorded stretches.
        row: All constants; those fitted start from here.
        names: Of the constants to be fitted; what every joint has, if not given.
        priors: What is believed of some of them.
        evaluations: Of the whole motion at each size of errors, at most, but for those of slopes.

    Returns:
        The constants, with deviations from the curvature at the best, for as many independent
        errors as their correlation leaves.
    """
    names = c.base_of(row) if names is None else tuple(names)
    known = {name: prior for name, prior in (priors or {}).items() if name in names}
    whole = [LoadedJoint.joined(parts)]
    held = whole[0].time.size

    def of(x: FloatArray) -> FloatArray:
        values = {name: c.outer(name, float(value)) for name, value in zip(names, x, strict=True)}
        return c.with_values(row, values)

    def objective(x: FloatArray, weight: float) -> FloatArray:
        believed = [
            weight * (x[names.index(name)] - c.inner(name, prior.value)) / prior.deviation
            for name, prior in known.items()
        ]
        return np.append(errors(whole, of(x)), believed)

    # Of the last constants slopes are asked next, and the next size of errors begins with them.
    latest, sloped = _Latest(), _Latest()

    def latest_objective(x: FloatArray, weight: float) -> FloatArray:
        return latest.of(x, lambda: objective(x, weight))

    def slopes(x: FloatArray, weight: float) -> FloatArray:
        def taken() -> FloatArray:
            here = latest_objective(x, weight)
            moved = [objective(x + step, weight) - here for step in c.STEP * np.eye(x.size)]
            return np.stack(moved, axis=1) / c.STEP

        return sloped.of(x, taken)

    start = np.array([c.inner(name, c.value_in(row, name)) for name in names])
    weight = _ROBUST * float(np.sqrt(held / max(_independent_of(parts), 1.0)))
    # Far from the best nearly all errors are large, and counted in proportion they lead astray.
    typical = float(np.median(np.abs(errors(whole, row))))
    large = max(COARSE * typical, _ROBUST)
    while True:
        found = least_squares(
            latest_objective,
            start,
            slopes,  # pyright: ignore[reportArgumentType]  # scipy's own stub is too narrow
            loss=partial(_robust, held),  # pyright: ignore[reportArgumentType]  # likewise
            f_scale=large,
            x_scale=np.where([name in c.SIGNED for name in names], MATTERS, 1 / FAR),
            max_nfev=evaluations,
            ftol=_ENOUGH,
            xtol=_ENOUGH,
            args=(weight,),
        )
        if large == _ROBUST:
            break
        start, large = found.x, max(large / _FINER, _ROBUST)
    best = of(found.x)
    error = found.fun[:held]
    spread = np.sqrt(np.mean(np.minimum(error**2, (COARSE * _ROBUST) ** 2)))
    scale = max(float(spread), TINY) * np.sqrt(error.size / independent(error))
    normal = found.jac[:held].T @ found.jac[:held]
    for name, prior in known.items():
        at = names.index(name)
        normal[at, at] += (scale / prior.deviation) ** 2
    deviation = scale * SymmetricSpectrum.of(normal).deviation()
    return JointFit(best, names, dict(zip(names, deviation.tolist(), strict=True)), error)


def left_out(
    fit: JointFit, parts: Sequence[LoadedJoint], priors: Mapping[str, c.BelievedValue] | None = None
) -> JointFit:
    """Return a fit whose deviations are those between fits that each leave a block of motion out.

    Curvature at the best says how sure values are if the constants explain all of the motion. Where
    they do not, values differ from motion to motion by more: the delete-a-group jackknife shows by
    how much. The larger of both is kept. Its fits are linear about the best of all motion, whose
    slopes they share: no motion is simulated anew.

    Args:
        fit: Of all motion.
        parts: The stretches that it was fitted to.
        priors: What was believed of some of them.
    """
    names, known = fit.names, priors or {}
    pull = _ROBUST**2 * fit.error.size / max(_independent_of(parts), 1.0)
    here, stiff, away = (np.zeros(len(names)) for _ in range(3))
    for k, name in enumerate(names):
        here[k] = c.inner(name, fit.value(name))
        if name in known:
            stiff[k] = pull / known[name].deviation ** 2
            away[k] = here[k] - c.inner(name, known[name].value)
    slope = slopes_at(parts, fit)
    block = blocks([part.time.size for part in parts])
    many = int(block.max()) + 1
    values = np.empty((many, len(names)))
    for number in range(many):
        own = block != number
        values[number] = here + _linear_step(slope[own], fit.error[own], stiff, away)
    deviation = {
        name: max(fit.deviation[name], own)
        for name, own in zip(names, between(values).tolist(), strict=True)
    }
    return replace(fit, deviation=deviation)


def between(fits: FloatArray) -> FloatArray:
    """Return deviations (p,) by what fits (F, p) that each leave a part out differ by."""
    few = float(student_t.ppf(1 - TAIL, len(fits) - 1)) / Z95  # few are less sure of a spread
    return few * np.linalg.norm(jackknife(list(fits)), axis=0)


def _linear_step(
    slope: FloatArray, error: FloatArray, stiff: FloatArray, away: FloatArray
) -> FloatArray:
    """Return the step to the best of errors that are linear in the constants, robust as any fit.

    Args:
        slope: (K, constants).
        error: (K,) [rad].
        stiff: Weight of what was believed of each constant.
        away: How far each is from that.
    """
    step = np.zeros(stiff.size)
    for _ in range(_LEFT_OUT):
        heavy = slope.T / np.hypot(1.0, (error + slope @ step) / _ROBUST)
        normal = heavy @ slope + np.diag(stiff + c.LEAST)
        step = np.linalg.solve(normal, -(heavy @ error + stiff * away))
        step = step.clip(-_FARTHEST, _FARTHEST)
    return step


def slopes_at(parts: Sequence[LoadedJoint], fit: JointFit) -> FloatArray:
    """Return the change of all errors by each fitted constant, (T, constants).

    Constants change as they are fitted: logarithms, but for signed values.

    Args:
        parts: The stretches that it was fitted to.
        fit: Whose errors are those of `parts`.
    """
    sides = [errors(parts, c.stepped(fit.row, {name: c.STEP})) - fit.error for name in fit.names]
    return np.stack(sides, axis=1) / c.STEP


def blocks(sizes: Sequence[int]) -> IntArray:
    """Return the block of each row, (T,): whole stretches, as what is amiss goes with a motion."""
    if len(sizes) < FEW:
        rows = sum(sizes)
        return np.arange(rows) * HELD_OUT.blocks // rows
    return np.repeat(np.arange(len(sizes)) % HELD_OUT.blocks, sizes)


def _robust(held: int, squares: FloatArray) -> FloatArray:
    """Return a loss of squared errors and its first two derivatives, (3, N): robust in the data.

    Args:
        held: How many of them are errors.
        squares: Of errors, then of what was believed before, in units of `_ROBUST`.
    """
    root = np.sqrt(1.0 + squares)
    loss = np.stack([2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3])
    loss[0, held:], loss[1, held:], loss[2, held:] = squares[held:], 1.0, 0.0
    return loss


def independent(error: FloatArray) -> float:
    """Return how many independent errors would say as much as these correlated ones, (T,)."""
    centred = error - error.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return 1.0
    total, lag = 1.0, 1
    while lag < centred.size // 4:
        correlation = float(centred[lag:] @ centred[:-lag]) / power
        if correlation < LITTLE:
            break
        total += 2.0 * correlation * (lag if lag > 1 else 1)
        lag *= 2
    return max(error.size / total, 1.0)


def _independent_of(parts: Sequence[LoadedJoint]) -> float:
    """Return the same before any fit: one in half a second."""
    return sum(2.0 * float(part.time[-1] - part.time[0]) for part in parts)
