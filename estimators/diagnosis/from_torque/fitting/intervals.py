"""Intervals: the parameters of what was found, and how well the recordings determine them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from estimators.diagnosis.from_torque.fitting.entries import entries_of, found_in, numbers_of
from estimators.diagnosis.from_torque.fitting.linearised import Linearised
from estimators.diagnosis.from_torque.fitting.sites import seen_by_sites
from estimators.diagnosis.from_torque.hypotheses.revision import relative_inertia
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Identified, Interval
from estimators.rigid_body.dynamics.regressor import PER_LINK
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model.descriptions.inertial import Inertial
    from limo_driver.physics import Effect, Simulation
    from limo_driver.types import FloatArray

_Found = TypeVar("_Found", Finding, Identified, "Finding | Identified")
_Z95 = 1.96
_MOMENTS = [4, 5, 7, 6, 8, 9]  # xx, xy, xz, yy, yz, zz among the parameters of a link


def with_parameters(findings: Sequence[_Found], observed: Observations) -> tuple[_Found, ...]:
    """Return what was found with the parameters that the improved simulation gives it.

    Args:
        findings: Findings, or identified values; those without an effect in the simulation stay as
            they are.
        observed: The recordings beside the improved simulation.
    """
    simulation = observed.simulation
    effects = {
        k: effect for k, item in enumerate(findings) if (effect := _effect(item, simulation))
    }
    own = simulation.model.linkage.own  # links, by joint
    links = {k: int(own[x.joints[0] - 1]) for k, x in enumerate(findings) if _is_body(x)}
    if not effects and not links:
        return tuple(findings)
    around = Linearised.of(observed, tuple(effects.values()), tuple(links.values()))
    of_nuisance, of_effects = around.deviations()
    parameters = {
        k: _of_effect(effect, spread)
        for (k, effect), spread in zip(effects.items(), of_effects, strict=True)
    }
    for k, link in links.items():
        body = simulation.model.inertials[simulation.model.link_names[link]]
        relative = of_nuisance[PER_LINK * link : PER_LINK * (link + 1)]
        parameters[k] = _of_body(body, _in_units(body, relative))
    told = tuple(
        replace(item, parameters=parameters.get(k, item.parameters))
        for k, item in enumerate(findings)
    )
    seen = {
        k: seen_by_sites(effect.load, simulation.model)
        for k, effect in effects.items()
        if isinstance(effect, Payload)
    }
    return tuple(
        replace(item, evidence=item.evidence + seen[k])
        if seen.get(k) and isinstance(item, Finding)
        else item
        for k, item in enumerate(told)
    )


def _is_body(finding: Finding | Identified) -> bool:
    return finding.effect == "link_inertia"


def _effect(finding: Finding | Identified, simulation: Simulation) -> Effect | None:
    if finding.effect in {CONTACT, UNKNOWN}:
        return None
    missing = isinstance(finding, Identified) or finding.kind == "missing"
    return found_in(simulation, finding.effect, finding.joints, missing=missing)


def _of_effect(effect: Any, spread: FloatArray) -> dict[str, Interval]:  # noqa: ANN401  # of any class
    """Return the parameters of an effect, given the deviations of its entries."""
    entries = zip(entries_of(effect), spread.tolist(), strict=True)
    deviation = {(entry.name, entry.at): s for entry, s in entries}
    known: dict[str, Interval] = {}
    for item in effect.parameters():
        value, within = getattr(effect, item.name), (item.lower, item.upper)
        if value is None or value == ():
            continue
        pairs = [
            _interval(x, deviation.get((item.name, at), 0.0), within)
            for at, x in numbers_of(effect, item)
        ]
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
    half = _Z95 * float(spread)
    return max(value - half, within[0]), min(value + half, within[1])


def _in_units(body: Inertial, relative: FloatArray) -> FloatArray:
    """Return deviations of mass, centre of mass and inertia, given the relative ones (10,)."""
    scale = np.diag(relative_inertia(body)).copy()
    scale[1:4] /= body.mass  # of m c
    return np.concatenate([(scale * relative)[:4], (scale * relative)[_MOMENTS]])
