"""Dry friction whose height follows load, position, time or temperature."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    FARTHEST,
    MOST_TORQUE,
    Friction,
    Hypothesis,
    JointMotion,
    State,
)
from limo_driver.physics.effects import friction
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics.effect import DiagnosisContext, Effect, SimulatedPlant
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

VARIANTS = ("absolute", "positive", "negative", "stribeck", "quadratic")
REFERENCE = 25.0  # [°C]
WARMING_TIMES = (0.1, 0.3, 1.0)  # of the length of the recordings
_FASTEST, _CONSTANT = 1e-2, 1e6  # [s], time constant of what does not change
_WARMING = 0.01  # [rad/s] beyond which motion warms a gear


class DryFriction(Friction):
    """Dry friction of a changing height, tau = height tanh(v / v_eps)."""

    v_eps: float  # a parameter of every subclass

    @abstractmethod
    def height(self, motion: JointMotion) -> FloatArray:
        """Return the friction torque while sliding [N m], (T,)."""

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return height tanh(v / v_eps) [N m], (T,)."""
        return self.height(motion) * np.tanh(motion.velocity / self.v_eps), state


@dataclass(frozen=True, kw_only=True)
class LoadDependentFriction(DryFriction):
    """Friction of gears that the load presses together; tau_0 is the nominal rigid-body torque.

    The height is, by variant: `absolute` k |tau_0|; `positive` k max(tau_0 sign v, 0), from loads
    that resist the motion; `negative` k max(-tau_0 sign v, 0), from loads that drive it; `stribeck`
    k |tau_0| exp(-|v / v_s|); `quadratic` k tau_0², with k in 1/(N m).

    Args:
        coefficient: Friction by load, k.
        variant: How load presses.
        v_s: Stribeck velocity of that variant.

    Raises:
        ConfigError: The variant is unknown, or v_s does not belong to it.

    Source: Hamon, Gautier and Garrec, "New dry friction model with load- and velocity-dependence
    and dynamic identification of multi-DOF robots", ICRA 2011.
    """

    name: ClassVar[str] = "load_dependent_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("coefficient",)
    description: ClassVar[Description] = Description(
        signature="the friction loop widens with the load the joint carries",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "position_dependent_friction",
                "the same path at another load changes one and not the other",
                "wide_sweep",
            ),
            Confusion(
                "temperature_dependent_friction",
                "one follows the load there and back, the other fades with time",
                "wide_sweep",
            ),
        ),
    )
    coefficient: float = parameter("1", lower=0.0, upper=10.0, scales=True)
    variant: str = parameter("text", of=VARIANTS, default="absolute")
    v_s: float | None = parameter("rad/s", lower=1e-5, upper=10.0, default=None)
    v_eps: float = friction.sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.variant == "stribeck") != (self.v_s is not None):
            fault = "lacks v_s" if self.v_s is None else f"has no v_s as {self.variant}"
            raise ConfigError(f"{self.place}: {fault}; the variant stribeck needs it, no other")

    def height(self, motion: JointMotion) -> FloatArray:
        """Return the friction torque while sliding [N m], (T,)."""
        return self.coefficient * self._pressing(motion)

    def _pressing(self, motion: JointMotion) -> FloatArray:
        if self.variant == "quadratic":
            return motion.load**2
        if self.variant in {"positive", "negative"}:
            resisting = motion.load * np.sign(motion.velocity)
            return np.maximum(resisting if self.variant == "positive" else -resisting, 0.0)
        fade = 1.0 if self.v_s is None else np.exp(-np.abs(motion.velocity / self.v_s))
        return np.abs(motion.load) * fade

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield every variant; a wide sign would make it a part of gravity's torque."""
        for variant in ("absolute", "positive", "negative", "quadratic"):
            effect = cls(joint=joint, coefficient=0.1, variant=variant)
            yield Hypothesis.of_one(effect, "coefficient", positive=True)
        yield cls.at_creep(joint, friction.CREEP_SPEEDS[2])

    @classmethod
    def at_creep(cls, joint: int, v_s: float) -> Hypothesis:
        """Return friction by load that fades with the speed."""
        return Hypothesis.of_one(
            cls(joint=joint, coefficient=0.1, variant="stribeck", v_s=v_s),
            "coefficient",
            positive=True,
            settings=(v_s,),
            family=partial(cls.at_creep, joint),
            bounds=((3e-3, 0.6),),
        )


@dataclass(frozen=True, kw_only=True)
class PositionDependentFriction(DryFriction):
    """Friction that varies along the range: excess linear between positions, constant beyond.

    Args:
        positions: Positions.
        excess: Added friction at each position.

    Raises:
        ConfigError: Positions do not increase, or are not as many as the excesses.

    Source: Armstrong, "Friction: experimental determination, modeling and compensation", ICRA 1988.
    """

    name: ClassVar[str] = "position_dependent_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("excess",)
    description: ClassVar[Description] = Description(
        signature="the friction loop changes its height over the joint's range",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "temperature_dependent_friction",
                "the same positions before and after the joint has warmed up",
                "revisit",
            ),
            Confusion(
                "torque_ripple",
                "friction changes sign with the direction, ripple does not",
                "creep",
            ),
        ),
    )
    positions: tuple[float, ...] = parameter("rad", lower=-FARTHEST, upper=FARTHEST, chosen=True)
    excess: tuple[float, ...] = parameter(
        "N m", lower=-MOST_TORQUE, upper=MOST_TORQUE, deviation="largest"
    )
    v_eps: float = friction.sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("positions", "excess")
        self._increasing("positions")

    known_by: ClassVar[tuple[str, ...]] = ("position",)

    def height(self, motion: JointMotion) -> FloatArray:
        """Return the excess at the position of each sample [N m], (T,)."""
        return np.interp(motion.position, self.positions, self.excess)

    @property
    def mean(self) -> float:
        """The mean excess over its positions [N m]."""
        span = self.positions[-1] - self.positions[0]
        return float(np.trapezoid(self.excess, self.positions)) / span if span else self.excess[0]

    def goes_on(self, inside: JointMotion, motion: JointMotion) -> FloatArray:
        """Return what takes the height at the end to the mean one."""
        gone = 1.0 - self.domain.fade(motion) if self.domain else 0.0
        return gone * (self.mean - self.height(inside)) * np.tanh(motion.velocity / self.v_eps)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it at places all over the range that the joint turned in."""
        q, eps = recorded.position[:, joint - 1], friction.sign_width_at(joint, recorded)
        low, high = float(q.min()), float(q.max())
        knots = tuple(np.linspace(low, max(high, low + 1e-3), friction.PLACES).tolist())
        terms = tuple(
            cls(joint=joint, positions=knots, excess=tuple(bump), v_eps=eps)
            for bump in friction.BUMPS.tolist()
        )
        yield Hypothesis(
            cls.name,
            (joint - 1,),
            terms,
            lambda c: (replace(terms[0], excess=tuple((friction.BUMPS @ c).tolist())),),
        )


@dataclass(frozen=True, kw_only=True)
class TemperatureDependentFriction(DryFriction):
    """Friction that changes as the gear warms up.

    The height is excess (1 - w) with warmth w, time_constant dw/dt = tanh(|v| / 0.01 rad/s) - w,
    from 0: while the joint moves, excess exp(-t / time_constant); while it rests, it cools down
    again. Or, where the joint's temperature is measured, per_kelvin (temperature - reference).

    Args:
        excess: Added friction when cold.
        time_constant: Time in which motion takes it to 1/e.
        per_kelvin: Added friction by temperature.

    Raises:
        ConfigError: Not exactly one of both forms is given whole; or, when evaluated, the motion
            has no temperature and per_kelvin needs it.

    Source: Bittencourt, Wernholt, Sander-Tavallaey and Brogårdh, "An extended friction model to
    capture load and temperature effects in robot joints", IROS 2010.
    """

    name: ClassVar[str] = "temperature_dependent_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("excess", "per_kelvin")
    description: ClassVar[Description] = Description(
        signature="friction changes over minutes while the motion stays alike",
        shown_by="revisit",
        confusions=(
            Confusion(
                "torque_drift", "warmth changes the height of the loop, drift its middle", "revisit"
            ),
        ),
    )
    known_by: ClassVar[tuple[str, ...]] = ("temperature",)
    excess: float | None = parameter("N m", lower=-MOST_TORQUE, upper=MOST_TORQUE, default=None)
    time_constant: float | None = parameter("s", lower=_FASTEST, upper=_CONSTANT, default=None)
    per_kelvin: float | None = parameter("N m/K", lower=-100.0, upper=100.0, default=None)
    reference: float | None = parameter(
        "°C",
        f"temperature without excess ({REFERENCE:g})",
        lower=-50.0,
        upper=200.0,
        default=None,
        chosen=True,
    )
    v_eps: float = friction.sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        timed = self.excess, self.time_constant
        thermal = self.per_kelvin, self.reference
        if any(v is not None for v in timed) and any(v is not None for v in thermal):
            raise ConfigError(
                f"{self.place}: has excess or time_constant beside per_kelvin or reference; "
                "give one form"
            )
        if None in timed and self.per_kelvin is None:
            raise ConfigError(
                f"{self.place}: lacks excess and time_constant, or per_kelvin: one form, whole"
            )

    def initial_state(self) -> State:
        """Return a cold joint, and no previous time."""
        return np.array([0.0, np.nan])

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return height tanh(v / v_eps) [N m], (T,)."""
        if self.per_kelvin is not None:
            return super().advance(state, motion)
        after = state.copy()
        heat = np.tanh(np.abs(motion.velocity) / _WARMING)
        warmth = _warm(after, motion.time, np.ascontiguousarray(heat), self.time_constant or 1.0)
        height = (self.excess or 0.0) * (1.0 - warmth)
        return height * np.tanh(motion.velocity / self.v_eps), after

    def height(self, motion: JointMotion) -> FloatArray:
        """Return the excess at the temperature of each sample [N m], (T,)."""
        if motion.temperature is None or not np.isfinite(motion.temperature).all():
            raise ConfigError(
                f"{self.place}: per_kelvin needs the temperature of the joint, "
                "and the motion has none, or holes in it"
            )
        return self.excess_at(motion.temperature)

    def excess_at(self, temperature: FloatArray) -> FloatArray:
        """Return what per_kelvin makes of a temperature [°C]: added friction [N m], same shape."""
        reference = REFERENCE if self.reference is None else self.reference
        return (self.per_kelvin or 0.0) * (temperature - reference)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield what fades at several rates, and what a temperature does where it was measured."""
        eps = friction.sign_width_at(joint, recorded)
        for part in WARMING_TIMES if recorded.shows_slow_change else ():
            yield cls.fading(joint, eps, part * recorded.longest)
        warmth = recorded.temperature
        if warmth is not None and np.isfinite(warmth[:, joint - 1]).all():
            yield cls.by_temperature(joint, eps, float(warmth[:, joint - 1].mean()))

    @classmethod
    def fading(cls, joint: int, v_eps: float, time_constant: float) -> Hypothesis:
        """Return friction that fades as a joint warms up."""
        return Hypothesis.of_one(
            cls(joint=joint, excess=1.0, time_constant=time_constant, v_eps=v_eps),
            "excess",
            settings=(time_constant,),
            family=partial(cls.fading, joint, v_eps),
            bounds=((max(0.02 * time_constant, _FASTEST), min(20 * time_constant, _CONSTANT)),),
        )

    @classmethod
    def by_temperature(cls, joint: int, v_eps: float, mean: float) -> Hypothesis:
        """Return friction that follows a temperature, with what it is at the mean [°C]."""
        slope = cls(joint=joint, per_kelvin=0.1, reference=mean, v_eps=v_eps)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            per_kelvin = 0.1 * float(c[0])
            reference = mean - float(c[1]) / per_kelvin if per_kelvin else mean
            reference = float(np.clip(reference, -50.0, 200))
            return (replace(slope, per_kelvin=per_kelvin, reference=reference),)

        height = friction.CoulombFriction(joint=joint, tau_c=1.0, v_eps=v_eps)
        return Hypothesis(slope.name, (joint - 1,), (slope, height), realise)

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for it sampled.

        Raises:
            ConfigError: It needs a temperature.
        """
        if self.per_kelvin is not None:
            raise ConfigError(
                f"{self.place}: the simulated robot has no temperature, which per_kelvin needs; "
                "give excess and time_constant"
            )
        robot.sample(self)

    def from_time(self, start: float, recording: Recording) -> Effect:
        """Return what is left of the excess by then, or that of the temperature measured then."""
        if self.excess is not None and self.time_constant is not None:
            return replace(self, excess=self.excess * (1.0 - self._warmth(start, recording)))
        measured = recording.temperature
        if measured is None or self.per_kelvin is None:
            return self  # which the robot refuses by name
        row = int(np.searchsorted(recording.time, start).clip(0, len(recording) - 1))
        excess = float(self.excess_at(measured[row, self.joint - 1]))  # hardly changes in 20 s
        return replace(
            self, excess=excess, time_constant=_CONSTANT, per_kelvin=None, reference=None
        )

    def _warmth(self, start: float, recording: Recording) -> float:
        """Return how warm a joint had run by then, from 0 to 1."""
        rows = recording.time < start
        if np.count_nonzero(rows) < 2:  # noqa: PLR2004  # no motion before
            return 0.0
        time, position = recording.time[rows], recording.position[rows, self.joint - 1]
        rest = np.zeros_like(time)
        motion = JointMotion(time, position, np.gradient(position, time), rest, rest)
        _, state = self.advance(self.initial_state(), motion)
        return float(state[0])


@compiled(reads=("time", "heat"))
def _warm(state: FloatArray, time: FloatArray, heat: FloatArray, constant: float) -> FloatArray:
    """Advance (warmth, last time) in place towards `heat` (T,); return the warmths (T,)."""
    warmth = np.empty(time.size)
    w, last = state
    for t in range(time.size):
        if not np.isnan(last):
            w = heat[t] + (w - heat[t]) * np.exp(-(time[t] - last) / constant)
        last = time[t]
        warmth[t] = w
    state[0], state[1] = w, last
    return warmth
