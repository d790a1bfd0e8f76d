"""Effects of the arm as a whole: joints that are coupled, and contact with what is around it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    MOST_INERTIA,
    MOST_SLOPE,
    MOST_STIFFNESS,
    MOST_TORQUE,
    ArmEffect,
    ArmMotion,
    DiagnosisContext,
    Effect,
    Hypothesis,
    JointMotion,
    SimulatedPlant,
    State,
    TorqueEffect,
)
from limo_driver.physics.effects.friction import sign_width
from limo_driver.physics.effects.sensing import TorqueOffset
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.parameters import JOINT, parameter
from limo_driver.types import FloatArray

_SOFTEST = 1e-3  # [N m/rad]
_REACH = 1.5  # [rad], how far a spring may rest from where it is looked for


@dataclass(frozen=True, kw_only=True)
class JointCoupling(ArmEffect):
    """Torque on one joint from a shaft that turns with w = v_joint + ratio v_other.

    tau_joint = f_v w + tau_c tanh(w / v_eps) + inertia dw/dt

    What the shaft does to the other joint is an entry of its own, with the joints exchanged.

    Args:
        joint: The joint that feels the torque.
        other: The other joint.
        f_v: Viscous friction.
        tau_c: Coulomb friction.
        inertia: Inertia.
        ratio: 1 or -1.

    Raises:
        ConfigError: The other joint is the joint itself, or the ratio is neither 1 nor -1.

    Source: Gautier, Janot and Vandanjon, "A new closed-loop output error method for parameter
    identification of robot dynamics", IEEE TCST 21(2), 2013 (a coupled wrist).
    """

    name: ClassVar[str] = "joint_coupling"
    sized_by: ClassVar[tuple[str, ...]] = ("f_v", "tau_c", "inertia")
    description: ClassVar[Description] = Description(
        signature="torque goes with the combined motion of two joints",
        shown_by="apart",
        confusions=(
            Confusion(
                "torque_crosstalk",
                "coupling follows the other joint's speed, crosstalk its torque",
                "apart",
            ),
        ),
    )
    joint: int = parameter(JOINT)
    other: int = parameter(JOINT, lower=1, upper=64)
    f_v: float = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=0.0)
    tau_c: float = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=0.0)
    inertia: float = parameter("kg m^2", lower=0.0, upper=MOST_INERTIA, default=0.0)
    ratio: float = parameter("1", lower=-1.0, upper=1.0, default=1.0, chosen=True)
    v_eps: float = sign_width()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.other == self.joint:
            raise self._refused("other", "another joint")
        if abs(self.ratio) != 1.0:
            raise self._refused("ratio", "1 or -1")

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint that feels the torque, then the other."""
        return self.joint, self.other

    def friction(self, w: FloatArray) -> FloatArray:
        """Return the friction of the shaft [N m] at its velocity w [rad/s]."""
        return self.f_v * w + self.tau_c * np.tanh(w / self.v_eps)

    def shaft(self, rate: FloatArray) -> FloatArray:
        """Return what a rate (T, n) of the joints is at the shaft, (T,)."""
        return rate[:, self.joint - 1] + self.ratio * rate[:, self.other - 1]

    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return friction and inertia of the shaft on the joint [N m], (T, n)."""
        torque = np.zeros_like(motion.load)
        w, rate = self.shaft(motion.motion.velocity), self.shaft(motion.motion.acceleration)
        torque[:, self.joint - 1] = self.friction(w) + self.inertia * rate
        return torque, state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for it sampled, as heavy as it is."""
        robot.sample(self)
        robot.expect_late(self.joint, inertia=self.inertia)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it with neighbours, and with every other joint, about which a wrist turns too."""
        for other in (joint - 2, joint - 1, joint + 1, joint + 2):
            for ratio in (1, -1):
                if 1 <= other <= recorded.n:
                    yield cls.between(joint, other, ratio)

    @classmethod
    def between(cls, joint: int, other: int, ratio: int) -> Hypothesis:
        """Return what one joint feels of another's motion."""
        base = cls(joint=joint, other=other, f_v=0.0, tau_c=0.0, inertia=0.0, ratio=ratio)
        terms = (replace(base, f_v=1.0), replace(base, tau_c=1.0), replace(base, inertia=1.0))
        return Hypothesis(
            base.name,
            (joint - 1, other - 1),
            terms,
            lambda c: (replace(base, f_v=float(c[0]), tau_c=float(c[1]), inertia=float(c[2])),),
            positive=True,
        )


@dataclass(frozen=True, kw_only=True)
class SpringLoad(TorqueEffect):
    """A cable, hose or counterbalance, tau = stiffness (q - rest) + cubic (q - rest)³.

    Args:
        stiffness: Stiffness.
        rest: Position without pull.
        cubic: Stiffening.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 9.
    """

    name: ClassVar[str] = "spring_load"
    sized_by: ClassVar[tuple[str, ...]] = ("stiffness",)  # stiffening alone pulls nowhere near rest
    description: ClassVar[Description] = Description(
        signature="the error depends on position alone, not on load",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "link_inertia",
                "gravity varies as the sine of the pose and with it, a spring with its joint",
                "wide_sweep",
            ),
            Confusion(
                "torque_offset",
                "a spring's torque grows with the position, an offset does not",
                "wide_sweep",
            ),
        ),
    )
    stiffness: float = parameter("N m/rad", lower=-MOST_STIFFNESS, upper=MOST_STIFFNESS)
    rest: float = parameter("rad", lower=-1e4, upper=1e4, deviation=1.0)
    cubic: float = parameter("N m/rad^3", lower=-MOST_STIFFNESS, upper=MOST_STIFFNESS, default=0.0)

    known_by: ClassVar[tuple[str, ...]] = ("position",)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return stiffness (q - rest) + cubic (q - rest)³ [N m], (T,)."""
        away = motion.position - self.rest
        return self.stiffness * away + self.cubic * away**3, state

    def goes_on(self, inside: JointMotion, motion: JointMotion) -> FloatArray:
        """Return what a linear spring adds: that this one stiffens was seen in the domain alone."""
        return self.stiffness * (motion.position - inside.position)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield a linear spring, and cubic ones that rest in several places."""
        position = recorded.position[:, joint - 1]
        span = float(position.min()), float(position.max())
        yield cls.linear(joint)
        low, high = np.quantile(position, (0.1, 0.9))
        for rest in np.linspace(low, high, 3):
            yield cls.stiffening(joint, span, float(rest))

    @classmethod
    def linear(cls, joint: int) -> Hypothesis:
        """Return a linear spring; where it rests follows from its pull at zero."""
        linear = cls(joint=joint, stiffness=1.0, rest=0.0)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            stiffness = float(c[0]) if abs(c[0]) > _SOFTEST else _SOFTEST
            return (replace(linear, stiffness=stiffness, rest=-float(c[1]) / stiffness),)

        terms = (linear, TorqueOffset(joint=joint, offset=1.0))
        return Hypothesis(cls.name, (joint - 1,), terms, realise)

    @classmethod
    def stiffening(cls, joint: int, span: tuple[float, float], rest: float) -> Hypothesis:
        """Return a spring that stiffens or softens, and rests at a position.

        One that would pull less, the further it is stretched, stands for something else, and runs
        away where the joint has not been.

        Args:
            joint: Where it acts, from 1.
            span: Least and largest position [rad] that the joint was at.
            rest: Position without pull [rad].
        """
        linear = cls(joint=joint, stiffness=1.0, rest=rest)
        furthest = max(abs(end - rest) for end in span)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            stiffness, cubic = float(c[0]), float(c[1])
            if stiffness * (stiffness + 3.0 * cubic * furthest**2) < 0.0:
                raise ConfigError(
                    f"spring of {stiffness:.3g} N m/rad and {cubic:.3g} N m/rad³ at joint {joint}: "
                    f"its stiffness changes sign within {furthest:.3g} rad; expected one sign"
                )
            return (replace(linear, stiffness=stiffness, cubic=cubic),)

        return Hypothesis(
            cls.name,
            (joint - 1,),
            (linear, replace(linear, stiffness=0.0, cubic=1.0)),
            realise,
            settings=(rest,),
            family=partial(cls.stiffening, joint, span),
            bounds=((rest - _REACH, rest + _REACH),),
        )


@dataclass(frozen=True, kw_only=True)
class ExternalContact(ArmEffect):
    """A wrench on the flange during windows of time, tau = -J(q)ᵀ wrench.

    The wrench is what the environment exerts on the arm at the origin of the flange, force then
    torque, in the axes of the base, constant in each window from its start to before its end.
    Windows that overlap add up.

    Args:
        windows: Start and end of each contact.
        wrench: Force and torque of each contact.

    Raises:
        ConfigError: A window ends before it starts, or has no wrench.

    Source: Haddadin, De Luca and Albu-Schäffer, "Robot collisions: a survey on detection,
    isolation, and identification", IEEE T-RO 33(6), 2017.
    """

    name: ClassVar[str] = "external_contact"
    description: ClassVar[Description] = Description(
        signature="short pushes act on several joints as one force at the flange"
    )
    windows: tuple[tuple[float, float], ...] = parameter(
        "s", lower=-1e12, upper=1e12, columns=2, chosen=True
    )
    wrench: tuple[tuple[float, float, float, float, float, float], ...] = parameter(
        "N, N m", lower=-1e5, upper=1e5, columns=6, chosen=True
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

    def from_time(self, start: float, recording: Recording) -> Effect:  # noqa: ARG002
        """Return the contact in a time that begins at `start` [s]."""
        return replace(self, windows=tuple((a - start, b - start) for a, b in self.windows))
