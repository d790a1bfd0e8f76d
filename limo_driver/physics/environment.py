"""Environment: what pushes and pulls on the arm from outside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.parameters import parameter
from limo_driver.physics.effect import ArmEffect, State, TorqueEffect

if TYPE_CHECKING:
    from limo_driver.physics.effect import ArmMotion, JointMotion
    from limo_driver.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class SpringLoad(TorqueEffect):
    """A cable, hose or counterbalance, tau = stiffness (q - rest) + cubic (q - rest)³.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "spring_load"
    stiffness: float = parameter("N m/rad", "stiffness", lower=-1e5, upper=1e5)
    rest: float = parameter("rad", "position without pull", lower=-1e4, upper=1e4)
    cubic: float = parameter("N m/rad^3", "stiffening", lower=-1e5, upper=1e5, default=0.0)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return stiffness (q - rest) + cubic (q - rest)³ [N m], (T,)."""
        away = motion.position - self.rest
        return self.stiffness * away + self.cubic * away**3, state


@dataclass(frozen=True, kw_only=True)
class ExternalContact(ArmEffect):
    """A wrench on the flange during windows of time, tau = -J(q)ᵀ wrench.

    The wrench is what the environment exerts on the arm at the origin of the flange, force then
    torque, in the axes of the base, constant in each window from its start to before its end.
    Windows that overlap add up.

    Raises:
        ConfigError: A window ends before it starts, or has no wrench.

    Source: Haddadin, De Luca and Albu-Schäffer, "Robot collisions: a survey on detection,
    isolation, and identification", IEEE T-RO 33(6), 2017.
    """

    name: ClassVar[str] = "external_contact"
    windows: tuple[tuple[float, float], ...] = parameter(
        "s", "start and end of each contact", lower=-1e12, upper=1e12, columns=2
    )
    wrench: tuple[tuple[float, float, float, float, float, float], ...] = parameter(
        "N, N m", "force and torque of each contact", lower=-1e5, upper=1e5, columns=6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("windows", "wrench")
        for start, end in self.windows:
            if not start < end:
                raise ConfigError(
                    f"{self.place}: the window from {start:g} s ends at {end:g} s; "
                    "it has to end later"
                )

    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return -Jᵀ wrench in the windows and 0 elsewhere [N m], (T, n)."""
        time = motion.motion.time
        total = np.zeros((time.size, 6))
        for (start, end), wrench in zip(self.windows, self.wrench, strict=True):
            total[(time >= start) & (time < end)] += wrench
        torque = np.zeros_like(motion.load)
        for t in np.flatnonzero(total.any(axis=1)):
            torque[t] = -motion.model.flange_jacobian(motion.motion.position[t]).T @ total[t]
        return torque, state
