"""The simulated robot follows a recorded motion and measures what the recorded arm measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backends.mujoco_sim import MujocoRobot
from backends.mujoco_sim.replay import follow, recorded_path
from limo_driver.errors import PathError
from limo_driver.physics import PreslidingHysteresis
from limo_driver.recording import Recording


@pytest.fixture(scope="module")
def recording(hysteretic, exploration):
    with MujocoRobot(hysteretic, initial_position=exploration[0], seed=3) as robot:
        robot.receive()
        run = robot.run(exploration)
    rows = slice(None, None, 4)
    return Recording.from_arrays(run.time[rows], run.position[rows], run.torque[rows])


def test_the_same_physics_measures_the_same_torque(hysteretic, recording):
    run = follow(hysteretic, recording, 2.5, 5.0, 10.0)
    rows = (recording.time >= 2.5) & (recording.time <= 5.0)
    assert np.array_equal(run.time, recording.time[rows])
    measured = recording.filtered_torque(10.0)[rows]
    assert (run.tracking < 2e-4).all()
    assert np.abs(run.position - recording.position[rows]).max() < 2e-3
    error = np.sqrt(np.mean((run.torque - measured) ** 2, axis=0))
    assert (error < [0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1]).all()


def test_what_was_left_out_shows(hysteretic, recording):
    kept = tuple(e for e in hysteretic.effects if not isinstance(e, PreslidingHysteresis))
    rows = (recording.time >= 2.5) & (recording.time <= 5.0)
    measured = recording.filtered_torque(10.0)[rows]
    errors = [
        np.sqrt(np.mean((follow(sim, recording, 2.5, 5.0, 10.0).torque - measured) ** 2, axis=0))
        for sim in (replace(hysteretic, effects=kept), hysteretic)
    ]
    assert (errors[0] > 2 * errors[1]).all()


def test_the_path_starts_at_rest_and_passes_through_the_smoothed_motion(hysteretic, recording):
    path = recorded_path(recording, 2.5, 5.0, 10.0, hysteretic.model)
    assert not path.velocity[0].any()
    motion = recording.motion(10.0)
    row = np.searchsorted(recording.time, 3.0)
    assert np.allclose(
        path.evaluate(recording.time[[row]] - path.time[0]).position[0], motion.position[row]
    )


def test_a_gap_is_refused(hysteretic, recording):
    keep = (recording.time < 3.0) | (recording.time > 3.5)
    with pytest.raises(PathError, match=r"gap between 2\.5 and 5 s"):
        follow(hysteretic, recording[keep], 2.5, 5.0, 10.0)


def test_a_motion_beyond_the_limits_is_refused(hysteretic, recording):
    every = replace(
        recording,
        time=recording.time,
        position=recording.position[0] + 30 * (recording.position - recording.position[0]),
    )
    with pytest.raises(PathError, match=r"exceeds the .*acceleration.* limits of iiwa14"):
        follow(hysteretic, every, 2.5, 5.0, 10.0)
