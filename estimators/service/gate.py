"""Promotion gate: whether a challenger is better than the champion, with intervals.

Squared errors are averaged over blocks of some seconds, which hardly depend on each other. Let a_k
and b_k be these means of challenger and champion in block k of K, and a and b the means of all.
Then block k moves log(a/b) by

    d_k / K,   d_k = a_k/a - b_k/b,

to first order, so that the standard deviation of log(a/b) is that of d_k over √K, and Student's t
with K - 1 degrees of freedom gives its interval. What a block still shares with the next one, by
their correlation ρ, widens it by √((1 + ρ)/(1 - ρ)). Both models see the same motion and noise;
most of that cancels in d_k.

Who looks again and again as blocks come in is lucky more often than who looks once. So the mean
ratio has to be below 1 beyond an interval that holds it in all of so many looks together, and a
joint that seems worse keeps from promotion, but is surely worse only beyond an interval that holds
the ratios of all joints in all looks (Bonferroni).

Source: Politis, Romano and Wolf, "Subsampling", 1999, ch. 3 (means of blocks); Efron and
Tibshirani, "An Introduction to the Bootstrap", 1993, ch. 21 (influence of an observation).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from limo_driver.errors import DivergedError, ShapeError
from limo_driver.types import FloatArray

LEVEL: Final = 0.95
BLOCK: Final = 5.0  # [s], longer than the errors of slow motion remember
FEWEST_BLOCKS: Final = 10  # to say anything of how they scatter
_DIMENSIONS: Final = 2
_LEAST: Final = 1e-3  # change of the logarithm that nobody would wait for
_MOST_SHARED: Final = 0.9  # correlation of blocks, beyond which they say next to nothing


@dataclass(frozen=True)
class ConfidenceInterval:
    """A value and the interval that holds it with `LEVEL`; each () or (n,)."""

    value: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Comparison:
    """Errors of a challenger beside those of the champion, for n joints."""

    champion: FloatArray  # RMSE, (n,) [N m]
    challenger: FloatArray  # RMSE, (n,) [N m]
    difference: ConfidenceInterval  # challenger - champion, (n,) [N m]
    ratio: ConfidenceInterval  # of the mean squared errors, challenger / champion, (n,)
    mean_ratio: ConfidenceInterval  # geometric mean of the joints, so that each counts the same, ()
    surely_worse: tuple[int, ...]  # joints, 1-based, whatever was looked at how often
    blocks: int
    needed: int  # blocks after which the mean ratio, if it is as it looks, is told from 1

    @property
    def enough(self) -> bool:
        """Whether there are blocks enough to judge."""
        return self.blocks >= FEWEST_BLOCKS

    @property
    def worse(self) -> tuple[int, ...]:
        """Joints, 1-based, on which the challenger is worse beyond the interval."""
        return tuple(int(j) + 1 for j in np.flatnonzero(self.ratio.low > 1.0))

    @property
    def better(self) -> bool:
        """Whether the challenger is better on average, beyond the interval."""
        return bool(self.mean_ratio.high < 1.0)

    @property
    def promote(self) -> bool:
        """Whether to promote: better on average, and worse on no joint."""
        return self.enough and self.better and not self.worse

    @property
    def drop(self) -> bool:
        """Whether nothing more has to be seen: worse on average, or surely worse on a joint."""
        return self.enough and bool(self.mean_ratio.low > 1.0 or self.surely_worse)

    @property
    def reason(self) -> str:
        """Reason for or against promotion, in a sentence."""
        found = (
            f"mean ratio of squared errors {self.mean_ratio.value:.3g} "
            f"({self.mean_ratio.low:.3g} to {self.mean_ratio.high:.3g})"
        )
        if not self.enough:
            return f"only {self.blocks} blocks, at least {self.needed} are needed"
        if self.worse:
            return f"worse on joint {', '.join(map(str, self.worse))}; {found}"
        if self.better:
            return f"better on average and worse on no joint; {found}"
        return f"not better beyond the interval; {found}; about {self.needed} blocks would tell"

    def as_values(self) -> dict[str, Any]:
        """Return the figures as JSON values; None where they are not known."""
        intervals = ("difference", "ratio", "mean_ratio")
        return {
            "promote": self.promote,
            "reason": self.reason,
            "rmse_champion": plain(self.champion),
            "rmse_challenger": plain(self.challenger),
            **{
                name: {key: plain(value) for key, value in vars(getattr(self, name)).items()}
                for name in intervals
            },
            "level": LEVEL,
            "surely_worse": list(self.surely_worse),
            "blocks": self.blocks,
            "blocks_needed": self.needed,
        }


def compare(champion: FloatArray, challenger: FloatArray, block: int, looks: int = 1) -> Comparison:
    """Compare errors of two models at the same instants.

    Args:
        champion: Its errors, (T, n) [N m].
        challenger: Its errors at the same instants, (T, n) [N m].
        block: Samples of a block: some seconds, and longer than the errors remember.
        looks: How often a verdict is looked for as blocks come in, in all.

    Returns:
        The figures; with fewer than `FEWEST_BLOCKS` blocks the intervals are infinite.

    Raises:
        ShapeError: The errors are not of the same T and n, or there is not one block of them.
        DivergedError: An error is no finite number.
    """
    _check(champion, "champion", block)
    _check(challenger, "challenger", block)
    if challenger.shape != champion.shape:
        raise ShapeError("errors of the challenger", challenger.shape, f"{champion.shape}")
    a, b = _block_means(challenger, block), _block_means(champion, block)  # (K, n) [(N m)²]
    mean_a, mean_b = _mean(a), _mean(b)
    rmse_a, rmse_b = np.sqrt(mean_a), np.sqrt(mean_b)
    influence = a / mean_a - b / mean_b  # (K, n), of log(mean_a / mean_b)
    logs = np.log(mean_a / mean_b)
    each = (1 - LEVEL) / looks
    mean = _interval(logs.mean(), influence.mean(axis=1), 1 - each)
    surely = _interval(logs, influence, 1 - each / logs.size)
    return Comparison(
        rmse_b,
        rmse_a,
        _interval(rmse_a - rmse_b, a / (2 * rmse_a) - b / (2 * rmse_b)),
        _exponential(_interval(logs, influence)),
        _exponential(mean),
        tuple(int(j) + 1 for j in np.flatnonzero(surely.low > 0.0)),
        len(a),
        _needed(mean, len(a)),
    )


def accuracy(errors: FloatArray, block: int) -> ConfidenceInterval:
    """Return the RMSE of each joint with its interval, (n,) [N m].

    Args:
        errors: Of one model, (T, n) [N m].
        block: Samples of a block, as for `compare`.

    Raises:
        ShapeError: There is not one block of errors.
        DivergedError: An error is no finite number.
    """
    _check(errors, "model", block)
    a = _block_means(errors, block)
    rmse = np.sqrt(_mean(a))
    return _interval(rmse, a / (2 * rmse))


def _check(errors: FloatArray, name: str, block: int) -> None:
    if errors.ndim != _DIMENSIONS or not 0 < block <= len(errors):
        raise ShapeError(f"errors of the {name}", errors.shape, f"(T, n) with T at least {block}")
    bad = np.argwhere(~np.isfinite(errors))
    if bad.size:
        t, j = bad[0]
        raise DivergedError(
            f"the error of the {name} on joint {j + 1} at sample {t} is {errors[t, j]}, expected a "
            "finite number"
        )


def _mean(blocks: FloatArray) -> FloatArray:
    """Return the mean over blocks, above zero so that ratios of nothing to nothing are 1."""
    return np.maximum(blocks.mean(axis=0), np.finfo(np.float64).tiny)


def _block_means(errors: FloatArray, block: int) -> FloatArray:
    """Return the mean squared error of each whole block, (K, n) [(N m)²]."""
    K = len(errors) // block
    return np.mean(errors[: K * block].reshape(K, block, -1) ** 2, axis=1)


def _interval(value: FloatArray, influence: FloatArray, level: float = LEVEL) -> ConfidenceInterval:
    """Return the interval of a mean from what each of K blocks adds to it, (K,) or (K, n)."""
    from scipy.special import stdtrit  # slow to import, and a service begins without it

    K = len(influence)
    if K < FEWEST_BLOCKS:
        infinite = np.full(np.shape(value), np.inf)
        return ConfidenceInterval(np.asarray(value), -infinite, infinite)
    centred = influence - influence.mean(axis=0)
    variance = np.sum(centred**2, axis=0) / (K - 1)
    shared = np.sum(centred[1:] * centred[:-1], axis=0) / np.maximum(variance * (K - 1), 1e-300)
    shared = np.clip(shared, 0.0, _MOST_SHARED)
    width = np.sqrt(variance / K * (1 + shared) / (1 - shared))
    width = width * float(stdtrit(K - 1, (1 + level) / 2))  # Student's t
    return ConfidenceInterval(np.asarray(value), value - width, value + width)


def _exponential(interval: ConfidenceInterval) -> ConfidenceInterval:
    with np.errstate(over="ignore"):
        return ConfidenceInterval(*(np.exp(value) for value in vars(interval).values()))


def _needed(mean: ConfidenceInterval, blocks: int) -> int:
    """Return how many blocks tell the mean from zero, where the width falls with their root."""
    if blocks < FEWEST_BLOCKS:
        return FEWEST_BLOCKS
    width, value = float(mean.high - mean.value), abs(float(mean.value))
    return max(FEWEST_BLOCKS, int(np.ceil(blocks * (width / max(value, _LEAST)) ** 2)))


def plain(values: FloatArray) -> Any:  # noqa: ANN401  # a number or a list
    """Return as JSON values, with None for what is not finite."""
    if np.ndim(values):
        return [plain(value) for value in values]
    return float(values) if np.isfinite(values) else None
