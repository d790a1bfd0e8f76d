"""Play between drive and link: the link falls across it, or a drag is not felt within it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import MOST_SLOPE, MOST_TORQUE, Hypothesis, MotionEffect, State
from limo_driver.physics.effects.friction import SIGN_WIDTH, dry_at, sign_width_at
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics.effect import DiagnosisContext, Effect, JointMotion, SimulatedPlant
    from limo_driver.types import FloatArray

_WIDEST = 0.2  # [rad]
GAPS = (2e-4, 6e-4, 2e-3, 6e-3)  # [rad], of a play that is looked for
DAMPED_GAPS = (*GAPS, 2e-2)  # [rad], of one whose fall grease slows
DAMPINGS, DAMPED = (3.0, 100.0), (0.3, 1000.0)  # [N m s/rad], of a fall that grease slows
DRAGGED_GAPS = (1e-4, 2.5e-4, 6e-4, 1.5e-3, 4e-3, 0.01, 0.025)  # [rad], of one with a drag
WOUND = "that of a drag that winds up what gives way, at either end of the gap"
FREE = "that of a link that falls across the gap"
SLOWED = "that of a link whose fall across the gap is damped"
AT_ONCE = "that of a drag that is not felt within the gap"
_PARTS, _PART = (0.05, 1.0), 0.4  # of the gap, that winds up; more would be presliding
MOST_DRAG = 1.5  # of the dry friction that is known, to its tolerance: a drag is a part of that
_LIGHT = 1e-9  # [kg m²]


@dataclass(frozen=True, kw_only=True)
class Backlash(MotionEffect):
    """Play between drive and link, q_link = q - x with |x| ≤ gap / 2.

    The load presses the teeth on one flank. When it changes sign, the link floats across the gap,
    inertia ddx = tau - damping dx with tau the nominal rigid-body torque, and no more than the
    damping of what fills the gap, as grease, passes until it meets the other flank, where it
    stays: the impact is without rebound. A link of unknown inertia crosses at once.

    With `drag`, the drive beyond the gap stays where its own friction holds it, and is taken along
    at a flank: x ← clip(x + Δq, -gap/2, gap/2). The link is where the encoder says; what is not
    felt while |x| < gap/2, that is from a reversal to the end of the gap, is a part of the joint's
    friction: tau = -drag tanh(v / v_eps). It comes back all at once, or, where teeth or bushings
    give way, in proportion to the distance beyond the flank, and goes so before the gap begins:
    x ← clip(x + Δq, -gap/2 - width, gap/2 + width), tau = drag (dz(x)/width - tanh(v / v_eps)) with
    dz(x) what of x is beyond ±gap/2.

    Args:
        gap: Whole play.
        damping: Of the fall across the gap.
        drag: Friction beyond the gap, not felt within it.
        width: Over which the drag comes up at a flank: drag over the stiffness of what gives way.
        v_eps: Width of the smoothed sign of the drag.

    Raises:
        ConfigError: A width is given, and no drag that has one; or a damping, and no fall.

    Source: Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica
    38(10), 2002: its friction-driven and inertia-driven hysteresis.
    """

    name: ClassVar[str] = "backlash"
    sized_by: ClassVar[tuple[str, ...]] = ("gap",)
    description: ClassVar[Description] = Description(
        signature=(
            "the link jumps where the load changes sign, or friction is gone for a distance after "
            "each reversal and then back at once"
        ),
        shown_by="load_reversal",
        confusions=(
            Confusion(
                "encoder_offset",
                "play jumps where the load changes sign, an offset does not",
                "load_reversal",
            ),
            Confusion(
                "joint_elasticity",
                "play jumps where the load changes sign, a spring winds up with the load",
                "load_reversal",
            ),
            Confusion(
                "presliding_hysteresis",
                "in play no drag is felt until all of it is, presliding builds up from the start",
                "nested_reversals",
            ),
        ),
    )
    needs_inertia: ClassVar[bool] = True
    gap: float = parameter("rad", lower=0.0, upper=_WIDEST, adds=True)
    damping: float | None = parameter("N m s/rad", lower=0.0, upper=MOST_SLOPE, default=None)
    drag: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    width: float | None = parameter("rad", lower=1e-9, upper=_WIDEST, default=None)
    v_eps: float | None = parameter(
        "rad/s",
        lower=1e-6,
        upper=1.0,
        default=None,
        smooths=True,
        chosen=True,  # that of the joint's friction, of which it is a part
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("v_eps", "width") if self.drag is None else ():
            if getattr(self, name) is not None:
                raise ConfigError(f"{self.place}: has a {name}, and no drag, which has it")
        if self.drag is not None and self.damping is not None:
            raise ConfigError(f"{self.place}: has a drag, and a damping of a fall, which has none")
        if self.drag is not None and self.v_eps is None:
            object.__setattr__(self, "v_eps", SIGN_WIDTH)

    @property
    def agility(self) -> float:
        """That of an impact, which is sharper than the motion."""
        return 4.0

    @property
    def displaces(self) -> bool:
        """Whether the link moves across the gap; else the drive lets go in it."""
        return self.drag is None

    def initial_state(self) -> State:
        """Return a link or drive in the middle, its speed, and no previous time or position."""
        return np.array([0.0, 0.0, np.nan])

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link position [rad], or with `drag` the torque [N m]; (T,)."""
        after, flank = state.copy(), 0.5 * self.gap
        if self.drag is None:
            inertia = (
                np.full_like(motion.load, _LIGHT) if motion.inertia is None else motion.inertia
            )
            ahead = np.ascontiguousarray(motion.load / inertia)
            slowed = np.ascontiguousarray((self.damping or 0.0) / inertia)
            return _float(after, motion.time, ahead, slowed, flank), after
        position = np.ascontiguousarray(motion.position)
        sign = np.tanh(motion.velocity / (self.v_eps or SIGN_WIDTH))
        if self.width is not None:
            return self.drag * (_wound(after, position, flank, self.width) - sign), after
        return -self.drag * sign * _loose(after, position, np.sign(sign), flank), after

    def realise(self, robot: SimulatedPlant) -> None:
        """Be sampled, as stiff as what is wound up at a flank."""
        super().realise(robot)
        if self.drag is not None and self.width is not None:
            robot.expect_late(self.joint, stiffness=self.drag / self.width)

    def with_more(self, more: Effect) -> Effect | None:
        """Return one play for two that the link falls across; drags of two gaps stay two."""
        forms = self.displaces, isinstance(more, Backlash) and more.displaces
        return super().with_more(more) if all(forms) else None

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield several gaps of both forms; of drags, those that leave a friction in the gap.

        More would drive the joint after each reversal, as friction does that still acts the way it
        did before: presliding.
        """
        for gap in GAPS:
            yield cls.of_gap(joint, gap)
        for gap in DAMPED_GAPS:  # where no flank is met, they are lags, or armatures
            yield from (cls.of_gap(joint, gap, damping) for damping in DAMPINGS)
        width, most = sign_width_at(joint, recorded), MOST_DRAG * dry_at(joint, recorded)
        for gap in DRAGGED_GAPS if most > 0 else ():
            yield cls.of_drag(joint, width, most, gap)

    @classmethod
    def further_laws(cls, found: Hypothesis) -> Iterator[Hypothesis]:
        """Yield a drag that winds something up, where one that is there at once was found.

        It goes and comes over a distance beside the gap, so that the gap itself is less; and the
        friction that is known is that of a joint without play, of which the drag may be more. And
        yield falls that are damped, where a free one was found.
        """
        if found.law == FREE and isinstance(found.family, partial):
            yield from (found.family(found.settings[0], damping) for damping in DAMPINGS)
        if found.law == AT_ONCE and isinstance(found.family, partial):
            joint, v_eps, _ = found.family.args
            yield cls.of_drag(joint, v_eps, math.inf, found.settings[0] / (1 + _PART), _PART)

    @classmethod
    def of_gap(cls, joint: int, gap: float, damping: float | None = None) -> Hypothesis:
        """Return play at one joint; how long the link floats depends on gap [rad] and damping."""
        settings = (gap,) if damping is None else (gap, damping)
        own = (_around(gap), DAMPED)[: len(settings)]
        return Hypothesis.of_one(
            cls(joint=joint, gap=gap, damping=damping),
            "gap",
            positive=True,
            settings=settings,
            family=partial(cls.of_gap, joint),
            bounds=own,
            sized=True,
            most=2.0,  # beyond, another gap of the grid is nearer
            seldom=damping is not None,
            law=FREE if damping is None else SLOWED,
        )

    @classmethod
    def of_drag(
        cls, joint: int, v_eps: float, most: float, gap: float, part: float | None = None
    ) -> Hypothesis:
        """Return play beyond which a drag is; where it is not felt depends on the gap [rad].

        Args:
            joint: Which, 1-based.
            v_eps: Width of the joint's smoothed sign [rad/s].
            most: That the drag can be [N m].
            gap: Whole play [rad].
            part: Of it, over which the drag winds something up; it is there at once if not given.
        """
        width = None if part is None else part * gap
        settings, law = ((gap,), AT_ONCE) if part is None else ((gap, part), WOUND)
        return Hypothesis.of_one(
            cls(joint=joint, gap=gap, drag=1.0, width=width, v_eps=v_eps),
            "drag",
            positive=True,
            most=most,
            settings=settings,
            family=partial(cls.of_drag, joint, v_eps, most),
            bounds=(_around(gap), _PARTS)[: len(settings)],
            law=law,
        )


def _around(gap: float) -> tuple[float, float]:
    """Return the gaps that a refinement may come to from one."""
    return 0.3 * gap, min(3.0 * gap, _WIDEST)


@compiled(reads=("time", "ahead", "slowed"), nogil=True)
def _float(
    state: FloatArray, time: FloatArray, ahead: FloatArray, slowed: FloatArray, flank: float
) -> FloatArray:
    """Advance (displacement, its speed, last time) in place; return displacements (T,) [rad].

    `ahead` is the acceleration of the displacement while the link floats, (T,) [rad/s²], and
    `slowed` what of its speed is lost, (T,) [1/s]. Both are held for a step.
    """
    x, speed, last = state
    displacement = np.empty(time.size)
    for t in range(time.size):
        if np.isnan(last):
            x = math.copysign(flank, ahead[t]) if ahead[t] != 0.0 else 0.0
        else:
            step = time[t] - last
            before = speed
            speed = (speed + ahead[t] * step) / (1.0 + slowed[t] * step)
            x += 0.5 * (before + speed) * step
        if abs(x) >= flank:
            x, speed = math.copysign(flank, x), 0.0
        last = time[t]
        displacement[t] = x
    state[0], state[1], state[2] = x, speed, last
    return displacement


@compiled(reads=("position", "way"), nogil=True)
def _loose(state: FloatArray, position: FloatArray, way: FloatArray, flank: float) -> FloatArray:
    """Advance (lead of the link over the drive, unused, last position) in place.

    `way` is the sign of the velocity, (T,): a joint that turned back within the step before a
    sample is off the flank that it came from.

    Returns:
        The part of the time around each sample, a step long, in which no flank is met, (T,): the
        joint goes on as it moves. The part of the step before would be late by half of one.
    """
    x, last = state[0], state[2]
    loose = np.empty(position.size)
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        to = way[t] if way[t] != 0.0 else math.copysign(1.0, step)
        ahead = flank - to * (x + step)  # to the flank that is moved to
        x, last = min(max(x + step, -flank), flank), position[t]
        if step != 0.0:
            loose[t] = min(max(0.5 + ahead / abs(step), 0.0), 1.0)
        else:
            loose[t] = 1.0 if abs(x) < flank else 0.0
    state[0], state[2] = x, last
    return loose


@compiled(reads=("position",), nogil=True)
def _wound(state: FloatArray, position: FloatArray, flank: float, width: float) -> FloatArray:
    """Advance (lead of the link over the drive, unused, last position) in place.

    Returns:
        The part of its drag that a joint feels, with its sign, (T,).
    """
    x, last, end = state[0], state[2], flank + width
    felt = np.empty(position.size)
    for t in range(position.size):
        step = 0.0 if np.isnan(last) else position[t] - last
        x, last = min(max(x + step, -end), end), position[t]
        felt[t] = math.copysign(max(abs(x) - flank, 0.0) / width, x)
    state[0], state[2] = x, last
    return felt
