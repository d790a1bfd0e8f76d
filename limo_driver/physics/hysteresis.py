"""Presliding hysteresis: friction that depends on the distance since reversals, not on speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numba import njit

from limo_driver.errors import ConfigError
from limo_driver.physics.effect import State, TorqueEffect, parameter

if TYPE_CHECKING:
    from limo_driver.physics.effect import JointMotion
    from limo_driver.types import FloatArray

LAWS = ("maxwell_slip",)


@dataclass(frozen=True, kw_only=True)
class PreslidingHysteresis(TorqueEffect):
    """Maxwell-slip friction: parallel springs that each slip at their width.

    tau = Σ_i stiffness_i z_i,  z_i ← clip(z_i + Δq, -width_i, width_i)

    where z_i is the deflection of element i and Δq the step in position. It is rate-independent,
    has non-local memory, and slides at Σ stiffness_i width_i. The deflections start at zero.

    Source: Al-Bender, Lampaert and Swevers, "The generalized Maxwell-slip model", IEEE TAC 2005.
    """

    name: ClassVar[str] = "presliding_hysteresis"
    law: str = parameter("text", f"hysteresis law: {', '.join(LAWS)}", default="maxwell_slip")
    stiffness: tuple[float, ...] = parameter(
        "N m/rad", "stiffness of each element", lower=0.0, upper=1e7
    )
    width: tuple[float, ...] = parameter(
        "rad", "deflection at which each element slips", lower=1e-7, upper=1.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law not in LAWS:
            raise ConfigError(
                f"{self.name}, joint {self.joint}: law {self.law!r} is unknown; "
                f"known: {', '.join(LAWS)}"
            )
        if len(self.stiffness) != len(self.width):
            raise ConfigError(
                f"{self.name}, joint {self.joint}: {len(self.stiffness)} stiffness values but "
                f"{len(self.width)} widths; each element needs both"
            )

    def initial_state(self) -> State:
        """Return relaxed springs and no previous position."""
        return np.append(np.zeros(len(self.width)), np.nan)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Move the springs along T positions; the state is (z_1 … z_k, last position)."""
        after = state.copy()
        torque = _maxwell_slip(
            after, motion.position, np.array(self.stiffness), np.array(self.width)
        )
        return torque, after


@njit(cache=True)
def _maxwell_slip(
    state: FloatArray, position: FloatArray, stiffness: FloatArray, width: FloatArray
) -> FloatArray:
    """Advance `state` in place over the positions and return the torques (T,) [N m]."""
    torque = np.zeros(position.size)
    last = state[-1]
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        last = position[t]
        for i in range(width.size):
            state[i] = min(max(state[i] + step, -width[i]), width[i])
            torque[t] += stiffness[i] * state[i]
    state[-1] = last
    return torque
