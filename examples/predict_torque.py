"""Predict the torque of a slow, reversing motion with a hysteretic joint, and without."""

from pathlib import Path

import numpy as np

import limo_driver as limo

simulation = limo.Simulation.load(Path(__file__).parent / "iiwa14_hysteretic.yaml")
t = np.arange(0, 4, 1e-3)
position = 0.5 + 0.02 * np.sin(np.pi * t)[:, None] * np.ones(7)  # ±1.1°, creeping
motion = limo.Motion.from_positions(t, position)
missing = simulation.predict(motion) - simulation.without_effects().predict(motion)
print("largest torque beyond the rigid body [N m]:", np.abs(missing).max(axis=0).round(2))
