"""Intervals: the parameters of what was found, and how well the recordings determine them.

Foreseen: how far a fitted simulation may be off on other motion, by what the rows left open.

A parameter that the recorded motion hardly shows keeps most of what its tolerance allows. On motion
that shows it, it then adds an error, however good the fit. The covariance of all that was fitted
says how large that is to be expected:

    variance of the torque = x C xᵀ,   C = (X'ᵀ X' + S⁻²)⁻¹

with X' the whitened columns of the rows fitted, S what was known before them, and x the columns of
the other motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from estimators.diagnosis.from_torque.fitting.entries import entries_of, found_in, numbers_of
from estimators.diagnosis.from_torque.fitting.linearised import Linearised
from estimators.diagnosis.from_torque.hypotheses.catalogue import relative_inertia
from estimators.diagnosis.quantities import listed
from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Z95, Finding, Identified, Interval
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.model.descriptions.description import SITE
from limo_driver.model.units import unit_of
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import Effect, Simulation
    from limo_driver.types import FloatArray

_Found = TypeVar("_Found", Finding, Identified, "Finding | Identified")

_OF_A_CYCLE = frozenset(("phase",))  # angles, whatever a joint does
_BODY = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]  # of a link: m, com, xx, xy, xz, yy, yz, zz
Place = tuple[str, "Sequence[int]", bool]


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
        f"{listed(places[-WORDING.places :])}."
    )


@dataclass(frozen=True)
class Foreseen:
    """What the fit of a simulation leaves open."""

    simulation: Simulation  # the fitted one
    given: Simulation  # whose values were known to its tolerances
    places: tuple[Place, ...]
    root: FloatArray  # R (c, c), with Rᵀ R the covariance of the coefficients of `Linearised`

    @classmethod
    def of(cls, fitted: Observations, given: Simulation, places: Sequence[Place]) -> Foreseen:
        """Take it from the recordings beside the simulation that was fitted to them.

        Args:
            fitted: The recordings beside that simulation.
            given: The simulation whose values were known to its tolerances.
            places: Of what was found: effect, joints (1-based), and whether it was missing.
        """
        around = _around(fitted, given, places)
        return cls(fitted.simulation, given, tuple(places), around.root())

    def rms(self, motion: Observations) -> FloatArray:
        """Return the error to be expected on other motion, (n,) [N m] RMS over its moving rows.

        Args:
            motion: Recordings of that motion; their torques do not matter.
        """
        around = _around(motion.under(self.simulation), self.given, self.places)
        entered = around.entered
        result = np.zeros(motion.n)
        for joint in range(motion.n):
            values, at = around.columns.of_joint(joint)
            own = entered[at]
            rows = motion.moving[:, joint]
            spread = values[np.ix_(rows, own)] @ self.root[:, at[own]].T
            result[joint] = np.sqrt(np.sum(spread**2) / max(len(spread), 1))
        return result


def _around(observed: Observations, given: Simulation, places: Sequence[Place]) -> Linearised:
    own = [found_in(observed.simulation, name, on, missing=missing) for name, on, missing in places]
    some = tuple({id(effect): effect for effect in own if effect is not None}.values())
    bodies = [on[0] - 1 for name, on, _ in places if name == "link_inertia"]
    return Linearised.of(observed, some, bodies, given)
