"""Recordings with coloured noise of an arm that wanders, pushed or with other effects."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter
from wandering import wander

from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.physics import ExternalContact, Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.physics import Effect
    from limo_driver.types import Motion

RATE, DURATION = 200.0, 60.0
NOISE = 0.02  # [N m], RMS, most of it below 3 Hz
WINDOWS = ((20.0, 20.8), (40.0, 40.6))  # [s]
WRENCHES = ((20.0, -10.0, 15.0, 0.0, 1.0, 0.0), (-10.0, 20.0, 5.0, 1.0, 0.0, 0.0))


def half_sines() -> ExternalContact:
    """Push as people do; made of pieces shorter than the filter can tell."""
    windows: list[tuple[float, float]] = []
    wrenches: list[tuple[float, ...]] = []
    for (start, end), wrench in zip(WINDOWS, WRENCHES, strict=True):
        edges = np.linspace(start, end, 41)
        windows += list(pairwise(edges.tolist()))
        course = np.sin(np.pi * (np.arange(40) + 0.5) / 40)
        wrenches += [tuple(size * np.array(wrench)) for size in course]
    return ExternalContact(windows=tuple(windows), wrench=tuple(wrenches))


def motion(seed: int, n: int = 7, duration: float = DURATION) -> Motion:
    """All joints wander over about 2 rad, none at the pace of another."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    return wander(t, np.zeros(n), seed, (0.03, 0.12), (0.2, 0.5))


@cache
def observed(
    *effects: Effect,
    seeds: tuple[int, ...] = (1,),
    affected: int = 0,
    robot: str = "iiwa14",
    duration: float = DURATION,
) -> Observations:
    """Record motion with coloured noise; the effects act in one recording alone."""
    simulation = Simulation(robot)
    recordings: list[Recording] = []
    for k, seed in enumerate(seeds):
        true = Simulation(robot, effects) if k == affected else simulation
        moved = motion(seed, simulation.model.n, duration)
        white = np.random.default_rng(100 + seed).standard_normal(moved.position.shape)
        coloured = lfilter([1.0], [1.0, -0.9], white, axis=0)
        torque = true.predict(moved) + NOISE * coloured / coloured.std()
        recordings.append(Recording.from_arrays(moved.time, moved.position, torque, source=str(k)))
    return Observations.of(simulation, recordings, 10.0)
