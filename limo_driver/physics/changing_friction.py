"""Dry friction whose height follows load, position, time or temperature."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.compiled import compiled
from limo_driver.errors import ConfigError
from limo_driver.parameters import parameter
from limo_driver.physics.effect import Friction, State
from limo_driver.physics.friction import sign_width

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray

VARIANTS = ("absolute", "positive", "negative", "stribeck", "quadratic")
REFERENCE = 25.0  # [°C]
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

    Raises:
        ConfigError: The variant is unknown, or v_s does not belong to it.

    Source: Hamon, Gautier and Garrec, "New dry friction model with load- and velocity-dependence
    and dynamic identification of multi-DOF robots", ICRA 2011.
    """

    name: ClassVar[str] = "load_dependent_friction"
    coefficient: float = parameter("1", "friction by load, k", lower=0.0, upper=10.0)
    variant: str = parameter("text", "how load presses", of=VARIANTS, default="absolute")
    v_s: float | None = parameter(
        "rad/s", "Stribeck velocity of that variant", lower=1e-5, upper=10.0, default=None
    )
    v_eps: float = sign_width()

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


@dataclass(frozen=True, kw_only=True)
class PositionDependentFriction(DryFriction):
    """Friction that varies along the range: excess linear between positions, constant beyond.

    Raises:
        ConfigError: Positions do not increase, or are not as many as the excesses.

    Source: Armstrong, "Friction: experimental determination, modeling and compensation", ICRA 1988.
    """

    name: ClassVar[str] = "position_dependent_friction"
    positions: tuple[float, ...] = parameter("rad", "positions", lower=-20.0, upper=20.0)
    excess: tuple[float, ...] = parameter(
        "N m", "added friction at each position", lower=-1e3, upper=1e3
    )
    v_eps: float = sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("positions", "excess")
        self._increasing("positions")

    def height(self, motion: JointMotion) -> FloatArray:
        """Return the excess at the position of each sample [N m], (T,)."""
        return np.interp(motion.position, self.positions, self.excess)


@dataclass(frozen=True, kw_only=True)
class TemperatureDependentFriction(DryFriction):
    """Friction that changes as the gear warms up.

    The height is excess (1 - w) with warmth w, time_constant dw/dt = tanh(|v| / 0.01 rad/s) - w,
    from 0: while the joint moves, excess exp(-t / time_constant); while it rests, it cools down
    again. Or, where the joint's temperature is measured, per_kelvin (temperature - reference).

    Raises:
        ConfigError: Not exactly one of both forms is given whole; or, when evaluated, the motion
            has no temperature and per_kelvin needs it.

    Source: Bittencourt, Wernholt, Sander-Tavallaey and Brogårdh, "An extended friction model to
    capture load and temperature effects in robot joints", IROS 2010.
    """

    name: ClassVar[str] = "temperature_dependent_friction"
    excess: float | None = parameter(
        "N m", "added friction when cold", lower=-1e3, upper=1e3, default=None
    )
    time_constant: float | None = parameter(
        "s", "time in which motion takes it to 1/e", lower=1e-2, upper=1e6, default=None
    )
    per_kelvin: float | None = parameter(
        "N m/K", "added friction by temperature", lower=-100.0, upper=100.0, default=None
    )
    reference: float | None = parameter(
        "°C", f"temperature without excess ({REFERENCE:g})", lower=-50.0, upper=200.0, default=None
    )
    v_eps: float = sign_width()

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
