"""Short recordings of arms of two joints, as a fleet has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import limo_driver as limo

if TYPE_CHECKING:
    from pathlib import Path


def record_swing(simulation: limo.Simulation, seed: int, path: Path) -> None:
    """Write 6 s of a motion, each seed's at a pace of its own, with noisy torques."""
    time = np.arange(0.0, 6.0, 0.01)
    random = np.random.default_rng(seed)
    position = np.stack([0.8 * np.sin((1 + 0.1 * seed) * time), 0.7 * np.cos(1.3 * time)], axis=1)
    still = limo.Recording.from_arrays(time, position, np.zeros_like(position))
    torque = simulation.predict(still) + 0.02 * random.standard_normal(position.shape)
    path.parent.mkdir(exist_ok=True, parents=True)
    limo.Recording.from_arrays(time, position, torque).save(path)
