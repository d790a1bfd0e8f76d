"""Domain: the motion of a joint that a law was learned from, beyond which it goes on more simply.

A law that was fitted to slow motion says little of fast motion, and a curve that was fitted to a
part of a range runs away beyond it. So an effect may have a domain, in `sim.yaml` as

```yaml
- effect: spring_load
  joint: 2
  stiffness: 12.0
  rest: 0.3
  cubic: 40.0
  domain: {position: [-0.8, 1.1]}
```
Without one, an effect is its equation everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.types import BoolArray, FloatArray

NARROWEST = 1e-9  # [rad], that a range is taken to be at least
FARTHEST = 1e4  # [rad], [rad/s], [°C], which catches a wrong unit


@dataclass(frozen=True)
class JointMotion:
    """Motion and load of one joint over T samples; each array has shape (T,)."""

    time: FloatArray  # [s]
    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s²]
    load: FloatArray  # nominal rigid-body torque [N m]
    temperature: FloatArray | None = None  # [°C]
    inertia: FloatArray | None = None  # [kg m²], for effects that ask for it
    held: float | None = None  # load at rest where the motion begins [N m], likewise


@dataclass(frozen=True, kw_only=True)
class Domain(Declared):
    """Motion of a joint that a law was learned from; what is not stated has no limits.

    Args:
        position: Least and largest.
        speed: Largest, of either sign.
        temperature: Lowest and highest.
        slope: Of friction beyond the speed; its own if not given.
    """

    _called: ClassVar[str] = "domain"

    position: tuple[float, ...] | None = parameter(
        "rad", lower=-FARTHEST, upper=FARTHEST, length=2, default=None
    )
    speed: float | None = parameter("rad/s", lower=0.0, upper=FARTHEST, default=None)
    temperature: tuple[float, ...] | None = parameter(
        "°C", lower=-FARTHEST, upper=FARTHEST, length=2, default=None
    )
    slope: float | None = parameter("N m s/rad", lower=0.0, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._increasing(
            *(name for name in ("position", "temperature") if getattr(self, name) is not None),
            strictly=False,
        )

    def held(self, motion: JointMotion) -> JointMotion:
        """Return a motion that is held at the ends of the domain where it goes beyond."""
        position, velocity, warmth = motion.position, motion.velocity, motion.temperature
        if self.position is not None:
            position = np.clip(position, self.position[0], self.position[1])
        if self.speed is not None:
            velocity = np.clip(velocity, -self.speed, self.speed)
        if self.temperature is not None and warmth is not None:
            warmth = np.clip(warmth, self.temperature[0], self.temperature[1])
        return replace(motion, position=position, velocity=velocity, temperature=warmth)

    def outside(self, motion: JointMotion) -> BoolArray:
        """Mark the samples of a motion that are beyond it, (T,)."""
        inside = self.held(motion)
        beyond = (inside.position != motion.position) | (inside.velocity != motion.velocity)
        if motion.temperature is not None and inside.temperature is not None:
            beyond |= inside.temperature != motion.temperature
        return beyond

    def fade(self, motion: JointMotion) -> FloatArray:
        """Return 1 in the range of positions, and less beyond: 0 a whole range away, (T,)."""
        if self.position is None:
            return np.ones_like(motion.position)
        away = np.abs(motion.position - self.held(motion).position)
        span = max(self.position[1] - self.position[0], NARROWEST)
        return np.maximum(1.0 - away / span, 0.0)

    def joined(self, other: Domain | None) -> Domain:
        """Return the motion of this and another one; of no domain, nothing is known."""
        if other is None:
            return self
        changes: dict[str, Any] = {
            name: (min(own[0], its[0]), max(own[1], its[1]))
            for name in ("position", "temperature")
            if (own := getattr(self, name)) and (its := getattr(other, name))
        }
        if self.speed is not None and other.speed is not None:
            changes["speed"] = max(self.speed, other.speed)
        return replace(self, **changes)

    def __str__(self) -> str:
        parts = {
            "positions": self.position and f"{self.position[0]:.3g} to {self.position[1]:.3g} rad",
            "speeds": self.speed is not None and f"up to {self.speed:.3g} rad/s",
            "temperatures": self.temperature
            and f"{self.temperature[0]:.3g} to {self.temperature[1]:.3g} °C",
        }
        return ", ".join(f"{name} {text}" for name, text in parts.items() if text)
