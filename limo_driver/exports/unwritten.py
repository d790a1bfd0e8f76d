"""What a target has no number for in the drives of a simulation: told, joint by joint."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, Final

from limo_driver.exports.formats import ISAAC_LAB, MJCF
from limo_driver.runtime.parameters import parameters_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics import JointDrive, Simulation

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


def unwritten(simulation: Simulation, kind: str) -> tuple[str, ...]:
    """Return a line for each number of a drive that is not written.

    Args:
        simulation: With drives, or without.
        kind: The target.
    """
    names = simulation.model.joint_names
    servos = [drive for drive in simulation.drives if drive.channel is not None]
    if kind == MJCF:
        return tuple(_numbers(servos, names))
    if kind == ISAAC_LAB or not servos:  # whose module says so itself
        return ()
    where = ", ".join(names[servo.joint - 1] for servo in servos)
    kinds = " and ".join(dict.fromkeys(_kind(servo) for servo in servos))
    return (f"{kinds} drives of {where}: this format has no number for them",)


def _numbers(servos: list[JointDrive], names: tuple[str, ...]) -> Iterator[str]:
    for servo in servos:
        reason = f"no {_kind(servo)} actuator has it"
        for key in BEYOND_ACTUATORS:
            if (value := beyond_default(servo, key)) is not None:
                joint, unit = names[servo.joint - 1], unit_of(servo, key)
                yield f"{key} {value:.4g} {unit} of the servo of {joint}: {reason}"


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
