"""Hypotheses: each effect of the catalogue, wherever it could act, at a unit size.

A hypothesis is a few effects of the catalogue at unit size. What they would add to the torque are
columns; their coefficients turn the same effects into the found ones. So what is compared, what is
fitted and what is written to `sim.yaml` are one equation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    Backlash,
    CoulombFriction,
    EncoderOffset,
    GravityDirection,
    JointCoupling,
    JointElasticity,
    LoadDependentFriction,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    SpringLoad,
    StribeckFriction,
    TemperatureDependentFriction,
    TimeDelay,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.improvement import Enter
    from estimators.diagnosis.observations import Observations
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray

Realise: TypeAlias = Callable[["FloatArray"], "tuple[Effect, ...]"]

GAPS = (2e-4, 6e-4, 2e-3, 6e-3)  # [rad]
BUILD_UP = (1e-3, 4e-3, 0.016)  # [rad] over which the friction of a law builds up
STOP_WIDTHS = tuple(np.geomspace(3e-4, 0.25, 9))  # [rad]
CREEP_SPEEDS = (0.006, 0.015, 0.04, 0.1)  # [rad/s], of the Stribeck effect
WARMING_TIMES = (0.1, 0.3, 1.0)  # of the length of the recordings
KNOTS = 6  # of drift over a recording
PLACES = 14  # of friction over a joint's range
UNIT_COMPLIANCE = 1e-5  # [rad/(N m)]
UNIT_DELAY = 1e-3  # [s]
UNIT_ANGLE = 1e-3  # [rad]
LOW_ORDERS = ((4.0,), (2.0, 4.0), (1.0, 2.0, 4.0))  # in a revolution, of a torque sensor's spokes
_SOFTEST = 1e-3  # [N m/rad]
_LEAST_FRICTION = 1e-6  # [N m]


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place; its coefficients are still free."""

    effect: str
    joints: tuple[int, ...]  # 0-based; empty for the whole arm
    terms: tuple[Effect, ...]  # of unit size, one column each
    realise: Realise  # coefficients → effects
    positive: bool = False  # whether no coefficient can be negative
    settings: tuple[float, ...] = ()  # what is not linear in the torque, for a refinement
    family: Callable[..., Hypothesis] | None = field(default=None, compare=False)
    bounds: tuple[tuple[float, float], ...] = ()  # of the settings
    enter: Enter | None = field(default=None, compare=False)  # where adding effects is not enough


def every(observed: Observations) -> Iterator[Hypothesis]:
    """Yield all hypotheses for a recorded arm."""
    n = observed.n
    for j in range(n):
        yield from _friction(observed, j)
        yield from _hysteresis(j)
        yield from _transmission(j)
        yield from _sensing(observed, j)
        yield from _environment(observed, j)
        yield from _coupling(j, n)
        if np.ptp(observed.slow.position[:, j]) * LOW_ORDERS[0][0] >= 2 * np.pi:
            yield from (rippling(j + 1, cycles) for cycles in LOW_ORDERS)
    yield gravity_direction(observed)


def _scaled(effect: Any, name: str) -> Realise:  # noqa: ANN401  # an effect of any class
    """Return how one effect grows with its one coefficient."""
    unit = getattr(effect, name)
    return lambda c: (replace(effect, **{name: float(c[0] * unit)}),)


def single(effect: Effect, name: str, **more: Any) -> Hypothesis:  # noqa: ANN401
    """Return the hypothesis of one effect that is linear in its parameter `name`."""
    joint = getattr(effect, "joint", 0)
    return Hypothesis(effect.name, (joint - 1,), (effect,), _scaled(effect, name), **more)


def _friction(observed: Observations, j: int) -> Iterator[Hypothesis]:
    joint, eps = j + 1, sign_width(observed, j + 1)
    yield coulomb(joint, eps)
    yield single(ViscousFriction(joint=joint, f_v=1.0), "f_v", positive=True)
    up = AsymmetricFriction(joint=joint, tau_plus=1.0, tau_minus=0.0, v_eps=eps)
    down = AsymmetricFriction(joint=joint, tau_plus=0.0, tau_minus=1.0, v_eps=eps)
    yield Hypothesis(
        up.name,
        (j,),
        (up, down),
        lambda c: (replace(up, tau_plus=abs(float(c[0])), tau_minus=abs(float(c[1]))),),
        enter=lambda improvement, c: improvement.skew(joint, float(c[0]), float(c[1]), eps),
    )
    for v_s in CREEP_SPEEDS:
        for delta in (1.0, 2.0):
            yield stribeck(joint, v_s, delta)
    yield single(QuadraticDrag(joint=joint, coefficient=1.0), "coefficient", positive=True)
    for variant in ("absolute", "positive", "negative", "quadratic"):
        effect = LoadDependentFriction(joint=joint, coefficient=0.1, variant=variant)
        yield single(effect, "coefficient", positive=True)
    yield position_dependent(observed, joint)
    duration = max(recording.duration for recording in observed.recordings)
    for part in WARMING_TIMES:
        yield warming(joint, part * duration)
    if observed.motion.temperature is not None:
        yield by_temperature(joint, float(np.nanmean(observed.motion.temperature[:, j])))


def sign_width(observed: Observations, joint: int) -> float:
    """Return the width of the smoothed sign that the simulation uses at a joint [rad/s]."""
    for effect in observed.simulation.effects:
        if isinstance(effect, CoulombFriction) and effect.joint == joint:
            return effect.v_eps
    return 0.002


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


def stribeck(joint: int, v_s: float, delta: float) -> Hypothesis:
    """Return the Stribeck effect at one joint."""
    effect = StribeckFriction(joint=joint, tau_s=1.0, v_s=v_s, delta=delta)
    return single(
        effect,
        "tau_s",
        positive=True,
        settings=(v_s, delta),
        family=partial(stribeck, joint),
        bounds=((3e-3, 0.6), (0.5, 4.0)),
    )


def warming(joint: int, time_constant: float) -> Hypothesis:
    """Return friction that fades as a joint warms up."""
    effect = TemperatureDependentFriction(joint=joint, excess=1.0, time_constant=time_constant)
    return single(
        effect,
        "excess",
        settings=(time_constant,),
        family=partial(warming, joint),
        bounds=((0.02 * time_constant, 20 * time_constant),),
    )


def by_temperature(joint: int, mean: float) -> Hypothesis:
    """Return friction that follows a measured temperature, with what it is at the mean [°C]."""
    slope = TemperatureDependentFriction(joint=joint, per_kelvin=0.1, reference=mean)

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        per_kelvin = 0.1 * float(c[0])
        reference = mean - float(c[1]) / per_kelvin if per_kelvin else mean
        return (
            replace(slope, per_kelvin=per_kelvin, reference=float(np.clip(reference, -50.0, 200))),
        )

    height = CoulombFriction(joint=joint, tau_c=1.0)
    return Hypothesis(slope.name, (joint - 1,), (slope, height), realise)


def position_dependent(observed: Observations, joint: int) -> Hypothesis:
    """Return friction that varies with the position, around its mean."""
    q = observed.slow.position[:, joint - 1]
    low, high = float(q.min()), float(q.max())
    knots = tuple(np.linspace(low, max(high, low + 1e-3), PLACES).tolist())
    hats = np.eye(PLACES)
    terms = tuple(
        PositionDependentFriction(joint=joint, positions=knots, excess=tuple(hat)) for hat in hats
    )
    return Hypothesis(
        terms[0].name,
        (joint - 1,),
        terms,
        lambda c: (replace(terms[0], excess=tuple(float(x) for x in c)),),
    )


def _hysteresis(j: int) -> Iterator[Hypothesis]:
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

    return Hypothesis(terms[0].name, (joint - 1,), terms, realise, positive=True)


def lugre(joint: int, width: float, rise: float, v_s: float) -> Hypothesis:
    """Return bristles that slide after a width [rad]; at rest they hold a part `rise` more."""
    effect = PreslidingHysteresis(
        joint=joint, law="lugre", sigma_0=1.0 / width, tau_c=1.0, tau_s=rise, v_s=v_s
    )
    return Hypothesis(
        effect.name,
        (joint - 1,),
        (effect,),
        _carrying(effect, "sigma_0", "tau_c", "tau_s"),
        positive=True,
        settings=(width, rise, v_s),
        family=partial(lugre, joint),
        bounds=((1e-4, 0.1), (1e-3, 1.0), (2e-3, 0.1)),
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
    return Hypothesis(
        effect.name,
        (joint - 1,),
        (effect,),
        _carrying(effect, "sigma_0", "tau_c"),
        positive=True,
        settings=(width, beta_ratio, exponent),
        family=partial(bouc_wen, joint),
        bounds=((1e-4, 0.1), (0.5, 1.0), (0.5, 3.0)),
    )


def _carrying(unit: PreslidingHysteresis, *names: str) -> Realise:
    """Return how the torques of a law of unit size grow with its one coefficient."""

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        grown = {name: max(float(c[0]), _LEAST_FRICTION) * getattr(unit, name) for name in names}
        return (replace(unit, **grown),)

    return realise


def backlash(joint: int, gap: float) -> Hypothesis:
    """Return play at one joint; how long the link floats depends on the gap."""
    return single(
        Backlash(joint=joint, gap=gap),
        "gap",
        positive=True,
        settings=(gap,),
        family=partial(backlash, joint),
        bounds=((0.3 * gap, 3.0 * gap),),
    )


def _transmission(j: int) -> Iterator[Hypothesis]:
    joint = j + 1
    yield single(Armature(joint=joint, inertia=1.0), "inertia", positive=True)
    yield single(EncoderOffset(joint=joint, offset=UNIT_ANGLE), "offset")
    for gap in GAPS:
        yield backlash(joint, gap)
    soft = JointElasticity(joint=joint, stiffness=1.0 / UNIT_COMPLIANCE)
    yield Hypothesis(
        soft.name,
        (j,),
        (soft,),
        lambda c: (replace(soft, stiffness=1.0 / (max(float(c[0]), 1e-6) * UNIT_COMPLIANCE)),),
        positive=True,
    )


def _sensing(observed: Observations, j: int) -> Iterator[Hypothesis]:
    joint = j + 1
    yield single(TorqueOffset(joint=joint, offset=1.0), "offset")
    yield single(TorqueGain(joint=joint, gain=0.01), "gain")
    yield single(TimeDelay(joint=joint, delay=UNIT_DELAY), "delay", positive=True)
    for k in range(observed.n):
        if k != j:
            yield single(TorqueCrosstalk(joint=joint, source=k + 1, gain=0.01), "gain")
    yield drift(observed, joint)


def drift(observed: Observations, joint: int) -> Hypothesis:
    """Return an offset that wanders with time, linear between knots."""
    end = max(float(recording.time[-1]) for recording in observed.recordings)
    start = min(float(recording.time[0]) for recording in observed.recordings)
    times = tuple(np.linspace(start, end, KNOTS).tolist())
    terms = tuple(TorqueDrift(joint=joint, times=times, offset=tuple(hat)) for hat in np.eye(KNOTS))
    return Hypothesis(
        terms[0].name,
        (joint - 1,),
        terms,
        lambda c: (replace(terms[0], offset=tuple(float(x) for x in c)),),
    )


def _environment(observed: Observations, j: int) -> Iterator[Hypothesis]:
    low, high = np.quantile(observed.slow.position[:, j], (0.1, 0.9))
    yield spring(j + 1)
    for rest in np.linspace(low, high, 3):
        yield cubic_spring(j + 1, float(rest))


def spring(joint: int) -> Hypothesis:
    """Return a linear spring; where it rests follows from its pull at zero."""
    linear = SpringLoad(joint=joint, stiffness=1.0, rest=0.0)

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        stiffness = float(c[0]) if abs(c[0]) > _SOFTEST else _SOFTEST
        return (replace(linear, stiffness=stiffness, rest=-float(c[1]) / stiffness),)

    terms = (linear, TorqueOffset(joint=joint, offset=1.0))
    return Hypothesis(linear.name, (joint - 1,), terms, realise)


def cubic_spring(joint: int, rest: float) -> Hypothesis:
    """Return a spring that stiffens."""
    linear = SpringLoad(joint=joint, stiffness=1.0, rest=rest)
    return Hypothesis(
        linear.name,
        (joint - 1,),
        (linear, replace(linear, stiffness=0.0, cubic=1.0)),
        lambda c: (replace(linear, stiffness=float(c[0]), cubic=float(c[1])),),
        settings=(rest,),
        family=partial(cubic_spring, joint),
        bounds=((rest - 1.5, rest + 1.5),),
    )


def _coupling(j: int, n: int) -> Iterator[Hypothesis]:
    for k in (j - 1, j + 1):
        for ratio in (1, -1):
            if 0 <= k < n:
                yield coupling(j + 1, k + 1, ratio)


def coupling(joint: int, other: int, ratio: int) -> Hypothesis:
    """Return what one joint feels of another's motion."""
    base = JointCoupling(joint=joint, other=other, f_v=0.0, tau_c=0.0, inertia=0.0, ratio=ratio)
    terms = (replace(base, f_v=1.0), replace(base, tau_c=1.0), replace(base, inertia=1.0))
    return Hypothesis(
        base.name,
        (joint - 1, other - 1),
        terms,
        lambda c: (replace(base, f_v=float(c[0]), tau_c=float(c[1]), inertia=float(c[2])),),
        positive=True,
    )


def gravity_direction(observed: Observations) -> Hypothesis:
    """Return a base that is not mounted as the simulation says."""
    nominal = np.array(observed.chain.gravity)
    across = [axis for axis in np.eye(3) if abs(axis @ nominal) < 1.0]
    terms = tuple(
        GravityDirection(gravity=tuple((nominal + 0.1 * axis).tolist())) for axis in across
    )
    size = float(np.linalg.norm(nominal))

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        tilted = nominal + 0.1 * sum(x * axis for x, axis in zip(c, across, strict=True))
        return (GravityDirection(gravity=tuple((tilted * size / np.linalg.norm(tilted)).tolist())),)

    return Hypothesis(terms[0].name, (), terms, realise)


def rippling(joint: int, cycles: tuple[float, ...]) -> Hypothesis:
    """Return a ripple of several lines at one joint (1-based)."""
    one = tuple(
        TorqueRipple(joint=joint, cycles_per_rev=(N,), amplitude=(1.0,), phase=(0.0,))
        for N in cycles
    )
    terms = tuple(term for base in one for term in (base, replace(base, phase=(np.pi / 2,))))

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        sine, cosine = c[0::2], c[1::2]
        size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
        return (
            TorqueRipple(
                joint=joint,
                cycles_per_rev=cycles,
                amplitude=tuple(size.tolist()),
                phase=tuple(phase.tolist()),
            ),
        )

    return Hypothesis(
        TorqueRipple.name,
        (joint - 1,),
        terms,
        realise,
        settings=cycles,
        family=lambda *N: rippling(joint, N),
        bounds=tuple((0.98 * N, 1.02 * N) for N in cycles),
    )
