"""Hypotheses: each effect of the catalogue, wherever it could act, at a unit size."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.friction import BUILD_UP, dahl, friction, hysteresis
from estimators.diagnosis.hypotheses.hypothesis import Hypothesis, single
from limo_driver.physics import (
    Armature,
    Backlash,
    EncoderOffset,
    GravityDirection,
    JointCoupling,
    JointElasticity,
    PreslidingHysteresis,
    SpringLoad,
    TimeDelay,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.residuals.observations import Observations
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray


GAPS = (2e-4, 6e-4, 2e-3, 6e-3)  # [rad]
KNOTS = 6  # of drift over a recording
UNIT_COMPLIANCE = 1e-5  # [rad/(N m)]
UNIT_CUBIC = 1e-9  # [rad/(N m)³]
STIFF = 1e8  # [N m/rad]
UNIT_DELAY = 1e-3  # [s]
LATE = (4e-3, 0.012, 0.03)  # [s], since within a sample all delays look alike
DELAYS = (2e-4, 0.1)  # [s]
DELAYED, LAGGING = "a pure delay", "a first-order lag"
UNIT_ANGLE = 1e-3  # [rad]
LOW_ORDERS = ((4.0,), (2.0, 4.0), (1.0, 2.0, 4.0))  # in a revolution, of a torque sensor's spokes
_SEEN_OF_A_PERIOD = 0.5  # of the longest line that a torque sensor may have
_SOFTEST = 1e-3  # [N m/rad]


def every(observed: Observations) -> Iterator[Hypothesis]:
    """Yield all hypotheses for a recorded arm."""
    n = observed.n
    for j in range(n):
        yield from friction(observed, j)
        yield from hysteresis(j)
        yield from _transmission(j)
        yield from _sensing(observed, j)
        yield from _environment(observed, j)
        yield from _coupling(j, n)
        yield from _spokes(observed, j)
    yield gravity_direction(observed)


def rivals(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield further laws of an effect that was found.

    They do not search, since another law of the same effect is near enough to find it by.
    """
    joint = hypothesis.joints[0] + 1 if hypothesis.joints else 0
    if hypothesis.effect == PreslidingHysteresis.name:
        width = hypothesis.settings[0] if hypothesis.settings else BUILD_UP[1]
        yield dahl(joint, width, 1.5)
    elif hypothesis.effect == JointElasticity.name:
        yield cubic_elasticity(joint)
    elif hypothesis.effect == TimeDelay.name:
        yield from (slowed(joint, "delay", DELAYED, time) for time in LATE)
        yield slowed(joint, "lag", LAGGING, LATE[0])


def slowed(joint: int, name: str, law: str, time: float) -> Hypothesis:
    """Return a torque that comes late; how that acts on what is fast depends on the time."""
    return single(
        TimeDelay(joint=joint, **{name: time}),
        name,
        positive=True,
        settings=(time,),
        family=partial(slowed, joint, name, law),
        law=law,
        bounds=(DELAYS,),
    )


def cubic_elasticity(joint: int) -> Hypothesis:
    """Return a gear whose stiffness changes with its load."""
    soft = JointElasticity(joint=joint, stiffness=1.0 / UNIT_COMPLIANCE)
    bent = JointElasticity(joint=joint, stiffness=STIFF, cubic=UNIT_CUBIC)

    def realise(c: FloatArray) -> tuple[Effect, ...]:
        stiffness = _stiffness(float(c[0]))
        return (replace(soft, stiffness=stiffness, cubic=float(c[1]) * UNIT_CUBIC),)

    return Hypothesis(soft.name, (joint - 1,), (soft, bent), realise, law="a cubic one")


def _stiffness(compliance: float) -> float:
    """Return the stiffness [N m/rad] of so many units of compliance; of none, the stiffest."""
    return 1.0 / max(compliance * UNIT_COMPLIANCE, 1.0 / STIFF)


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
        lambda c: (replace(soft, stiffness=_stiffness(float(c[0]))),),
        positive=True,
        law="a linear one",
    )


def _sensing(observed: Observations, j: int) -> Iterator[Hypothesis]:
    joint = j + 1
    yield single(TorqueOffset(joint=joint, offset=1.0), "offset")
    yield single(TorqueGain(joint=joint, gain=0.01), "gain")
    delay = TimeDelay(joint=joint, delay=UNIT_DELAY)
    yield single(delay, "delay", positive=True, law=DELAYED)
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
    for k in (j - 2, j - 1, j + 1, j + 2):  # a wrist turns about every other axis, too
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


def _spokes(observed: Observations, j: int) -> Iterator[Hypothesis]:
    """Yield ripples of low orders, as far as a joint turns through them."""
    turns = float(np.ptp(observed.slow.position[:, j])) / (2 * np.pi)
    for cycles in LOW_ORDERS:
        if turns * max(cycles) >= 1.0 and turns * min(cycles) >= _SEEN_OF_A_PERIOD:
            yield rippling(j + 1, cycles)


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
