"""What a target has no number for in the drives of a simulation: told, joint by joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from limo_driver.exports.formats import ISAAC_LAB, MJCF
from limo_driver.physics import PositionServo

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics import Simulation

BEYOND_ACTUATORS: Final = {  # of a position servo, with its unit
    "dead_band": "rad",
    "punch": "N m",
    "play": "rad",
    "ki": "N m/(rad s)",
    "sag": "of the supply",
    "derating": "of the warm motor",
    "speed": "rad/s",
    "acceleration": "rad/s^2",
    "straight": "(no profile to a repeated command)",
    "resolution": "rad",
}


def unwritten(simulation: Simulation, kind: str) -> tuple[str, ...]:
    """Return a line for each number of a drive that is not written.

    Args:
        simulation: With drives, or without.
        kind: The target.
    """
    names = simulation.model.joint_names
    servos = [drive for drive in simulation.drives if isinstance(drive, PositionServo)]
    if kind == MJCF:
        return tuple(_numbers(servos, names, "no position actuator has it"))
    if kind == ISAAC_LAB or not servos:  # whose module says so itself
        return ()
    where = ", ".join(names[servo.joint - 1] for servo in servos)
    return (f"position servos of {where}: this format has no number for them",)


def _numbers(servos: list[PositionServo], names: tuple[str, ...], reason: str) -> Iterator[str]:
    for servo in servos:
        for key, unit in BEYOND_ACTUATORS.items():
            if value := getattr(servo, key):
                joint = names[servo.joint - 1]
                yield f"{key} {value:.4g} {unit} of the servo of {joint}: {reason}"
