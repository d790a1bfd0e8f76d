"""Tree: plain questions about what the residual of a joint depends on, one nested in the other.

Does it remember where the joint turned? If not only that, does it change with speed, with load,
with position, with time? Each question adds a generic family of columns to those that said yes
before it. They name no effect; they show on what ground the names stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.responses import over_joint
from estimators.diagnosis.result import Test
from estimators.diagnosis.selection.columns import Columns, Products
from estimators.diagnosis.selection.evidence import Evidence, Prior, joined, posterior
from limo_driver.physics import PreslidingHysteresis

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimators.diagnosis.fitting.problem import Bench, Solution
    from estimators.diagnosis.residuals.noise import Noise
    from estimators.diagnosis.residuals.observations import Observations
    from estimators.diagnosis.selection.evidence import Posterior
    from limo_driver.types import FloatArray

AFFECTED = 1.15  # times its noise floor, from which a joint's error is looked into
LEAST_EVIDENCE = 6.0  # [nat] for a yes
LEAST_SHARE = 0.05  # of the joint's reducible error on rows held out, for a yes
_DISTANCES = (1e-3, 6e-3, 0.03, 0.15)  # [rad] over which friction may build up
_SPEEDS = (0.01, 0.05)  # [rad/s]
_HATS = 5
_LEAST_REDUCIBLE = 0.1  # of the floor; where less is held out, shares would be noise


def tests_of(bench: Bench, solution: Solution) -> tuple[Test, ...]:
    """Ask every question of every joint whose error is above its noise floor.

    Args:
        bench: Observations, nuisance columns and rows held out.
        solution: The chosen set; what it leaves is the noise floor, and its noise counts.
    """
    empty = solution.search.prior(())
    before = bench.left(solution.search.evidence.posterior(empty))
    after = bench.left(solution.fitted)
    tests: list[Test] = []
    for joint in range(bench.observed.n):
        rows = bench.observed.moving[:, joint]
        energy, floor = (float(np.sum(left[rows, joint] ** 2)) for left in (before, after))
        if energy > AFFECTED**2 * floor:
            floor /= max(1, int(rows.sum()))
            tests += _Questions.of(bench, solution.noise, joint, floor).asked()
    return tuple(tests)


_Family = tuple[str, "Callable[[Observations, int], FloatArray]"]


@dataclass(frozen=True)
class _Questions:
    """One joint's residual, with nuisance columns and those of every question in a table."""

    bench: Bench
    joint: int  # 0-based
    columns: Columns  # of one joint
    nuisance: Prior
    families: tuple[tuple[str, Prior], ...]
    products: Products
    floor: float  # mean square of the noise [N² m²]

    @classmethod
    def of(cls, bench: Bench, noise: Noise, joint: int, floor: float) -> _Questions:
        """Lay out the columns of all questions at a joint (0-based)."""
        residual = bench.target[:, joint : joint + 1]
        columns = Columns(residual.shape[0], 1)
        nuisance = _nuisance(bench, columns, joint)
        level = float(bench.level[joint])
        sharp = [family(bench.observed, joint) for _, family in _FAMILIES]
        ends = np.cumsum([part.shape[1] for part in sharp])[:-1]
        made = np.split(bench.observed.filter(np.concatenate(sharp, axis=1)), ends, axis=1)
        families: list[tuple[str, Prior]] = []
        for (question, _), part in zip(_FAMILIES, made, strict=True):
            strength = np.maximum(np.sqrt(np.mean(part**2, axis=0)), 1e-12)
            index = columns.add((0,), np.ascontiguousarray(part / strength)[None])
            families.append((question, Prior.free(index, np.full(index.size, level))))
        return cls(
            bench,
            joint,
            columns,
            nuisance,
            tuple(families),
            Products.of(columns, residual, _own(noise, joint), bench.split.fitted[:, [joint]]),
            floor,
        )

    def asked(self) -> list[Test]:
        """Ask one question after the other; a yes stays for those that follow."""
        evidence = Evidence(self.products, self.nuisance)
        known = joined()
        gain, error = 0.0, self._error(known)
        reducible = max(error - self.floor, _LEAST_REDUCIBLE * self.floor, 1e-12)
        tests: list[Test] = []
        for question, family in self.families:
            both = joined(known, family)
            more, less = evidence.gain(both), self._error(both)
            share = float(np.clip((error - less) / reducible, 0.0, 1.0))
            yes = more - gain > LEAST_EVIDENCE and share > LEAST_SHARE
            tests.append(Test(self.joint + 1, question, share, yes))
            if yes:
                known, gain, error = both, more, less
        return tests

    def _error(self, prior: Prior) -> float:
        """Return the mean square on rows held out after a fit to the others [N² m²]."""
        fit: Posterior = posterior(self.products, self.nuisance, prior)
        left = self.bench.target[:, self.joint] - self.columns.apply(fit.index, fit.mean)[:, 0]
        return float(np.mean(left[self.bench.split.held_out[:, self.joint]] ** 2))


def _nuisance(bench: Bench, columns: Columns, joint: int) -> Prior:
    """Copy the nuisance columns that act on a joint."""
    values, at = bench.columns.of_joint(joint)
    prior = bench.nuisance.prior
    place = {int(index): k for k, index in enumerate(prior.index)}
    own = np.array([k for k, index in enumerate(at) if int(index) in place], dtype=np.int64)
    index = columns.add((0,), np.ascontiguousarray(values[:, own])[None])
    known = np.array([place[int(at[k])] for k in own], dtype=np.int64)
    return Prior(index, prior.deviation[known], prior.positive[known])


def _own(noise: Noise, joint: int) -> Noise:
    """Return the noise of one joint as that of an arm of one joint."""
    return replace(
        noise,
        weight=noise.weight[[joint]],
        white=noise.white[[joint]],
        known=noise.known[:, [joint]],
    )


def _sign(observed: Observations, j: int) -> FloatArray:
    return np.tanh(observed.motion.velocity[:, j] / 0.002)


def _memory(observed: Observations, j: int) -> FloatArray:
    return np.stack(
        [over_joint(PreslidingHysteresis.stop(j + 1, w), observed) for w in _DISTANCES], axis=1
    )


def _rate(observed: Observations, j: int) -> FloatArray:
    v = observed.motion.velocity[:, j]
    sign = _sign(observed, j)
    fading = [sign * np.exp(-np.abs(v) / speed) for speed in _SPEEDS]
    return np.stack([sign, v, v * np.abs(v), *fading], axis=1)


def _load(observed: Observations, j: int) -> FloatArray:
    load = observed.load[:, j]
    load = load / max(float(np.abs(load).max()), 1e-9)
    sign = _sign(observed, j)
    return np.stack([load, sign * np.abs(load), sign * load], axis=1)


def _position(observed: Observations, j: int) -> FloatArray:
    return _with_sign(_hats(observed.motion.position[:, j]), _sign(observed, j))


def _time(observed: Observations, j: int) -> FloatArray:
    return _with_sign(_hats(observed.motion.time), _sign(observed, j))


def _with_sign(hats: FloatArray, sign: FloatArray) -> FloatArray:
    return np.concatenate([hats, sign[:, None] * hats], axis=1)


def _hats(values: FloatArray) -> FloatArray:
    knots = np.linspace(values.min(), max(values.max(), values.min() + 1e-6), _HATS)
    return np.maximum(0.0, 1.0 - np.abs(values[:, None] - knots) / (knots[1] - knots[0]))


_FAMILIES: tuple[_Family, ...] = (
    ("Does the residual depend on the distance since the last reversal?", _memory),
    ("Does it change with speed?", _rate),
    ("Does it change with the load on the joint?", _load),
    ("Does it change with the position of the joint?", _position),
    ("Does it change with time, at the same position and speed?", _time),
)
