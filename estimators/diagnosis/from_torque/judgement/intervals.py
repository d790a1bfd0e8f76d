"""Intervals: the parameters of what was found, and how well the recordings determine them.

A given simulation, what was proven and what fits: how values differ, and what that takes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import surely_less
from estimators.diagnosis.from_torque.fitting.linearised import Linearised, effects_at
from estimators.diagnosis.from_torque.hypotheses.catalogue import (
    entries_of,
    found_in,
    numbers_of,
    relative_inertia,
)
from estimators.diagnosis.from_torque.judgement.conclusion import above_floor
from estimators.diagnosis.from_torque.judgement.judged_set import places_of
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.quantities import listed
from estimators.diagnosis.settings import MATTERS, Z95
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Identified, Interval
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.model.descriptions.description import SITE
from limo_driver.model.units import unit_of
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import Effect, Simulation
    from limo_driver.types import BoolArray, FloatArray

_Found = TypeVar("_Found", Finding, Identified, "Finding | Identified")

_OF_A_CYCLE = frozenset(("phase",))  # angles, whatever a joint does
_BODY = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]  # of a link: m, com, xx, xy, xz, yy, yz, zz


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
        k: _of_effect(effect, spread, simulation.model.sliding)
        for (k, effect), spread in zip(effects.items(), of_effects, strict=True)
    }
    for k, link in links.items():
        body = simulation.model.inertials[simulation.model.link_names[link]]
        relative = of_nuisance[PER_LINK * link : PER_LINK * (link + 1)]
        parameters[k] = _of_body(body, _in_units(body, relative))
    with_values = tuple(
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
        for k, item in enumerate(with_values)
    )


def _is_body(finding: Finding | Identified) -> bool:
    return finding.effect == "link_inertia"


def _effect(finding: Finding | Identified, simulation: Simulation) -> Effect | None:
    if finding.effect in {CONTACT, UNKNOWN}:
        return None
    missing = isinstance(finding, Identified) or finding.kind == "missing"
    return found_in(simulation, finding.effect, finding.joints, missing=missing)


def _of_effect(
    effect: Any,  # noqa: ANN401  # of any class
    spread: FloatArray,
    sliding: Sequence[bool],
) -> dict[str, Interval]:
    """Return the parameters of an effect, given the deviations of its entries."""
    entries = zip(entries_of(effect), spread.tolist(), strict=True)
    deviation = {(entry.name, entry.at): s for entry, s in entries}
    own = [sliding[j - 1] for j in effect.joints]
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
        unit = item.unit if item.name in _OF_A_CYCLE else unit_of(item.unit, own)
        known[item.name] = Interval(value, unit, ci)
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
    half = Z95 * float(spread)
    return max(value - half, within[0]), min(value + half, within[1])


def _in_units(body: Inertial, relative: FloatArray) -> FloatArray:
    """Return deviations of mass, centre of mass and inertia, given the relative ones (10,)."""
    scale = np.diag(relative_inertia(body)).copy()
    scale[1:4] /= body.mass  # of m c
    return (scale * relative)[_BODY]


def seen_by_sites(load: Inertial, model: RobotModel) -> str:
    """Say where the sites that the last link carries see a load; empty where there are none.

    Args:
        load: In the frame of the last link.
        model: The arm that carries it.
    """
    links = {str(link.get("name")) for link in model.description.root.findall("link")}
    places: list[str] = []
    for name, pose in model.last_frames.items():
        if f"{SITE}{name}" in links:
            at = ", ".join(
                f"{x:.3f}" for x in load.moved(np.linalg.inv(pose).astype(np.float64)).com
            )
            places.append(f"({at}) m from the site {name}")
    if not places:
        return ""
    return (
        f" Its centre is given in the frame of {model.link_names[-1]}; it is at "
        f"{listed(places[-WORDING.listed :])}."
    )


@dataclass(frozen=True)
class ValueComparison:
    """A given, a proven and a fitted simulation, and what is known of their values."""

    judged: JudgedSet
    improved: Observations
    stated: Simulation
    findings: tuple[Finding, ...]
    around: Linearised
    deviation: FloatArray  # (c,) of the coefficients of what may move within its tolerance
    found: dict[tuple[int, str], float]  # deviations of sizes of what was found, by effect and name

    @classmethod
    def of(
        cls,
        judged: JudgedSet,
        improved: Observations,
        stated: Simulation,
        findings: tuple[Finding, ...],
    ) -> Self:
        """Linearise around the improved simulation, whose values were known as they are stated."""
        found = effects_at(improved.simulation, places_of(judged.solution))
        around = Linearised.of(improved, found, (), stated)
        deviation, of_found = around.deviations()
        spread = {
            (id(effect), entry.name): sigma
            for effect, sigmas in zip(found, of_found, strict=True)
            for entry, sigma in zip(entries_of(effect), sigmas.tolist(), strict=True)
        }
        return cls(judged, improved, stated, findings, around, deviation, spread)

    @property
    def proof(self) -> Observations:
        """The recordings and a simulation that was fitted to no row held out."""
        return self.judged.beside

    @cached_property
    def before(self) -> FloatArray:
        """Held-out RMSE of the given simulation, (n,) [N m]."""
        problem = self.judged.problem
        return rmse(problem.observed.residual, problem.split.held_out)

    @cached_property
    def above(self) -> BoolArray:
        """Mark the joints (n,) at which the given simulation surely errs by more than noise."""
        problem, floor = self.judged.problem, self.judged.remaining.floor
        found = above_floor(problem, problem.observed.residual, floor)
        return np.isin(np.arange(self.improved.n), found)

    @cached_property
    def tolerated(self) -> dict[tuple[str, tuple[int, ...], str], int]:
        """Which coefficient each value has that may move, by effect, joints (0-based) and name."""
        every = enumerate(self.around.nuisance.parameters)
        return {(*x.place, x.known.name): k for k, x in every if x.known is not None}

    def names(self, joints: Sequence[int]) -> tuple[str, ...]:
        """Return the names of some joints, 1-based."""
        return tuple(self.stated.model.joint_names[j - 1] for j in joints)

    def taken(
        self, change: FloatArray, acts: BoolArray, *, doubtless: bool = False
    ) -> tuple[float, bool]:
        """Return which part of a joint's reducible error a change takes, and whether that counts.

        Args:
            change: Torque by which the proven simulation differs from another, (K, n) [N m].
            acts: Joints at which it acts, (n,).
            doubtless: Whether it counts also where the given simulation errs hardly more than
                noise.
        """
        judged, rows = self.judged, self.judged.problem.split.held_out
        after, floor = judged.proven, judged.remaining.floor
        lost = rmse(after + change, rows) ** 2 - rmse(after, rows) ** 2
        reducible = self.before**2 - floor**2
        some = acts & (self.above | doubtless) & rows.any(axis=0)
        part = np.divide(lost, reducible, out=np.zeros_like(lost), where=some & (reducible > 0))
        joint = int(np.argmax(part))
        if part[joint] < MATTERS:
            return max(float(part[joint]), 0.0), False
        own = [joint]
        sure = surely_less(
            after[:, own],
            (after + change)[:, own],
            floor[own],
            judged.problem.observed,
            rows[:, own],
        )
        return min(float(part[joint]), 1.0), sure
