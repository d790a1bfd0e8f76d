"""What a target has no number for, and how many N m that is on a motion."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.exports.xml_edits import ISAAC_LAB, MJCF, USD
from limo_driver.physics import (
    Armature,
    Backlash,
    JointElasticity,
    PreslidingHysteresis,
    SensorEffect,
    display_name,
)
from limo_driver.runtime.parameters import parameters_of
from limo_driver.types import Motion

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from limo_driver.exports.changes.joints import EffectSplit
    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect, JointDrive, Simulation

DURATION: Final = 60.0  # [s]
RATE: Final = 250.0  # [Hz]
_SPEED: Final = 0.5  # [rad/s], at which a slow arm moves
_REACH: Final = 0.6  # of a joint's range
_WIDEST: Final = 1.2  # [rad]
BEYOND_ACTUATORS: Final = (  # of a servo
    "dead_band",
    "punch",
    "play",
    "ki",
    "sag",
    "derating",
    "speed",
    "acceleration",
    "straight",
    "resolution",
)
_MEANT: Final = {  # by what has no unit
    "sag": "of the supply",
    "derating": "of the warm motor",
    "straight": "(no profile to a repeated command)",
}


@dataclass(frozen=True)
class Remainder:
    """What a target does not express of an effect."""

    place: str  # effect and joints
    rms: tuple[float, ...]  # (n,) [N m]
    instead: str  # what is expressed instead, or why nothing is

    def __str__(self) -> str:
        """Say how much of it remains."""
        worst = max(self.rms)
        joint = self.rms.index(worst) + 1
        return f"{self.place} {self.instead}: {worst:.3g} N m RMS remain (joint {joint})"


def remainders(simulation: Simulation, split: EffectSplit, motion: Motion) -> tuple[Remainder, ...]:
    """Return the size of what is not expressed of each effect, alone.

    Args:
        simulation: All that was found.
        split: What of its effects the target expresses.
        motion: On which their torque is counted.
    """
    whole = simulation.predict(motion)
    found: list[Remainder] = []
    left = [x for x in split.left if not (isinstance(x, Armature) and x.inertia == 0)]
    pairs = [(effect, None) for effect in left] + list(split.stand_ins)
    for effect, instead in pairs:
        others = [x for x in simulation.effects if x is not effect]
        changed = replace(simulation, effects=(*others, *([instead] if instead else [])))
        rms = np.sqrt(np.mean((whole - changed.predict(motion)) ** 2, axis=0))
        found.append(Remainder(effect.place, tuple(rms.tolist()), _instead(effect, instead)))
    return tuple(sorted(found, key=lambda item: -max(item.rms)))


def _instead(effect: Effect, instead: Effect | None) -> str:
    if isinstance(instead, PreslidingHysteresis):
        return "is written as LuGre friction"
    if type(instead) is type(effect):
        return f"is written without its domain ({getattr(effect, 'domain', None)})"
    if instead is not None:
        return f"is written as {display_name(instead.name)}"
    if isinstance(effect, Backlash) and effect.displaces:
        return "is not expressible (MJCF has play of joints with an armature, without keyframes)"
    if isinstance(effect, SensorEffect):
        return "is of the sensor, not of the robot"
    is_spring = isinstance(effect, JointElasticity)
    why = " (a spring between drive and link: `--to c` has it)" if is_spring else ""
    return "is not expressible" + why


def proof_motion(model: RobotModel) -> Motion:
    """Return a minute of slow motion through most of the range of all joints.

    Args:
        model: The robot.
    """
    time = np.arange(0, DURATION, 1 / RATE)
    low, high = model.limits.position_min, model.limits.position_max
    middle = np.where(np.isfinite(low + high), (low + high) / 2, 0.0)
    reach = np.minimum(_REACH * np.nan_to_num(high - low, posinf=10.0) / 2, _WIDEST)
    speed = np.minimum(_SPEED, 0.5 * model.limits.velocity)
    rate = speed / np.maximum(reach, 1e-3) * (1 + 0.07 * np.arange(model.n))
    phase = np.outer(time, rate) + np.arange(model.n)
    return Motion(
        time,
        middle + reach * np.sin(phase),
        reach * rate * np.cos(phase),
        -reach * rate**2 * np.sin(phase),
    )


def unwritten(simulation: Simulation, kind: str) -> tuple[str, ...]:
    """Return a line for each number of a drive that is not written.

    Args:
        simulation: With drives, or without.
        kind: The target.
    """
    names = simulation.model.joint_names
    servos = [drive for drive in simulation.drives if drive.channel is not None]
    if kind == MJCF:
        pairs = ((servo, names[servo.joint - 1]) for servo in servos)
        return tuple(line for pair in pairs for line in missing_numbers(*pair, BEYOND_ACTUATORS))
    if kind in {ISAAC_LAB, USD} or not servos:  # which say so themselves
        return ()
    where = ", ".join(names[servo.joint - 1] for servo in servos)
    kinds = " and ".join(dict.fromkeys(_kind(servo) for servo in servos))
    return (f"{kinds} drives of {where}: this format has no number for them",)


def missing_numbers(servo: JointDrive, joint: str, keys: Iterable[str]) -> Iterator[str]:
    """Yield a line for each number of a drive that no actuator of a target has.

    Args:
        servo: The drive.
        joint: Name of its joint.
        keys: Parameters that the target's actuators do not have.
    """
    for key in keys:
        if (value := beyond_default(servo, key)) is not None:
            number = f"{key} {value:.4g} {unit_of(servo, key)} of the servo of {joint}"
            yield f"{number}: no {_kind(servo)} actuator has it"


def beyond_default(servo: JointDrive, key: str) -> Any:  # noqa: ANN401  # as it is stated
    """Return a parameter of a drive; None where it has none, or its default.

    Args:
        servo: The drive.
        key: Name of the parameter.
    """
    defaults = {item.name: item.default for item in fields(servo)}
    value = getattr(servo, key, None)
    return value if key in defaults and value != defaults[key] else None


def unit_of(servo: JointDrive, key: str) -> str:
    """Return the unit of a parameter, or what is meant by one that has none.

    Args:
        servo: The servo.
        key: Name of the parameter.
    """
    own = {known.name: known.unit for known in parameters_of(type(servo))}
    return _MEANT.get(key, own[key])


def _kind(servo: JointDrive) -> str:
    return servo.name.partition("_")[0]
