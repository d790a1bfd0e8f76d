"""Intervals: the parameters of what was found, and how well the recordings determine them.

Around the improved simulation the torque is linear in every parameter: in those of the findings,
which nothing but data determines, and in those that are known within tolerances. Their joint
covariance is that of least squares. Where errors are not what the noise model says, scores summed
over blocks of time show it, and the larger of the two variances counts.

Source: White, "Maximum likelihood estimation of misspecified models", Econometrica 1982.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.columns import Columns
from estimators.diagnosis.evidence import Prior, joined
from estimators.diagnosis.noise import Noise, roughness
from estimators.diagnosis.nuisance import nuisance_of
from estimators.diagnosis.responses import responses
from estimators.diagnosis.revision import relative_inertia
from estimators.diagnosis.verdict import Finding, Interval
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics.effect import JOINT, TEXT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.observations import Observations
    from limo_driver.model import Inertial
    from limo_driver.physics import Effect, Parameter, Simulation
    from limo_driver.types import FloatArray

_Z95 = 1.96
_WIDER = 1.0  # times what noise alone makes
_STEP = 1e-3  # prior deviations, for derivatives
_BLOCK = 2.0  # [s], over which scores are summed
_CHOSEN = {"positions", "times", "width", "windows", "ratio", "reference"}  # not estimated
_FREE_INERTIA = 0.4  # relative deviation of a body that is simply wrong
_OF_LISTS = {"com": 0.2, "inertia": 0.02, "gravity": 1.0, "phase": 1.0}  # prior deviation
_ANGLE = 1.0  # [rad], prior deviation of a rest position
_MOMENTS = [4, 5, 7, 6, 8, 9]  # xx, xy, xz, yy, yz, zz among the parameters of a link


@dataclass(frozen=True)
class Entry:
    """One number among the parameters of an effect."""

    name: str
    at: int | None  # place in a list
    value: float
    deviation: float  # before any data

    def moved(self, effect: Any, by: float) -> Effect:  # noqa: ANN401  # of any class
        """Return the effect with this number moved."""
        if self.at is None:
            return replace(effect, **{self.name: self.value + by})
        values = list(getattr(effect, self.name))
        values[self.at] += by
        return replace(effect, **{self.name: tuple(values)})


def with_parameters(findings: Sequence[Finding], observed: Observations) -> tuple[Finding, ...]:
    """Return the findings with the parameters that the improved simulation gives them.

    Args:
        findings: What was found; those without an effect in the simulation stay as they are.
        observed: The recordings beside the improved simulation.
    """
    effects = {k: effect for k, item in enumerate(findings) if (effect := _effect(item, observed))}
    bodies = {k: item.joints[0] - 1 for k, item in enumerate(findings) if _is_body(item)}
    if not effects and not bodies:
        return tuple(findings)
    of_effects, of_bodies = deviations(observed, [*effects.values()], [*bodies.values()])
    known = {
        k: _of_effect(effect, spread)
        for (k, effect), spread in zip(effects.items(), of_effects, strict=True)
    } | {
        k: _of_body(_inertial(observed.simulation, link), spread)
        for (k, link), spread in zip(bodies.items(), of_bodies, strict=True)
    }
    return tuple(
        replace(item, parameters=known[k]) if k in known else item
        for k, item in enumerate(findings)
    )


def _is_body(finding: Finding) -> bool:
    return finding.effect == "link_inertia"


def _inertial(simulation: Simulation, link: int) -> Inertial:
    return simulation.model.inertials[simulation.model.link_names[link]]


def _effect(finding: Finding, observed: Observations) -> Effect | None:
    """Return the effect of the improved simulation that a finding is about."""
    same = [
        effect
        for effect in observed.simulation.effects
        if effect.name == finding.effect and set(effect.joints) <= set(finding.joints)
    ]
    if not same or finding.effect == "external_contact":
        return None
    return same[-1] if finding.kind == "missing" else same[0]


def entries_of(effect: Effect) -> tuple[Entry, ...]:
    """Return the numbers of an effect that are estimated; a zero is a part that it lacks."""
    return tuple(
        Entry(known.name, at, value, deviation)
        for known in effect.parameters()
        for at, value in _numbers(effect, known)
        if (deviation := _deviation(known, value))
    )


def _numbers(effect: Any, known: Parameter) -> Iterator[tuple[int | None, float]]:  # noqa: ANN401
    value = getattr(effect, known.name)
    if value is None or known.unit in {TEXT, JOINT} or known.name in _CHOSEN:
        return
    if known.is_list:
        yield from enumerate(map(float, value))
    else:
        yield None, float(value)


def _deviation(known: Parameter, value: float) -> float:
    """Return how far a number may be off before any data, in its unit."""
    if known.is_list and known.name in _OF_LISTS:
        return _OF_LISTS[known.name]
    return _ANGLE if known.name == "rest" else abs(value)


def deviations(
    observed: Observations, found: Sequence[Effect], bodies: Sequence[int]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the standard deviations of what was found.

    Args:
        observed: The recordings beside the improved simulation.
        found: Effects of that simulation that are findings.
        bodies: Links (0-based) whose bodies are findings.

    Returns:
        For each effect those of its `entries_of`, and for each body those of mass [kg], centre of
        mass [m] and inertia (xx, xy, xz, yy, yz, zz) [kg m²].
    """
    simulation, residual = observed.simulation, observed.residual
    rest = tuple(effect for effect in simulation.effects if not any(effect is f for f in found))
    around = replace(observed, simulation=replace(simulation, effects=rest))
    columns = Columns(*residual.shape)
    rough = roughness(residual, observed.moving)
    known = _freed(nuisance_of(around, columns, rough).prior, bodies)
    own = [_entered(effect, observed, columns) for effect in found]
    spread = np.sqrt(_variance(observed, columns, residual, joined(known, *own)))
    ends = np.cumsum([known.index.size, *(part.index.size for part in own)])
    links = (slice(PER_LINK * link, PER_LINK * (link + 1)) for link in bodies)
    return (
        [spread[a:b] for a, b in pairwise(ends.tolist())],
        [
            _in_units(_inertial(simulation, link), spread[rows])
            for link, rows in zip(bodies, links, strict=True)
        ],
    )


def _freed(prior: Prior, bodies: Sequence[int]) -> Prior:
    """Return the prior of the nuisance columns, bodies first, with some bodies free."""
    deviation = prior.deviation.copy()
    for link in bodies:
        deviation[PER_LINK * link : PER_LINK * (link + 1)] = _FREE_INERTIA
    return Prior.free(prior.index, deviation)


def _entered(effect: Effect, observed: Observations, columns: Columns) -> Prior:
    """Add what each number of an effect adds to the torque, to first order."""
    entries = entries_of(effect)
    signs = (1.0, -1.0)
    moved = [e.moved(effect, sign * _STEP * e.deviation) for e in entries for sign in signs]
    parts = responses(moved, observed)
    joints = sorted({joint for part in parts for joint in part.joints})
    values = np.zeros((len(joints), len(observed.kept), len(entries)))
    for k, part in enumerate(parts):
        step = 2 * signs[k % 2] * _STEP * entries[k // 2].deviation
        for joint, row in zip(part.joints, part.values, strict=True):
            values[joints.index(joint), :, k // 2] += row / step
    return Prior.free(columns.add(joints, values), np.array([e.deviation for e in entries]))


def _variance(
    observed: Observations, columns: Columns, residual: FloatArray, prior: Prior
) -> FloatArray:
    """Return the variance of each coefficient, in its own unit squared."""
    use, s, size = observed.moving, prior.deviation, prior.index.size
    noise = Noise.of(residual, use, observed.segment)
    block = _blocks(observed)
    gram, scores = np.zeros((size, size)), np.zeros((int(block.max()) + 1, size))
    for joint in range(observed.n):
        values, at = columns.of_joint(joint)
        rows = use[:, joint]
        A = noise.whiten(values, joint)[rows] * s[at]
        y = noise.whiten(residual[:, joint], joint)[rows]
        gram[np.ix_(at, at)] += A.T @ A
        np.add.at(scores, np.ix_(block[rows], at), A * y[:, None])
    inverse = np.linalg.inv(gram + np.eye(size))
    spread = inverse @ (scores.T @ scores + np.eye(size)) @ inverse
    return np.maximum(np.diag(inverse), np.diag(spread)) * s**2


def _blocks(observed: Observations) -> NDArray[np.int64]:
    """Number the block of time of each row, (K,)."""
    of_time = np.floor(observed.slow.time / _BLOCK).astype(np.int64)
    both = np.stack([observed.segment, of_time], axis=1)
    return np.unique(both, axis=0, return_inverse=True)[1].ravel()


def _of_effect(effect: Any, spread: FloatArray) -> dict[str, Interval]:  # noqa: ANN401
    deviation = {
        (entry.name, entry.at): float(s)
        for entry, s in zip(entries_of(effect), spread, strict=True)
    }
    known: dict[str, Interval] = {}
    for item in effect.parameters():
        value = getattr(effect, item.name)
        if value is None or value == ():
            continue
        within = (item.lower, item.upper)
        pairs = [_interval(x, deviation.get((item.name, at), 0.0), within)
                 for at, x in _numbers(effect, item)]  # fmt: skip
        estimated = any(name == item.name for name, _ in deviation)
        ci = (tuple(pairs) if item.is_list else pairs[0]) if estimated else None
        known[item.name] = Interval(value, item.unit, ci)
    return known


def _of_body(body: Inertial, spread: FloatArray) -> dict[str, Interval]:
    free, positive = (-np.inf, np.inf), (0.0, np.inf)
    com = [_interval(x, s, free) for x, s in zip(body.com, spread[1:4], strict=True)]
    inertia = [_interval(x, s, free) for x, s in zip(body.inertia, spread[4:], strict=True)]
    return {
        "mass": Interval(body.mass, "kg", _interval(body.mass, spread[0], positive)),
        "com": Interval(body.com, "m", tuple(com)),
        "inertia": Interval(body.inertia, "kg m^2", tuple(inertia)),
    }


def _interval(value: float, spread: float, within: tuple[float, float]) -> tuple[float, float]:
    half = _Z95 * _WIDER * float(spread)
    return max(value - half, within[0]), min(value + half, within[1])


def _in_units(body: Inertial, relative: FloatArray) -> FloatArray:
    """Return deviations of mass, centre of mass and inertia of relative ones, (10,)."""
    scale = np.diag(relative_inertia(body)).copy()
    scale[1:4] /= body.mass
    return np.concatenate([(scale * relative)[:4], (scale * relative)[_MOMENTS]])
