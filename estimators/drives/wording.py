"""What was found of drives, in the words of those who use them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.drives.identification import DriveIdentification
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_POSES: Final = 2000  # tried for the one that loads a joint most
_WORTH: Final = 0.01  # [rad], sag below which nothing is said
_SHOWS: Final = {"delay": ("drive_delay", "delay"), "inertia": ("armature", "inertia")}


def sags(found: DriveIdentification) -> tuple[str, ...]:
    """Say how far joints sag under the arm's own weight, and what would help."""
    full = full_load(found.simulation.body)
    said: list[str] = []
    for j, (fit, load) in enumerate(zip(found.fits, full.tolist(), strict=True), start=1):
        kp = fit.value("kp")
        if found.scaled[j - 1] and load / kp > _WORTH:
            said.append(
                f"Joint {j} sags {load / kp:.3f} rad at full reach: its P gain of {kp:.1f} N m/rad "
                f"is low for {load:.2f} N m; with twice the gain it would be {load / kp / 2:.3f} "
                "rad."
            )
    return tuple(said)


def full_load(body: RobotModel) -> FloatArray:
    """Return the largest gravity torque of each joint within its limits, (n,) [N m]."""
    limits = body.limits
    low, high = np.maximum(limits.position_min, -np.pi), np.minimum(limits.position_max, np.pi)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, body.n))
    return np.abs(body.gravity_torque(poses)).max(axis=0)


def undecided(found: DriveIdentification, rate: float) -> Iterator[tuple[str, str]]:
    """Yield effects and why these recordings do not show them."""
    for name, (effect, word) in _SHOWS.items():
        joints = [str(j) for j, other in found.undecided if other == name]
        if joints:
            yield (
                effect,
                f"{word} of joint{'s' * (len(joints) > 1)} {', '.join(joints)} is not decidable at "
                f"this rate ({rate:.0f} Hz): damping explains the motion as well",
            )
