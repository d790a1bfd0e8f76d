"""Joint physics on motion unlike that of training: it fades to the simulation, and says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from wandering import wander

from estimators.evaluation import evaluate
from estimators.joint_physics import JointPhysics
from estimators.joint_physics.calibration import Calibration, judge
from estimators.joint_physics.columns import JointColumns
from estimators.joint_physics.model import tolerances
from estimators.joint_physics.normal_equations import REGIONS, Regions
from estimators.model_folder import MANIFEST, as_manifest, read_manifest
from estimators.regression.empirical_bayes import most_probable_prior
from estimators.regression.evidence import NormalEquations
from estimators.service.store.version import digest
from limo_driver.physics import JointElasticity, PreslidingHysteresis, Simulation, TorqueOffset
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

RATE = 100.0


@pytest.fixture(scope="module")
def soft_arm(arm: Path) -> Simulation:
    """The arm with gears that give way and a sensor that is off."""
    slip = [PreslidingHysteresis(joint=j, stiffness=(200.0,), width=(0.006,)) for j in (1, 2)]
    soft = [JointElasticity(joint=j, stiffness=k) for j, k in ((1, 2e3), (2, 1e3))]
    return Simulation(str(arm), (*slip, *soft, TorqueOffset(joint=1, offset=0.2)))


def record(
    arm: Simulation,
    seed: int,
    seconds: float,
    centre: tuple[float, float],
    frequency: tuple[float, float],
    amplitude: tuple[float, float],
) -> Recording:
    random = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    motion = wander(t, np.array(centre), random, frequency, amplitude)
    torque = arm.predict(motion)
    torque += 0.02 * random.standard_normal(torque.shape)
    return Recording.from_arrays(t, motion.position, torque)


@pytest.mark.slow("fits five models")
def test_elsewhere_it_is_flagged_and_hardly_worse_than_the_rigid_body(
    rigid: Simulation, soft_arm: Simulation
) -> None:
    coverage: list[np.ndarray] = []
    outside: list[np.ndarray] = []
    for seed in range(5):
        slow = record(soft_arm, seed, 25.0, (0.4, -0.8), (0.1, 0.4), (0.02, 0.08))
        brisk = record(soft_arm, 100 + seed, 30.0, (-1.0, 1.2), (0.1, 0.8), (0.1, 0.5))
        found = evaluate(JointPhysics(rigid).fit([slow]), brisk)
        assert (found.hybrid.rmse < 1.2 * found.rigid_body.rmse).all()
        coverage.append(found.coverage)
        outside.append(found.outside)
    assert np.mean(coverage) > 0.92
    assert np.mean(outside) > 0.7


def test_a_motion_that_repeats_itself_comes_back_to_its_regions(soft_arm: Simulation) -> None:
    once = record(soft_arm, 5, 20.0, (0.4, -0.8), (0.1, 0.4), (0.1, 0.3))
    position = np.concatenate([once.position, once.position[::-1]])  # and back
    time = np.arange(len(position)) / RATE
    twice = Recording.from_arrays(time, position, np.concatenate([once.torque, once.torque[::-1]]))
    region = Regions.of([twice]).at(twice.position)
    np.testing.assert_array_equal(region[: len(once)], region[len(once) :][::-1])
    counts = np.bincount(region, minlength=REGIONS)
    assert counts.min() > 0.9 * len(twice) / REGIONS


@pytest.mark.parametrize("poses", [2001, 2002])  # with a pose at the median, and without
def test_rounding_puts_no_pose_into_another_region(poses: int) -> None:
    random = np.random.default_rng(poses)
    time = np.arange(poses) / RATE
    position = np.cumsum(0.01 * random.standard_normal((poses, 3)), axis=0)
    still = Recording.from_arrays(time, position, np.zeros((poses, 3)))
    region = Regions.of([still]).at(position)
    assert np.bincount(region, minlength=REGIONS).min() > 0.9 * poses / REGIONS
    for _ in range(5):
        rounded = position * (1.0 + 1e-15 * random.standard_normal(position.shape))
        same = Recording.from_arrays(time, rounded, np.zeros((poses, 3)))
        np.testing.assert_array_equal(Regions.of([same]).at(position), region)


def test_regions_of_poses_that_are_all_alike() -> None:
    time = np.arange(90) / RATE
    still = Recording.from_arrays(time, np.full((90, 2), 0.3), np.zeros((90, 2)))
    assert np.unique(Regions.of([still]).at(still.position)).size == 1


def test_weights_whose_size_is_known_keep_it() -> None:
    random = np.random.default_rng(0)
    x = random.standard_normal((1000, 3)) * [1.0, 0.01, 0.0]
    y = x @ [1.0, 300.0, 0.0] + 0.1 * random.standard_normal(1000)
    evidence = NormalEquations.of(x, y)
    prior = most_probable_prior(evidence, np.array([0, 1, 1]), np.array([np.nan, 0.5, 0.5]))
    assert prior.precision[1] == pytest.approx(1.0 / (0.5 * evidence.rms[1]) ** 2)
    assert np.isfinite(prior.precision).all()
    free = most_probable_prior(evidence, np.array([0, 1, 1]))
    assert free.precision[1] < 1e-3 * prior.precision[1]


def test_sensors_encoders_and_gears_have_tolerances(rigid: Simulation) -> None:
    columns = JointColumns(rigid.body, 10.0)
    rms = np.ones(columns.count)
    rms[columns.of_family("gain")] = [10.0, 2.0]
    known = tolerances(columns, 1, rms)
    np.testing.assert_allclose(known[columns.of_family("gain")], [0.01, 0.05])
    np.testing.assert_allclose(known[columns.of_family("elasticity")], [0.0005, 0.0025])
    np.testing.assert_allclose(known[columns.of_family("placement")], 0.005)
    assert np.isfinite(known).sum() == 6


def test_learned_torque_fades_and_its_deviation_does_not() -> None:
    one = np.ones(1)
    calibration = Calibration(0.01 * one, 2.0 * one, 3.0 * one, 0.5 * one, one, 2.0 * one, one)
    leverage = np.array([[0.0], [1.0 / 6.0], [1e6], [0.0]])
    turned = np.array([[0.1], [0.1], [0.1], [0.02]])
    velocity = np.array([[1.0], [-1.0], [0.0], [-3.0]])
    learned, std = np.full((4, 1), 4.0), np.zeros((4, 1))
    outside = np.empty((4, 1), np.bool_)
    judge(calibration.rows, leverage, turned, velocity, 0.02, learned, std, outside)
    np.testing.assert_allclose(learned[:, 0], [4.0, 2.0, 0.0, 4.0], atol=1e-5)
    np.testing.assert_allclose(std[:, 0], np.sqrt([0.02, 1.02, 6e6, 2.02]), rtol=1e-6)
    assert outside[:, 0].tolist() == [False, False, True, True]  # far off, or hardly turned


@pytest.mark.slow("learns from a recording")
def test_a_folder_from_before_torque_faded_estimates_as_it_did(
    rigid: Simulation, soft_arm: Simulation, tmp_path: Path
) -> None:
    slow = record(soft_arm, 0, 25.0, (0.4, -0.8), (0.1, 0.4), (0.02, 0.08))
    model = JointPhysics(rigid).fit([slow])
    model.save(tmp_path)
    file = tmp_path / "model.safetensors"
    older = {
        k: v for k, v in load_file(file).items() if k not in ("growth", "usual", "power", "fastest")
    }
    save_file(older, file)
    values = read_manifest(tmp_path).content
    values = {**values, "weights": {**values["weights"], "sha256": digest(file)}}
    (tmp_path / MANIFEST).write_text(as_manifest(values))
    loaded = JointPhysics.load(tmp_path)
    brisk = record(soft_arm, 100, 5.0, (-1.0, 1.2), (0.1, 0.8), (0.1, 0.5))
    motion = brisk.motion(10.0)
    rows = model.columns.advance(model.columns.init(), motion, rigid.predict(motion))[0]
    learned = np.einsum("jtk,jk->tj", rows.columns, model.fitted.weights)
    np.testing.assert_allclose(loaded.estimate(brisk).learned, learned, rtol=1e-9, atol=1e-9)
    assert np.linalg.norm(model.estimate(brisk).learned) < np.linalg.norm(learned)
    loaded.save(tmp_path / "again")
    assert JointPhysics.load(tmp_path / "again").fitted.calibration.growth.max() == 1.0


@pytest.mark.parametrize("last_bit", [-1e-12, 0.0, 1e-12])
def test_directions_in_which_poses_differ_as_much_are_not_told_apart_by_rounding(
    last_bit: float,
) -> None:
    """Poses on a circle have no first component, and poses to and fro none of one sign."""
    angle = np.arange(4000) * 2.0 * np.pi / 1000
    circle = np.stack([np.cos(angle), (1.0 + last_bit) * np.sin(angle)], axis=1)
    to_and_fro = np.stack([np.cos(angle), -(1.0 + last_bit) * np.cos(angle)], axis=1)
    for position, axis in ((circle, [1.0, 0.0]), (to_and_fro, [0.5**0.5, -(0.5**0.5)])):
        recording = Recording.from_arrays(np.arange(4000) / 100, position, 0.0 * position)
        np.testing.assert_allclose(Regions.of([recording]).axes[0], axis, atol=1e-6)
