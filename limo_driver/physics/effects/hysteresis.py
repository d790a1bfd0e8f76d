"""Presliding hysteresis: friction that depends on the distance since reversals, not on speed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    FARTHEST,
    MOST_SLOPE,
    MOST_STIFFNESS,
    MOST_TORQUE,
    Hypothesis,
    State,
    TorqueEffect,
)
from limo_driver.physics.effects import laws
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from limo_driver.physics.effect import DiagnosisContext, Effect, JointMotion, SimulatedPlant
    from limo_driver.types import FloatArray, Motion


@dataclass(frozen=True)
class Law:
    """One law of hysteresis: how it advances its memory, and its parameters."""

    follow: Callable[..., FloatArray]  # (memory, path, *parameters), see hysteresis_laws
    required: tuple[str, ...]
    optional: dict[str, float] = field(default_factory=dict)  # with their values if not given

    @property
    def parameters(self) -> tuple[str, ...]:
        """All parameters of the law, in the order in which `follow` takes them."""
        return (*self.required, *self.optional)


MAXWELL_SLIP = "maxwell_slip"
_WIDEST = 1.0  # [rad]
STOP_WIDTHS = tuple(np.geomspace(3e-4, 0.25, 9))  # [rad], at which a diagnosis has elements slip
BUILD_UP = (1e-3, 4e-3, 0.016)  # [rad] over which the friction of a law builds up
_LEAST_FRICTION = 1e-6  # [N m]
_FORGETTING = 2.3  # presliding distances, twice of which leave exp(-4.6) of a deflection
LAWS: dict[str, Law] = {
    MAXWELL_SLIP: Law(laws.maxwell_slip, ("stiffness", "width")),
    "lugre": Law(laws.lugre, ("sigma_0", "tau_c"), {"sigma_1": 0.0, "tau_s": 0.0, "v_s": 0.01}),
    "dahl": Law(laws.dahl, ("sigma_0", "tau_c"), {"exponent": 1.0}),
    "bouc_wen": Law(laws.bouc_wen, ("sigma_0", "tau_c"), {"beta_ratio": 0.5, "exponent": 1.0}),
    "preisach": Law(laws.preisach, ("up", "down", "weight")),
}


def _list(unit: str, description: str, lower: float, upper: float):  # noqa: ANN202  # a field
    return parameter(unit, description, lower=lower, upper=upper, default=())


def _value(unit: str, description: str, lower: float, upper: float):  # noqa: ANN202  # a field
    return parameter(unit, description, lower=lower, upper=upper, default=None)


@dataclass(frozen=True, kw_only=True)
class PreslidingHysteresis(TorqueEffect):
    """Friction with memory, by one of several laws; it includes the sliding friction.

    `maxwell_slip`: springs that each slip at their width, tau = Σ stiffness_i z_i,
    z_i ← clip(z_i + Δq, -width_i, width_i). Rate-independent with non-local memory.

    `lugre`: bristles, dz = dq - sigma_0 |dq| z / g(v), g = tau_c + tau_s exp(-(v / v_s)²),
    tau = sigma_0 z + sigma_1 dz/dt; tau_s is the excess over tau_c.

    `dahl`: dtau/dq = sigma_0 (1 - tau sign(dq) / tau_c)^exponent.

    `bouc_wen`: with zeta = tau / tau_c, dtau/dq = sigma_0 (1 - |zeta|^exponent (beta_ratio
    sign(zeta dq) + 1 - beta_ratio)); beta_ratio is beta / (beta + gamma) of the classic form,
    whose A is sigma_0. At least one half, or a closed loop would yield energy.

    `preisach`: relays on the position, tau = Σ weight_i r_i; r_i becomes 1 above up_i and -1 below
    down_i. Relays between their thresholds start on the side that is nearer.

    All others start relaxed at the first position.

    Args:
        law: What remembers.

    Raises:
        ConfigError: The law is unknown; a parameter of it is missing, or one that it does not have
            is given; lists differ in length; a relay goes up below where it goes down.

    Source: Al-Bender, Lampaert and Swevers, "The generalized Maxwell-slip model", IEEE TAC 2005;
    Canudas de Wit, Olsson, Åström and Lischinsky, "A new model for control of systems with
    friction", IEEE TAC 1995; Dahl, "Solid friction damping of mechanical vibrations", AIAA Journal
    1976; Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. 1976; Mayergoyz,
    "Mathematical Models of Hysteresis", 1991.
    """

    name: ClassVar[str] = "presliding_hysteresis"
    sized_by: ClassVar[tuple[str, ...]] = ("stiffness", "tau_c", "weight")
    description: ClassVar[Description] = Description(
        signature="torque rises with the distance since the last reversal",
        shown_by="nested_reversals",
        confusions=(
            Confusion(
                "stribeck_friction",
                "one changes with the speed, the other only with the distance since the reversal",
                "creep",
            ),
        ),
    )
    is_friction: ClassVar[bool] = True
    law: str = parameter("text", of=LAWS, default="maxwell_slip")
    stiffness: tuple[float, ...] = _list(
        "N m/rad", "stiffness of each element", 0.0, MOST_STIFFNESS
    )
    width: tuple[float, ...] = _list("rad", "deflection at which each element slips", 1e-7, _WIDEST)
    sigma_0: float | None = _value("N m/rad", "stiffness at small motion", 1e-3, MOST_STIFFNESS)
    sigma_1: float | None = _value("N m s/rad", "damping of the bristles", 0.0, MOST_SLOPE)
    tau_c: float | None = _value("N m", "sliding friction", 1e-6, MOST_TORQUE)
    tau_s: float | None = _value("N m", "excess of the breakaway torque", 0.0, MOST_TORQUE)
    v_s: float | None = _value("rad/s", "Stribeck velocity", 1e-5, 10.0)
    exponent: float | None = _value("1", "sharpness of the knee", 0.1, 20.0)
    beta_ratio: float | None = _value("1", "beta / (beta + gamma)", 0.5, 10.0)
    up: tuple[float, ...] = _list("rad", "position above which a relay is on", -FARTHEST, FARTHEST)
    down: tuple[float, ...] = _list(
        "rad", "position below which a relay is off", -FARTHEST, FARTHEST
    )
    weight: tuple[float, ...] = _list("N m", "torque of each relay", 0.0, MOST_TORQUE)

    def __post_init__(self) -> None:
        super().__post_init__()
        law = LAWS[self.law]
        given = {
            known.name
            for known in self.parameters()
            if known.name != "law" and getattr(self, known.name) not in {None, ()}
        }
        if missing := [name for name in law.required if name not in given]:
            raise ConfigError(f"{self.place}: law {self.law} lacks {', '.join(missing)}")
        if foreign := sorted(given - set(law.parameters)):
            raise ConfigError(
                f"{self.place}: law {self.law} has no {', '.join(foreign)}; "
                f"it has {', '.join(law.parameters)}"
            )
        for name, value in law.optional.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        self._same_length(
            *(name for name in law.required if isinstance(getattr(self, name), tuple))
        )
        for up, down in zip(self.up, self.down, strict=True):
            if up < down:
                raise ConfigError(
                    f"{self.place}: a relay goes up at {up:g} rad, below its down at {down:g} rad"
                )

    @property
    def initial_stiffness(self) -> float:
        """The steepest slope of torque over position [N m/rad]; 0 for relays, which jump."""
        return float(sum(self.stiffness)) if self.stiffness else self.sigma_0 or 0.0

    def stops(self) -> tuple[tuple[float, float], ...]:
        """Return those of the law.

        Bristles forget exponentially, a hundredth being left after twice such a width; a relay
        once the joint has turned from one threshold to the other.
        """
        if self.width:
            pairs = zip(self.stiffness, self.width, strict=True)
            return tuple((stiffness * width, width) for stiffness, width in pairs)
        if self.sigma_0 and self.tau_c:
            return ((self.tau_c, _FORGETTING * self.tau_c / self.sigma_0),)
        relays = zip(self.weight, self.up, self.down, strict=True)
        return tuple((w, 0.5 * (up - down)) for w, up, down in relays if w > 0 and up > down)

    def initial_state(self) -> State:
        """Return relaxed memory and no previous position."""
        size = max(len(self.width), len(self.up), 1)
        return np.append(np.zeros(size), np.nan)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Follow T positions; the state is (deflections, torque or relays …, last position)."""
        law, after = LAWS[self.law], state.copy()
        path = laws.path_of(
            after, np.ascontiguousarray(motion.position), np.ascontiguousarray(motion.velocity)
        )
        values = [getattr(self, name) for name in law.parameters]
        given = [np.array(v) if isinstance(v, tuple) else float(v) for v in values]
        return law.follow(after, path, *given), after

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for slipping springs; other laws are sampled, as stiff as they are."""
        if self.law == MAXWELL_SLIP:
            for stiffness, width in zip(self.stiffness, self.width, strict=True):
                robot.add_slipping_spring(self.joint, stiffness, width)
            return
        robot.sample(self)
        robot.expect_late(self.joint, stiffness=self.initial_stiffness, damping=self.sigma_1 or 0.0)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield several laws."""
        yield cls.maxwell_slip(joint, STOP_WIDTHS)
        for width in BUILD_UP:
            yield cls.lugre(joint, width, 0.15, 0.01)
            yield cls.bouc_wen(joint, width, 0.7, 1.5)

    @classmethod
    def further_laws(cls, found: Hypothesis) -> Iterator[Hypothesis]:
        """Yield Dahl's law."""
        width = found.settings[0] if found.settings else BUILD_UP[1]
        yield cls.dahl(found.joints[0] + 1, width, 1.5)

    @classmethod
    def stop(cls, joint: int, width: float) -> PreslidingHysteresis:
        """Return one spring that slips at a width [rad], and then carries 1 N m."""
        return cls(joint=joint, law=MAXWELL_SLIP, stiffness=(1.0 / width,), width=(width,))

    @classmethod
    def maxwell_slip(cls, joint: int, widths: tuple[float, ...]) -> Hypothesis:
        """Return parallel springs that slip at given widths [rad]."""
        terms = tuple(cls.stop(joint, width) for width in widths)

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            used = [i for i in range(len(widths)) if c[i] > 0]
            if not used:
                return ()
            stiffness = tuple(float(c[i] / widths[i]) for i in used)
            width = tuple(widths[i] for i in used)
            return (cls(joint=joint, law=MAXWELL_SLIP, stiffness=stiffness, width=width),)

        return Hypothesis(cls.name, (joint - 1,), terms, realise, positive=True, law="Maxwell slip")

    @classmethod
    def slips(cls, joint: int, *widths: float) -> Hypothesis:
        """Return parallel springs that slip at widths [rad] of their own, for a refinement."""
        return replace(
            cls.maxwell_slip(joint, widths),
            settings=widths,
            family=partial(cls.slips, joint),
            bounds=tuple(
                (max(0.4 * width, STOP_WIDTHS[0]), min(2.5 * width, _WIDEST)) for width in widths
            ),
        )

    @classmethod
    def lugre(cls, joint: int, width: float, rise: float, v_s: float) -> Hypothesis:
        """Return bristles that slide after a width [rad]; at rest they hold a part `rise` more."""
        unit = cls(joint=joint, law="lugre", sigma_0=1.0 / width, tau_c=1.0, tau_s=rise, v_s=v_s)
        return unit._growing(
            ("sigma_0", "tau_c", "tau_s"),
            "LuGre",
            partial(cls.lugre, joint),
            (width, rise, v_s),
            ((1e-4, 0.1), (1e-3, 1.0), (2e-3, 0.1)),
        )

    @classmethod
    def bouc_wen(cls, joint: int, width: float, beta_ratio: float, exponent: float) -> Hypothesis:
        """Return Bouc and Wen's law, which slides after about a width [rad]."""
        unit = cls(
            joint=joint,
            law="bouc_wen",
            sigma_0=1.0 / width,
            tau_c=1.0,
            beta_ratio=beta_ratio,
            exponent=exponent,
        )
        return unit._growing(
            ("sigma_0", "tau_c"),
            "Bouc-Wen",
            partial(cls.bouc_wen, joint),
            (width, beta_ratio, exponent),
            ((1e-4, 0.1), (0.5, 1.0), (0.5, 3.0)),
        )

    @classmethod
    def dahl(cls, joint: int, width: float, exponent: float) -> Hypothesis:
        """Return Dahl's law, which slides after about a width [rad].

        With an exponent of 1 it is LuGre without excess at rest, and Bouc and Wen's with a ratio
        of 1.
        """
        unit = cls(joint=joint, law="dahl", sigma_0=1.0 / width, tau_c=1.0, exponent=exponent)
        return unit._growing(
            ("sigma_0", "tau_c"),
            "Dahl",
            partial(cls.dahl, joint),
            (width, exponent),
            ((1e-4, 0.1), (0.3, 4.0)),
        )

    def _growing(
        self,
        names: tuple[str, ...],
        law: str,
        family: Callable[..., Hypothesis],
        settings: tuple[float, ...],
        bounds: tuple[tuple[float, float], ...],
    ) -> Hypothesis:
        """Return the hypothesis of a law of unit size, whose torques grow with one coefficient."""

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            size = max(float(c[0]), _LEAST_FRICTION)
            return (replace(self, **{name: size * getattr(self, name) for name in names}),)

        return Hypothesis(
            self.name,
            (self.joint - 1,),
            (self,),
            realise,
            positive=True,
            settings=settings,
            family=family,
            law=law,
            bounds=bounds,
        )


class MaxwellSlips:
    """Several effects of the law `maxwell_slip`, advanced in one compiled call.

    Args:
        effects: The effects.
    """

    def __init__(self, effects: Sequence[PreslidingHysteresis]) -> None:
        self._joint = np.array([effect.joint - 1 for effect in effects], dtype=np.int64)
        sizes = np.array([len(effect.width) for effect in effects], dtype=np.int64)
        self._ends = np.cumsum(sizes)
        self._stiffness = np.array([k for effect in effects for k in effect.stiffness])
        self._width = np.array([w for effect in effects for w in effect.width])
        bounds = [0, *np.cumsum(sizes + 1).tolist()]
        self._memories = tuple(slice(a, b) for a, b in pairwise(bounds))

    def add(self, torque: FloatArray, motion: Motion, states: Sequence[State]) -> list[State]:
        """Add their torque to `torque` (T, n) [N m], in place; return their memories after."""
        memory = np.concatenate(states)
        laws.add_maxwell_slips(
            torque,
            np.ascontiguousarray(motion.position),
            np.ascontiguousarray(motion.velocity),
            memory,
            self._joint,
            self._ends,
            self._stiffness,
            self._width,
        )
        return [memory[own] for own in self._memories]
