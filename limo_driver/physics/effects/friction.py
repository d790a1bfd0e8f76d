"""Friction without memory: functions of the joint velocity."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.domain import Domain
from limo_driver.physics.effect import MOST_SLOPE, MOST_TORQUE, Friction, Hypothesis, State
from limo_driver.physics.effects import laws
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.physics.effect import DiagnosisContext, Effect, JointMotion, SimulatedPlant
    from limo_driver.types import FloatArray, IntArray

SIGN_WIDTH = 0.002  # [rad/s], width of the smoothed sign where an effect has no own
CREEP_SPEEDS = (0.006, 0.015, 0.04, 0.1)  # [rad/s], of the Stribeck effect
PLACES = 14  # of friction over a joint's range
_ALIKE = 3.0  # places over which friction is alike, since a bearing or a seal is wider than one


def _bumps() -> FloatArray:
    """Return heights at all places, (PLACES, PLACES), that make neighbours alike if drawn equally.

    Their product with itself is the covariance exp(-distance / _ALIKE). A place that the motion
    hardly passes then follows its neighbours; alone, it would be whatever suits a few rows.
    """
    place = np.arange(PLACES)
    values, vectors = np.linalg.eigh(np.exp(-np.abs(place[:, None] - place) / _ALIKE))
    return vectors * np.sqrt(values) @ vectors.T


BUMPS = _bumps()


def sign_width():  # noqa: ANN201  # a dataclass field
    """Declare the parameter v_eps."""
    return parameter(
        "rad/s",
        "width of the smoothed sign",
        lower=1e-6,
        upper=1.0,
        default=SIGN_WIDTH,
        smooths=True,
    )


def sign_width_at(joint: int, recorded: DiagnosisContext) -> float:
    """Return the width of the smoothed sign at a joint of what is known of an arm [rad/s].

    All dry friction of a joint shares it: two widths at one joint look like a Stribeck effect.
    """
    for effect in recorded.effects:
        if isinstance(effect, (CoulombFriction, AsymmetricFriction)) and effect.joint == joint:
            return effect.v_eps
    return SIGN_WIDTH


def dry_at(joint: int, recorded: DiagnosisContext) -> float:
    """Return the dry friction at a joint of what is known of an arm, either way [N m].

    Not what presses on it or where it is adds.
    """
    return sum(
        effect.tau_c
        if isinstance(effect, CoulombFriction)
        else min(effect.tau_plus, effect.tau_minus)
        for effect in recorded.effects
        if isinstance(effect, (CoulombFriction, AsymmetricFriction)) and effect.joint == joint
    )


@dataclass(frozen=True, kw_only=True)
class VelocityFriction(Friction):
    """Friction that is a function of velocity alone, by one of the compiled laws."""

    friction_law: ClassVar[int]  # see friction_laws

    @property
    @abstractmethod
    def coefficients(self) -> tuple[float, ...]:
        """The parameters of the law, in its order."""

    @property
    def row(self) -> FloatArray:
        """The same for compiled code, (friction_laws.PARAMETERS,), zeros behind."""
        row = np.zeros(laws.PARAMETERS)
        row[: len(self.coefficients)] = self.coefficients
        return row

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Return the friction torque [N m] at `velocity` [rad/s]; same shape."""
        torque = laws.friction_torques(self.friction_law, self.row, np.ravel(velocity))
        return torque.reshape(velocity.shape)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Evaluate `torque` over T samples."""
        return self.torque(motion.velocity), state

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes beyond the domain, moving positive and negative [N m s/rad]."""
        return (0.0, 0.0)

    @property
    def is_law(self) -> bool:
        """Whether it is its compiled law, and goes on otherwise nowhere."""
        goes_on = self.friction_law == laws.VISCOUS  # by its own slope, if no other is stated
        return self.domain is None or (goes_on and self.domain.slope is None)

    def goes_on(self, inside: JointMotion, motion: JointMotion) -> FloatArray:
        """Return what a slope adds: the one stated before, or its own."""
        beyond, (_, up, down) = motion.velocity - inside.velocity, self.end
        return np.where(beyond > 0, up, down) * beyond

    @property
    def end(self) -> tuple[float, float, float]:
        """Speed up to which it is its law [rad/s], and slopes beyond, as those of `slopes`."""
        domain = self.domain or Domain()
        up, down = self.slopes if domain.slope is None else (domain.slope,) * 2
        return np.inf if domain.speed is None else domain.speed, up, down

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for the compiled law."""
        robot.add_friction(self.joint, self.friction_law, np.append(self.row, self.end))


class Frictions(NamedTuple):
    """F frictions as tables, for compiled code."""

    joint: IntArray  # (F,), 0-based
    law: IntArray  # (F,)
    parameters: FloatArray  # (F, friction_laws.PARAMETERS)

    @classmethod
    def of(cls, effects: Sequence[VelocityFriction]) -> Frictions:
        """Return the tables of effects, in their order."""
        return cls(
            np.array([effect.joint - 1 for effect in effects], dtype=np.int64),
            np.array([effect.friction_law for effect in effects], dtype=np.int64),
            np.array([effect.row for effect in effects]).reshape(-1, laws.PARAMETERS),
        )

    def add(self, torque: FloatArray, velocity: FloatArray) -> None:
        """Add their torque at `velocity` (T, n) [rad/s] to `torque` (T, n) [N m], in place."""
        laws.add_frictions(torque, np.ascontiguousarray(velocity), *self)


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(VelocityFriction):
    """Dry friction, tau = tau_c tanh(v / v_eps).

    Args:
        tau_c: Friction torque while sliding.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "coulomb_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("tau_c",)
    description: ClassVar[Description] = Description(
        signature="the error is a torque of constant size against the direction of motion",
        shown_by="creep",
        confusions=(
            Confusion(
                "load_dependent_friction",
                "one height of the loop in all poses against one that follows the load",
                "wide_sweep",
            ),
            Confusion(
                "position_dependent_friction",
                "one height of the loop over the whole range against one that varies",
                "wide_sweep",
            ),
            Confusion(
                "presliding_hysteresis",
                "a loop inside a loop shrinks with memory, and keeps its height without",
                "nested_reversals",
            ),
            Confusion(
                "stribeck_friction",
                "the excess falls off with speed against one height at all speeds",
                "creep",
            ),
            Confusion(
                "temperature_dependent_friction",
                "the loop shrinks as the joint warms up, or does not",
                "revisit",
            ),
        ),
    )
    friction_law: ClassVar[int] = laws.COULOMB
    tau_c: float = parameter("N m", lower=0.0, upper=MOST_TORQUE, adds=True)
    v_eps: float = sign_width()

    @property
    def coefficients(self) -> tuple[float, ...]:
        """tau_c and v_eps."""
        return self.tau_c, self.v_eps

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it with the sign of the joint."""
        yield cls.of_unit_size(joint, sign_width_at(joint, recorded))

    @classmethod
    def of_unit_size(cls, joint: int, v_eps: float) -> Hypothesis:
        """Return Coulomb friction; how sharp its sign is has to be found, too."""
        return Hypothesis.of_one(
            cls(joint=joint, tau_c=1.0, v_eps=v_eps),
            "tau_c",
            positive=True,
            settings=(v_eps,),
            family=partial(cls.of_unit_size, joint),
            bounds=((2e-4, 0.02),),
        )


@dataclass(frozen=True, kw_only=True)
class AsymmetricFriction(VelocityFriction):
    """Dry friction that differs by direction.

    tau = tau_plus tanh(v / v_eps) for v > 0, tau_minus tanh(v / v_eps) for v < 0.

    Args:
        tau_plus: Friction moving positive.
        tau_minus: Friction moving negative.

    Source: Swevers, Verdonck and De Schutter, "Dynamic model identification for industrial
    robots", IEEE Control Systems Magazine 27(5), 2007.
    """

    name: ClassVar[str] = "asymmetric_friction"
    description: ClassVar[Description] = Description(
        signature="the error has another constant size in each direction of motion",
        shown_by="creep",
        confusions=(
            Confusion(
                "coulomb_friction",
                "two plateaus of different height against one height both ways",
                "creep",
            ),
            Confusion(
                "torque_offset",
                "friction of unlike height both ways is even friction and an offset, moving or "
                "held by it; read the sensor of the unloaded joint",
                identical=True,
            ),
        ),
        part_of="coulomb_friction",
    )
    friction_law: ClassVar[int] = laws.ASYMMETRIC
    tau_plus: float = parameter("N m", lower=0.0, upper=MOST_TORQUE)
    tau_minus: float = parameter("N m", lower=0.0, upper=MOST_TORQUE)
    v_eps: float = sign_width()

    @property
    def coefficients(self) -> tuple[float, ...]:
        """tau_plus, tau_minus and v_eps."""
        return self.tau_plus, self.tau_minus, self.v_eps

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it with the sign of the joint.

        Alone, it cannot push; entered, it also takes from the Coulomb friction of the joint.
        """
        eps = sign_width_at(joint, recorded)
        up = cls(joint=joint, tau_plus=1.0, tau_minus=0.0, v_eps=eps)
        down = cls(joint=joint, tau_plus=0.0, tau_minus=1.0, v_eps=eps)
        yield Hypothesis(
            up.name,
            (joint - 1,),
            (up, down),
            lambda c: (
                replace(up, tau_plus=max(0.0, float(c[0])), tau_minus=max(0.0, float(c[1]))),
            ),
            enter=lambda effects, c: up.skewing(effects, float(c[0]), float(c[1])),
        )

    def skewing(self, effects: Sequence[Effect], plus: float, minus: float) -> tuple[Effect, ...]:
        """Return effects and friction that differs with the direction by so much [N m].

        Coulomb friction of the joint becomes part of it.
        """
        for place, old in enumerate(effects):
            if isinstance(old, CoulombFriction) and old.joint == self.joint:
                skewed = replace(
                    self,
                    tau_plus=max(0.0, old.tau_c + plus),
                    tau_minus=max(0.0, old.tau_c + minus),
                    v_eps=old.v_eps,
                )
                return (*effects[:place], skewed, *effects[place + 1 :])
        return (*effects, replace(self, tau_plus=max(0.0, plus), tau_minus=max(0.0, minus)))


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(VelocityFriction):
    """Friction in proportion to velocity, tau = f_v v, or with a slope for each direction.

    Args:
        f_v: Slope.
        f_v_plus: Slope moving positive.
        f_v_minus: Slope moving negative.

    Raises:
        ConfigError: Neither f_v nor both of f_v_plus and f_v_minus are given, or all of them.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "viscous_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("f_v", "f_v_plus", "f_v_minus")
    description: ClassVar[Description] = Description(
        signature="torque grows in proportion to speed", shown_by="speed_ladder"
    )
    friction_law: ClassVar[int] = laws.VISCOUS
    known_by: ClassVar[tuple[str, ...]] = ("speed",)
    f_v: float | None = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=None, adds=True)
    f_v_plus: float | None = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=None)
    f_v_minus: float | None = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        sides = [value for value in (self.f_v_plus, self.f_v_minus) if value is not None]
        if self.f_v is None and len(sides) < 2:  # noqa: PLR2004  # both directions
            raise ConfigError(f"{self.place}: lacks f_v, or f_v_plus and f_v_minus")
        if self.f_v is not None and sides:
            raise ConfigError(f"{self.place}: has f_v and a slope by direction; give one or other")

    @property
    def slopes(self) -> tuple[float, float]:
        """Its own."""
        return _given(self.f_v, self.f_v_plus), _given(self.f_v, self.f_v_minus)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Slope moving positive and moving negative [N m s/rad]."""
        return self.slopes

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield one slope both ways."""
        yield cls.of_unit_size(joint)

    @classmethod
    def of_unit_size(cls, joint: int) -> Hypothesis:
        """Return one slope both ways."""
        return Hypothesis.of_one(cls(joint=joint, f_v=1.0), "f_v", positive=True)


def _given(both: float | None, one: float | None) -> float:
    return both if both is not None else one or 0.0


@dataclass(frozen=True, kw_only=True)
class QuadraticDrag(VelocityFriction):
    """Drag that grows with the square of velocity, tau = coefficient v |v|.

    Args:
        coefficient: Coefficient.

    Source: Bona and Indri, "Friction compensation in robotics: an overview", CDC 2005.
    """

    name: ClassVar[str] = "quadratic_drag"
    sized_by: ClassVar[tuple[str, ...]] = ("coefficient",)
    description: ClassVar[Description] = Description(
        signature="torque curves upwards with speed",
        shown_by="speed_ladder",
        confusions=(
            Confusion(
                "viscous_friction", "a straight line over speed against a curve", "speed_ladder"
            ),
        ),
    )
    friction_law: ClassVar[int] = laws.DRAG
    known_by: ClassVar[tuple[str, ...]] = ("speed",)
    coefficient: float = parameter("N m s^2/rad^2", lower=0.0, upper=MOST_SLOPE, adds=True)

    @property
    def slopes(self) -> tuple[float, float]:
        """Those at the end of its domain."""
        fastest = 0.0 if self.domain is None else self.domain.speed or 0.0
        slope = 2.0 * self.coefficient * fastest
        return slope, slope

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The coefficient alone."""
        return (self.coefficient,)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield it."""
        yield Hypothesis.of_one(cls(joint=joint, coefficient=1.0), "coefficient", positive=True)


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(VelocityFriction):
    """Excess of dry friction at creep, tau = tau_s exp(-|v / v_s|^delta) tanh(v / v_eps).

    Another width of the sign than Coulomb friction's would look like presliding.

    Args:
        tau_s: Excess over Coulomb at rest.
        v_s: Stribeck velocity.
        delta: Shape exponent.

    Source: Armstrong-Hélouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and
    compensation methods for the control of machines with friction", Automatica 1994, eq. (3).
    """

    name: ClassVar[str] = "stribeck_friction"
    sized_by: ClassVar[tuple[str, ...]] = ("tau_s",)
    description: ClassVar[Description] = Description(
        signature="friction falls as speed grows from creep, at any distance travelled",
        shown_by="creep",
        confusions=(
            Confusion(
                "viscous_friction",
                "one falls off with speed, the other grows with it",
                "speed_ladder",
            ),
        ),
    )
    friction_law: ClassVar[int] = laws.STRIBECK
    tau_s: float = parameter("N m", lower=0.0, upper=MOST_TORQUE)
    v_s: float = parameter("rad/s", lower=1e-5, upper=10.0)
    delta: float = parameter("1", lower=0.5, upper=4.0, default=2.0)
    v_eps: float = sign_width()

    @property
    def coefficients(self) -> tuple[float, ...]:
        """tau_s, v_s, delta and v_eps."""
        return self.tau_s, self.v_s, self.delta, self.v_eps

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it at several speeds, sharp and soft."""
        eps = sign_width_at(joint, recorded)
        for v_s in CREEP_SPEEDS:
            for delta in (1.0, 2.0):
                yield cls.of_unit_size(joint, eps, v_s, delta)

    @classmethod
    def of_unit_size(cls, joint: int, v_eps: float, v_s: float, delta: float) -> Hypothesis:
        """Return the Stribeck effect at one joint."""
        return Hypothesis.of_one(
            cls(joint=joint, tau_s=1.0, v_s=v_s, delta=delta, v_eps=v_eps),
            "tau_s",
            positive=True,
            settings=(v_s, delta),
            family=partial(cls.of_unit_size, joint, v_eps),
            bounds=((3e-3, 0.6), (0.5, 4.0)),
        )
