"""Which motion tells two effects apart, and why: the answer to an ambiguous diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.physics import spoken
from limopa.separation.chain import first_feasible
from limopa.separation.motions import (
    apart,
    creep,
    load_reversal,
    nested_reversals,
    rest_holds,
    revisit,
    speed_ladder,
    two_frequencies,
    wide_sweep,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray

Kind: TypeAlias = "Callable[[RobotModel, FloatArray, Sequence[int]], Trajectory]"


@dataclass(frozen=True)
class Separation:
    """A kind of motion and what two effects do differently in it."""

    motion: Kind
    reason: str  # completes "<kind of motion>: ..."


_NAMES: dict[Kind, str] = {
    apart: "Two joints moved apart, together and alone",
    creep: "Creep at five speeds, both ways",
    load_reversal: "Sweeps through the pose where gravity's torque changes sign",
    nested_reversals: "Nested, shrinking reversals at two speeds",
    rest_holds: "Holds at seven poses, each approached from both sides",
    revisit: "The same slow sweep before and after a minute and a half of exercise",
    speed_ladder: "Steady speeds from 5 to 80 % of the limit, both ways",
    two_frequencies: "Swings at a low and at a high frequency",
    wide_sweep: "Wide sweeps both ways in poses of low and of high load",
}

# What the two effects of a pair do differently, for the pairs that motion of one kind confuses.
_PAIRS: dict[tuple[str, str], Separation] = {
    ("armature", "link_inertia"): Separation(
        two_frequencies, "a drive's inertia loads its own joint only, a link's all joints below it"
    ),
    ("armature", "time_delay"): Separation(
        two_frequencies, "inertia grows with the square of the frequency, a delay's phase with it"
    ),
    ("armature", "payload"): Separation(
        two_frequencies, "a drive's inertia has no weight and loads its own joint only"
    ),
    ("asymmetric_friction", "coulomb_friction"): Separation(
        creep, "two plateaus of different height against one height both ways"
    ),
    ("backlash", "encoder_offset"): Separation(
        load_reversal, "play jumps where the load changes sign, an offset does not"
    ),
    ("backlash", "joint_elasticity"): Separation(
        load_reversal, "play jumps where the load changes sign, a spring winds up with the load"
    ),
    ("backlash", "presliding_hysteresis"): Separation(
        load_reversal, "play depends on the sign of the load, hysteresis on reversals at any load"
    ),
    ("coulomb_friction", "load_dependent_friction"): Separation(
        wide_sweep, "one height of the loop in all poses against one that follows the load"
    ),
    ("coulomb_friction", "position_dependent_friction"): Separation(
        wide_sweep, "one height of the loop over the whole range against one that varies"
    ),
    ("coulomb_friction", "presliding_hysteresis"): Separation(
        nested_reversals, "a loop inside a loop shrinks with memory, and keeps its height without"
    ),
    ("coulomb_friction", "stribeck_friction"): Separation(
        creep, "the excess falls off with speed against one height at all speeds"
    ),
    ("coulomb_friction", "temperature_dependent_friction"): Separation(
        revisit, "the loop shrinks as the joint warms up, or does not"
    ),
    ("encoder_offset", "link_inertia"): Separation(
        wide_sweep, "an offset shifts the gravity torque over position, inertia scales it"
    ),
    ("encoder_offset", "spring_load"): Separation(
        wide_sweep, "an offset acts in proportion to the load's slope, a spring at any load"
    ),
    ("gravity_direction", "spring_load"): Separation(
        wide_sweep, "gravity changes with the whole pose, a spring with its own joint only"
    ),
    ("gravity_direction", "torque_offset"): Separation(
        wide_sweep, "gravity changes with the pose, an offset does not"
    ),
    ("joint_coupling", "torque_crosstalk"): Separation(
        apart, "coupling follows the other joint's speed, crosstalk its torque"
    ),
    ("joint_elasticity", "link_inertia"): Separation(
        wide_sweep, "wind-up grows with the square of the load, a wrong inertia with the load"
    ),
    ("joint_elasticity", "spring_load"): Separation(
        wide_sweep, "wind-up follows the load, a spring the position at any load"
    ),
    ("link_inertia", "spring_load"): Separation(
        wide_sweep, "gravity varies as the sine of the pose and with it, a spring with its joint"
    ),
    ("link_inertia", "torque_gain"): Separation(
        wide_sweep, "a gain scales all torques of the joint, friction too, in every pose alike"
    ),
    ("load_dependent_friction", "position_dependent_friction"): Separation(
        wide_sweep, "the same path at another load changes one and not the other"
    ),
    ("load_dependent_friction", "temperature_dependent_friction"): Separation(
        wide_sweep, "one follows the load there and back, the other fades with time"
    ),
    ("position_dependent_friction", "temperature_dependent_friction"): Separation(
        revisit, "the same positions before and after the joint has warmed up"
    ),
    ("position_dependent_friction", "torque_ripple"): Separation(
        creep, "friction changes sign with the direction, ripple does not"
    ),
    ("presliding_hysteresis", "stribeck_friction"): Separation(
        creep, "one changes with the speed, the other only with the distance since the reversal"
    ),
    ("quadratic_drag", "viscous_friction"): Separation(
        speed_ladder, "a straight line over speed against a curve"
    ),
    ("spring_load", "torque_offset"): Separation(
        wide_sweep, "a spring's torque grows with the position, an offset does not"
    ),
    ("stribeck_friction", "viscous_friction"): Separation(
        speed_ladder, "one falls off with speed, the other grows with it"
    ),
    ("temperature_dependent_friction", "torque_drift"): Separation(
        revisit, "warmth changes the height of the loop, drift its middle"
    ),
    ("time_delay", "viscous_friction"): Separation(
        two_frequencies, "a delay's phase grows with the frequency at the same speed"
    ),
    ("torque_crosstalk", "torque_offset"): Separation(
        apart, "crosstalk changes when another joint alone is moved"
    ),
    ("torque_drift", "torque_offset"): Separation(
        revisit, "the same poses later show the same offset, or another"
    ),
}

# The motion that shows an effect, for pairs that are not listed above.
_SHOWS: dict[str, Kind] = {
    "armature": two_frequencies,
    "asymmetric_friction": creep,
    "backlash": load_reversal,
    "coulomb_friction": creep,
    "encoder_offset": wide_sweep,
    "gravity_direction": wide_sweep,
    "joint_coupling": apart,
    "joint_elasticity": wide_sweep,
    "link_inertia": wide_sweep,
    "load_dependent_friction": wide_sweep,
    "position_dependent_friction": wide_sweep,
    "presliding_hysteresis": nested_reversals,
    "quadratic_drag": speed_ladder,
    "spring_load": wide_sweep,
    "stribeck_friction": creep,
    "temperature_dependent_friction": revisit,
    "time_delay": two_frequencies,
    "torque_crosstalk": apart,
    "torque_drift": revisit,
    "torque_gain": wide_sweep,
    "torque_offset": rest_holds,
    "torque_ripple": creep,
    "viscous_friction": speed_ladder,
}

_NEVER = {
    frozenset({"asymmetric_friction", "torque_offset"}): "friction of unlike height both ways is "
    "even friction and an offset, moving or held by it; read the sensor of the unloaded joint",
    frozenset({"link_inertia", "payload"}): "a payload is part of the last link's inertia; "
    "record once with and once without it",
    frozenset({"torque_gain", "payload"}): "only a known mass tells the gain of a sensor",
}


def separation_of(pair: tuple[str, str]) -> Separation:
    """Return the kind of motion that tells two effects apart.

    Args:
        pair: Two effect IDs.

    Raises:
        InfeasiblePathError: No motion tells them apart; says why.
    """
    first, second = sorted(pair)
    if reason := _NEVER.get(frozenset(pair)):
        raise InfeasiblePathError("separation", f"no motion tells {first} from {second}: {reason}")
    if known := _PAIRS.get((first, second)):
        return known
    if first == second:
        return Separation(
            _SHOWS.get(first, wide_sweep), "the laws of one effect differ most in what shows it"
        )
    for effect in pair:
        if effect in _SHOWS:
            return Separation(_SHOWS[effect], f"it makes {spoken(effect)} show")
    raise InfeasiblePathError("separation", f"no motion is known that tells {first} from {second}")


def purpose_of(pair: tuple[str, str], joints: Sequence[int]) -> str:
    """Say in one sentence what a motion is and what it would decide.

    Args:
        pair: Two effect IDs.
        joints: Joints concerned, 1-based.
    """
    found = separation_of(pair)
    which = f"{spoken(pair[0])} or {spoken(pair[1])}"
    where = f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
    return f"{_NAMES[found.motion]}; decides between {which} at {where}: {found.reason}."


def motion_for(
    model: RobotModel, joints: Sequence[int], pair: tuple[str, str], start: FloatArray
) -> Trajectory:
    """Return the motion that tells two effects apart at some joints.

    Args:
        model: The robot.
        joints: Joints concerned, 1-based.
        pair: Two effect IDs.
        start: Pose around which to move, (n,) [rad], or several, (k, n), of which the first that
            allows the motion is taken.

    Raises:
        InfeasiblePathError: No motion tells them apart, or none is feasible from these poses.
        ConfigError: The robot's collision shapes cannot be read, or a joint does not exist.
    """
    found = separation_of(pair)
    return first_feasible(lambda pose: found.motion(model, pose, joints), np.atleast_2d(start))
