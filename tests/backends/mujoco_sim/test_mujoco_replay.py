"""The simulated robot follows a recorded motion and measures what the recorded arm measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backends.mujoco_sim import MujocoRobot
from backends.mujoco_sim.replay import follow, recorded_path
from limo_driver.errors import PathError
from limo_driver.physics import (
    ExternalContact,
    PreslidingHysteresis,
    Simulation,
    TemperatureDependentFriction,
    TorqueDrift,
)
from limo_driver.recordings.recording import Recording


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


def test_an_arm_whose_last_joint_turns_replays_what_it_did_after_many_turns(
    hysteretic, recording, tmp_path
):
    text = Path(hysteretic.model.urdf).read_text()
    last = text.index('name="joint7"')
    (tmp_path / "turning.urdf").write_text(
        text[:last] + text[last:].replace('type="revolute"', 'type="continuous"', 1)
    )
    turning = replace(hysteretic, robot=str(tmp_path / "turning.urdf"))
    assert turning.model.turning == (*6 * (False,), True)
    turns = np.array([*6 * (0.0,), 60 * np.pi])
    turned = replace(recording, position=recording.position + turns)
    run, same = (follow(turning, given, 2.5, 5.0, 10.0) for given in (turned, recording))
    np.testing.assert_allclose(run.position[:, 6], same.position[:, 6] + 60 * np.pi, atol=1e-6)
    np.testing.assert_allclose(run.torque, same.torque, atol=1e-3)


def test_a_gap_is_refused(hysteretic, recording):
    keep = (recording.time < 3.0) | (recording.time > 3.5)
    with pytest.raises(PathError, match=r"gap between 2\.5 and 5 s"):
        follow(hysteretic, recording[keep], 2.5, 5.0, 10.0)


def test_a_motion_beyond_the_limits_is_refused(hysteretic, recording):
    start = recording.position[0]
    wide = replace(recording, position=start + 30 * (recording.position - start))
    with pytest.raises(PathError, match=r"exceeds the .*acceleration.* limits of iiwa14"):
        follow(hysteretic, wide, 2.5, 5.0, 10.0)


def test_effects_of_time_act_when_they_did_in_the_recording(recording):
    effects = (
        TorqueDrift(joint=1, times=(3.0, 5.0), offset=(0.0, 2.0)),
        ExternalContact(windows=((3.5, 4.0),), wrench=((0.0, 0.0, -20.0, 0.0, 0.0, 0.0),)),
        TemperatureDependentFriction(joint=2, excess=1.0, time_constant=3.0),
    )
    plain = follow(Simulation("iiwa14"), recording, 2.5, 5.0, 10.0)
    run = follow(Simulation("iiwa14", effects), recording, 2.5, 5.0, 10.0)
    added = run.torque - plain.torque
    drift = np.interp(run.time, (3.0, 5.0), (0.0, 2.0))
    apart = np.abs(run.time - 3.75) > 0.6  # from the contact and its ringing
    assert np.allclose(added[apart, 0], drift[apart], atol=0.1)
    pressed = (run.time > 3.6) & (run.time < 3.9)
    assert np.abs(added[pressed, 3]).min() > 5.0
    steady = apart & (np.abs(np.gradient(run.position[:, 1], run.time)) > 0.03)
    assert steady.sum() > 50
    warming = Simulation("iiwa14", effects[2:]).predict(recording)
    said = np.abs(warming - Simulation("iiwa14").predict(recording))[:, 1]
    expected = np.interp(run.time[steady], recording.time, said)
    assert np.allclose(np.abs(added[steady, 1]), expected, atol=0.1)


@pytest.mark.slow("replays a motion twice")
def test_friction_by_temperature_takes_the_temperature_that_was_measured(recording):
    temperature = np.full(recording.position.shape, 35.0)
    temperature[::2] = np.nan  # holes, as of a sensor that is slower than the recording
    warm = replace(recording, extras={"temperature": temperature})
    friction = TemperatureDependentFriction(joint=1, per_kelvin=0.1)
    runs = [
        follow(Simulation("iiwa14", effects), warm, 2.5, 5.0, 10.0) for effects in ((), (friction,))
    ]
    moving = np.abs(np.gradient(runs[0].position[:, 0], runs[0].time)) > 0.03
    added = (runs[1].torque - runs[0].torque)[moving, 0]
    assert np.allclose(np.abs(added), 1.0, atol=0.1)


def test_a_file_that_limits_no_speed_is_replayed_as_fast_as_the_arm_was(tmp_path):
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint name="lift" axis="0 1 0"/>'
        '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04"/></body></worldbody></mujoco>'
    )
    simulation = Simulation.load(tmp_path / "arm.xml")
    assert simulation.model.limits.velocity.tolist() == [1.0]  # for plans
    time = np.arange(0.0, 6.0, 0.005)
    position = 1.2 * np.sin(3.0 * time)[:, None]  # at up to 3.6 rad/s
    run = follow(simulation, Recording.from_arrays(time, position, 0 * position), 2.0, 4.0, 10.0)
    assert (run.tracking < 2e-3).all()
