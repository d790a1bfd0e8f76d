"""Between samples a trajectory is the quintic through both neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.errors import ConfigError, PathError
from limo_driver.trajectory import Segment, Trajectory

C = np.random.default_rng(0).uniform(-1, 1, (6, 2))  # two joints, each one quintic in time


def _quintic(time, order=0):
    return np.stack([np.polynomial.Polynomial(c).deriv(order)(time) for c in C.T], axis=1)


@pytest.fixture
def trajectory():
    time = 3.0 + np.array([0.0, 0.3, 0.35, 0.8, 1.0])  # neither uniform nor from 0
    motion = (_quintic(time - 3.0, order) for order in range(3))
    return Trajectory(time, *motion, robot="arm", segments=(Segment("reaching", 0, 5),))


def test_a_quintic_is_reproduced(trajectory):
    time = np.linspace(0, 1, 301)
    motion = trajectory.evaluate(time)
    np.testing.assert_allclose(motion.position, _quintic(time), atol=1e-12)
    np.testing.assert_allclose(motion.velocity, _quintic(time, 1), atol=1e-11)
    np.testing.assert_allclose(motion.acceleration, _quintic(time, 2), atol=1e-9)


def test_resampling_ends_on_the_last_sample(trajectory):
    motion = trajectory.resample(0.03)
    assert motion.time[-1] == trajectory.duration
    np.testing.assert_allclose(motion.position[-1], trajectory.position[-1])


def test_peaks_are_the_largest_values_between_samples(trajectory):
    fine = np.linspace(0, 1, 100_001)
    peaks = trajectory.peaks()
    for order, name in enumerate(("velocity", "acceleration", "jerk"), start=1):
        true = np.abs(_quintic(fine, order)).max(axis=0)
        tolerance = 5e-3 if name == "velocity" else 1e-6  # velocity is taken at nine points
        np.testing.assert_allclose(getattr(peaks, name), true, rtol=tolerance)


def test_time_outside_is_refused(trajectory):
    with pytest.raises(PathError, match=r"outside the trajectory \(0 to 1 s\)"):
        trajectory.evaluate(np.array([0.5, 1.5]))


def test_file_keeps_everything(trajectory, tmp_path):
    trajectory.save(tmp_path / "t.parquet")
    loaded = Trajectory.load(tmp_path / "t.parquet")
    for name in ("time", "position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(trajectory, name))
    assert (loaded.robot, loaded.segments) == ("arm", trajectory.segments)


def test_a_file_that_is_no_trajectory_is_refused(tmp_path):
    (tmp_path / "t.parquet").write_text("no parquet")
    with pytest.raises(ConfigError, match="cannot be read as a trajectory"):
        Trajectory.load(tmp_path / "t.parquet")
