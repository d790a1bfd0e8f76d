"""What each peer of the diagnosis benchmark is given, and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnosis_closure import GUARD, MOVING
from scipy.ndimage import maximum_filter1d

from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from limo_driver.physics import Simulation
    from limo_driver.types import Motion

    Array = NDArray[np.float64]

BAND = 10.0  # [Hz] in which torques are compared
LEAVES = 2.0  # tolerances (1 sigma) beyond which a parameter counts as changed


@dataclass(frozen=True)
class Rows:
    """One recording at its own instants: motion, residual and where both can be trusted."""

    motion: Motion  # (T, n)
    load: Array  # (T, n) [N m], torque of the nominal body
    residual: Array  # (T, n) [N m], recorded minus simulated, below 10 Hz
    usable: NDArray[np.bool_]  # (T, n), moving and away from rest and edges
    noise: Array  # (n,) [N m], white noise below 10 Hz


@dataclass(frozen=True)
class Task:
    """What a peer is given of one case; nothing hidden is in it."""

    case: Path
    nominal: Simulation

    @cached_property
    def paths(self) -> list[Path]:
        """The recordings."""
        return sorted(self.case.glob("recording_*.parquet"))

    @cached_property
    def rows(self) -> list[Rows]:
        """What every recording says."""
        return [rows_of(Recording.load(path), self.nominal) for path in self.paths]

    @cached_property
    def noise(self) -> Array:
        """White noise below 10 Hz, (n,) [N m]."""
        return np.mean([rows.noise for rows in self.rows], axis=0)


@dataclass(frozen=True)
class Answer:
    """What a peer says: findings as in verdict.json, and how it predicts a recording."""

    findings: list[dict[str, Any]]
    predict: Callable[[Recording], Array]  # (T, n) [N m]


def rows_of(recording: Recording, nominal: Simulation) -> Rows:
    """Bring a recording to what regressions need."""
    motion = recording.sharp_motion(BAND)
    body = nominal.body
    load = body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    error = recording.torque - nominal.predict(recording, BAND)
    reach = 2 * round(GUARD * recording.rate) + 1
    still = np.abs(recording.motion(BAND).velocity) <= MOVING
    usable = maximum_filter1d(still.astype(np.uint8), reach, axis=0) == 0
    usable &= ~recording.edges(1.0)[:, None]  # as far from the ends as closure stays
    above = recording.torque - recording.filtered_torque(BAND)
    share = min(BAND / (recording.rate / 2), 0.5)  # of white noise that lies below 10 Hz
    noise = above.std(axis=0) * np.sqrt(share / (1 - share))
    residual = smooth(recording.time, error, BAND, recording.segments)
    return Rows(motion, load, residual, usable, noise)


def finding(effect: str, *joints: int) -> dict[str, Any]:
    """Return a finding as in verdict.json."""
    return {"effect": effect, "joints": list(joints), "confidence": 1.0}


def link_finding(joint: int, n: int) -> dict[str, Any]:
    """Return a finding about a link; the last one's inertia is also a payload."""
    same = {"equivalent": ["payload"]} if joint == n else {}
    return finding("link_inertia", joint) | same


def spread(task: Task) -> tuple[Array, Array]:
    """Return the RMS of velocity and acceleration over all recordings, (n,) each."""
    v, a = (np.concatenate([getattr(r.motion, name) for r in task.rows])
            for name in ("velocity", "acceleration"))  # fmt: skip
    return np.sqrt((v**2).mean(axis=0)), np.sqrt((a**2).mean(axis=0))


def joint_terms(simulation: Simulation) -> dict[tuple[str, int], float]:
    """Return the value of each term that is one number a joint."""
    value = {"coulomb_friction": "tau_c", "viscous_friction": "f_v", "armature": "inertia",
             "torque_offset": "offset"}  # fmt: skip
    return {
        (effect.name, effect.joint): float(getattr(effect, value[effect.name]))
        for effect in simulation.effects
        if effect.name in value
    }
