"""Predict the torque of a slow, reversing motion with a hysteretic joint, and without."""

from pathlib import Path

import numpy as np

from limo_driver import Motion, Simulation

simulation = Simulation.load(Path(__file__).parent / "iiwa14_hysteretic.yaml")
t = np.arange(0, 4, 1e-3)
position = 0.5 + 0.02 * np.sin(2 * np.pi * 0.5 * t)[:, None] * np.ones(7)  # ±1.1°, creeping
velocity = np.gradient(position, t, axis=0)
motion = Motion(t, position, velocity, np.gradient(velocity, t, axis=0))
missing = simulation.predict(motion) - simulation.without_effects().predict(motion)
print("largest torque beyond the rigid body [N m]:", np.abs(missing).max(axis=0).round(2))
