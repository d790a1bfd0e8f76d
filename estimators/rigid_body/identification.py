"""Identify a robot from recordings: base parameters, and a simulation that a robot can be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.regression.definite import jackknife
from estimators.rigid_body import tolerances
from estimators.rigid_body.base_parameters import BaseParameters, find_base_parameters
from estimators.rigid_body.fitting.consistent import (
    ConsistentFit,
    Quadratic,
    fit_consistent,
    inertial_of,
    thickened,
)
from estimators.rigid_body.fitting.effective_rows import FOLDS
from estimators.rigid_body.fitting.least_squares import BaseFit, choose_sign_widths, fit_base
from estimators.rigid_body.fitting.normal_equations import ArmEquations, Rows, accumulate
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from estimators.rigid_body.terms import JointTerms, Term
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.units import unit_of
from limo_driver.physics import Armature, Effect, Simulation, Tolerances
from limo_driver.physics.described import described_effects
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import Displayed
from limo_driver.types import BoolArray, FloatArray

TOLERANCES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # relative, of inertias in a URDF
_TOLERABLE = (1e-4, 10.0)  # beyond, the prior or the data vanish in rounding
_SIGNIFICANT = 3.0  # standard deviations below which an armature is left out
_NEGLIGIBLE = 1e-3  # [N m], an error that no sensor shows
_GAINED = 0.3  # of the last link's mass, above which a gain is no error of a description
_MUCH_WORSE = 1.1  # ratio of errors above which a consistent fit is worth a warning


@dataclass(frozen=True)
class TermEstimate:
    """One joint's friction, offset or armature."""

    effect: str
    parameter: str
    joint: int  # 1-based
    value: float
    deviation: float  # standard deviation, same unit; 0 if held at zero
    unit: str


@dataclass(frozen=True)
class LinkChange:
    """Change of a link's inertia from its nominal value."""

    link: str
    mass: float  # [kg]
    mass_nominal: float  # [kg]
    com_shift: float  # [m]
    inertia_ratio: float  # trace of the inertia at the centre of mass, over the nominal one


@dataclass(frozen=True, repr=False)
class Identification(Displayed):
    """Result of an identification."""

    model: RobotModel
    terms: JointTerms
    rows: Rows
    base: BaseParameters
    nominal: FloatArray  # (p,), full parameters of the robot description
    fit: BaseFit  # of the base parameters
    simulation: Simulation  # physically consistent; its tolerances say how well it is known
    rmse_consistent: FloatArray  # (n,) [N m], in sample
    tolerance: float  # relative standard deviation of inertias before the data, given or found
    estimates: tuple[TermEstimate, ...]
    links: tuple[LinkChange, ...]
    samples: int
    warnings: tuple[str, ...]

    def headline(self) -> str:
        """Say what was identified from how much."""
        return (
            f"{self.model.name} from {self.samples} samples, {self.base.rank} base parameters, "
            f"condition number {self.fit.condition:.3g}"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors and the terms of each joint."""
        terms: dict[str, list[float | str]] = {}
        for item in self.estimates:
            column = terms.setdefault(f"{item.parameter} [{item.unit}]", [""] * self.model.n)
            column[item.joint - 1] = item.value
        unit = unit_of("N m", self.model.sliding)
        return {
            "joint": self.model.joint_names,
            f"RMSE, in sample [{unit}]": self.rmse_consistent.tolist(),
            **terms,
        }


@threadpool_limits.wrap(limits=1, user_api="blas")  # its matrices are small; more only wait
def identify(
    model: RobotModel,
    recordings: Sequence[Recording],
    terms: JointTerms | None = None,
    rows: Rows | None = None,
    tolerance: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Identification:
    """Identify a robot from logs as they are: `limo_driver.identify` refuses mistakes in them.

    Springs, cogging and the like that the description states are known; they stay in the
    simulation, and their torque is no inertia's. Friction is unknown, whatever it states.

    Args:
        model: The robot with its nominal inertias.
        recordings: Measured motions and torques.
        terms: What is modelled beside the inertias.
        rows: Which rows are used, and the bandwidth.
        tolerance: Relative standard deviation of the nominal inertias; what the motion does not
            reveal stays there. Without one, that of `TOLERANCES` under which the data are most
            likely.
        progress: Called with the number of samples done since the last call.

    Raises:
        ConfigError: A tolerance outside 1e-4 to 10.
        RecordingError: A recording is of another robot or given twice, nothing moves, no torque was
            measured, or no row is left.
    """
    low, high = _TOLERABLE
    if tolerance is not None and not low <= tolerance <= high:
        raise ConfigError(f"inertia tolerance {tolerance:g}: has to lie in {low:g} to {high:g}")
    terms, rows = terms or JointTerms(), rows or Rows(bandwidth_for(recordings))
    base = find_base_parameters(model, terms)
    nominal = nominal_parameters(model, terms)
    stated = tolerances.stated_beside(model, terms)
    recordings = tolerances.without_stated(model, recordings, stated, rows.bandwidth)
    choice = choose_sign_widths(
        accumulate(model, terms, recordings, rows, progress), terms, base, nominal
    )
    equations, terms = choice.equations, choice.terms
    fit = fit_base(equations, base, nominal)
    spread, _ = equations.weighted(fit.weight**2 * fit.row_variance)
    data = Quadratic(*equations.weighted(fit.weight), spread)
    armatures = tolerances.stated_armatures(model, terms)
    bodies = _Bodies(model.n, model.linkage.links, terms, data, nominal, armatures)
    if tolerance is None:
        tolerance, likely = bodies.fit_most_likely()
    else:
        likely = bodies.fit(tolerance)
    consistent = bodies.fit_significant(tolerance, likely)
    # D (FOLDS, p), with Dᵀ D the covariance of parameters fitted without each fold in turn
    absent = consistent.deviation == 0
    fits: list[FloatArray] = []
    for fold in range(FOLDS):
        gram, product = equations.weighted(fit.weight, without=fold)
        without = replace(bodies, data=Quadratic(gram, product, bodies.data.spread))
        held = consistent.parameters
        fits.append(without.fit(tolerance, held, absent, held).parameters)
    apart = jackknife(fits)
    surely = replace(consistent, spread=np.concatenate([consistent.spread, apart]))
    covariance = surely.spread.T @ surely.spread
    known = tolerances.tolerances_of(consistent.parameters, covariance, equations, terms)
    observable = equations.count > 0  # joints of which something is
    estimates = _estimates(terms, surely, observable, model.sliding)
    rmse = equations.rmse(consistent.parameters)
    return Identification(
        model,
        terms,
        rows,
        base,
        nominal,
        fit,
        _simulation(model, terms, consistent, known, stated, observable),
        rmse,
        tolerance,
        estimates,
        _changes(model, consistent),
        sum(len(recording) for recording in recordings),
        (
            *_warnings(base, fit, rmse, equations),
            *_gained(model, surely),
            *_kept(model.n, terms, consistent),
        ),
    )


def nominal_parameters(model: RobotModel, terms: JointTerms) -> FloatArray:
    """Return full parameters (p,) with the robot's inertias and without friction."""
    links = [thickened(parameters_of(model.inertials[link])) for link in model.link_names]
    return np.concatenate([*links, np.zeros(model.n * len(terms.all()))])


@dataclass(frozen=True)
class _Bodies:
    """Fit of physically consistent bodies: the data and the prior."""

    n: int
    links: int
    terms: JointTerms
    data: Quadratic
    nominal: FloatArray  # (p,)
    stated: FloatArray  # (p,), armatures of the description, beside zeros

    def fit(
        self,
        tolerance: float,
        start: FloatArray | None = None,
        absent: BoolArray | None = None,
        held: FloatArray | None = None,
        any_sign: BoolArray | None = None,
    ) -> ConsistentFit:
        """Fit under one tolerance from a start.

        Args:
            tolerance: Relative standard deviation of the nominal inertias.
            start: Parameters (p,) to begin with.
            absent: Parameters (p,) that are held.
            held: At these values (p,); at zero if not given.
            any_sign: Parameters (p,) that may be negative although nothing has such a value.
        """
        positive = np.zeros(self.nominal.size, dtype=bool)
        positive[PER_LINK * self.links :] = np.repeat(
            [term.positive for term in self.terms.all()], self.n
        )
        positive &= ~any_sign if any_sign is not None else True
        absent = np.zeros_like(positive) if absent is None else absent
        known = np.zeros_like(self.nominal) if held is None else np.where(absent, held, 0.0)
        data = self.data.without(known)
        found = fit_consistent(data, self.nominal, self.links, tolerance, positive, absent, start)
        return replace(found, parameters=found.parameters + known)

    def fit_most_likely(self) -> tuple[float, ConsistentFit]:
        """Fit under each of `TOLERANCES`; return the one under which the data are most likely."""
        found: list[ConsistentFit] = []
        for tolerance in TOLERANCES:
            found.append(self.fit(tolerance, found[-1].parameters if found else None))
        best = int(np.argmax([fit.log_evidence for fit in found]))
        return TOLERANCES[best], found[best]

    def fit_significant(self, tolerance: float, found: ConsistentFit) -> ConsistentFit:
        """Fit once more from what was found, without insignificant armatures.

        An armature that torque alone cannot tell from a link's inertia can be told by the nominal
        inertia: what exceeds it beyond its tolerance is the drive's. One that is not told stays as
        the description states it, as long as that may be.
        """
        if not self.terms.armature:
            return found
        drives = slice(-self.n, None)
        absent = np.zeros(self.nominal.size, dtype=bool)
        absent[drives] = found.parameters[drives] <= _SIGNIFICANT * found.deviation[drives]
        held, in_doubt = np.zeros_like(self.stated), absent & (self.stated > 0)
        if in_doubt.any():
            observable = self.fit(tolerance, found.parameters, any_sign=in_doubt)
            apart = np.abs(observable.parameters - self.stated)
            held[apart <= _SIGNIFICANT * observable.deviation] = 1.0
            held *= self.stated
        return self.fit(tolerance, found.parameters, absent, held)


def _simulation(
    model: RobotModel,
    terms: JointTerms,
    fit: ConsistentFit,
    known: Tolerances,
    beside: tuple[Effect, ...],
    observable: BoolArray,
) -> Simulation:
    bodies = {
        link: inertial_of(fit.parameters[PER_LINK * i : PER_LINK * (i + 1)])
        for i, link in enumerate(model.link_names)
    }
    # A value that was not found is said to be 0 where the description states another.
    stated = {
        (effect.name, joint) for effect in described_effects(model) for joint in effect.joints
    }
    effects = tuple(
        term.make(joint, value)
        for term, joint, value, deviation in _by_joint(model.n, terms, fit)
        if (observable[joint - 1] and (deviation > 0 or term.effect.endswith("friction")))
        or (term.effect, joint) in stated
    )
    every = (*effects, *beside, *tolerances.mounting_of(model))
    return Simulation(model.name, every, bodies, tolerances=known)


def _by_joint(
    n: int, terms: JointTerms, fit: ConsistentFit
) -> list[tuple[Term, int, float, float]]:
    """List term, 1-based joint, value and standard deviation, joint by joint."""
    of_terms = slice(fit.parameters.size - n * len(terms.all()), None)
    values = fit.parameters[of_terms].reshape(-1, n)
    deviations = fit.deviation[of_terms].reshape(-1, n)
    return [
        (term, j + 1, float(values[k, j]), float(deviations[k, j]))
        for j in range(n)
        for k, term in enumerate(terms.all())
    ]


def _estimates(
    terms: JointTerms, fit: ConsistentFit, observable: BoolArray, sliding: Sequence[bool]
) -> tuple[TermEstimate, ...]:
    return tuple(
        TermEstimate(*named, value, deviation, unit_of(term.unit, sliding, joint - 1))
        for term, joint, value, deviation in _by_joint(observable.size, terms, fit)
        for named in [(term.effect, term.parameter, joint)]
        if observable[joint - 1] and (deviation > 0 or term.effect.endswith("friction"))
    )


def _changes(model: RobotModel, fit: ConsistentFit) -> tuple[LinkChange, ...]:
    changes: list[LinkChange] = []
    for i, link in enumerate(model.link_names):
        before = model.inertials[link]
        after = inertial_of(fit.parameters[PER_LINK * i : PER_LINK * (i + 1)])
        trace = float(np.trace(before.tensor()))
        changes.append(
            LinkChange(
                link,
                after.mass,
                before.mass,
                float(np.linalg.norm(np.subtract(after.com, before.com))),
                float(np.trace(after.tensor())) / trace if trace > 0 else np.inf,
            )
        )
    return tuple(changes)


def _gained(model: RobotModel, fit: ConsistentFit) -> Iterator[str]:
    """Yield a warning where the last link has surely taken up a mass that no tolerance explains."""
    at, link = PER_LINK * (model.linkage.links - 1), model.link_names[-1]
    stated, mass = model.inertials[link].mass, float(fit.parameters[at])
    gained, deviation = mass - stated, float(fit.deviation[at])
    if gained > max(_GAINED * stated, _SIGNIFICANT * deviation):
        yield (
            f"{link} gained {gained:.2f} kg ({stated:.2f} to {mass:.2f} kg): is there a tool? "
            "`limo diagnose --robot` estimates it as a payload, and friction with it; or keep the "
            "links to what the description allows (--inertia-tolerance 0.05)"
        )


def _kept(n: int, terms: JointTerms, fit: ConsistentFit) -> Iterator[str]:
    """Yield at which joints an armature stays as the description states it."""
    kept = [
        str(joint)
        for term, joint, value, deviation in _by_joint(n, terms, fit)
        if term.effect == Armature.name and value > 0 and deviation == 0
    ]
    if kept:
        yield (
            f"armature of joint {', '.join(kept)} stays as the description states it: "
            "the motion does not tell it"
        )


def _warnings(
    base: BaseParameters, fit: BaseFit, rmse: FloatArray, equations: ArmEquations
) -> list[str]:
    found: list[str] = []
    if fit.excited < base.rank:
        found.append(
            f"the motion reveals {fit.excited} of {base.rank} base parameters; "
            "the others stay at their nominal value"
        )
    if idle := [str(j + 1) for j in np.flatnonzero(equations.count == 0)]:
        found.append(f"no row is used for joint {', '.join(idle)}")
    ratio = rmse / np.maximum(fit.rmse, _NEGLIGIBLE)
    worse = np.flatnonzero(ratio > _MUCH_WORSE)
    if worse.size:
        listed = ", ".join(f"{j + 1} ({ratio[j]:.2f} times)" for j in worse)
        found.append(
            f"a consistent body fits worse than base parameters at joint {listed}: "
            "the torque holds what no rigid body and simple friction explain"
        )
    return found
