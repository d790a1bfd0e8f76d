"""Description of an effect besides its law: signature, confusions, and motion that shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Motions: TypeAlias = Literal[  # kinds of motion that `limopa.separation` can plan
    "apart",  # two joints apart, together and alone
    "creep",  # at five speeds, both ways
    "load_reversal",  # through the pose where gravity's torque changes sign
    "nested_reversals",  # shrinking, at two speeds
    "rest_holds",  # at poses approached from both sides
    "revisit",  # the same slow sweep before and after exercise
    "speed_ladder",  # steady speeds, both ways
    "two_frequencies",  # a low and a high one
    "wide_sweep",  # both ways, in poses of low and of high load
]


@dataclass(frozen=True)
class Confusion:
    """Another effect that some recordings take for the one described."""

    other: str  # its identifier, or `link_inertia`
    reason: str  # what the two do differently in the motion; without one, why there is none
    motion: Motions | None = None  # in which they differ; None: in no motion
    identical: bool = False  # indistinguishable in any motion, so both are named


@dataclass(frozen=True)
class Description:
    """Description of an effect of the catalogue; the defaults suit one that is little known."""

    signature: str = ""  # how it shows; completes "At joint 3 …"
    shown_by: Motions | None = None  # motion that excites it
    confusions: tuple[Confusion, ...] = ()  # each pair is stated by one of the two
    part_of: str = ""  # identifier of what says all that it says, and stands in its place or not
