"""Refinement: parameters that the torque is not linear in, found once effects are named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from estimators.diagnosis.from_torque.selection.candidates import Candidate, entered
from estimators.diagnosis.from_torque.selection.columns import ColumnTable
from estimators.diagnosis.settings.fitting import REFINEMENT
from estimators.regression.evidence import Evidence, Prior, joined
from estimators.regression.normal_equations import NormalEquations

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Hypothesis
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Setting:
    """Everything around one candidate: the columns that are fitted with it."""

    observed: Observations
    columns: ColumnTable
    nuisance: Prior
    others: Prior
    residual: FloatArray  # (K, n) [N m]
    noise: Noise
    use: NDArray[np.bool_]  # (K, n)
    level: FloatArray  # (n,) [N m]


def refine(hypothesis: Hypothesis, around: Setting) -> tuple[Hypothesis, float]:
    """Move the settings of a hypothesis to where the evidence is highest.

    Returns:
        The hypothesis with its best settings, and its log evidence given the others.
    """
    local = _Local(around)
    if hypothesis.family is None:
        return hypothesis, local.gain(hypothesis)
    low, high = np.array(hypothesis.bounds).T
    # Positive settings span decades; others are angles and rest positions.
    scaled = low > 0

    def settings(x: FloatArray) -> tuple[float, ...]:
        x = np.clip(x, 0.0, 1.0)
        ratio = np.where(scaled, high / np.where(scaled, low, 1.0), 1.0)
        return tuple(np.where(scaled, low * ratio**x, low + (high - low) * x).tolist())

    start = np.array(hypothesis.settings)
    with np.errstate(divide="ignore", invalid="ignore"):
        x0 = np.where(
            scaled,
            np.log(start / np.where(scaled, low, 1.0)) / np.log(high / np.where(scaled, low, 1.0)),
            (start - low) / (high - low),
        )
    family, begin = hypothesis.family, np.clip(x0, REFINEMENT.inside, 1.0 - REFINEMENT.inside)

    def cost(x: FloatArray) -> float:
        return -local.gain(family(*settings(x)))

    found = minimize(
        cost,
        begin,
        method="Nelder-Mead",
        options={
            "maxfev": REFINEMENT.evaluations,
            "xatol": REFINEMENT.tolerance,
            "fatol": REFINEMENT.gained,
            "initial_simplex": _simplex(begin),
        },
    )
    best, gain = family(*settings(found.x)), -float(found.fun)
    unchanged = local.gain(hypothesis)
    return (best, gain) if gain > unchanged else (hypothesis, unchanged)


def _simplex(start: FloatArray) -> FloatArray:
    step = REFINEMENT.step * np.where(start > 0.5, -1.0, 1.0)  # noqa: PLR2004  # towards the middle
    return np.concatenate([start[None], start + np.diag(step)])


class _Local:
    """Evidence of one hypothesis beside fixed others, where only its own joints' sums change."""

    def __init__(self, around: Setting) -> None:
        self.around = around
        base = joined(around.nuisance, around.others)
        self.base = base
        size = base.index.size
        self._gram, self._product = np.zeros((size, size)), np.zeros(size)
        self._white: list[tuple[FloatArray, NDArray[np.int64], FloatArray]] = []
        place = {int(column): k for k, column in reversed(list(enumerate(base.index)))}
        for joint in range(around.observed.n):
            values, at = around.columns.of_joint(joint)
            mine = [k for k, column in enumerate(at) if int(column) in place]
            rows = around.use[:, joint]
            A = around.noise.whiten(values[:, mine], joint, rows)
            y = around.noise.whiten(around.residual[:, joint], joint, rows)
            to = np.array([place[int(at[k])] for k in mine], dtype=np.int64)
            self._gram[np.ix_(to, to)] += A.T @ A
            self._product[to] += A.T @ y
            self._white.append((A, to, y))
        count = around.nuisance.index.size
        nuisance = Prior.free(np.arange(count), around.nuisance.deviation)
        self._others = replace(around.others, index=np.arange(count, size))
        self._alone = Evidence(NormalEquations(self._gram, self._product), nuisance)

    def gain(self, hypothesis: Hypothesis) -> float:
        """Return the log evidence of the hypothesis together with the others."""
        table = ColumnTable(len(self.around.observed.kept), self.around.observed.n)
        candidate = entered(hypothesis, self.around.observed, table, self.around.level)
        if candidate is None:
            return -REFINEMENT.rejected
        size, more = self.base.index.size, table.count
        gram = np.zeros((size + more, size + more))
        gram[:size, :size] = self._gram
        product = np.append(self._product, np.zeros(more))
        for joint, (A, to, y) in enumerate(self._white):
            values, at = table.of_joint(joint)
            if not at.size:
                continue
            B = self.around.noise.whiten(values, joint, self.around.use[:, joint])
            gram[np.ix_(to, size + at)] += A.T @ B
            gram[np.ix_(size + at, size + at)] += B.T @ B
            product[size + at] += B.T @ y
        gram[size:, :size] = gram[:size, size:].T
        own = replace(candidate.prior, index=size + candidate.prior.index)
        evidence = self._alone.extended(NormalEquations(gram, product))
        return evidence.gain(joined(self._others, own))


def replaced(candidate: Candidate, hypothesis: Hypothesis, around: Setting) -> Candidate | None:
    """Return the candidate with a refined hypothesis, its columns added to the table."""
    new = entered(hypothesis, around.observed, around.columns, around.level)
    if new is None:
        return None
    return replace(
        new,
        kind=candidate.kind,
        variants=candidate.variants,
        laws=candidate.laws,
        rarity=candidate.rarity,
    )
