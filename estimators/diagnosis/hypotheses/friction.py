"""Hypotheses of friction, with and without memory."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.hypothesis import Hypothesis, Realise, single
from limo_driver.physics import (
    AsymmetricFriction,
    CoulombFriction,
    LoadDependentFriction,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    StribeckFriction,
    TemperatureDependentFriction,
    ViscousFriction,
)
from limo_driver.physics.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from estimators.diagnosis.residuals.observations import Observations
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray

BUILD_UP = (1e-3, 4e-3, 0.016)  # [rad] over which the friction of a law builds up
STOP_WIDTHS = tuple(np.geomspace(3e-4, 0.25, 9))  # [rad]
CREEP_SPEEDS = (0.006, 0.015, 0.04, 0.1)  # [rad/s], of the Stribeck effect
WARMING_TIMES = (0.1, 0.3, 1.0)  # of the length of the recordings
PLACES = 14  # of friction over a joint's range
_LEAST_FRICTION = 1e-6  # [N m]


def friction(observed: Observations, j: int) -> Iterator[Hypothesis]:
    """Yield friction without memory at a joint (0-based)."""
    joint, eps = j + 1, sign_width(observed, j + 1)
    yield coulomb(joint, eps)
    yield viscous(joint)
    up = AsymmetricFriction(joint=joint, tau_plus=1.0, tau_minus=0.0, v_eps=eps)
    down = AsymmetricFriction(joint=joint, tau_plus=0.0, tau_minus=1.0, v_eps=eps)
    yield Hypothesis(
        up.name,
        (j,),
        (up, down),
        # Alone, it cannot push; `enter` lets it also take from the Coulomb friction of the joint.
        lambda c: (replace(up, tau_plus=max(0.0, float(c[0])), tau_minus=max(0.0, float(c[1]))),),
        enter=lambda improvement, c: improvement.skew(joint, float(c[0]), float(c[1]), eps),
    )
    for v_s in CREEP_SPEEDS:
        for delta in (1.0, 2.0):
            yield stribeck(joint, eps, v_s, delta)
    yield single(QuadraticDrag(joint=joint, coefficient=1.0), "coefficient", positive=True)
    for variant in ("absolute", "positive", "negative", "quadratic"):
        # a wide sign would make it a part of gravity's torque, and a payload lighter
        effect = LoadDependentFriction(joint=joint, coefficient=0.1, variant=variant)
        yield single(effect, "coefficient", positive=True)
    yield load_at_creep(joint, CREEP_SPEEDS[2])
    yield position_dependent(observed, joint)
    duration = max(recording.duration for recording in observed.recordings)
    for part in WARMING_TIMES:
        yield warming(joint, eps, part * duration)
    warmth = observed.motion.temperature
    if warmth is not None and np.isfinite(warmth[:, j]).all():
        yield by_temperature(joint, eps, float(warmth[:, j].mean()))


def sign_width(observed: Observations, joint: int) -> float:
    """Return the width of the smoothed sign at a joint of the arm that columns are around [rad/s].

    All dry friction of a joint shares it: two widths at one joint look like a Stribeck effect.
    """
    for effect in observed.reference.effects:
        if isinstance(effect, (CoulombFriction, AsymmetricFriction)) and effect.joint == joint:
            return effect.v_eps
    return SIGN_WIDTH


def coulomb(joint: int, v_eps: float) -> Hypothesis:
    """Return Coulomb friction; how sharp its sign is has to be found, too."""
    return single(
        CoulombFriction(joint=joint, tau_c=1.0, v_eps=v_eps),
        "tau_c",
        positive=True,
        settings=(v_eps,),
        family=partial(coulomb, joint),
        bounds=((2e-4, 0.02),),
    )


def viscous(joint: int) -> Hypothesis:
    """Return viscous friction."""
    return single(ViscousFriction(joint=joint, f_v=1.0), "f_v", positive=True)


def stribeck(joint: int, v_eps: float, v_s: float, delta: float) -> Hypothesis:
    """Return the Stribeck effect at one joint."""
    effect = StribeckFriction(joint=joint, tau_s=1.0, v_s=v_s, delta=delta, v_eps=v_eps)
    return single(
        effect,
        "tau_s",
        positive=True,
        settings=(v_s, delta),
        family=partial(stribeck, joint, v_eps),
        bounds=((3e-3, 0.6), (0.5, 4.0)),
    )


def load_at_creep(joint: int, v_s: float) -> Hypothesis:
    """Return friction by load that fades with the speed."""
    effect = LoadDependentFriction(joint=joint, coefficient=0.1, variant="stribeck", v_s=v_s)
    return single(
        effect,
        "coefficient",
        positive=True,
        settings=(v_s,),
        family=partial(load_at_creep, joint),
        bounds=((3e-3, 0.6),),
    )


def warming(joint: int, v_eps: float, time_constant: float) -> Hypothesis:
    """Return friction that fades as a joint warms up."""
    effect = TemperatureDependentFriction(
        joint=joint, excess=1.0, time_constant=time_constant, v_eps=v_eps
    )
    return single(
        effect,
        "excess",
        settings=(time_constant,),
        family=partial(warming, joint, v_eps),
        bounds=((0.02 * time_constant, 20 * time_constant),),
    )


def by_temperature(joint: int, v_eps: float, mean: float) -> Hypothesis:
    """Return friction that follows a measured temperature, with what it is at the mean [°C]."""
    slope = TemperatureDependentFriction(joint=joint, per_kelvin=0.1, reference=mean, v_eps=v_eps)

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        per_kelvin = 0.1 * float(c[0])
        reference = mean - float(c[1]) / per_kelvin if per_kelvin else mean
        return (
            replace(slope, per_kelvin=per_kelvin, reference=float(np.clip(reference, -50.0, 200))),
        )

    height = CoulombFriction(joint=joint, tau_c=1.0, v_eps=v_eps)
    return Hypothesis(slope.name, (joint - 1,), (slope, height), realise)


def position_dependent(observed: Observations, joint: int) -> Hypothesis:
    """Return friction that varies with the position, around its mean."""
    q, eps = observed.slow.position[:, joint - 1], sign_width(observed, joint)
    low, high = float(q.min()), float(q.max())
    knots = tuple(np.linspace(low, max(high, low + 1e-3), PLACES).tolist())
    hats = np.eye(PLACES)
    terms = tuple(
        PositionDependentFriction(joint=joint, positions=knots, excess=tuple(hat), v_eps=eps)
        for hat in hats
    )
    return Hypothesis(
        terms[0].name,
        (joint - 1,),
        terms,
        lambda c: (replace(terms[0], excess=tuple(float(x) for x in c)),),
    )


def hysteresis(j: int) -> Iterator[Hypothesis]:
    """Yield friction that remembers where a joint (0-based) turned, by several laws."""
    yield maxwell_slip(j + 1, STOP_WIDTHS)
    for width in BUILD_UP:
        yield lugre(j + 1, width, 0.15, 0.01)
        yield bouc_wen(j + 1, width, 0.7, 1.5)


def stop(joint: int, width: float) -> PreslidingHysteresis:
    """Return one spring that slips at a width [rad], and then carries 1 N m."""
    return PreslidingHysteresis(
        joint=joint, law="maxwell_slip", stiffness=(1.0 / width,), width=(width,)
    )


def maxwell_slip(joint: int, widths: tuple[float, ...]) -> Hypothesis:
    """Return parallel springs that slip at given widths."""
    terms = tuple(stop(joint, width) for width in widths)

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        used = [i for i in range(len(widths)) if c[i] > 0]
        if not used:
            return ()
        stiffness = tuple(float(c[i] / widths[i]) for i in used)
        width = tuple(widths[i] for i in used)
        return (
            PreslidingHysteresis(joint=joint, law="maxwell_slip", stiffness=stiffness, width=width),
        )

    return Hypothesis(
        terms[0].name, (joint - 1,), terms, realise, positive=True, law="Maxwell slip"
    )


def lugre(joint: int, width: float, rise: float, v_s: float) -> Hypothesis:
    """Return bristles that slide after a width [rad]; at rest they hold a part `rise` more."""
    effect = PreslidingHysteresis(
        joint=joint, law="lugre", sigma_0=1.0 / width, tau_c=1.0, tau_s=rise, v_s=v_s
    )
    return _law(
        effect,
        ("sigma_0", "tau_c", "tau_s"),
        "LuGre",
        partial(lugre, joint),
        (width, rise, v_s),
        ((1e-4, 0.1), (1e-3, 1.0), (2e-3, 0.1)),
    )


def bouc_wen(joint: int, width: float, beta_ratio: float, exponent: float) -> Hypothesis:
    """Return Bouc and Wen's law, which slides after about a width [rad]."""
    effect = PreslidingHysteresis(
        joint=joint,
        law="bouc_wen",
        sigma_0=1.0 / width,
        tau_c=1.0,
        beta_ratio=beta_ratio,
        exponent=exponent,
    )
    return _law(
        effect,
        ("sigma_0", "tau_c"),
        "Bouc-Wen",
        partial(bouc_wen, joint),
        (width, beta_ratio, exponent),
        ((1e-4, 0.1), (0.5, 1.0), (0.5, 3.0)),
    )


def dahl(joint: int, width: float, exponent: float) -> Hypothesis:
    """Return Dahl's law, which slides after about a width [rad].

    With an exponent of 1 it is LuGre without excess at rest, and Bouc and Wen's with a ratio of 1.
    """
    effect = PreslidingHysteresis(
        joint=joint, law="dahl", sigma_0=1.0 / width, tau_c=1.0, exponent=exponent
    )
    return _law(
        effect,
        ("sigma_0", "tau_c"),
        "Dahl",
        partial(dahl, joint),
        (width, exponent),
        ((1e-4, 0.1), (0.3, 4.0)),
    )


def _law(
    unit: PreslidingHysteresis,
    growing: tuple[str, ...],
    law: str,
    family: Callable[..., Hypothesis],
    settings: tuple[float, ...],
    bounds: tuple[tuple[float, float], ...],
) -> Hypothesis:
    """Return a law of hysteresis of unit size, whose torques grow with one coefficient."""
    return Hypothesis(
        unit.name,
        (unit.joint - 1,),
        (unit,),
        _carrying(unit, *growing),
        positive=True,
        settings=settings,
        family=family,
        law=law,
        bounds=bounds,
    )


def _carrying(unit: PreslidingHysteresis, *names: str) -> Realise:
    """Return how the torques of a law of unit size grow with its one coefficient."""

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        grown = {name: max(float(c[0]), _LEAST_FRICTION) * getattr(unit, name) for name in names}
        return (replace(unit, **grown),)

    return realise
