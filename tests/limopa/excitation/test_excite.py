"""Excitation: within limits everywhere, at rest at both ends, and well conditioned."""

from __future__ import annotations

import json
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from matplotlib.image import imread

from estimators.rigid_body.base_parameters import Conditioning
from limo_driver.app.cli.excite import command
from limo_driver.errors import ConfigError, InfeasiblePathError, LimoError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.robot.playback import Playback
from limo_driver.robot.registry import open_for
from limo_driver.trajectory import Trajectory
from limo_driver.types import Motion
from limopa import ExcitationRequest, Feasibility, Surroundings, Workspace, excite

PAPER = 68
QUICK = ExcitationRequest(duration=30.0, harmonics=4, starts=2, iterations=12)
SMALL = ExcitationRequest(
    duration=10.0, harmonics=3, starts=2, iterations=20, surroundings=Surroundings(
        self_collision=False, table_height=-1.0
    ),
)  # fmt: skip


@pytest.fixture(scope="module")
def conditioning(iiwa):
    return Conditioning(iiwa)


@pytest.fixture(scope="module")
def found(iiwa, conditioning):
    return excite(iiwa, conditioning, QUICK, seed=1)


@pytest.fixture(scope="module")
def arm(two_links_urdf):
    return RobotModel.load(two_links_urdf)


def test_limits_hold_everywhere(found, iiwa):
    motion, limits = found.trajectory, iiwa.limits
    at = motion.resample(1e-3)
    for values, bound in (
        (at.velocity, limits.velocity),
        (at.acceleration, limits.acceleration),
        (np.diff(at.acceleration, axis=0) / 1e-3, limits.jerk),
    ):
        assert (np.abs(values) < bound).all()
    peaks = motion.peaks()
    assert (peaks.velocity < limits.velocity).all()
    assert (peaks.acceleration < limits.acceleration).all()
    assert (peaks.jerk < limits.jerk).all()
    feasibility = Feasibility(iiwa, QUICK.surroundings, QUICK.workspace)
    assert feasibility.check_scaffold(at.position).feasible.all()
    assert feasibility.margins(at.position).min() >= 0.0


def test_it_starts_and_ends_at_rest_in_one_pose(found):
    motion = found.trajectory
    for row in (0, -1):
        assert not motion.velocity[row].any()
        assert not motion.acceleration[row].any()
    np.testing.assert_array_equal(motion.position[0], motion.position[-1])
    assert np.abs(motion.velocity[1]).max() < 1e-3  # and gets there smoothly
    assert np.abs(motion.acceleration[1]).max() < 0.2
    assert motion.duration == pytest.approx(QUICK.duration)


def test_each_joint_moves_on_harmonics_of_its_own(found):
    listed = [h for own in found.harmonics for h in own]
    assert sorted(listed) == list(range(1, 7 * QUICK.harmonics + 1))
    position = found.trajectory.position[:-1]
    amplitude = np.abs(np.fft.rfft(position, axis=0)) / len(position)
    for j, own in enumerate(found.harmonics):
        elsewhere = np.delete(amplitude[:, j], [0, *own])
        assert elsewhere.max() < 1e-9
        assert amplitude[list(own), j].max() > 0.05


def test_it_is_better_conditioned_than_a_random_motion_and_than_the_paper(
    found, iiwa, conditioning
):
    random = excite(iiwa, conditioning, replace(QUICK, iterations=0), seed=1)
    condition = conditioning.condition(found.trajectory)
    assert conditioning.columns == 57
    assert condition < 0.6 * conditioning.condition(random.trajectory)
    assert condition < PAPER


def test_the_regressor_spans_what_inertias_can_add_to_the_torque(found, iiwa, conditioning):
    motion = found.trajectory.resample(0.1)
    state = (motion.position, motion.velocity, motion.acceleration)
    random = np.random.default_rng(0)
    K = conditioning.regressor(motion).reshape(-1, 57)
    for _ in range(5):
        bodies = {
            link: Inertial(
                random.uniform(1, 5), tuple(random.uniform(-0.2, 0.2, 3)), (0.1, 0, 0, 0.1, 0, 0.1)
            )
            for link in iiwa.link_names
        }
        torque = iiwa.with_inertials(bodies).inverse_dynamics(*state).T.ravel()
        fitted = K @ np.linalg.lstsq(K, torque, rcond=None)[0]
        np.testing.assert_allclose(fitted, torque, atol=1e-8)


def test_the_condition_number_is_that_of_the_stacked_regressor(found, conditioning):
    motion = found.trajectory.resample(0.1)
    K = conditioning.regressor(motion)
    stacked = K.reshape(-1, 57)
    assert conditioning.condition(motion) == pytest.approx(np.linalg.cond(stacked), rel=1e-9)
    unit = stacked / np.linalg.norm(stacked, axis=0)
    assert conditioning.scaled(motion) == pytest.approx(np.linalg.cond(unit), rel=1e-9)
    for j in range(7):  # the last columns are viscous, then Coulomb friction of each joint
        np.testing.assert_array_equal(K[j, :, 43 + j], motion.velocity[:, j])
        moving = np.abs(motion.velocity[:, j]) > 0.02
        np.testing.assert_allclose(K[j, moving, 50 + j], np.sign(motion.velocity[moving, j]))


def test_the_smooth_bound_has_the_right_slope(found, conditioning):
    motion = found.trajectory.resample(0.5)
    states = [motion.position, motion.velocity, motion.acceleration]
    slope = conditioning.smooth(motion, 8.0)
    assert np.exp(slope.value) > 0.9 * conditioning.condition(motion)
    random = np.random.default_rng(0)
    for k, own in enumerate((slope.position, slope.velocity, slope.acceleration)):
        way = random.standard_normal(own.shape)
        values = [
            conditioning.smooth(
                Motion(motion.time, *(s + h * way * (i == k) for i, s in enumerate(states))), 8.0
            ).value
            for h in (1e-6, -1e-6)
        ]
        assert (values[0] - values[1]) / 2e-6 == pytest.approx(float((own * way).sum()), rel=1e-3)


def test_a_motion_that_reveals_nothing_has_no_condition_number(conditioning):
    rest = np.zeros((50, 7))
    motion = Motion(np.arange(50.0), rest, rest, rest)
    assert conditioning.condition(motion) == inf


def test_the_simulated_arm_follows_it_within_all_limits(found, hysteretic, tmp_path):
    motion = found.trajectory
    with open_for("mujoco", motion, simulation=hysteretic, robot=None, seed=0) as robot:
        summary = Playback(motion, tmp_path / "run.parquet", 10).run(
            robot, lambda _done, _most: None
        )
    assert not summary.limited
    assert summary.tracking_max.max() < 1e-3


def test_two_joints_of_a_urdf(arm):
    conditioning = Conditioning(arm)
    found = excite(arm, conditioning, SMALL, seed=2)
    random = excite(arm, conditioning, replace(SMALL, iterations=0), seed=2)
    assert found.trajectory.n == 2
    assert conditioning.condition(found.trajectory) < conditioning.condition(random.trajectory)
    assert (found.trajectory.peaks().velocity < arm.limits.velocity).all()


@pytest.mark.slow("optimises motions")
def test_a_seed_gives_one_motion(arm):
    motions = [excite(arm, Conditioning(arm), SMALL, seed).trajectory for seed in (3, 3, 4)]
    np.testing.assert_array_equal(motions[0].position, motions[1].position)
    assert np.abs(motions[0].position - motions[2].position).max() > 0.01


def test_the_flange_stays_in_the_workspace(arm):
    near = replace(SMALL, workspace=Workspace(radius=0.6, lower=(-inf, -inf, -0.2)))
    flange = arm.flange_position(excite(arm, Conditioning(arm), near, 1).trajectory.position)
    assert np.linalg.norm(flange, axis=1).max() <= 0.6 + 1e-9
    assert flange[:, 2].min() >= -0.2 - 1e-9


@pytest.mark.slow("optimises a motion")
def test_progress_ends_at_its_end(arm):
    told = []
    excite(arm, Conditioning(arm), SMALL, 1, lambda *figures: told.append(figures))
    done = [figures[0] for figures in told]
    assert done == sorted(done)
    assert done[-1] == told[-1][1]
    assert all(figures[2] > 1 for figures in told)


@pytest.fixture
def run(commanded):
    return commanded(command)


FEW = ("--duration", 10, "--harmonics", 3, "--starts", 1, "--iterations", 4,
       "--no-self-collision", "--table-height", -1)  # fmt: skip


@pytest.mark.slow("optimises a motion and draws it")
def test_the_command_writes_motion_figures_and_picture(run, two_links_urdf, tmp_path):
    out, picture = tmp_path / "a.traj.parquet", tmp_path / "a.png"
    result = run(
        "--robot", two_links_urdf, "--out", out, "--picture", picture, "--seed", 1, "--json", *FEW
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    trajectory = Trajectory.load(out)
    conditioning = Conditioning(RobotModel.load(two_links_urdf))
    assert figures["condition"] == pytest.approx(conditioning.condition(trajectory))
    assert figures["condition_of_columns_of_unit_norm"] == pytest.approx(
        conditioning.scaled(trajectory)
    )
    assert sum(figures["columns"].values()) == conditioning.columns
    assert [s.kind for s in trajectory.segments] == ["excitation"]
    assert imread(picture)[..., :3].std() > 0.05


def test_the_command_says_what_the_number_is_of(run, two_links_urdf, tmp_path):
    result = run("--robot", two_links_urdf, "--out", tmp_path / "a.traj.parquet", *FEW)
    assert result.exit_code == 0, result.output
    for text in ("condition number", "68 in Çallar", "SI units, unscaled", "scaled to unit norm"):
        assert text in result.stdout


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--robot", "kr16"), ConfigError, "'kr16' is neither built in"),
        (("--duration", 5), ConfigError, "duration 5 s is too short for 5 harmonics of each of 7"),
        (("--duration", "nan"), ConfigError, "duration is nan"),
        (("--harmonics", 1), ConfigError, "harmonics is 1, expected a whole number from 2 to 20"),
        (("--rate", 5), ConfigError, "rate is 5 Hz, expected a number from 50 to 1000 Hz"),
        (("--starts", 0), ConfigError, "starts is 0, expected"),
        (("--iterations", -1), ConfigError, "iterations is -1, expected"),
        (("--table-height", 3), InfeasiblePathError, "is a feasible scaffold"),
        (("--joint-margin", 130), InfeasiblePathError, "leaves joint 2 no range"),
        (("--workspace-radius", 0.01), InfeasiblePathError, "effective workspace"),
        (("--workspace-radius", 0), ConfigError, "workspace: radius is 0 m"),
        (("--out", "."), ConfigError, "cannot be written: it is a folder"),
        (("--out", "no/such/folder/a.parquet"), ConfigError, "there is no folder no/such/folder"),
        (("--picture", "x.foo"), ConfigError, "expected .png, .pdf, .svg"),
    ],
)
def test_bad_input_is_one_clear_line(run, tmp_path, arguments, error, message):
    result = run("--out", tmp_path / "a.traj.parquet", *arguments)
    assert isinstance(result.exception, error)
    assert isinstance(result.exception, LimoError)  # main() makes it exit status 2
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not (tmp_path / "a.traj.parquet").exists()


def test_an_input_is_not_written_over(run, two_links_urdf, tmp_path):
    before = two_links_urdf.read_text()
    result = run("--robot", two_links_urdf, "--out", two_links_urdf, *FEW)
    assert isinstance(result.exception, ConfigError)
    assert "is read and would be written over" in str(result.exception)
    assert two_links_urdf.read_text() == before
    both = run("--out", tmp_path / "a.png", "--picture", tmp_path / "a.png")
    assert "both the trajectory and the picture" in str(both.exception)


def test_a_joint_that_rests_is_a_condition_without_limit_and_no_nan(arm):
    time = np.linspace(0.0, 5.0, 500)
    position = np.stack([np.sin(3.0 * time), np.full(500, 0.2)], axis=1)
    rests = Motion.from_positions(time, position)
    conditioning = Conditioning(arm)
    assert conditioning.scaled(rests) == np.inf
    assert conditioning.condition(rests) == np.inf
