"""Proof: how much of the error is gone on rows that nothing was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from estimators.diagnosis.settings import FINE, LITTLE, MATTERS, ROUNDING, TAIL
from estimators.diagnosis.settings.residuals import ELSEWHERE, HELD_OUT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, IntArray, Motion


class Observed(Protocol):
    """Rows of recordings, K on a slow grid, as far as what is held out of them has to be known."""

    @property
    def recordings(self) -> Sequence[Recording]:
        """All of them."""
        ...

    @cached_property
    def recording(self) -> IntArray:
        """Which of them each row is of, (K,), 0-based."""
        ...

    @property
    def slow(self) -> Motion:
        """Motion on the slow grid, K rows."""
        ...

    @property
    def kept(self) -> IntArray:
        """Samples that are rows of the slow grid, (K,)."""
        ...

    @cached_property
    def moving(self) -> BoolArray:
        """Not near rest, (K, n)."""
        ...

    @property
    def bandwidth(self) -> float:
        """Of the filter [Hz]."""
        ...


@dataclass(frozen=True)
class Split:
    """Rows that are fitted to and rows held out; none is both, some near an edge neither."""

    fitted: BoolArray  # (K, n)
    held_out: BoolArray  # (K, n)
    apart: BoolArray  # (K,) rows in the blocks held out, whether they count or not

    @classmethod
    def of(cls, observed: Observed, which: Sequence[int] = HELD_OUT.which) -> Split:
        """Hold out blocks of each recording, counted from 0."""
        held_out = np.zeros(observed.kept.size, dtype=bool)
        near = np.zeros(observed.kept.size, dtype=bool)
        for rows, time in _by_recording(observed):
            edges = np.linspace(time[0], time[-1], HELD_OUT.blocks + 1)
            guard = guard_of(float(edges[-1] - edges[0]), observed.bandwidth)
            for block in which:
                low, high = edges[block], edges[block + 1]
                held_out[rows] |= (time >= low) & (time < high)
                near[rows] |= (time >= low - guard) & (time < high + guard)
        return cls._of(observed, held_out, near)

    @classmethod
    def without(cls, observed: Observed, held_out: BoolArray) -> Split:
        """Hold out some rows (K,); what is near them in time is neither fitted nor held out."""
        near = held_out.copy()
        for rows, time in _by_recording(observed):
            guard = guard_of(float(time[-1] - time[0]), observed.bandwidth)
            out = time[held_out[rows]]
            near[rows] |= np.searchsorted(out, time + guard) > np.searchsorted(out, time - guard)
        return cls._of(observed, held_out, near)

    @classmethod
    def _of(cls, observed: Observed, held_out: BoolArray, near: BoolArray) -> Split:
        moving = observed.moving
        return cls(~near[:, None] & moving, held_out[:, None] & moving, held_out)


def _by_recording(observed: Observed) -> Iterator[tuple[IntArray, FloatArray]]:
    """Yield the rows of each recording and their times."""
    for recording in range(len(observed.recordings)):
        rows = np.flatnonzero(observed.recording == recording)
        if rows.size:
            yield rows, observed.slow.time[rows]


def of_another_kind(observed: Observed) -> tuple[str, tuple[BoolArray, ...]]:
    """Return what is left out for a proof on motion of another kind, and the rows (K,) of each.

    With several recordings, whole recordings: they differ most. With one, or where a joint moves in
    one alone (joints that were moved one after the other), the blocks of time in which the arm is
    fastest and slowest, and those at either end of its poses, which are ordered along the direction
    in which they vary most.
    """
    of_row, fewest = observed.recording, 2
    if len(present := np.unique(of_row)) >= fewest:
        groups = np.array_split(present, min(len(present), ELSEWHERE.turns))
        out = tuple(np.isin(of_row, group) for group in groups)
        least = MATTERS * observed.moving.sum(axis=0)
        if all((observed.moving[~rows].sum(axis=0) >= least).all() for rows in out):
            return "whole recordings", out
    block = blocks(observed)
    count = np.maximum(np.bincount(block), 1)[:, None]

    def mean(values: FloatArray) -> FloatArray:
        sums = np.zeros((len(count), values.shape[1]))
        np.add.at(sums, block, values)
        return sums / count

    position, speed = observed.slow.position, np.abs(observed.slow.velocity)
    scaled = position / np.maximum(position.std(axis=0), FINE)
    poses = mean(scaled - scaled.mean(axis=0))
    along = poses @ np.linalg.svd(poses, full_matrices=False)[2][0]
    pace = mean(speed / np.maximum(speed.mean(axis=0), FINE)).sum(axis=1)
    many = max(1, round(len(count) / ELSEWHERE.turns))
    chosen = [np.argsort(key, kind="stable")[:many] for key in (-pace, pace, along, -along)]
    return "blocks of other speeds and poses", tuple(np.isin(block, some) for some in chosen)


def guard_of(duration: float, bandwidth: float) -> float:
    """Return how far apart rows fitted and rows held out are [s].

    Args:
        duration: Of the recording [s]; a short one cannot spare as much as a long one.
        bandwidth: Of the filter, which must not reach across [Hz].
    """
    return max(min(HELD_OUT.guard, HELD_OUT.guard_part * duration), 2 / bandwidth)


def block_of(observed: Observed, longest: float) -> FloatArray:
    """Return the length of the blocks of time that are taken as a whole, of each row (K,) [s].

    Args:
        observed: Where time comes from.
        longest: Of a block [s]; those of a recording too short for many are shorter.
    """
    lengths = [block_length(recording, longest) for recording in observed.recordings]
    return np.array(lengths)[observed.recording]


def block_length(recording: Recording, longest: float = HELD_OUT.block) -> float:
    """Return how long the blocks are that are taken as a whole [s], of so long a recording."""
    return min(longest, recording.duration / (2 * HELD_OUT.blocks))


def rmse(residual: FloatArray, rows: BoolArray) -> FloatArray:
    """Return the RMSE of each joint over its rows in `rows` (K, n), (n,) [N m]."""
    return np.sqrt(np.sum(np.where(rows, residual, 0.0) ** 2, axis=0) / np.maximum(rows.sum(0), 1))


def reducible_removed(before: FloatArray, after: FloatArray, floor: FloatArray) -> float:
    """Return the part of the reducible error Σ (RMSE² - floor²) that is gone."""
    reducible = float(np.sum(np.maximum(before**2 - floor**2, 0.0)))
    if reducible <= LITTLE * float(np.sum(floor**2)):
        return 0.0
    gone = np.maximum(before, floor) ** 2 - np.maximum(after, floor) ** 2
    return float(np.clip(np.sum(gone) / reducible, -1.0, 1.0))


def surely_positive(gained: FloatArray, observed: Observed, rows: BoolArray) -> bool:
    """Say whether a sum over rows stays positive whichever blocks of time had been recorded.

    Args:
        gained: What each row of each joint adds to it, in squares of an error, (K, n).
        observed: Where time comes from.
        rows: Those that count, (K, n).

    Returns:
        Whether the 2.5 % quantile over resampled blocks is above 0, and above rounding: of two
        residuals that are one, either is the smaller by the last bit.
    """
    nothing = ROUNDING * float(rows.sum())
    of_row = blocks(observed)
    sums = np.zeros((2, int(of_row.max(initial=-1)) + 1))
    np.add.at(sums[0], of_row, np.where(rows, gained, 0.0).sum(axis=1))
    np.add.at(sums[1], of_row, rows.any(axis=1).astype(float))
    of_block = sums[0, sums[1] > 0]
    if of_block.size < 2:  # noqa: PLR2004  # nothing to resample
        return bool(of_block.sum() > nothing)
    drawn = np.random.default_rng(0).integers(0, of_block.size, (HELD_OUT.resamples, of_block.size))
    return bool(np.quantile(of_block[drawn].sum(axis=1), TAIL) > nothing)


def blocks(observed: Observed) -> IntArray:
    """Number the block of time of each row, (K,)."""
    length = block_of(observed, HELD_OUT.block)
    return blocks_of_time(observed.slow.time, observed.recording, length)


def blocks_of_time(time: FloatArray, recording: IntArray, length: FloatArray | float) -> IntArray:
    """Number the blocks of time that are resampled whole, (K,).

    Args:
        time: Of each row, (K,) [s].
        recording: Which it is of, (K,).
        length: Of a block [s], of each row or all.
    """
    both = np.stack([recording, np.floor(time / length).astype(np.int64)], axis=1)
    return np.unique(both, axis=0, return_inverse=True)[1].ravel()


def bootstrap(
    before: FloatArray, after: FloatArray, floor: FloatArray, observed: Observed, rows: BoolArray
) -> tuple[float, float]:
    """Return the 95 % interval of `reducible_removed` by resampling blocks of time.

    Args:
        before: Residuals (K, n) of the given simulation [N m].
        after: Residuals (K, n) of the improved simulation [N m].
        floor: Noise floor (n,) [N m].
        observed: Where time comes from.
        rows: Held-out rows (K, n).

    Source: Künsch, "The jackknife and the bootstrap for general stationary observations", 1989.
    """
    drawn = _resampled(before, after, blocks(observed), rows)
    if drawn is None:
        return (-1.0, 1.0)
    found = [
        reducible_removed(np.sqrt(first / count), np.sqrt(second / count), floor)
        for first, second, count in zip(*drawn, strict=True)
    ]
    low, high = np.quantile(found, (TAIL, 1.0 - TAIL))
    return float(low), float(high)


def rmse_change(
    before: FloatArray, after: FloatArray, block: IntArray, rows: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % interval of RMSE after less RMSE before, of each joint, (n,) each.

    Args:
        before: Errors of one simulation, (K, n).
        after: Those of another on the same rows.
        block: Which block of time each row is of, (K,); see `blocks_of_time`.
        rows: Those that count, (K, n).

    Returns:
        Its ends; infinite where there is one block, which nothing can be resampled of.
    """
    drawn = _resampled(before, after, block, rows)
    if drawn is None:
        return np.full(before.shape[1], -np.inf), np.full(before.shape[1], np.inf)
    change = np.sqrt(drawn[1] / drawn[2]) - np.sqrt(drawn[0] / drawn[2])
    low, high = np.quantile(change, (TAIL, 1.0 - TAIL), axis=0)
    return low, high


def _resampled(
    before: FloatArray, after: FloatArray, block: IntArray, rows: BoolArray
) -> FloatArray | None:
    """Return sums of squares before and after, and rows, of resampled blocks, (3, resamples, n).

    None where there are no two blocks.
    """
    sums = np.zeros((3, int(block.max(initial=-1)) + 1, before.shape[1]))
    np.add.at(sums[0], block, np.where(rows, before, 0.0) ** 2)
    np.add.at(sums[1], block, np.where(rows, after, 0.0) ** 2)
    np.add.at(sums[2], block, rows.astype(float))
    sums = sums[:, sums[2].any(axis=1)]
    count = sums.shape[1]
    if count < 2:  # noqa: PLR2004  # nothing to resample
        return None
    random = np.random.default_rng(0)
    drawn = np.stack(
        [sums[:, random.integers(0, count, count)].sum(axis=1) for _ in range(HELD_OUT.resamples)],
        axis=1,
    )
    drawn[2] = np.maximum(drawn[2], 1.0)
    return drawn
