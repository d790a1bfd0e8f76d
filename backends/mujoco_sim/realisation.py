"""How the simulated robot realises each effect: natively where a native form is known.

`realise` is dispatched on the class of the effect. An effect without an entry of its own runs
through its `advance`, sample by sample in Python: slower, and as correct. What changes the rigid
body is in `Simulation.body` already, of which the MuJoCo model is made.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import singledispatch
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics import (
    Armature,
    BodyEffect,
    Effect,
    EncoderOffset,
    JointCoupling,
    JointElasticity,
    PreslidingHysteresis,
    SensorEffect,
    TemperatureDependentFriction,
    TorqueDrift,
    TorqueOffset,
)
from limo_driver.physics.friction import Frictions, VelocityFriction

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


class Plant(NamedTuple):
    """Joint physics of n joints as tables, for compiled code; F frictions, E spring elements."""

    motor_inertia: FloatArray  # (n,) [kg m²], behind the torque sensor
    armature: FloatArray  # (n,) [kg m²], all reflected inertia: the motor's and that of effects
    compliance: FloatArray  # (n,) [rad/(N m)]
    cubic: FloatArray  # (n,) [rad/(N m)³]
    offset: FloatArray  # (n,) [N m], of the torque sensor
    friction_joint: NDArray[np.int64]  # (F,) 0-based
    friction_law: NDArray[np.int64]  # (F,) see friction_laws
    friction_parameters: FloatArray  # (F, 4)
    element_joint: NDArray[np.int64]  # (E,) 0-based
    element_stiffness: FloatArray  # (E,) [N m/rad]
    element_width: FloatArray  # (E,) [rad]


@dataclass
class Draft:
    """Collects what the effects of a simulation ask for."""

    n: int
    frictions: list[VelocityFriction] = field(default_factory=list)
    elements: list[tuple[int, float, float]] = field(default_factory=list)
    sampled: list[Effect] = field(default_factory=list)  # effects without a native form
    sensed: list[SensorEffect | TorqueDrift] = field(default_factory=list)  # change no motion

    def __post_init__(self) -> None:
        self.link_inertia, self.compliance, self.cubic, self.offset = np.zeros((4, self.n))
        self.encoder_offset = np.zeros(self.n)  # [rad]
        # What sampled effects make stiff or heavy, one cycle late: the step has to carry it.
        self.late_stiffness, self.late_damping, self.late_inertia = np.zeros((3, self.n))

    @property
    def shafts(self) -> tuple[JointCoupling, ...]:
        """One of each two couplings that are one shaft: equal, with the joints exchanged."""
        couplings = [effect for effect in self.sampled if isinstance(effect, JointCoupling)]
        return tuple(
            one
            for index, one in enumerate(couplings)
            if replace(one, joint=one.other, other=one.joint) in couplings[index + 1 :]
        )

    def plant(self, motor_inertia: FloatArray) -> Plant:
        """Return the tables."""
        frictions = Frictions.of(sorted(self.frictions, key=lambda effect: effect.joint))
        elements = sorted(self.elements)
        return Plant(
            motor_inertia=motor_inertia,
            armature=motor_inertia + self.link_inertia,
            compliance=self.compliance,
            cubic=self.cubic,
            offset=self.offset,
            friction_joint=frictions.joint,
            friction_law=frictions.law,
            friction_parameters=frictions.parameters,
            element_joint=np.array([row[0] for row in elements], dtype=np.int64),
            element_stiffness=np.array([row[1] for row in elements], dtype=float),
            element_width=np.array([row[2] for row in elements], dtype=float),
        )


def draft_of(effects: Iterable[Effect], n: int) -> Draft:
    """Realise every effect on an arm of n joints."""
    draft = Draft(n)
    for effect in effects:
        realise(effect, draft)
    return draft


@singledispatch
def realise(effect: Effect, draft: Draft) -> None:
    """Enter an effect into the draft; without a native form it is sampled."""
    draft.sampled.append(effect)


@realise.register
def _(effect: VelocityFriction, draft: Draft) -> None:
    draft.frictions.append(effect)


@realise.register
def _(effect: PreslidingHysteresis, draft: Draft) -> None:
    if effect.law == "maxwell_slip":
        draft.elements += [
            (effect.joint - 1, stiffness, width)
            for stiffness, width in zip(effect.stiffness, effect.width, strict=True)
        ]
        return
    draft.sampled.append(effect)
    draft.late_stiffness[effect.joint - 1] += effect.initial_stiffness
    draft.late_damping[effect.joint - 1] += effect.sigma_1 or 0.0


@realise.register
def _(effect: JointCoupling, draft: Draft) -> None:
    draft.sampled.append(effect)
    draft.late_inertia[effect.joint - 1] += effect.inertia


@realise.register
def _(effect: TemperatureDependentFriction, draft: Draft) -> None:
    if effect.per_kelvin is not None:
        raise ConfigError(
            f"{effect.place}: the simulated robot has no temperature, which per_kelvin needs; "
            "give excess and time_constant"
        )
    draft.sampled.append(effect)


@realise.register
def _(effect: BodyEffect, draft: Draft) -> None:
    """Leave it: the MuJoCo model is made of `Simulation.body`."""


@realise.register
def _(effect: SensorEffect | TorqueDrift, draft: Draft) -> None:
    draft.sensed.append(effect)


@realise.register
def _(effect: EncoderOffset, draft: Draft) -> None:
    draft.encoder_offset[effect.joint - 1] += effect.offset


@realise.register
def _(effect: JointElasticity, draft: Draft) -> None:
    draft.compliance[effect.joint - 1] += 1.0 / effect.stiffness
    draft.cubic[effect.joint - 1] += effect.cubic


@realise.register
def _(effect: TorqueOffset, draft: Draft) -> None:
    draft.offset[effect.joint - 1] += effect.offset


@realise.register
def _(effect: Armature, draft: Draft) -> None:
    draft.link_inertia[effect.joint - 1] += effect.inertia
