"""Which rows count: how many of them are independent, and folds of time.

Effective number of independent samples of a recording, whose errors are correlated in time.

What the model does not explain (hysteresis above all) lasts for a second where noise lasts for a
sample. A fit that took every row for new evidence would trust the data far too much: it would move
masses by kilograms to explain what is friction. So each joint's rows are divided by their design
effect, the mean over all directions of the parameters of

    variance of the estimate with correlated errors / with independent errors
    = 1/rank Σ_b u_bᵀ A⁺ u_b / σ²,    u_b = Σ_{t in b} y_t e_t,    A = Σ_t y_t y_tᵀ,

with errors e, regressor rows y, and blocks b of time that are longer than the errors remember.

Source: Rao and Scott, "The analysis of categorical data from complex sample surveys", JASA 1981
(the mean design effect); Liang and Zeger, "Longitudinal data analysis using generalized linear
models", Biometrika 1986 (the variance from blocks).

Folds: parts of the recordings that a fit leaves out, to see how far its parameters hold.

A recording is cut into blocks of time, which are dealt to the folds in turn. Blocks are far longer
than the errors remember, so that those of one fold say little about those of another; in a long
recording each fold has many, so that no fold is all there is of one kind of motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.types import BoolArray, FloatArray, IntArray, Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.rigid_body.regressor import RegressorChain
    from limo_driver.recordings.recording import Recording

REMEMBERED = 2.0  # [s], that errors are correlated at most
_TOLD_APART = 1e-6  # least eigenvalue of a correlation matrix that counts as a direction
_ROUNDING = 1e-8  # of the greatest column; less is what sums that should be zero leave
_CHUNK = 1024  # rows whose regressor is held at a time
FOLDS = 5
_LONGEST = 10.0  # [s] of a block


@dataclass(frozen=True)
class ThinnedRows:
    """Rows so far apart that white noise within the bandwidth would be independent."""

    motion: Motion  # T samples
    own: FloatArray  # (T, n, own), columns of the joint terms
    torque: FloatArray  # (T, n) [N m]
    use: BoolArray  # (T, n)
    block: IntArray  # (T,), counts blocks of time

    @classmethod
    def joined(cls, parts: Sequence[ThinnedRows]) -> ThinnedRows:
        """Join rows of several blocks or recordings; their blocks stay apart."""
        new = [np.diff(part.block, prepend=-1) != 0 for part in parts]
        return cls(
            Motion(
                np.concatenate([part.motion.time for part in parts]),
                np.concatenate([part.motion.position for part in parts]),
                np.concatenate([part.motion.velocity for part in parts]),
                np.concatenate([part.motion.acceleration for part in parts]),
            ),
            np.concatenate([part.own for part in parts]),
            np.concatenate([part.torque for part in parts]),
            np.concatenate([part.use for part in parts]),
            np.cumsum(np.concatenate(new)) - 1,
        )

    def choose(self, columns: IntArray) -> ThinnedRows:
        """Return the rows with some of the joint terms' columns, (n, terms) for each joint."""
        return replace(self, own=np.take_along_axis(self.own, columns[None], axis=2))


def blocks_of(recording: Recording) -> IntArray:
    """Count blocks of `REMEMBERED` seconds, none across a gap; (T,)."""
    count = np.floor((recording.time - recording.time[0]) / REMEMBERED)
    new = np.diff(count, prepend=count[0]) != 0
    new[[rows.start for rows in recording.segments[1:]]] = True
    return np.cumsum(new)


def effective_rows(
    chain: RegressorChain, rows: ThinnedRows, gram: FloatArray, parameters: FloatArray
) -> FloatArray:
    """Return the number of independent rows that each joint's rows are worth, (n,).

    Args:
        chain: The arm.
        rows: Thinned rows.
        gram: Mean outer product of each joint's regressor, (n, p, p).
        parameters: Full parameters (p,) whose errors count.
    """
    n, links, terms = chain.n, chain.width, rows.own.shape[2]
    columns = [np.r_[chain.first(j) : links, links + j + n * np.arange(terms)] for j in range(n)]
    scores = [np.zeros((int(rows.block.max(initial=-1)) + 1, at.size)) for at in columns]
    energy = np.zeros(n)
    Y = np.zeros((n, _CHUNK, links + terms))
    for start in range(0, len(rows.motion), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        block = rows.block[chunk]
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        chain.fill(rows.motion[chunk], Y)
        Y[:, : block.size, links:] = rows.own[chunk].transpose(1, 0, 2)
        for j, at in enumerate(columns):
            y = Y[j, : block.size, chain.first(j) :]
            error = (rows.torque[chunk, j] - y @ parameters[at]) * rows.use[chunk, j]
            scores[j][block[starts]] += np.add.reduceat(y * error[:, None], starts)
            energy[j] += error @ error
    count = rows.use.sum(axis=0)
    effect = [
        _design_effect(scores[j], gram[j][np.ix_(at, at)] * energy[j])
        for j, at in enumerate(columns)
    ]
    return count / np.maximum(effect, 1.0)


def _design_effect(scores: FloatArray, expected: FloatArray) -> float:
    """Compare scores (b, k) with the covariance (k, k) of their sum if errors were independent."""
    scale = np.sqrt(np.diag(expected))
    known = scale > _ROUNDING * scale.max(initial=0.0)
    correlation = expected[np.ix_(known, known)] / np.outer(scale[known], scale[known])
    values, vectors = np.linalg.eigh(correlation)
    apart = values > _TOLD_APART
    if not apart.any():
        return 1.0
    whitened = (scores[:, known] / scale[known]) @ vectors[:, apart] / np.sqrt(values[apart])
    return float(np.sum(whitened**2)) / int(apart.sum())


def fold_of(recording: Recording) -> IntArray:
    """Return which fold each sample of a recording is in, (T,)."""
    time = recording.time - recording.time[0]
    block = min(_LONGEST, recording.duration / FOLDS)
    return np.floor(time / block).astype(np.int64) % FOLDS
