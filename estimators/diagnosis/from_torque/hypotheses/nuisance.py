"""Nuisance parameters: values that may differ from the simulation within their tolerances.

Inertias and friction are known to the tolerances of `sim.yaml`; sensors have a little offset and
lag. Each is a column with a prior standard deviation. Fitted without a prior, they would absorb
nearly all of an elasticity or a backlash; ignored, they would look like missing physics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.catalogue import (
    beside_stated,
    derivative,
    mover,
    relative_change,
    relative_inertia,
    reviser,
)
from estimators.diagnosis.from_torque.hypotheses.responses import response
from estimators.diagnosis.settings.fitting import TOLERATED
from estimators.regression.definite import inverse_root
from estimators.regression.evidence import REACH, Prior, joined
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.model.units import unit_of
from limo_driver.physics import (
    CoulombFriction,
    PositionDependentFriction,
    TimeDelay,
    TorqueGain,
    TorqueOffset,
    display_name,
)
from limo_driver.physics.effects.delay import UNIT_DELAY

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from estimators.diagnosis.from_torque.hypotheses.responses import Enter, Improvement
    from estimators.diagnosis.from_torque.residuals.noise import ColumnTable, Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Effect, Parameter, Simulation
    from limo_driver.types import BoolArray, FloatArray


# what is a part of an effect that is found, where something is tolerated of it
_CONTAINED = {
    PositionDependentFriction.name: CoulombFriction.name,
    TimeDelay.name: TimeDelay.name,
    TorqueOffset.name: TorqueOffset.name,
}


@dataclass(frozen=True)
class Tolerated:
    """One parameter that may move within its tolerance."""

    name: str  # e.g. "tau_c of joint 2 (coulomb friction)"
    unit: str  # or "relative"
    nominal: float
    scale: float  # what a relative change of 1 adds
    place: tuple[str, tuple[int, ...]] = ("", ())  # effect that has or is it; its joints (0-based)
    known: Parameter | None = None  # of an effect, where it is one
    lower: float = -np.inf
    upper: float = np.inf

    def value(self, coefficient: float) -> float:
        """Return the value that a fitted coefficient means, in the parameter's unit."""
        part = coefficient if self.known is None else relative_change(self.known, coefficient)
        return float(np.clip(self.nominal + self.scale * part, self.lower, self.upper))

    @property
    def smooths(self) -> bool:
        """Whether it is the width of a smoothed sign, which is but guessed."""
        return self.known is not None and self.known.smooths

    @property
    def of_effect(self) -> bool:
        """Whether it is a size of an effect, of no body or sensor."""
        return self.known is not None and not self.smooths


@dataclass(frozen=True)
class Nuisance:
    """Columns inside tolerances, with how to enter each group into a simulation."""

    parameters: tuple[Tolerated, ...]  # one of each column
    prior: Prior
    groups: tuple[tuple[slice, Enter | None], ...]
    start: FloatArray  # (c,) coefficients that the simulation at hand has against the stated one

    @property
    def entered(self) -> BoolArray:
        """Mark the coefficients (c,) that a simulation has; those of sensors it has not."""
        marks = [np.full(rows.stop - rows.start, enter is not None) for rows, enter in self.groups]
        return np.concatenate(marks)

    def of(self, places: Collection[tuple[str, tuple[int, ...]]]) -> BoolArray:
        """Mark the sizes (c,) of some effects at their joints (0-based)."""
        return np.array([item.of_effect and item.place in places for item in self.parameters])

    def contained_in(self, found: Iterable[Effect]) -> BoolArray:
        """Mark the coefficients (c,) that say a part of what effects found beside them say.

        Where a delay was found, a sensor's own lag is a part of it; where friction is free at all
        positions, so is what it is everywhere. Were both to move, neither would be determined.
        """
        all_of_it: set[tuple[str, tuple[int, ...]]] = set()
        for effect in found:
            name = _CONTAINED.get(effect.name)
            if name is not None:
                all_of_it.add((name, tuple(joint - 1 for joint in effect.joints)))
        return np.array(
            [item.place in all_of_it and not item.smooths for item in self.parameters], dtype=bool
        )

    def certain(self, some: BoolArray) -> Nuisance:
        """Return the same without tolerance of some coefficients (c,): those stay as stated."""
        deviation = np.where(some, 0.0, self.prior.deviation)
        return replace(self, prior=replace(self.prior, deviation=deviation))

    def enter(self, improvement: Improvement, coefficients: FloatArray) -> None:
        """Enter fitted coefficients (c,)."""
        for rows, enter in self.groups:
            if enter is not None:
                enter(improvement, coefficients[rows])


def nuisance_of(
    observed: Observations,
    columns: ColumnTable,
    floor: FloatArray,
    stated: Simulation | None = None,
) -> Nuisance:
    """Add the nuisance columns to the table.

    Args:
        observed: Recordings and simulation.
        columns: The table.
        floor: Rough noise floor of each joint (n,) [N m].
        stated: The simulation whose values are known to its tolerances, if not the observed one.
    """
    stated = stated or observed.simulation
    parts = [
        *_inertias(observed, columns, stated),
        *_parameters(observed, columns, stated),
        *_sensors(observed, columns, floor),
        *_gains(observed, columns, stated),
    ]
    sizes = np.cumsum([0, *(part.prior.index.size for part in parts)])
    return Nuisance(
        tuple(parameter for part in parts for parameter in part.parameters),
        joined(*(part.prior for part in parts)),
        tuple(
            (slice(start, stop), part.enter)
            for part, start, stop in zip(parts, sizes[:-1], sizes[1:], strict=True)
        ),
        np.concatenate([np.zeros(0), *(part.start for part in parts)]),
    )


def without_sensors(
    left: FloatArray, noise: Noise, rows: BoolArray, columns: ColumnTable, nuisance: Nuisance
) -> FloatArray:
    """Take out of a residual (K, n) what lags and offsets of sensors explain of it [N m].

    Args:
        left: The residual.
        noise: Of it.
        rows: That they are fitted to, (K, n), within their tolerances.
        columns: The table.
        nuisance: Whose sensors they are.
    """
    result = left.copy()
    prior, sensors = nuisance.prior, ~nuisance.entered
    deviation = np.full(columns.count, np.nan)
    deviation[prior.index[sensors]] = prior.deviation[sensors]
    for joint in range(columns.joints):
        values, at = columns.of_joint(joint)
        own = deviation[at] > 0  # not those that nothing is tolerated of, nor any other column
        scaled = values[:, own] * deviation[at[own]]
        A = noise.whiten(scaled, joint, rows[:, joint])
        y = noise.whiten(left[:, joint], joint, rows[:, joint])
        root = inverse_root(A.T @ A + np.eye(A.shape[1]))
        found = root.T @ (root @ (A.T @ y))
        result[:, joint] -= scaled @ np.clip(found, -REACH, REACH)
    return result


@dataclass(frozen=True)
class _Part:
    parameters: tuple[Tolerated, ...]
    prior: Prior
    enter: Enter | None
    start: FloatArray


def _inertias(observed: Observations, columns: ColumnTable, stated: Simulation) -> list[_Part]:
    Y, model = observed.regressor, observed.simulation.model
    parts: list[_Part] = []
    for link, name in enumerate(model.link_names):
        known = stated.model.inertials[name]
        scale = relative_inertia(known)
        off = parameters_of(model.inertials[name]) - parameters_of(known)
        many = model.linkage.felt_by(link)
        own = Y[:many, :, PER_LINK * link : PER_LINK * (link + 1)] @ scale
        index = columns.add(range(many), own)
        deviation = np.full(PER_LINK, observed.simulation.tolerances.inertia)
        parts.append(
            _Part(
                tuple(
                    Tolerated(f"{part} of {name}", "relative", 0.0, 1.0) for part in _INERTIAL_NAMES
                ),
                Prior.free(index, deviation),
                mover(link, scale),
                np.asarray(np.linalg.lstsq(scale, off, rcond=None)[0], dtype=float),
            )
        )
    return parts


_TENSOR = (
    "Ixx",
    "Ixy",
    "Iyy",
    "Ixz",
    "Iyz",
    "Izz",
)  # at the centre of mass, as a regressor has them
_INERTIAL_NAMES = ("mass", *(f"com {axis}" for axis in "xyz"), *_TENSOR)


def _parameters(observed: Observations, columns: ColumnTable, stated: Simulation) -> list[_Part]:
    parts: list[_Part] = []
    for place, effect in enumerate(observed.simulation.effects):
        if _is_of_tolerance(effect, observed, stated):
            continue
        known_as = next((item for item in stated.effects if item.place == effect.place), effect)
        for known in effect.parameters():
            value: Any = getattr(effect, known.name)
            if not known.is_size or not value:
                continue
            joints, values = derivative(observed, effect, known.name)
            own = observed.simulation.tolerances.friction
            tolerance = TOLERATED.width if known.smooths else own
            named = getattr(known_as, known.name) or value
            # of what is stated: a tenth more of that is another part of this value
            scale, start = beside_stated(known, value / named)
            index = columns.add(joints, scale * values[:, :, None])
            enter = reviser(place, (known,))
            parts.append(
                _Part(
                    (_tolerated(effect, known, float(named), observed),),
                    Prior.free(index, np.array([tolerance])),
                    _scaled(enter, scale),
                    np.array([start]),
                )
            )
    return parts


def _scaled(enter: Enter, scale: float) -> Enter:
    return lambda improvement, c: enter(improvement, scale * c)


def _tolerated(
    effect: Any,  # noqa: ANN401  # of any class
    known: Parameter,
    value: float,
    observed: Observations,
) -> Tolerated:
    joint = getattr(effect, "joint", None)
    where = "" if joint is None else f" of joint {joint}"
    return Tolerated(
        f"{known.name}{where} ({display_name(effect.name)})",
        unit_of(known.unit, [observed.simulation.model.sliding[j - 1] for j in effect.joints]),
        value,
        value,
        (effect.name, tuple(j - 1 for j in effect.joints)),
        known,
        known.lower,
        known.upper,
    )


def _is_of_tolerance(effect: Effect, observed: Observations, stated: Simulation) -> bool:
    """Say whether an effect is a gain that a fit has moved inside the tolerance of all gains."""
    tolerated = isinstance(effect, TorqueGain) and observed.simulation.tolerances.gain > 0
    return tolerated and all(effect.place != item.place for item in stated.effects)


def _gains(observed: Observations, columns: ColumnTable, stated: Simulation) -> list[_Part]:
    """Return the scale of each joint's torque, as of currents that are torque to some percent."""
    tolerance = observed.simulation.tolerances.gain
    parts: list[_Part] = []
    for joint in range(1, observed.n + 1) if tolerance else ():
        column = response(TorqueGain(joint=joint, gain=1.0), observed)
        index = columns.add(column.joints, column.values[:, :, None])
        parts.append(
            _Part(
                (Tolerated(f"gain of torque {joint}", "relative", 0.0, 1.0),),
                Prior.free(index, np.array([tolerance])),
                lambda improvement, c, joint=joint: improvement.add(
                    TorqueGain(joint=joint, gain=float(c[0]))
                ),
                np.array([_gain_in(observed.simulation, joint) - _gain_in(stated, joint)]),
            )
        )
    return parts


def _gain_in(simulation: Simulation, joint: int) -> float:
    gains = [effect for effect in simulation.effects if isinstance(effect, TorqueGain)]
    return sum(effect.gain for effect in gains if effect.joint == joint)


def _sensors(observed: Observations, columns: ColumnTable, floor: FloatArray) -> list[_Part]:
    parts: list[_Part] = []
    for j in range(observed.n):
        lag, offset = (
            TimeDelay(joint=j + 1, delay=UNIT_DELAY),
            TorqueOffset(joint=j + 1, offset=1.0),
        )
        unit, off = observed.unit("N m", j), TOLERATED.sensor_offset * float(floor[j])
        for effect, name, unit_, scale, deviation in (
            (lag, "lag", "s", UNIT_DELAY, TOLERATED.sensor_lag / UNIT_DELAY),
            (offset, "offset", unit, 1.0, off),
        ):
            column = response(effect, observed)
            index = columns.add(column.joints, column.values[:, :, None])
            own = Tolerated(f"{name} of sensor {j + 1}", unit_, 0.0, scale, (effect.name, (j,)))
            prior = Prior.free(index, np.array([deviation]))
            parts.append(_Part((own,), prior, None, np.zeros(1)))
    return parts
