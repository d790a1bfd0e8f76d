"""What an arm may have beyond what is stated, and what is believed of it.

Suspects begin their fits each where it comes nearest.

Stiction: friction of a joint at rest beyond its dry friction, and where its fit begins.

As stiction grows, the instants at which a joint breaks away move, and where it comes to rest with
them: an error as a function of how much there is has many hollows. A fit goes down the one that it
begins in, and one that begins with little ends with too little. So each of a grid is tried first,
with less dry friction, too: a fit without stiction has raised it in its place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.checks.conventions import likeliest_order
from estimators.diagnosis.from_motion.fitting.starts import (
    LIMITS,
    MOVING,
    mean_distance,
    start_of_limit,
    start_of_motor,
)
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.plant import most_torque
from estimators.diagnosis.settings import FAR, LITTLE, SOME

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.from_motion.fitting.arm import ArmGuess
    from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray

OFFSET: Final = 0.02  # [N m], deviation of what pulls on a joint beside the known masses
_SMALL: Final = 2e-3  # in the unit of each
_UNSTATED: Final = 1.0  # deviation of the logarithm of what is stated as none
_FADING: Final = c.BelievedValue(0.05, 0.7)  # [rad/s] at which stiction fades, of most gears
# Friction by load where the load drives the joint, over that where it resists: alike in most gears,
# less where it goes by the motor's torque, which friction raises one way and lowers the other.
_DRIVEN: Final = c.BelievedValue(1.0, 0.35)
COUNTED: Final = ("joint_sign", "swapped_joints")  # how recordings count, and no physics
_FREED: Final = (
    *c.GAINS,
    c.DAMPING,
    c.COULOMB,
    "delay",
    "inertia",
    "offset",
)  # that each joint has
_BESIDE: Final = (  # constants that a drive may be stated to have
    "dead_band",
    "punch",
    "ki",
    "play",
    "speed",
    "acceleration",
    "torque_limit",
    "stall",
    "free_speed",
)
SHAPES: Final = (1.0, 2.0)  # exponents of the fading: exponential, and as a bell
# tried as stiction: times the dry friction; where it fades [rad/s]; dry friction that is left, over
# the fitted
_AMOUNTS: Final = tuple(np.linspace(SOME, FAR, 9).tolist())
_FADES: Final = tuple((MOVING * 2.0 ** np.arange(-2, 2)).tolist())
_DRY: Final = (1.0, 0.85)
_LEAST: Final = 0.005  # [rad, rad/s] of lag that a joint of no dry friction is taken to have


@dataclass(frozen=True)
class Suspect:
    """Something that may be there."""

    effect: str
    joint: int | None  # 0-based; None: the whole arm
    start: tuple[tuple[str, float], ...]  # constants, and where their fit begins
    shared: bool = False  # whether these are of the arm
    freed: str = ""  # a stated constant that is another
    other: int | None = None  # the second of two joints, 0-based
    carrier: int | None = None  # link that carries a body, 0-based; the last, if not given
    shape: tuple[tuple[str, float], ...] = ()  # constants of its law that are not fitted
    bent: tuple[tuple[str, float], ...] = ()  # others, which a fit without it bends: from anew

    @property
    def names(self) -> tuple[str, ...]:
        """Its constants."""
        return tuple(name for name, _ in self.start)

    @property
    def price(self) -> int:
        """How many constants it makes another."""
        return len(self.names) + bool(self.freed)

    @property
    def affects(self) -> tuple[int, ...] | None:
        """Joints that it acts on, 0-based; None: all."""
        return None if self.shared or self.joint is None else (self.joint,)

    def excludes(self, other: Suspect) -> bool:
        """Say whether another cannot be there beside it: itself, or another shape of it."""
        return (self.effect, self.joint, self.other, self.freed) == (
            other.effect,
            other.joint,
            other.other,
            other.freed,
        )

    def counted(self, change: ArmChange) -> ArmChange:
        """Return an arm in which a joint counts the other way, or two are exchanged."""
        j = self.joint or 0
        if self.other is None:
            sign = list(change.sign)
            sign[j] *= -1
            return replace(change, sign=tuple(sign))
        order = list(change.order or range(len(change.sign)))
        order[j], order[self.other] = order[self.other], order[j]
        return replace(change, order=() if order == sorted(order) else tuple(order))

    def added(self, guess: ArmGuess) -> ArmGuess:
        """Return a guess that has it."""
        if self.effect in COUNTED:
            return replace(guess, change=self.counted(guess.change))
        if self.shared:
            change = guess.change
            if self.effect == "payload":
                change = replace(change, carrier=self.carrier)
            for name, value in self.start:
                change = change.with_value(name, value)
            return replace(guess, change=change, shared=(*guess.shared, *self.names))
        rows, names, j = guess.rows.copy(), list(guess.names), self.joint or 0
        rows[j] = c.with_values(rows[j], dict((*self.bent, *self.shape, *self.start)))
        if self.freed:
            return replace(guess, rows=rows, free=guess.free | {(j, self.freed)})
        names[j] = (*names[j], *self.names)
        return replace(guess, rows=rows, names=tuple(names))

    def removed(self, guess: ArmGuess) -> ArmGuess:
        """Return a guess that has it no longer."""
        if self.freed:
            return replace(guess, free=guess.free - {(self.joint or 0, self.freed)})
        if self.effect in COUNTED:
            return self.added(guess)  # twice is not at all
        if self.shared:
            change = guess.change
            for name in self.names:
                change = change.with_value(name, 0.0)
            shared = tuple(name for name in guess.shared if name not in self.names)
            return replace(guess, change=change, shared=shared)
        rows, names, j = guess.rows.copy(), list(guess.names), self.joint or 0
        own = (*self.names, *(name for name, _ in self.shape))
        rows[j] = c.with_values(rows[j], {name: c.constant_of(name).absent for name in own})
        names[j] = tuple(name for name in names[j] if name not in self.names)
        return replace(guess, rows=rows, names=tuple(names))


def beliefs(rows: FloatArray, tolerance: FloatArray | float) -> list[Mapping[str, c.BelievedValue]]:
    """Return what is believed of each joint: the stated values, within their tolerances.

    Args:
        rows: Stated constants of each joint, (n, columns).
        tolerance: Deviations of their logarithms, likewise, or one of all.
    """
    own = (c.DAMPING, c.COULOMB, "delay", "inertia")
    return [
        {
            **{
                name: _belief(c.value_in(row, name), c.value_in(reach, name))
                for name in (c.gain_of(row), *own, *stated_beside(row))
            },
            "offset": c.BelievedValue(c.value_in(row, "offset"), OFFSET),
            "v_s": _FADING,
            "assisted": _DRIVEN,
        }
        for row, reach in zip(rows, np.broadcast_to(tolerance, rows.shape), strict=True)
    ]


def _belief(value: float, tolerance: float) -> c.BelievedValue:
    """Return what is believed of a stated value; one that is stated as none may be small."""
    if value > _SMALL:
        return c.BelievedValue(value, tolerance)
    return c.BelievedValue(_SMALL, _UNSTATED)


def stated_beside(row: FloatArray) -> tuple[str, ...]:
    """Return which constants a drive is stated to have beyond the usual ones.

    Args:
        row: The stated constants of a joint.
    """
    return tuple(name for name in _BESIDE if c.value_in(row, name) != c.constant_of(name).absent)


def suspects_of(loads: ArmLoads, guess: ArmGuess, stated: FloatArray) -> Iterator[Suspect]:
    """Yield what may be there in any arm.

    Args:
        loads: Of the recordings.
        guess: What is known of the arm; limits are suspects where one beyond it comes nearer.
        stated: Constants of each joint that fits began with, (n, columns).
    """
    mass = sum(own.mass for own in loads.body.inertials.values())
    com = tuple((f"com_{axis}", 0.0) for axis in "xyz")
    start = (("mass", LITTLE * mass), *com)
    for link in loads.carriers:
        yield Suspect("payload", None, start, shared=True, carrier=link)
    if loads.shows_supply:
        yield Suspect("supply_sag", None, (("sag", 0.2),), shared=True)
    # There are many pairs of joints, and a right one is likelier before any constant is fitted.
    order = likeliest_order(loads.body, loads.recordings)
    if pair := [j for j in range(loads.n) if order[j] != j]:
        yield Suspect("swapped_joints", pair[0], (), shared=True, other=pair[1])
    parts, most = loads.parts(guess.change), most_torque(guess.rows)
    for j in range(loads.n):
        yield Suspect("encoder_offset", j, ((f"zero_{j + 1}", 0.0),), shared=True)
        if not guess.names[j]:
            continue  # no command moves it: nothing of its drive shows
        yield Suspect("joint_sign", j, (), shared=True)
        own = guess.names[j]
        stated_names = [n for n in _FREED if n in own] + [n for n in own if n in _BESIDE]
        for name in stated_names:
            yield Suspect(c.constant_of(name).effect, j, (), freed=name)
        for one in (
            *_stiction(parts[j], guess.rows[j], guess.names[j]),
            *_of_joints(guess.rows[j]),
            *_limits(parts[j], guess, j, stated[j]),
        ):
            own = replace(one, joint=j)
            if not set(own.names) & set(guess.names[j]):
                yield own
        if (
            np.isfinite(most[j]) and c.gain_of(guess.rows[j]) == "kp"
        ):  # how warm a motor gets is in units of its stall
            start = (("derating", 1.0), ("heating", 15.0))
            yield Suspect("thermal_derating", j, start)


def _stiction(
    parts: Sequence[LoadedJoint], row: FloatArray, names: Sequence[str]
) -> Iterator[Suspect]:
    """Yield stiction of either shape, at no joint yet; none where it is fitted already."""
    if "stribeck" in names:
        return
    for delta in SHAPES:
        start = dict(start_of_stiction(parts, row, delta))
        bent = ((c.COULOMB, start.pop(c.COULOMB)),)
        own = tuple(start.items())
        yield Suspect("stribeck_friction", None, own, shape=(("delta", delta),), bent=bent)


def _of_joints(row: FloatArray) -> Iterator[Suspect]:
    """Yield what else any joint may have, at no joint yet; some of it behind position servos."""
    of_position = c.gain_of(row) == "kp"
    start = (("by_load", 0.1), ("assisted", 1.0))
    yield Suspect("load_dependent_friction", None, start)
    if of_position:
        yield Suspect("dead_band", None, (("dead_band", 0.01),))
        yield Suspect("punch", None, (("punch", 0.05),))
    yield Suspect("spring_load", None, (("spring", 0.1),))
    if of_position:
        yield Suspect("backlash", None, (("play", 0.01),))
    yield Suspect("gear_ratio", None, (("gear", 1.0),))
    if c.gain_of(row) != "gain":
        yield Suspect("integral_gain", None, (("ki", 1.0),))


def _limits(
    parts: Sequence[LoadedJoint], guess: ArmGuess, j: int, stated: FloatArray
) -> Iterator[Suspect]:
    """Yield the limits that come nearer to the recorded motion of a joint than what is known.

    A fit without a limit has bent gain and damping towards it: so each is tried beside the stated
    ones, too.
    """
    row, names = guess.rows[j], guess.names[j]
    known = mean_distance(parts, row)
    as_stated = c.with_values(row, {name: c.value_in(stated, name) for name in names})
    limits = LIMITS if c.gain_of(row) == "kp" else ("torque_limit",)
    for limit in (*limits, "voltage_limit"):
        tried = [
            (
                start_of_limit(limit, parts, own)
                if limit in LIMITS
                else start_of_motor(parts, own),
                own,
            )
            for own in (row, as_stated)
        ]
        start, base = min(tried, key=lambda one: one[0].away)
        if start.away >= known:
            continue
        other = () if base is row else tuple((n, c.value_in(base, n)) for n in names if n != limit)
        other = (*other, *start.bent.items())
        effect = c.constant_of(limit).effect if limit in LIMITS else limit
        one = Suspect(effect, j, tuple(start.values.items()), bent=other)
        if limit in names:
            one = replace(one, start=(), bent=(*other, *start.values.items()), freed=limit)
        yield one


def start_of_stiction(
    parts: Sequence[LoadedJoint], row: FloatArray, shape: float
) -> Mapping[str, float]:
    """Return how much stiction to start a fit from, and where it fades: the nearest of those tried.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint without it.
        shape: Exponent of the fading.

    Returns:
        Constants by name, dry friction among them.
    """
    dry = max(c.value_in(row, c.COULOMB), _LEAST * c.value_in(row, c.gain_of(row)))
    tried = [
        {"stribeck": share * dry, "v_s": pace, c.COULOMB: left * c.value_in(row, c.COULOMB)}
        for share, pace, left in product(_AMOUNTS, _FADES, _DRY)
    ]
    base = c.with_values(row, {"delta": shape})
    return tried[int(np.argmin([mean_distance(parts, c.with_values(base, one)) for one in tried]))]
