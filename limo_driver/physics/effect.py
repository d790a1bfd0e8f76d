"""Effect: one piece of physics, with one set of named parameters.

A subclass writes only the mathematics. A `BodyEffect` writes `body(model)`: the rigid body that it
makes of another. All others write `advance(state, ...)`: values over the T samples that follow
`state`, the memory after the sample before them, and the memory after the last sample. So one
equation is used over a recording (`predict`), sample by sample (`step`), and in a simulated robot.

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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, ClassVar, Final, Protocol, TypeAlias

import numpy as np

from limo_driver.model import RobotModel
from limo_driver.physics.description import Description
from limo_driver.physics.domain import Domain, JointMotion
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.parameters import JOINT, Declared, Parameter, parameter, parameters_of
from limo_driver.types import FloatArray, Motion

# Bounds of what a file may say, far beyond the smallest servo and the largest arm: they catch a
# wrong unit or a slip of the pen, and are no opinion of what is likely.
MOST_TORQUE: Final = 1e6  # [N m]
MOST_SLOPE: Final = 1e7  # of friction over speed [N m s/rad], [N m s²/rad²]
MOST_STIFFNESS: Final = 1e10  # [N m/rad], [N m/rad³]
MOST_INERTIA: Final = 1e6  # [kg m²]
FARTHEST: Final = 1e4  # [rad]
SLOW_CHANGE: Final = 30.0  # [s] in which gears warm up or sensors drift by an amount that shows

State: TypeAlias = "FloatArray"
STATELESS: FloatArray = np.zeros(0)
STATELESS.flags.writeable = False


@dataclass(frozen=True)
class ArmMotion:
    """Motion and load of all n joints over T samples."""

    motion: Motion
    load: FloatArray  # (T, n), nominal rigid-body torque [N m]
    model: RobotModel

    def of_joint(self, j: int, *, inertia: bool = False) -> JointMotion:
        """Return the motion and load of one joint (0-based), its inertia only if asked for."""
        of, model = self.motion, self.model
        return JointMotion(
            of.time, of.position[:, j], of.velocity[:, j], of.acceleration[:, j], self.load[:, j],
            None if of.temperature is None else of.temperature[:, j],
            model.inertia_of(of.position, j)[:, j] if inertia else None,
            float(model.gravity_torque(of.position[0])[0, j]) if inertia else None,
        )  # fmt: skip


@dataclass(frozen=True)
class SensedTorque:
    """Torque of all n joints as it reaches a sensor effect, after the sensor effects before it."""

    time: FloatArray  # (T,) [s]
    torque: FloatArray  # (T, n) [N m]


@dataclass(frozen=True, kw_only=True)
class Effect(Declared, ABC):
    """One piece of physics."""

    name: ClassVar[str]  # the identifier in sim.yaml and in a diagnosis
    description: ClassVar[Description] = Description()
    is_friction: ClassVar[bool] = False  # whether it is friction, as every joint has some of
    persists: ClassVar[bool] = True  # whether another recording of the arm has it, too, as it is
    sized_by: ClassVar[tuple[str, ...]] = ()  # parameters without which, all zero, it does nothing

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

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterable[Hypothesis]:  # noqa: ARG003
        """Return the hypotheses of a diagnosis about a joint (1-based); none by default."""
        return ()

    @classmethod
    def on_arm(cls, recorded: DiagnosisContext) -> Iterable[Hypothesis]:  # noqa: ARG003
        """Return the hypotheses of a diagnosis about an effect of the arm as a whole."""
        return ()

    @classmethod
    def further_laws(cls, found: Hypothesis) -> Iterable[Hypothesis]:  # noqa: ARG003
        """Return other laws of the effect, to compete with the one it was found by.

        They need not search, since another law of the same effect is near enough to find it by.
        """
        return ()

    def fitted_from(self, start: Effect) -> Effect:  # noqa: ARG002
        """Return this effect, fitted from `start`, with what no fit may change as it was there."""
        return self

    def with_value(self, name: str, value: float) -> Effect:
        """Return this effect with another value of one of its numbers.

        Args:
            name: Of the parameter.
            value: In its unit, within its bounds.
        """
        return replace(self, **{name: value})

    def with_more(self, more: Effect) -> Effect | None:
        """Return one effect for this and another one; None where they stay two."""
        if type(more) is not type(self) or more.joints != self.joints:
            return None
        for known in self.parameters():
            if known.adds:
                own, its = getattr(self, known.name), getattr(more, known.name)
                if own is None or its is None:
                    return None
                total = float(np.clip(own + its, known.lower, known.upper))
                return replace(self, **{known.name: total})
        return None

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask a simulated robot for the effect; without a native form it is sampled."""
        robot.sample(self)

    def from_time(self, start: float, recording: Recording) -> Effect:  # noqa: ARG002
        """Return the effect on a robot whose time 0 is `start` [s] of a recording.

        It differs for what knows the time, or remembers more than the last reversals.
        """
        return self


class SimulatedPlant(Protocol):
    """How effects act on a simulated robot: sampled, sensed or natively; joints are 1-based."""

    def sample(self, effect: Effect) -> None:
        """Run an effect one sample in each cycle."""
        ...

    def sense(self, effect: SensorEffect | TorqueEffect) -> None:
        """Run an effect on what the torque sensor says, which changes no motion."""
        ...

    def carry(self, start: float, load: BodyEffect) -> None:
        """Change the rigid body from a time on [s]."""
        ...

    def add_friction(self, joint: int, law: int, parameters: FloatArray) -> None:
        """Add a friction of one of `laws`, with its padded parameters and where it ends."""
        ...

    def add_slipping_spring(self, joint: int, stiffness: float, width: float) -> None:
        """Add a spring [N m/rad] that slips at a width [rad]."""
        ...

    def add_inertia(self, joint: int, inertia: float) -> None:
        """Add reflected inertia [kg m²]."""
        ...

    def add_compliance(self, joint: int, linear: float, cubic: float) -> None:
        """Add compliance between encoder and link [rad/(N m)], [rad/(N m)³]."""
        ...

    def add_torque_offset(self, joint: int, offset: float) -> None:
        """Add an offset to the torque sensor [N m]."""
        ...

    def add_encoder_offset(self, joint: int, offset: float) -> None:
        """Move the zero of the encoder [rad]."""
        ...

    def expect_late(
        self, joint: int, *, stiffness: float = 0.0, damping: float = 0.0, inertia: float = 0.0
    ) -> None:
        """Note what a sampled effect makes stiff [N m/rad], damped [N m s/rad] or heavy [kg m²].

        It acts one cycle late, which the step has to carry.
        """
        ...


class BodyEffect(Effect):
    """An effect on the rigid body itself."""

    @abstractmethod
    def body(self, model: RobotModel) -> RobotModel:
        """Return a rigid body with the effect added."""

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for nothing: a simulated robot is made of `Simulation.body`."""


class ArmEffect(Effect):
    """An effect that adds torque and needs the motion of more than one joint."""

    @abstractmethod
    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return the torques of T samples, (T, n) [N m], and the memory after them."""


@dataclass(frozen=True, kw_only=True)
class JointEffect(Effect):
    """One piece of physics of one joint.

    Args:
        joint: The joint, 1-based.
    """

    joint: int = parameter(JOINT)

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint."""
        return (self.joint,)


@dataclass(frozen=True, kw_only=True)
class TorqueEffect(JointEffect):
    """An effect that adds torque to that of the rigid body."""

    known_by: ClassVar[tuple[str, ...]] = ()  # what its domain has; without, it has none
    domain: Domain | None = None  # that it was learned from

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the torque of T samples, (T,) [N m], and the memory after them."""

    def evaluate(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the same, which beyond its domain goes on as its simplest part does."""
        domain = self.domain
        if domain is None:
            return self.advance(state, motion)
        inside = domain.held(motion)
        values, state = self.advance(state, inside)
        return values + self.goes_on(inside, motion), state

    def goes_on(self, inside: JointMotion, motion: JointMotion) -> FloatArray | float:  # noqa: ARG002
        """Return what is added beyond the domain to the torque at its end, (T,) [N m]."""
        return 0.0

    def stops(self) -> tuple[tuple[float, float], ...]:
        """Return heights [N m] and widths [rad] of stops that remember the beginning as long."""
        return ()


class Friction(TorqueEffect):
    """Torque without memory that vanishes with the velocity and has its sign.

    The simulated robot takes it as a damping, so that it dissipates at any step size.
    """

    is_friction: ClassVar[bool] = True


class MotionEffect(JointEffect):
    """An effect that displaces the link from where the encoder says it is.

    Sample by sample it is quasi-static: velocity and acceleration are the encoder's. Where past
    and future are known, the displacement has its own, within `agility` times the bandwidth.
    """

    needs_inertia: ClassVar[bool] = False

    @property
    def agility(self) -> float:
        """How fast the link moves against its encoder, in bandwidths; 0 of what stays in place."""
        return 0.0

    @property
    def displaces(self) -> bool:
        """Whether it does; a form of it that leaves the link in place adds torque instead."""
        return True

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link of T samples, (T,) [rad], and the memory after them.

        In a form that displaces nothing: the torque, (T,) [N m].
        """


class SensorEffect(JointEffect):
    """An effect of the torque sensor, after all that is torque."""

    @abstractmethod
    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return what this joint's sensor adds, (T,) [N m], and the memory after it."""

    def realise(self, robot: SimulatedPlant) -> None:
        """Add it to the simulated sensor."""
        robot.sense(self)


Realise: TypeAlias = Callable[["FloatArray"], tuple[Effect, ...]]  # of fitted coefficients
Enter: TypeAlias = Callable[[Sequence[Effect], "FloatArray"], tuple[Effect, ...]]


@dataclass(frozen=True)
class DiagnosisContext:
    """Recordings of an arm of n joints beside its simulation, before any fit; K rows, T samples."""

    position: FloatArray  # (K, n) [rad]
    temperature: FloatArray | None  # (T, n) [°C]
    start: float  # [s], of the earliest sample in the time of its recording
    end: float  # [s], of the latest
    longest: float  # [s] of one recording
    gravity: FloatArray  # (3,) [m/s²], as the simulation says
    effects: tuple[Effect, ...]  # that are known already
    inertia: FloatArray  # (n,) [kg m²], usual, of each joint alone

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    @property
    def shows_slow_change(self) -> bool:
        """Whether a recording lasts long enough to tell warming and drift from slow motion."""
        return self.longest >= SLOW_CHANGE


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place; its coefficients are still free.

    It is a few effects at unit size. What they would add to the torque are columns; their
    coefficients turn the same effects into the found ones. So what is compared, what is fitted and
    what is written to `sim.yaml` are one equation.
    """

    effect: str
    joints: tuple[int, ...]  # 0-based; empty for the whole arm
    terms: tuple[Effect, ...]  # of unit size, one column each
    realise: Realise  # coefficients → effects
    positive: bool = False  # whether no coefficient can be negative
    most: float = np.inf  # that a positive coefficient can be
    settings: tuple[float, ...] = ()  # what is not linear in the torque, for a refinement
    family: Callable[..., Hypothesis] | None = field(default=None, compare=False)  # of settings
    bounds: tuple[tuple[float, float], ...] = ()  # of the settings
    sized: bool = False  # whether a setting is its size, of which it is: its coefficient is one
    seldom: bool = False  # whether it competes only where the others leave something unexplained
    law: str = ""  # in words, where the effect follows one of several
    # effects of a simulation and coefficients → its effects, where adding to them is not enough
    enter: Enter | None = field(default=None, compare=False)

    @property
    def is_list(self) -> bool:
        """Whether its coefficients are one list, as of places, whose values are of one size."""
        known = (item for term in self.terms for item in term.parameters())
        return any(item.deviation == "largest" for item in known)

    @classmethod
    def of_one(cls, effect: Effect, name: str, **more: Any) -> Hypothesis:  # noqa: ANN401  # fields
        """Return the hypothesis of one effect that is linear in its parameter `name`.

        Args:
            effect: Of unit size.
            name: Of the parameter.
            more: Other fields of the hypothesis.
        """
        unit = getattr(effect, name)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            return (replace(effect, **{name: float(c[0] * unit)}),)

        joint = getattr(effect, "joint", None)
        joints = () if joint is None else (joint - 1,)
        return cls(effect.name, joints, (effect,), realise, **more)
