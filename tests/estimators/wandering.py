"""Motion of random sinusoids, no joint at the pace of another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

if TYPE_CHECKING:
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray


def wander(
    t: FloatArray,
    centre: FloatArray,
    seed: int | np.random.Generator,
    frequency: tuple[float, float],
    amplitude: tuple[float, float],
) -> Motion:
    """Move each of n joints about `centre` (n,) [rad] by three sinusoids drawn from a seed.

    Args:
        t: When, (T,) [s].
        centre: Pose in the middle, (n,) [rad].
        seed: Of what is drawn.
        frequency: Range of frequencies [Hz].
        amplitude: Range of amplitudes of each sinusoid [rad].
    """
    random, n = np.random.default_rng(seed), centre.size
    position = centre + np.zeros((t.size, n))
    velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
    for _ in range(3):
        w, phase = 2 * np.pi * random.uniform(*frequency, n), random.uniform(0, 6.3, n)
        size = random.uniform(*amplitude, n)
        angle = t[:, None] * w + phase
        position += size * np.sin(angle)
        velocity += size * w * np.cos(angle)
        acceleration -= size * w**2 * np.sin(angle)
    return Motion(t, position, velocity, acceleration)


def calm(simulation: Simulation, rate: float, seconds: float) -> Recording:
    """Record free motion of an arm that is as simulated, with noise of 0.05 N m."""
    t = np.arange(int(seconds * rate)) / rate
    motion = wander(t, np.zeros(simulation.model.n), 5, (0.1, 0.9), (0.01, 0.3))
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.position.shape)
    return Recording.from_arrays(t, motion.position, simulation.predict(motion) + noise)
