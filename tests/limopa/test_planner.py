"""A plan is Algorithm 1: feasible everywhere, within all limits, and the same for the same seed."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from lanes import sampled
from scipy.spatial import cKDTree

from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.model import RobotModel
from limo_driver.trajectory import Trajectory
from limopa import Exploring, Feasibility, PlanRequest, Surroundings, Workspace, plan, summarise
from limopa.path import Line
from limopa.planner import path_deviation

QUICK = PlanRequest(scaffolds=2, exploring=Exploring(waypoints=(200, 250)))


def test_phases_alternate_and_share_the_samples(short_plan):
    segments = short_plan.trajectory.segments
    kinds = [segment.kind for segment in segments]
    assert kinds == ["exploring"] + ["reaching", "exploring"] * (len(short_plan.scaffolds) - 1)
    assert segments[0].start == 0
    assert segments[-1].stop == len(short_plan.trajectory)
    assert all(a.stop == b.start for a, b in pairwise(segments))


def test_every_phase_starts_and_ends_at_rest(short_plan):
    motion = short_plan.trajectory
    rows = [0] + [segment.stop - 1 for segment in motion.segments]
    assert np.abs(motion.velocity[rows]).max() == 0.0
    assert np.abs(motion.acceleration[rows]).max() == 0.0


def test_reaching_ends_at_the_scaffold_that_is_explored(short_plan):
    motion = short_plan.trajectory
    ends = [motion.position[s.stop - 1] for s in motion.segments if s.kind == "reaching"]
    np.testing.assert_allclose(motion.position[0], short_plan.scaffolds[0], atol=1e-14)
    np.testing.assert_allclose(ends, short_plan.scaffolds[1:], atol=1e-14)


def test_limits_hold_at_1_khz(short_plan, iiwa):
    motion, limits = short_plan.trajectory.resample(1e-3), iiwa.limits
    within = 1 + 1e-6
    assert np.all(np.abs(motion.velocity) <= limits.velocity * within)
    assert np.all(np.abs(motion.acceleration) <= limits.acceleration * within)
    jerk = np.diff(motion.acceleration, axis=0) / 1e-3
    assert np.all(np.abs(jerk[:-1]) <= limits.jerk * within)
    margin = short_plan.request.surroundings.joint_margin
    assert np.all(motion.position >= limits.position_min + margin - 1e-6)
    assert np.all(motion.position <= limits.position_max - margin + 1e-6)


def test_acceleration_and_velocity_are_derivatives_of_the_position(short_plan):
    motion = short_plan.trajectory.resample(1e-3)
    velocity = (motion.position[2:-1] - motion.position[:-3]) / 2e-3
    np.testing.assert_allclose(velocity, motion.velocity[1:-2], atol=2e-5)
    acceleration = (motion.velocity[2:-1] - motion.velocity[:-3]) / 2e-3
    np.testing.assert_allclose(acceleration, motion.acceleration[1:-2], atol=0.05)


def test_exploring_follows_its_sinusoids(short_plan):
    """Distance to the path by brute force, and the quick figure that the benchmark prints."""
    motion = short_plan.trajectory
    for phase, segment in list(zip(short_plan.phases, motion.segments, strict=True))[:4:2]:
        time = np.arange(motion.time[segment.start], motion.time[segment.stop - 1], 1e-2)
        position = motion.evaluate(time + 5e-4).position
        s = np.linspace(0, phase.path.length, 200_000)
        path = phase.path.derivative(s, 0)
        near = np.clip(cKDTree(path).query(position)[1], 1, len(s) - 2)
        chord = path[near + 1] - path[near - 1]
        miss = position - path[near]
        along = np.sum(miss * chord, axis=1) / np.sum(chord**2, axis=1)
        assert np.linalg.norm(miss - along[:, None] * chord, axis=1).max() < 1e-4
        rows = slice(segment.start, segment.stop)
        assert path_deviation(short_plan, phase, rows) < 1e-4


def test_whole_motion_is_feasible(short_plan, iiwa):
    feasibility = Feasibility(iiwa, replace(Surroundings(), clearance=0.0099), Workspace())
    position = short_plan.trajectory.resample(2e-3).position
    assert feasibility.check(position).conditions() == ()
    assert feasibility.check_scaffold(short_plan.scaffolds).conditions() == ()


def test_scaffolds_lie_in_the_effective_workspace(short_plan, iiwa):
    flange = iiwa.flange_position(short_plan.scaffolds)
    assert np.linalg.norm(flange, axis=1).max() <= 0.8
    assert flange[:, [0, 2]].min() >= 0.0


def test_next_scaffold_is_the_nearest_that_can_be_reached(iiwa):
    request = replace(QUICK, scaffolds=8)
    planned = plan(iiwa, request, seed=0)
    feasibility = Feasibility(iiwa, request.surroundings, request.workspace)
    rest = list(range(1, 8))
    for current in range(7):
        distance = np.linalg.norm(planned.scaffolds[rest] - planned.scaffolds[current], axis=1)
        here = planned.phases[2 * current].path
        end = here.derivative(np.array([here.length]), 0)[0]
        for row in np.argsort(distance):
            line = Line(end, planned.scaffolds[rest[row]])
            if not feasibility.check_path(line):
                assert rest[row] == current + 1
                break
        rest.remove(current + 1)


def test_same_seed_gives_the_same_file(iiwa, tmp_path):
    for seed, name in ((5, "a"), (5, "b"), (6, "c")):
        plan(iiwa, QUICK, seed).trajectory.save(tmp_path / name)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_file_keeps_the_motion(short_plan, tmp_path):
    path = tmp_path / "limo.traj.parquet"
    short_plan.trajectory.save(path)
    loaded = Trajectory.load(path)
    np.testing.assert_array_equal(loaded.position, short_plan.trajectory.position)
    assert loaded.segments == short_plan.trajectory.segments
    assert loaded.robot == "iiwa14"


def test_progress_counts_scaffolds(iiwa):
    seen = []
    plan(iiwa, QUICK, 0, lambda done, wanted: seen.append((done, wanted)))
    assert seen == [(1, 2), (2, 2)]


def test_reach_through_a_collision_is_refused(iiwa):
    """Both ends are free; in between the wrist passes through the base."""
    surroundings = Surroundings(joint_margin=0, clearance=0.003, table_height=-5)
    feasibility = Feasibility(iiwa, surroundings, Workspace())
    left, right = np.radians([[0, 100, -169, -119, 0, 60, 0], [0, 100, 169, -119, 0, 60, 0]])
    assert feasibility.check(np.stack([left, right])).conditions() == ()
    assert feasibility.check_path(Line(left, right)) == ("self-collision",)
    assert feasibility.check_path(Line(left, left)) == ()


def test_no_collision_hides_between_the_samples_of_a_path(iiwa):
    """A path that passes keeps half of the clearance at any resolution."""
    surroundings = Surroundings(joint_margin=0, clearance=0.03)
    feasibility = Feasibility(iiwa, surroundings, Workspace())
    finely = Feasibility(iiwa, replace(surroundings, clearance=0.015), Workspace())
    limits = iiwa.limits
    ends = np.random.default_rng(0).uniform(
        limits.position_min, limits.position_max, (80, 2, iiwa.n)
    )
    lines = [Line(start, end) for start, end in ends]
    passed = [line for line in lines if not feasibility.check_path(line)]
    assert 0 < len(passed) < len(lines)
    for line in passed:
        assert finely.check(line.derivative(np.linspace(0, 1, 5000), 0)).conditions() == ()


@pytest.mark.parametrize("joint", [2, 4, 6])
def test_the_flange_of_a_stretched_arm_moves_by_no_more_than_the_clearance_between_samples(
    iiwa, joint, monkeypatch
):
    """Nothing moves farther than that, and little of the clearance is wasted on more samples."""
    feasibility, checked = Feasibility(iiwa, Surroundings(clearance=0.01), Workspace()), []
    check = feasibility.check
    monkeypatch.setattr(feasibility, "check", lambda q, **k: checked.append(q) or check(q, **k))
    feasibility.check_path(Line(np.zeros(7), np.where(np.arange(1, 8) == joint, 1.0, 0.0)))
    flange = feasibility.chain.flange_position(along(checked))
    assert 0.007 < np.linalg.norm(np.diff(flange, axis=0), axis=1).max() <= 0.01


@sampled(
    ("request_", "condition"),
    [
        (PlanRequest(workspace=Workspace(radius=0.1), candidates=2000), "effective workspace"),
        (
            PlanRequest(surroundings=Surroundings(table_height=1.1), candidates=2000),
            r"cannot be lifted off the table at 1.1 m \(`table_height`\)",
        ),
        (PlanRequest(surroundings=Surroundings(joint_margin=2.5)), "joint limits"),
        (
            PlanRequest(surroundings=Surroundings(clearance=0.2), candidates=2000),
            "self-collision",
        ),
        (
            PlanRequest(exploring=Exploring(amplitude=(1.0, 1.5)), exploring_tries=3, repairs=3),
            "joint limits",
        ),
    ],
    "searches in vain, again and again",
    first=4,
)
def test_an_infeasible_request_names_the_condition(iiwa, request_, condition):
    with pytest.raises(InfeasiblePathError, match=condition) as caught:
        plan(iiwa, request_)
    assert caught.value.condition in condition


def test_what_no_motion_mends_is_said_after_a_few_draws(iiwa):
    request = PlanRequest(surroundings=Surroundings(table_height=2.0))  # links reach 1.3 m
    with pytest.raises(InfeasiblePathError, match=r"of 1024 random .*cannot be lifted off the tab"):
        plan(iiwa, request)


def test_only_links_that_nothing_frees_block(iiwa):
    free = Feasibility(iiwa, Surroundings(), Workspace())
    at = np.random.default_rng(0).uniform(free.lower, free.upper, (200, 7))
    assert free.blocked(at) is None
    said = [
        Feasibility(iiwa, around, Workspace()).blocked(at)
        for around in (
            Surroundings(table_height=0.3),  # that only some configurations break, and by little
            Surroundings(table_height=0.5),
            Surroundings(table_height=2.0),
            Surroundings(clearance=1.0, table_height=-9.0),
        )
    ]
    assert said == [
        None,
        ("table", "link2 cannot be lifted off the table at 0.5 m (`table_height`)"),
        (
            "table",
            "link2, link3, link4, link5 cannot be lifted off the table at 2 m (`table_height`)",
        ),
        (
            "self-collision",
            "base and link2, base and link3, base and link4, link1 and link3 and 11 more cannot be "
            "kept 1 m apart (`clearance`)",
        ),
    ]


ROD = """<robot name="rod"><link name="base"/>
<link name="post"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial></link>
<link name="rod"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial><collision><origin xyz="0 0 0.55"/><geometry><cylinder radius="0.05"
length="0.9"/></geometry></collision></link>
<joint name="yaw" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
<joint name="pitch" type="revolute"><parent link="post"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="2"/></joint></robot>"""


def test_the_far_end_of_a_rod_moves_by_no_more_than_the_clearance_between_samples(
    tmp_path, monkeypatch
):
    (path := tmp_path / "rod.urdf").write_text(ROD)
    around, checked = Surroundings(clearance=0.01), []
    feasibility = Feasibility(RobotModel.load(path), around, Workspace())
    check = feasibility.check
    monkeypatch.setattr(feasibility, "check", lambda q, **k: checked.append(q) or check(q, **k))
    feasibility.check_path(Line(np.zeros(2), np.array([0.0, 1.0])))
    assert 0.009 < 1.05 * np.diff(along(checked), axis=0).max() <= 0.01


def along(checked):
    """Samples of a line in their order, without the few that are looked at before."""
    return np.sort(np.concatenate(checked[2:]), axis=0)


def test_another_robot_can_be_planned_for(panda):
    planned = plan(panda, QUICK, seed=0)
    peaks = planned.trajectory.peaks()
    assert np.all(peaks.jerk <= panda.limits.jerk)
    feasibility = Feasibility(panda, replace(Surroundings(), clearance=0.0099), Workspace())
    assert feasibility.check(planned.trajectory.position).conditions() == ()


@pytest.fixture
def arm_without_meshes(tmp_path):
    links = "".join(
        f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial><collision><geometry><mesh filename="package://no/where.stl"/>'
        "</geometry></collision></link>"
        for k in range(3)
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><origin xyz="0 0 0.3"/><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><axis xyz="{k} 0 {1 - k}"/>'
        '<limit lower="-2" upper="2" velocity="1" effort="10"/></joint>'
        for k in range(2)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return RobotModel.load(path)


def test_missing_collision_meshes_name_the_way_out(arm_without_meshes):
    with pytest.raises(ConfigError, match=r"where\.stl.*`Surroundings\.self_collision`"):
        plan(arm_without_meshes, QUICK)


def test_planning_without_self_collision_keeps_the_frames_off_the_table(arm_without_meshes):
    surroundings = Surroundings(self_collision=False, table_height=0.2)
    request = replace(
        QUICK, surroundings=surroundings, workspace=Workspace(lower=(-1.0, -1.0, 0.0))
    )
    planned = plan(arm_without_meshes, request)
    assert arm_without_meshes.flange_position(planned.trajectory.position)[:, 2].min() > 0.2


def test_statistics_describe_the_motion(short_plan, iiwa):
    statistics = summarise(short_plan, iiwa)
    segments = short_plan.trajectory.segments
    assert statistics.waypoints == sum(p.path.waypoints for p in short_plan.phases[::2])
    assert statistics.exploring_velocity.least >= 0.1 * (1 - 2e-3)
    assert statistics.exploring_velocity.most <= 0.3
    assert statistics.exploring_duration.most * 250 == max(
        s.stop - s.start for s in segments if s.kind == "exploring"
    )
    joint = statistics.joints[3]
    signs = np.concatenate(
        [
            [0.0, *np.sign(short_plan.trajectory.velocity[s.start + 1 : s.stop - 1, 3]), 0.0]
            for s in segments
            if s.kind == "exploring"
        ]
    )
    assert joint.reversals == np.sum(signs[1:] * signs[:-1] < 0)
    assert 0 < joint.rotation_between_reversals < np.radians(10)
    assert 0 < joint.coverage < 1
    assert max(j.peak_velocity for j in statistics.joints) <= 0.9
    assert statistics.rejections["scaffold"]["effective workspace"] > 0


def test_a_joint_without_a_limit_of_velocity_is_named(iiwa, tmp_path):
    text = Path(iiwa.urdf).read_text()
    (tmp_path / "arm.urdf").write_text(re.sub(r'velocity="[^"]*"', 'velocity="0"', text, count=1))
    model = RobotModel.load(tmp_path / "arm.urdf")
    with pytest.raises(ConfigError, match=r"arm\.urdf: joint 1 .* has no limit of velocity"):
        Feasibility(model, Surroundings(), Workspace())
