"""Plan the motion in which two effects differ most, to resolve an ambiguous diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.model import RobotModel
from limo_driver.physics import display_name
from limo_driver.physics.catalogue import confusion_of, description_of
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray
from limopa.separation import motions
from limopa.separation.chain import first_feasible

Kind: TypeAlias = "Callable[[RobotModel, FloatArray, Sequence[int]], Trajectory]"


@dataclass(frozen=True)
class Separation:
    """A kind of motion and what two effects do differently in it."""

    motion: Kind
    reason: str  # completes "<kind of motion>: ..."


_NAMES: dict[Kind, str] = {
    motions.apart: "Two joints moved apart, together and alone",
    motions.creep: "Creep at five speeds, both ways",
    motions.load_reversal: "Sweeps through the pose where gravity's torque changes sign",
    motions.nested_reversals: "Nested, shrinking reversals at two speeds",
    motions.rest_holds: "Holds at seven poses, each approached from both sides",
    motions.revisit: "The same slow sweep before and after a minute and a half of exercise",
    motions.speed_ladder: "Steady speeds from 5 to 80 % of the limit, both ways",
    motions.two_frequencies: "Swings at a low and at a high frequency",
    motions.wide_sweep: "Wide sweeps both ways in poses of low and of high load",
}
_KINDS: dict[str, Kind] = {kind.__name__: kind for kind in _NAMES}
SEPARATION = "separation"  # the condition that a pair breaks which no motion tells apart
_LINK_INERTIA = "link_inertia"  # what a body has wrong, which is no effect of the catalogue


def separation_of(pair: tuple[str, str]) -> Separation:
    """Return the kind of motion in which two effects differ most.

    What the two do differently stands in the description of one of them.

    Args:
        pair: Two effect IDs.

    Raises:
        InfeasiblePathError: They do not differ in any motion; says why.
    """
    first, second = sorted(pair)
    known = confusion_of(first, second)
    if known is not None:
        if known.motion is None:
            reason = (
                f"no motion tells {display_name(first)} from {display_name(second)}: {known.reason}"
            )
            raise InfeasiblePathError(SEPARATION, reason)
        return Separation(_KINDS[known.motion], known.reason)
    if first == second:
        return Separation(
            _shows(first) or motions.wide_sweep,
            "the laws of one effect differ most in what shows it",
        )
    for effect in pair:
        if (motion := _shows(effect)) is not None:
            return Separation(motion, f"it makes {display_name(effect)} show")
    raise InfeasiblePathError(
        SEPARATION,
        f"no motion is known that tells {display_name(first)} from {display_name(second)}",
    )


def _shows(effect: str) -> Kind | None:
    """Return the motion that shows an effect, if one is known."""
    if effect == _LINK_INERTIA:
        return motions.wide_sweep
    known = description_of(effect).shown_by
    return None if known is None else _KINDS[known]


def purpose_of(pair: tuple[str, str], joints: Sequence[int]) -> str:
    """Describe a motion, and the two effects that it would distinguish, in one sentence.

    Args:
        pair: Two effect IDs.
        joints: Joints concerned, 1-based.
    """
    found = separation_of(pair)
    which = f"{display_name(pair[0])} or {display_name(pair[1])}"
    where = f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
    return f"{_NAMES[found.motion]}; decides between {which} at {where}: {found.reason}."


def motion_for(
    model: RobotModel, joints: Sequence[int], pair: tuple[str, str], start: FloatArray
) -> Trajectory:
    """Return the motion in which two effects differ at some joints.

    Args:
        model: The robot.
        joints: Joints concerned, 1-based.
        pair: Two effect IDs.
        start: Pose around which to move, (n,) [rad], or several, (k, n), of which the first that
            allows the motion is taken.

    Raises:
        InfeasiblePathError: They differ in no motion, or in none that is feasible from these poses.
        ConfigError: The robot's collision shapes cannot be read, or a joint does not exist.
    """
    found = separation_of(pair)
    return first_feasible(lambda pose: found.motion(model, pose, joints), np.atleast_2d(start))
