"""Transmission between drive and link: elasticity, ripple and the inertia of the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    MOST_INERTIA,
    MOST_SLOPE,
    MOST_STIFFNESS,
    MOST_TORQUE,
    STATELESS,
    Hypothesis,
    MotionEffect,
    State,
    TorqueEffect,
)
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics.effect import DiagnosisContext, Effect, JointMotion, SimulatedPlant
    from limo_driver.types import FloatArray

LOW_ORDERS = ((4.0,), (2.0, 4.0), (1.0, 2.0, 4.0))  # in a revolution, of a torque sensor's spokes
_LIGHT = 1e-9  # [kg m²]
_UNIT_COMPLIANCE = 1e-5  # [rad/(N m)]
_UNIT_CUBIC = 1e-9  # [rad/(N m)³]
_SOFT, _STIFF = 1e-3, 1e8  # [N m/rad]
WINDS_UP, _SWINGS = 0.7, 2.0  # of the bandwidth
_RATES = (1.5, 1.8, 2.2, 2.6, 3.1, 3.8, 4.5, 5.4, 6.5, 7.8, 9.4)  # [Hz], of usual inertias
_DAMPED, _DAMPINGS = 5e-3, (2e-4, 0.05)  # [s], damping over stiffness
_HARDEST = 0.05  # of its compliance at rest, that is left of a spring that hardens
_TOGETHER = 1e-6  # between exponents that are taken as one
_SEEN_OF_A_PERIOD = 0.5  # of the longest line that a torque sensor may have


@dataclass(frozen=True, kw_only=True)
class JointElasticity(MotionEffect):
    """Wind-up of the gear between encoder and link, q_link = q - x, x = s / stiffness + cubic s³.

    The torque s of the spring is tau, that of the nominal rigid body: the deflection is
    quasi-static, right while it changes slowly against the motion, as in creeping and holding.

    With `damping`, the link swings on its spring, inertia ddx = tau - s - damping dx, and begins at
    rest; of a link of unknown inertia, it stays quasi-static. Over whole stretches,
    `Simulation.predict_stretches` gives velocity and acceleration of either to the link.

    Args:
        stiffness: Stiffness.
        cubic: Cubic compliance.
        damping: Of the link on its spring.

    Source: Spong, "Modeling and control of elastic joint robots", J. Dyn. Sys. 1987.
    """

    name: ClassVar[str] = "joint_elasticity"
    description: ClassVar[Description] = Description(
        signature="the link gives way in proportion to its load",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "link_inertia",
                "wind-up grows with the square of the load, a wrong inertia with the load",
                "wide_sweep",
            ),
            Confusion(
                "spring_load",
                "wind-up follows the load, a spring the position at any load",
                "wide_sweep",
            ),
        ),
    )
    needs_inertia: ClassVar[bool] = True
    stiffness: float = parameter("N m/rad", lower=_SOFT, upper=MOST_STIFFNESS, inverse=True)
    cubic: float = parameter("rad/(N m)^3", lower=-1e-3, upper=1e-3, default=0.0)
    damping: float | None = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=None)

    @property
    def agility(self) -> float:
        """The least in which a link can swing, or a spring winds up as its load changes."""
        return WINDS_UP if self.damping is None else _SWINGS

    def initial_state(self) -> State:
        """Return wind-up, torque, momentum, load, inertia, and no time, of a link that swings."""
        return STATELESS if self.damping is None else np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.nan])

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], (T,)."""
        if self.damping is None or motion.inertia is None:
            return wind_up(motion.load, 1.0 / self.stiffness, self.cubic), state
        after, spring = state.copy(), (1.0 / self.stiffness, self.cubic, self.damping)
        held = float(motion.load[0] if motion.held is None else motion.held)
        samples = np.stack([motion.time, motion.load, motion.inertia])
        return _swing(after, samples, held, spring), after

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for a compliance."""
        robot.add_compliance(self.joint, 1.0 / self.stiffness, self.cubic)

    def with_more(self, more: Effect) -> Effect | None:
        """Return one gear for two that wind up behind each other, of the longer time of damping."""
        if not isinstance(more, JointElasticity) or more.joint != self.joint:
            return None
        stiffness = 1.0 / (1.0 / self.stiffness + 1.0 / more.stiffness)
        times = [e.damping / e.stiffness for e in (self, more) if e.damping is not None]
        damping = stiffness * max(times) if times else None
        return replace(self, stiffness=stiffness, damping=damping)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield a gear of one stiffness at any load; and links that swing at several rates."""
        soft = cls(joint=joint, stiffness=1.0 / _UNIT_COMPLIANCE)
        yield Hypothesis(
            soft.name,
            (joint - 1,),
            (soft,),
            lambda c: (replace(soft, stiffness=_stiffness(float(c[0]))),),
            positive=True,
            law="a linear one",
        )
        for rate in _RATES:
            stiffness = float(recorded.inertia[joint - 1]) * (2 * np.pi * rate) ** 2
            if 2.0 * _SOFT <= stiffness <= _STIFF:
                yield cls.of_swing(joint, stiffness, _DAMPED)

    @classmethod
    def of_swing(cls, joint: int, stiffness: float, time: float) -> Hypothesis:
        """Return a link on its spring [N m/rad], of a damping that is a time [s] times that."""
        unit = cls(joint=joint, stiffness=stiffness, damping=time * stiffness)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            own = stiffness / max(float(c[0]), stiffness / _STIFF)
            return (replace(unit, stiffness=own, damping=time * own),)

        return Hypothesis(
            cls.name,
            (joint - 1,),
            (unit,),
            realise,
            positive=True,
            settings=(stiffness, time),
            family=partial(cls.of_swing, joint),
            bounds=((0.5 * stiffness, min(2.0 * stiffness, _STIFF)), _DAMPINGS),
            sized=True,
            most=2.0,  # beyond, another of the grid is nearer
            seldom=True,
            law="that of a link that swings on its spring",
        )

    @classmethod
    def further_laws(cls, found: Hypothesis) -> Iterator[Hypothesis]:
        """Yield a gear whose stiffness changes with its load."""
        (j,) = found.joints
        soft = cls(joint=j + 1, stiffness=1.0 / _UNIT_COMPLIANCE)
        bent = cls(joint=j + 1, stiffness=_STIFF, cubic=_UNIT_CUBIC)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            stiffness = _stiffness(float(c[0]))
            return (replace(soft, stiffness=stiffness, cubic=float(c[1]) * _UNIT_CUBIC),)

        yield Hypothesis(soft.name, (j,), (soft, bent), realise, law="a cubic one")


def _stiffness(compliance: float) -> float:
    """Return the stiffness [N m/rad] of so many units of compliance; of none, the stiffest."""
    return 1.0 / max(compliance * _UNIT_COMPLIANCE, 1.0 / _STIFF)


def wind_up(
    load: FloatArray, compliance: float | FloatArray, cubic: float | FloatArray
) -> FloatArray:
    """Return compliance load + cubic load³ [rad], the equation of `JointElasticity`."""
    return load * (compliance + cubic * load * load)


@compiled(nogil=True)
def _swing(
    state: FloatArray, samples: FloatArray, held: float, spring: tuple[float, float, float]
) -> FloatArray:
    """Advance (wind-up, torque of the spring, momentum; last load, inertia and time) in place.

    A step is exact for a load that changes evenly in it, the mean inertia, and a spring of the
    slope at its beginning.

    Returns:
        Wind-up, (T,) [rad].
    """
    time, load, inertia = samples
    compliance, cubic, damping = spring
    x, s, p, last, had, then = state
    out = np.empty(time.size)
    for t in range(time.size):
        if np.isnan(then):
            s, p = held, 0.0
            x = s * (compliance + cubic * s * s)
        elif time[t] > then:
            h, m = time[t] - then, 0.5 * (had + inertia[t])
            slope = 1.0 / max(compliance + 3.0 * cubic * s * s, _HARDEST * compliance)
            rate = (load[t] - last) / (h * slope)  # of where it would rest [rad/s]
            rest = (last - s - damping * rate) / slope  # beyond where it is
            decay, square = 0.5 * damping / m, slope / m
            apart = decay * decay - square
            w = math.sqrt(abs(apart))
            if apart < 0.0:
                e = math.exp(-decay * h)
                cosine, sine = e * math.cos(w * h), e * math.sin(w * h) / w
            else:
                slow, fast = math.exp(-square / (decay + w) * h), math.exp(-(decay + w) * h)
                cosine = 0.5 * (slow + fast)
                sine = 0.5 * (slow - fast) / w if w * h > _TOGETHER else h * slow
            off = p / m - rate
            moved = rest + rate * h - rest * cosine + (off - decay * rest) * sine
            p = m * (rate + off * cosine - (decay * off - square * rest) * sine)
            x += moved
            s += slope * moved
            s -= slope * (s * (compliance + cubic * s * s) - x)
        last, had, then = load[t], inertia[t], time[t]
        out[t] = x
    state[:] = x, s, p, last, had, then
    return out


@dataclass(frozen=True, kw_only=True)
class Armature(TorqueEffect):
    """Inertia of the drive seen from the joint, tau = inertia ddq; absent from a link-side torque.

    Args:
        inertia: Reflected inertia.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 9.6.
    """

    name: ClassVar[str] = "armature"
    sized_by: ClassVar[tuple[str, ...]] = ("inertia",)
    description: ClassVar[Description] = Description(
        signature="torque goes with this joint's own acceleration alone",
        shown_by="two_frequencies",
        confusions=(
            Confusion(
                "link_inertia",
                "a drive's inertia loads its own joint only, a link's all joints below it",
                "two_frequencies",
            ),
            Confusion(
                "payload",
                "a drive's inertia has no weight and loads its own joint only",
                "two_frequencies",
            ),
            Confusion(
                "time_delay",
                "inertia grows with the square of the frequency, a delay's phase with it",
                "two_frequencies",
            ),
        ),
    )
    inertia: float = parameter("kg m^2", lower=0.0, upper=MOST_INERTIA, adds=True)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return inertia ddq [N m], (T,)."""
        return self.inertia * motion.acceleration, state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for reflected inertia."""
        robot.add_inertia(self.joint, self.inertia)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield it."""
        yield Hypothesis.of_one(cls(joint=joint, inertia=1.0), "inertia", positive=True)


@dataclass(frozen=True, kw_only=True)
class TorqueRipple(TorqueEffect):
    """Torque that repeats with the angle, tau = Σ amplitude_i sin(cycles_per_rev_i q + phase_i).

    The cogging of a motor behind a gear of ratio r has cycles_per_rev = poles times r.

    Args:
        cycles_per_rev: Cycles in a revolution of the joint.
        amplitude: Amplitude.
        phase: Phase.

    Raises:
        ConfigError: The lists differ in length.

    Source: Taghirad and Bélanger, "Modeling and parameter identification of harmonic drive
    systems", J. Dyn. Sys. Meas. Control 120(4), 1998.
    """

    name: ClassVar[str] = "torque_ripple"
    sized_by: ClassVar[tuple[str, ...]] = ("amplitude",)
    description: ClassVar[Description] = Description(
        signature="the error repeats a fixed number of times in a revolution", shown_by="creep"
    )
    cycles_per_rev: tuple[float, ...] = parameter("1/rev", lower=1e-3, upper=1e6, deviation=1.0)
    amplitude: tuple[float, ...] = parameter(
        "N m", lower=0.0, upper=MOST_TORQUE, deviation="largest"
    )
    phase: tuple[float, ...] = parameter("rad", lower=-1e3, upper=1e3, deviation=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("cycles_per_rev", "amplitude", "phase")

    known_by: ClassVar[tuple[str, ...]] = ("position",)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the sum of the harmonics at the position of each sample [N m], (T,)."""
        torque = np.zeros_like(motion.position)
        for N, A, phi in zip(self.cycles_per_rev, self.amplitude, self.phase, strict=True):
            torque += A * np.sin(N * motion.position + phi)
        return torque, state

    def goes_on(self, inside: JointMotion, motion: JointMotion) -> FloatArray:
        """Return what takes the ripple at the end to one that fades."""
        (there, _), (at_end, _) = (self.advance(STATELESS, some) for some in (motion, inside))
        return there * (self.domain.fade(motion) if self.domain else 1.0) - at_end

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield ripples of low orders, as far as the joint turns through them."""
        turns = float(np.ptp(recorded.position[:, joint - 1])) / (2 * np.pi)
        for cycles in LOW_ORDERS:
            if turns * max(cycles) >= 1.0 and turns * min(cycles) >= _SEEN_OF_A_PERIOD:
                yield cls.of_lines(joint, cycles)

    @classmethod
    def of_lines(cls, joint: int, cycles: tuple[float, ...]) -> Hypothesis:
        """Return a ripple of several lines [1/rev] at one joint."""
        one = tuple(
            cls(joint=joint, cycles_per_rev=(N,), amplitude=(1.0,), phase=(0.0,)) for N in cycles
        )
        terms = tuple(term for base in one for term in (base, replace(base, phase=(np.pi / 2,))))

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            sine, cosine = c[0::2], c[1::2]
            size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
            return (
                cls(
                    joint=joint,
                    cycles_per_rev=cycles,
                    amplitude=tuple(size.tolist()),
                    phase=tuple(phase.tolist()),
                ),
            )

        return Hypothesis(
            cls.name,
            (joint - 1,),
            terms,
            realise,
            settings=cycles,
            family=lambda *N: cls.of_lines(joint, N),
            bounds=tuple((0.98 * N, 1.02 * N) for N in cycles),
        )
