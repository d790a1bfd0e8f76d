"""Every motion that a diagnosis can ask for: within all limits, from rest to rest, to the point."""

from __future__ import annotations

import numpy as np
import pytest
from lanes import sampled

from backends.mujoco_sim import MujocoRobot
from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.trajectory import Trajectory
from limopa.feasibility import Feasibility
from limopa.request import Surroundings, Workspace
from limopa.separation import motions as excitation

START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
KINDS = (
    excitation.apart,
    excitation.creep,
    excitation.load_reversal,
    excitation.nested_reversals,
    excitation.rest_holds,
    excitation.revisit,
    excitation.speed_ladder,
    excitation.two_frequencies,
    excitation.wide_sweep,
)


@sampled("joints", [(2,), (6, 7)], "plans a motion of a minute or more each")
@sampled(
    "kind",
    KINDS,
    "plans a motion of a minute or more each",
    first=4,
    ids=lambda kind: kind.__name__,
)
def test_a_motion_keeps_every_limit_between_its_samples(iiwa, kind, joints):
    motion = kind(iiwa, START, joints)
    peaks, limits = motion.peaks(), iiwa.limits
    assert (peaks.velocity <= limits.velocity).all()
    assert (peaks.acceleration <= limits.acceleration).all()
    assert (peaks.jerk <= limits.jerk).all()
    assert np.allclose(np.diff(motion.time), 1e-3)
    for row in (0, -1):
        assert not motion.velocity[row].any()
        assert not motion.acceleration[row].any()
    verdict = Feasibility(iiwa, Surroundings(), Workspace()).check(motion.position[::20])
    assert verdict.feasible.all()
    assert motion.duration < 330
    assert motion.robot == iiwa.name


def test_creep_passes_the_same_stretch_both_ways_at_each_speed(iiwa):
    motion = excitation.creep(iiwa, START, [3])
    velocity = motion.velocity[:, 2]
    for speed in excitation.CREEP:
        for sign in (1, -1):
            steady = np.abs(velocity - sign * speed) < 1e-3 * speed
            assert steady.sum() > 2000, (speed, sign)
    assert not np.delete(motion.velocity, 2, axis=1).any()


def test_nested_reversals_shrink(iiwa):
    motion = excitation.nested_reversals(iiwa, START, [4], speeds=(0.05,))
    position, velocity = motion.position[:, 3], motion.velocity[:, 3]
    moving = np.flatnonzero(velocity)
    turns = moving[np.flatnonzero(np.diff(np.sign(velocity[moving])))]
    loops = np.abs(np.diff(position[turns]))
    assert len(loops) > 10
    assert (np.diff(loops) < 0).all()
    assert loops[-1] < 3e-3


def test_rest_holds_meet_each_pose_from_either_side(iiwa):
    motion = excitation.rest_holds(iiwa, START, [2])
    held = [s for s in motion.segments if s.kind == "hold"]
    poses = np.round([motion.position[s.start, 1] for s in held], 6)
    sides = [np.sign(motion.velocity[s.start - 100, 1]) for s in held]
    met = {pose: {s for p, s in zip(poses, sides, strict=True) if p == pose} for pose in poses}
    assert sum(found == {1.0, -1.0} for found in met.values()) >= 6


def test_a_wide_sweep_passes_the_same_positions_at_loads_that_differ(iiwa):
    motion = excitation.wide_sweep(iiwa, START, [4])
    load = iiwa.inverse_dynamics(motion.position, 0 * motion.velocity, 0 * motion.velocity)[:, 3]
    sweeping = np.zeros(len(motion), dtype=bool)
    for segment in motion.segments:
        sweeping[segment.start : segment.stop] = segment.kind == "sweep"
    near = sweeping & (np.abs(motion.position[:, 3] - START[3]) < 0.05)
    assert np.ptp(load[near]) > 3.0  # [N m]


def test_load_reversal_passes_zero_load_with_load_on_either_side(iiwa):
    motion = excitation.load_reversal(iiwa, START, [4])
    load = iiwa.inverse_dynamics(motion.position, 0 * motion.velocity, 0 * motion.velocity)[:, 3]
    assert load.min() < -3.0
    assert load.max() > 3.0
    assert (np.diff(np.sign(load)) != 0).sum() >= 8


def test_a_joint_that_gravity_never_loads_has_no_reversal_of_the_load(iiwa):
    with pytest.raises(InfeasiblePathError, match=r"gravity: it loads none of the joints \[1\]"):
        excitation.load_reversal(iiwa, START, [1])


def test_joints_that_move_apart_also_move_together_and_alone(iiwa):
    motion = excitation.apart(iiwa, START, [6, 7])
    v, w = np.sign(np.round(motion.velocity[:, 5:7], 3)).T
    seen = set(zip(v.tolist(), w.tolist(), strict=True))
    assert {(1, -1), (-1, 1), (1, 1), (-1, -1), (1, 0), (0, 1)} <= seen


def test_near_a_limit_a_motion_goes_the_other_way(iiwa):
    start = START.copy()
    start[5] = iiwa.limits.position_max[5] - np.radians(5.5)
    motion = excitation.creep(iiwa, start, [6])
    assert motion.position[:, 5].max() <= start[5] + 1e-9
    assert np.ptp(motion.position[:, 5]) > 0.1


def test_a_pose_that_allows_no_motion_is_refused_by_name(iiwa):
    with pytest.raises(InfeasiblePathError, match="joint limits"):
        excitation.creep(iiwa, iiwa.limits.position_max, [1])


@pytest.mark.parametrize("joints", [[0], [8], []])
def test_joints_that_do_not_exist_are_refused(iiwa, joints):
    with pytest.raises(ConfigError, match="expected some of 1 to 7"):
        excitation.creep(iiwa, START, joints)


def test_the_simulated_robot_follows_it(iiwa, tmp_path):
    motion = excitation.nested_reversals(iiwa, START, [2, 4])
    motion.save(tmp_path / "next_motion.parquet")
    targets = Trajectory.load(tmp_path / "next_motion.parquet").resample(1e-3).position
    with MujocoRobot(robot="iiwa14", initial_position=START) as robot:
        robot.receive()
        run = robot.run(targets)
    assert run.limited_by == ()
    assert np.abs(run.position[100:] - run.target[99:-1]).max() < 2e-3
