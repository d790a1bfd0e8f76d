"""Motion where the arm works: around the poses of a recording, or within a region, and as slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.app.cli.plan import command
from limo_driver.errors import ConfigError, InfeasiblePathError, LimoError, RecordingError
from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Trajectory
from limopa import Exploring, PlanRequest, Surroundings, Workspace, plan, summarise
from limopa.distances import ways

COUCH = Workspace(radius=np.inf, lower=(0.35, -0.2, 0.1), upper=(0.75, 0.25, 0.45), throughout=True)
QUICK = PlanRequest(scaffolds=3, rate=100.0, exploring=Exploring(waypoints=(300, 400)))
NEARBY = np.radians(5.0)


@pytest.fixture(scope="module")
def on_couch(iiwa):
    return plan(iiwa, replace(QUICK, workspace=COUCH, speed=0.05), seed=2)


@pytest.fixture(scope="module")
def scan(iiwa):
    """Work behind the arm, where plans are not by default: slow waves around a pose, then rest."""
    time = np.arange(0.0, 40.0, 0.01)
    middle = np.radians([150.0, 30.0, 10.0, -80.0, 0.0, 60.0, 0.0])
    wave = np.sin(2 * np.pi * np.minimum(time, 20.0)[:, None] * np.linspace(0.1, 0.2, 7))
    position = middle + 0.15 * wave + np.random.default_rng(0).normal(0, 1e-5, (len(time), 7))
    return Recording(time, position, iiwa.gravity_torque(position), robot="iiwa14", source="scan")


def speeds(model, trajectory):
    """Speed of the flange and of points 0.1 m from it, at 1 kHz [m/s]."""
    points = np.concatenate([np.zeros((1, 3)), 0.1 * np.eye(3)])
    poses = np.array([model.flange_pose(q) for q in trajectory.resample(2e-3).position])
    at = points @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    return np.linalg.norm(np.diff(at, axis=0), axis=2).max(axis=1) / 2e-3


def test_the_flange_never_leaves_a_region(on_couch, iiwa):
    flange = iiwa.flange_position(on_couch.trajectory.resample(2e-3).position)
    spare = Surroundings().clearance / 2
    assert np.all(flange >= np.array(COUCH.lower) - spare)
    assert np.all(flange <= np.array(COUCH.upper) + spare)


def test_a_plan_that_is_to_be_in_a_region_at_scaffolds_only_does_leave_it(iiwa):
    loose = replace(QUICK, workspace=replace(COUCH, throughout=False))
    flange = iiwa.flange_position(plan(iiwa, loose, seed=2).trajectory.position)
    assert np.any((flange < np.array(COUCH.lower)) | (flange > np.array(COUCH.upper)))


def test_a_probe_is_as_fast_as_it_is_asked_to_be_and_no_faster(on_couch, iiwa):
    fastest = speeds(iiwa, on_couch.trajectory).max()
    assert 0.04 < fastest <= 0.0505  # a point elsewhere around the flange may be a little faster
    moved = ways(limo_chain(iiwa), on_couch.trajectory.position) * 100.0
    assert moved.max() <= 0.05 * (1 + 1e-3)


def limo_chain(model):
    from limo_driver.model.kinematics import KinematicChain

    return KinematicChain.of(model)


def test_slow_motion_reverses_as_often_on_its_way(on_couch, iiwa):
    fast = plan(iiwa, replace(QUICK, workspace=COUCH), seed=2)
    np.testing.assert_array_equal(fast.scaffolds, on_couch.scaffolds)
    counts = [[j.reversals for j in summarise(p, iiwa).joints] for p in (on_couch, fast)]
    assert counts[0] == counts[1]
    assert on_couch.trajectory.duration > 1.5 * fast.trajectory.duration


def test_scaffolds_lie_around_the_poses_of_a_recording_wherever_these_are(scan, iiwa):
    planned = plan(iiwa, QUICK, seed=1, near=scan)
    apart = np.abs(planned.scaffolds[:, None] - scan.position).max(axis=2).min(axis=1)
    assert np.all(apart <= NEARBY)
    assert iiwa.flange_position(planned.scaffolds)[:, 0].max() < 0  # not in the default workspace


def test_a_long_rest_does_not_draw_scaffolds_to_itself(scan, iiwa):
    planned = plan(iiwa, replace(QUICK, scaffolds=12), seed=1, near=scan)
    at_rest = np.abs(planned.scaffolds - scan.position[-1]).max(axis=1) < NEARBY
    assert at_rest.sum() < 4  # of half of the time


def test_motion_is_as_fast_as_the_recording_unless_a_speed_is_asked_for(scan, iiwa):
    apart = 10
    recorded = ways(limo_chain(iiwa), scan.position, apart) / 0.1
    planned = plan(iiwa, QUICK, seed=1, near=scan)
    assert planned.request.speed == pytest.approx(np.quantile(recorded, 0.95))
    assert speeds(iiwa, planned.trajectory).max() < 1.02 * planned.request.speed
    slower = plan(iiwa, replace(QUICK, scaffolds=1, speed=0.02), seed=1, near=scan)
    assert speeds(iiwa, slower.trajectory).max() < 0.0205


def test_work_near_a_recording_may_be_kept_in_a_region(scan, iiwa):
    with pytest.raises(InfeasiblePathError, match=r"away from the region from .* \(`region`\)"):
        plan(iiwa, replace(QUICK, workspace=COUCH), near=scan)


def test_the_library_takes_a_file_as_well(scan, tmp_path):
    scan.save(path := tmp_path / "scan.parquet")
    planned = limo.plan("iiwa14", QUICK, near=path, seed=1)
    assert np.array_equal(
        planned.scaffolds, limo.plan("iiwa14", QUICK, near=scan, seed=1).scaffolds
    )


def test_a_recording_that_stands_still_has_no_speed(scan, iiwa):
    still = replace(scan, position=scan.position[:1].repeat(len(scan), axis=0))
    with pytest.raises(ConfigError, match=r"^scan: the flange stands still .*\(`speed`\)$"):
        plan(iiwa, QUICK, near=still)
    assert len(plan(iiwa, replace(QUICK, scaffolds=1, speed=0.1), near=still).scaffolds) == 1


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"robot": "panda"}, "is of robot panda, expected iiwa14"),
        ({"robot": "", "joints": 6}, "has 6 joints, but iiwa14 has 7"),
    ],
)
def test_a_recording_of_another_robot_is_refused(scan, iiwa, changed, message):
    q, torque = (x[:, : changed.get("joints")] for x in (scan.position, scan.torque))
    log = Recording(scan.time, q, torque, robot=changed["robot"])
    with pytest.raises(RecordingError, match=message):
        plan(iiwa, QUICK, near=log)


def test_something_else_is_no_recording():
    with pytest.raises(ConfigError, match="`near` is an int, expected one Recording"):
        limo.plan("iiwa14", QUICK, near=5)


@pytest.fixture
def run(commanded, tmp_path):
    out = tmp_path / "a.traj.parquet"
    return lambda *given: commanded(command)("--out", out, "--rate", 100, *given)


def test_the_command_plans_in_a_region_as_slow_as_contact_is(run, tmp_path, iiwa):
    result = run("--region", "0.75,-0.2,0.1,0.35,0.25,0.45", "--scaffolds", 1)
    assert result.exit_code == 0, result.output
    assert speeds(iiwa, Trajectory.load(tmp_path / "a.traj.parquet")).max() < 0.0505
    assert "the region from [0.35, -0.2, 0.1]" in (tmp_path / "a.traj.html").read_text()


def test_the_command_plans_near_a_log(run, scan, tmp_path):
    columns = {"time": scan.time} | {f"position_{j + 1}": scan.position[:, j] for j in range(7)}
    columns |= {f"torque_{j + 1}": scan.torque[:, j] for j in range(7)}
    rows = np.column_stack(list(columns.values()))
    np.savetxt(
        log := tmp_path / "scan.csv", rows, delimiter=",", header=",".join(columns), comments=""
    )
    result = run("--near", log, "--scaffolds", 1, "--picture", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    start = Trajectory.load(tmp_path / "a.traj.parquet").position[0]
    assert np.abs(start - scan.position).max(axis=1).min() <= NEARBY


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--region", "0,0,0,1,1"), "--region is '0,0,0,1,1', expected x,y,z of a corner"),
        (("--region", "a,0,0,1,1,1"), "--region is 'a,0,0,1,1,1', expected x,y,z of a corner"),
        (("--region", "0,0,0,1,1,inf"), "expected x,y,z of a corner"),
        (("--region", "0,0,0,0,1,1"), "lower is [0, 0, 0], expected less than upper"),
        (("--region", "2,0,0,3,1,1"), "m away from the region"),
        (("--region", "0.3,0,0,1,1,1", "--speed", 0), "speed is 0 m/s, expected a number above 0"),
        (("--region", "0.3,0,0,1,1,1", "--workspace-radius", 1), "has no use with --region"),
        (("--near", "no.parquet"), "no.parquet: no such file"),
    ],
)
def test_bad_input_is_one_clear_line(run, arguments, message):
    result = run(*arguments)
    assert isinstance(result.exception, LimoError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
