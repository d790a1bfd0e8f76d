"""Stated values: what the given simulation states, and what fits the recordings.

A tolerance says how surprising it is that a value differs, never whether that is reported. It is
where it is sure, and where a tenth of a joint's reducible error goes with it on motion held out:
with the value as it is stated, and all else as it was proven, the joint errs by that much more.

Of bodies, torques tell sums alone: masses and centres of several links make one torque at a joint.
They are reported as a family, by the torque that they make there; and so are all values of a joint
where it errs by more than noise as given, they take that away together, and none does alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import TINY
from estimators.diagnosis.from_torque.hypotheses.responses import difference
from estimators.diagnosis.from_torque.judgement.intervals import ValueComparison
from estimators.diagnosis.settings import Z95
from estimators.diagnosis.settings.fitting import TOLERATED
from estimators.diagnosis.verdict import LINK_INERTIA, StatedValue, is_felt_by_all
from estimators.regression.evidence import REACH
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.model.units import unit_of
from limo_driver.physics import BodyEffect, TorqueGain

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.verdict import Finding
    from limo_driver.physics import Effect, Parameter, Simulation
    from limo_driver.types import FloatArray


def stated_values(
    judged: JudgedSet,
    improved: Observations,
    stated: Simulation,
    findings: Sequence[Finding] = (),
) -> tuple[StatedValue, ...]:
    """Return the stated values and those that fit, the families among them last.

    Args:
        judged: The set, with its proof on motion held out.
        improved: The recordings and the simulation that was fitted to all their rows.
        stated: The given simulation, with gravity as the arm is mounted.
        findings: Of the verdict, with their parameters.
    """
    if improved.simulation is stated:
        return ()
    return tuple(_Values.of(judged, improved, stated, tuple(findings)).values())


@dataclass(frozen=True)
class _Values(ValueComparison):
    """Values that are stated, one by one and in families."""

    def values(self) -> Iterator[StatedValue]:
        """Yield single values, then families."""
        changes = np.zeros_like(self.improved.measured)
        reported: set[int] = set()
        for value, change in (*self._sizes(), *self._gains()):
            changes += 0.0 if is_felt_by_all(value.effect) else change
            joints = value.joints or tuple(range(1, self.improved.n + 1))
            reported |= {*joints} if value.reported else set()
            yield value
        bodies = np.zeros_like(changes)  # of links that are reported alone
        if any(item.effect == LINK_INERTIA for item in self.findings):
            yield from self._masses()
        else:
            for value, change in self._links():
                bodies += change
                yield value
            yield from self._families(changes, reported, bodies)

    def _sizes(self) -> Iterator[tuple[StatedValue, FloatArray]]:
        """Yield the sizes of stated effects, with what the proven ones add, (K, n) [N m]."""
        for effect, fitted, proven in self._matched():
            for known in effect.parameters():
                stated = getattr(effect, known.name)
                if known.is_size and stated:
                    change = self._added(proven, proven.with_value(known.name, float(stated)))
                    yield self._size(effect, fitted, known, change), change

    def _matched(self) -> Iterator[tuple[Any, Any, Any]]:
        """Yield stated effects with those in their place: fitted to all rows, and proven."""
        every = [
            list(simulation.effects)
            for simulation in (self.improved.simulation, self.proof.simulation)
        ]
        for effect in self.stated.effects:
            fitted, proven = (
                next((x for x in own if x.place == effect.place), None) for own in every
            )
            if fitted is not None and proven is not None:
                every = [
                    [x for x in own if x is not gone]
                    for own, gone in zip(every, (fitted, proven), strict=True)
                ]
                yield effect, fitted, proven

    def _size(
        self, effect: Effect, fitted: Effect, known: Parameter, change: FloatArray
    ) -> StatedValue:
        stated, value = (float(getattr(one, known.name)) for one in (effect, fitted))
        spread, sharp = self._spread(fitted, known), known.smooths
        off, wrong = abs(value - stated), self._is_wrong(effect) and not sharp
        doubtless = spread is not None and not sharp and off > 2 * REACH * spread
        share, sure = self.taken(change, np.abs(change).max(axis=0) > 0.0, doubtless=doubtless)
        own = TOLERATED.width if sharp else self.stated.tolerances.friction
        reported = wrong or (sure and spread is not None and off > REACH * spread)
        unit = unit_of(known.unit, [self.stated.model.sliding[j - 1] for j in effect.joints])
        found = self._value(known.name, effect.name, effect.joints, unit, stated, value, share)
        return replace(
            found,
            ci95=_interval(value, spread, known.lower, known.upper),
            tolerance=own * abs(stated),
            assumed=sharp or self._is_assumed("friction"),
            beyond=reported and not sharp and (wrong or off > REACH * own * abs(stated)),
            reported=reported,
        )

    def _value(
        self,
        name: str,
        effect: str,
        joints: tuple[int, ...],
        unit: str,
        stated: float,
        fitted: float,
        share: float,
    ) -> StatedValue:
        names = self.names(joints)
        return StatedValue(name, effect, joints, names, unit, stated, fitted, share=share)

    def _is_assumed(self, tolerance: str) -> bool:
        return tolerance in self.stated.tolerances.assumed

    def _spread(self, fitted: Effect, known: Parameter) -> float | None:
        """Return the standard deviation of a size in its unit; None where none is known."""
        if (found := self.found.get((id(fitted), known.name))) is not None:
            return found
        at = self.tolerated.get((fitted.name, tuple(j - 1 for j in fitted.joints), known.name))
        if at is None:
            return None
        item, start = self.around.nuisance.parameters[at], float(self.around.nuisance.start[at])
        ends = [item.value(start + side * float(self.deviation[at])) for side in (-1.0, 1.0)]
        return abs(ends[1] - ends[0]) / 2.0

    def _is_wrong(self, effect: Effect) -> bool:
        return any(
            item.kind == "wrong_parameter"
            and item.effect == effect.name
            and (item.joints == effect.joints or not effect.joints)
            for item in self.findings
        )

    def _added(self, ahead: Effect, behind: Effect) -> FloatArray:
        """Return what one effect adds more than another of its kind, (K, n) [N m]."""
        change = np.zeros_like(self.improved.measured)
        if ahead != behind:
            joints, values = difference(ahead, behind, self.proof)
            change[:, list(joints)] = values.T
        return change

    def _gains(self) -> Iterator[tuple[StatedValue, FloatArray]]:
        """Yield the scales of torques, where a tolerance lets them move and none is stated."""
        places = {effect.place for effect in self.stated.effects}
        at = {x.name: k for k, x in enumerate(self.around.nuisance.parameters)}
        tolerance = self.stated.tolerances.gain
        for effect in self.proof.simulation.effects if tolerance else ():
            if not isinstance(effect, TorqueGain) or effect.place in places:
                continue
            change = self._added(effect, replace(effect, gain=0.0))
            share, sure = self.taken(change, np.abs(change).max(axis=0) > 0.0)
            gain = 1.0 + sum(
                x.gain
                for x in self.improved.simulation.effects
                if isinstance(x, TorqueGain) and x.place == effect.place
            )
            k = at.get(f"gain of torque {effect.joint}")
            spread, off = None if k is None else float(self.deviation[k]), abs(gain - 1.0)
            reported = sure and spread is not None and off > REACH * spread
            found = self._value("gain", effect.name, effect.joints, "1", 1.0, gain, share)
            yield (
                replace(
                    found,
                    ci95=_interval(gain, spread),
                    tolerance=tolerance,
                    assumed=self._is_assumed("gain"),
                    beyond=reported and off > REACH * tolerance,
                    reported=reported,
                ),
                change,
            )

    def _masses(self) -> Iterator[StatedValue]:
        """Yield the masses of links that were found wrong."""
        for item in self.findings:
            mass = item.parameters.get("mass")
            if item.effect == LINK_INERTIA and mass is not None:
                value = float(mass.value)  # pyright: ignore[reportArgumentType]  # a number
                found = self._mass(item.joints[0], value, item.share)
                yield replace(found, ci95=mass.ci95, beyond=True)

    def _links(self) -> Iterator[tuple[StatedValue, FloatArray]]:
        """Yield the masses that torques tell alone, as the last link's, with what they add."""
        proof, improved = self.proof.simulation, self.improved.simulation
        at = {x.name: k for k, x in enumerate(self.around.nuisance.parameters)}
        for joint in range(1, self.improved.n + 1):
            name = self._link(joint)
            body = self.stated.model.inertials[name]
            value = improved.model.inertials[name].mass
            reach = Z95 * float(self.deviation[at[f"mass of {name}"]]) * body.mass
            if abs(value - body.mass) <= REACH / Z95 * reach:
                continue
            before = replace(proof, inertials={**proof.inertials, name: body})
            change = self._of_bodies(proof) - self._of_bodies(before)
            share, sure = self.taken(change, np.abs(change).max(axis=0) > 0.0)
            if sure:
                ends = max(value - reach, 0.0), value + reach
                yield replace(self._mass(joint, value, share), ci95=ends), change

    def _link(self, joint: int) -> str:
        model = self.stated.model
        return model.link_names[int(model.linkage.own[joint - 1])]

    def _mass(self, joint: int, value: float, share: float) -> StatedValue:
        """Return a mass; a fit that is no finding moved it as far as it is tolerated, at most."""
        mass, known = self.stated.model.inertials[self._link(joint)].mass, self.stated.tolerances
        return replace(
            self._value("mass", LINK_INERTIA, (joint,), "kg", mass, value, share),
            tolerance=known.inertia * mass,
            assumed=self._is_assumed("inertia"),
            reported=True,
        )

    def _families(
        self, changes: FloatArray, reported: set[int], alone: FloatArray
    ) -> Iterator[StatedValue]:
        """Yield the bodies, where they take enough; then all of joints that nothing is reported of.

        Args:
            changes: What single values add, as proven, (K, n) [N m].
            reported: Joints, 1-based, that single values are reported of.
            alone: What bodies add that are reported alone, as proven, (K, n) [N m].
        """
        if any(is_felt_by_all(item.effect) for item in self.findings):
            return  # a load that was found moves all of them, and is reported by its name
        simulations = self.stated, self.proof.simulation, self.improved.simulation
        given, proven, final = map(self._of_bodies, simulations)
        bodies, n = proven - given - alone, self.improved.n
        if felt := {j: share for j in range(n) if (share := self._sure_share(bodies, j))}:
            loads = any(isinstance(effect, BodyEffect) for effect in self.stated.effects)
            name = f"masses and centres of links{' and loads' if loads else ''}"
            yield self._family(name, given, final, felt, of_bodies=True)
        every = bodies + alone + changes
        rest = [j for j in range(n) if j + 1 not in reported and j not in felt]
        if together := {j: share for j in rest if (share := self._sure_share(every, j))}:
            before, after = self.judged.problem.observed.simulated, self.improved.simulated
            yield self._family("values within tolerances", before, after, together)

    def _of_bodies(self, simulation: Simulation) -> FloatArray:
        slow = self.improved.slow
        return simulation.body.inverse_dynamics(slow.position, slow.velocity, slow.acceleration)

    def _sure_share(self, change: FloatArray, joint: int) -> float:
        """Return the part of a joint's reducible error that a change surely takes; else 0."""
        share, sure = self.taken(change, np.arange(self.improved.n) == joint)
        return share if sure else 0.0

    def _rms_of_bodies(self, torque: FloatArray, joint: int) -> float:
        """Return the standard deviation of the RMS torque of bodies at a joint [N m]."""
        rows = self.improved.moving[:, joint]
        values, at = self.around.columns.of_joint(joint)
        bodies = at < PER_LINK * self.stated.model.linkage.links
        own = torque[rows, joint]
        size = max(float(np.sqrt(np.mean(own**2))), TINY) * len(own)
        factors = np.zeros(self.around.columns.count)
        factors[at[bodies]] = own @ values[np.ix_(rows, bodies)] / size
        return self.around.deviation_of_sum(factors)

    def _family(
        self,
        name: str,
        given: FloatArray,
        fitted: FloatArray,
        felt: Mapping[int, float],
        *,
        of_bodies: bool = False,
    ) -> StatedValue:
        worst = max(felt, key=lambda j: felt[j])
        known = self._rms_of_bodies(fitted, worst) if of_bodies else None
        rows = self.improved.moving[:, worst]
        stated, value = (float(np.sqrt(np.mean(x[rows, worst] ** 2))) for x in (given, fitted))
        joints = (worst + 1, *(j + 1 for j in sorted(felt) if j != worst))
        unit = unit_of("N m", self.stated.model.sliding, worst)
        return replace(
            self._value(name, "", joints, unit, stated, value, felt[worst]),
            ci95=_interval(value, known, 0.0),
            assumed=self._is_assumed("inertia"),
            reported=True,
        )


def _interval(
    value: float, spread: float | None, low: float = -np.inf, high: float = np.inf
) -> tuple[float, float] | None:
    if spread is None:
        return None
    half = Z95 * spread
    return max(value - half, low), min(value + half, high)
