"""Wording: what gives each effect away, and recordings, in words that go into a report."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording

_COUNTED, _MOST = 3, 99  # powers of ten: up to where odds are counted, and beyond which nobody does

OF_BODIES = {"payload", "link_inertia"}  # effects of one body, felt by all joints below it

SIGNATURES: dict[str, str] = {
    "link_inertia": "several joints err together, smoothly with the pose and without history",
    "payload": "the joints err in the fixed ratios of a body at the flange",
    "gravity_direction": "the gravity torques err as if the base were tilted",
    "armature": "torque goes with this joint's own acceleration alone",
    "coulomb_friction": "a loop of constant height that flips with the direction of motion",
    "asymmetric_friction": "two plateaus of different height for the two directions",
    "viscous_friction": "torque grows in proportion to speed",
    "stribeck_friction": "friction falls as speed grows from creep, at any distance travelled",
    "presliding_hysteresis": "torque rises with the distance since the last reversal",
    "load_dependent_friction": "the friction loop widens with the load the joint carries",
    "position_dependent_friction": "the friction loop changes its height over the joint's range",
    "temperature_dependent_friction": "friction changes over minutes while the motion stays alike",
    "quadratic_drag": "torque curves upwards with speed",
    "backlash": "the link jumps where the load changes sign",
    "joint_elasticity": "the link gives way in proportion to its load",
    "torque_ripple": "a line at a fixed number of cycles in a revolution",
    "torque_offset": "a constant, also at rest",
    "torque_gain": "all of this joint's torque is scaled together",
    "torque_crosstalk": "the error follows another joint's torque",
    "torque_drift": "the same motion needs another torque later on",
    "encoder_offset": "the gravity torque is that of a shifted position",
    "time_delay": "the measured torque lags behind the motion",
    "external_contact": "short pushes that act on several joints as one force at the flange",
    "spring_load": "a torque that depends on position alone, not on load",
    "joint_coupling": "torque goes with the combined motion of two joints",
    "unknown": "it could be foretold from the motion, yet no known effect foretells it",
}


def names_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the file names of recordings, and numbers for those that have none of their own."""
    files = [PurePath(recording.source).name for recording in recordings]
    return tuple(
        name if name and files.count(name) == 1 else f"recording {k}"
        for k, name in enumerate(files, start=1)
    )


def times(lead: float) -> str:
    """Say evidence [nat] as odds; beyond 10^99 nobody counts."""
    power = lead / math.log(10.0)
    if power < _COUNTED:
        return f"{math.exp(lead):.0f} times"
    return f"more than 10^{_MOST} times" if power > _MOST else f"10^{power:.0f} times"
