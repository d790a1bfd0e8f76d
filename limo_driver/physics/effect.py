"""Effect: one piece of physics, with one set of named parameters.

A subclass writes only the mathematics: `advance(state, ...)` evaluates it over the T samples that
follow `state`, the memory after the sample before them, and returns its values and the memory after
the last sample. Every effect is so used in three ways with the same equation: over a recording
(`predict`), sample by sample (`step`), and inside the simulated robot.

Effect
├── BodyEffect          what it makes of the rigid body
├── ArmEffect           torque that needs the motion of more than one joint
└── JointEffect         of one joint
    ├── TorqueEffect    torque that the joint needs beyond the rigid body
    │   └── Friction    torque against the motion, without memory
    ├── MotionEffect    displacement of the link from where the encoder says it is
    └── SensorEffect    what the torque sensor makes of the torque
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np

from limo_driver.parameters import JOINT, Declared, Parameter, parameter, parameters_of

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray, Motion

State: TypeAlias = "FloatArray"
STATELESS: FloatArray = np.zeros(0)
STATELESS.flags.writeable = False


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


@dataclass(frozen=True)
class ArmMotion:
    """Motion and load of all n joints over T samples."""

    motion: Motion
    load: FloatArray  # (T, n), nominal rigid-body torque [N m]
    model: RobotModel

    def of_joint(self, j: int, *, inertia: bool = False) -> JointMotion:
        """Return the motion and load of one joint (0-based), its inertia only if asked for."""
        motion = self.motion
        return JointMotion(
            motion.time,
            motion.position[:, j],
            motion.velocity[:, j],
            motion.acceleration[:, j],
            self.load[:, j],
            None if motion.temperature is None else motion.temperature[:, j],
            self.model.inertia_of(motion.position, j)[:, j] if inertia else None,
        )


@dataclass(frozen=True)
class SensedTorque:
    """Torque of all n joints as it reaches a sensor effect, after the sensor effects before it."""

    time: FloatArray  # (T,) [s]
    torque: FloatArray  # (T, n) [N m]


@dataclass(frozen=True, kw_only=True)
class Effect(Declared, ABC):
    """One piece of physics."""

    name: ClassVar[str]  # the identifier in sim.yaml and in a diagnosis

    @classmethod
    @cache  # effects are made by the thousand while they are fitted
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the named parameters with unit and bounds."""
        return tuple(item for item in parameters_of(cls) if item.name != "joint")

    @property
    def joints(self) -> tuple[int, ...]:
        """The 1-based joints that the effect belongs to; empty if it is of the whole arm."""
        return ()

    @property
    def place(self) -> str:
        """Name and joints, as they stand in messages."""
        if not self.joints:
            return self.name
        numbers = ", ".join(map(str, self.joints))
        return f"{self.name}, joint{'s' if len(self.joints) > 1 else ''} {numbers}"

    def initial_state(self) -> State:
        """Return the memory before the first sample; empty for effects without memory."""
        return STATELESS


class BodyEffect(Effect):
    """An effect on the rigid body itself."""

    @abstractmethod
    def body(self, model: RobotModel) -> RobotModel:
        """Return what the effect makes of a rigid body."""


class ArmEffect(Effect):
    """An effect that adds torque and needs the motion of more than one joint."""

    @abstractmethod
    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return the torques of T samples, (T, n) [N m], and the memory after them."""


@dataclass(frozen=True, kw_only=True)
class JointEffect(Effect):
    """One piece of physics of one joint."""

    joint: int = parameter(JOINT, "the joint, 1-based")

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint."""
        return (self.joint,)


class TorqueEffect(JointEffect):
    """An effect that adds torque: what the joint needs beyond the rigid body."""

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the torque of T samples, (T,) [N m], and the memory after them."""


class Friction(TorqueEffect):
    """Torque without memory that vanishes with the velocity and has its sign.

    The simulated robot takes it as a damping, so that it dissipates at any step size.
    """


class MotionEffect(JointEffect):
    """An effect that displaces the link from where the encoder says it is.

    Sample by sample it is quasi-static: the link's velocity and acceleration are the encoder's.
    Where past and future are known, the displacement has its own, within `agility` times the
    bandwidth.
    """

    agility: ClassVar[float] = 0.0
    needs_inertia: ClassVar[bool] = False

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link of T samples, (T,) [rad], and the memory after them."""


class SensorEffect(JointEffect):
    """An effect of the torque sensor, after all that is torque."""

    @abstractmethod
    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return what this joint's sensor adds, (T,) [N m], and the memory after it."""
