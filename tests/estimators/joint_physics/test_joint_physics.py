from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.hybrid import HybridModel
from estimators.joint_physics import JointPhysics
from estimators.joint_physics.calibration import FASTER, leverage_of
from estimators.joint_physics.columns import SETTLED, JointColumns, scan
from estimators.joint_physics.prediction import Prediction, fill_variance, predict
from estimators.model_folder import as_manifest, load_model, read_manifest
from estimators.regression.empirical_bayes import fit, most_probable_prior
from estimators.regression.evidence import NormalEquations
from limo_driver.errors import ModelStoreError, RecordingError
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray, JointSample, Motion

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.physics import Simulation

    Limo = Callable[..., subprocess.CompletedProcess[str]]

BANDWIDTH = 10.0


@pytest.fixture(scope="module")
def model(rigid: Simulation, record: Callable[[int, float], Recording]) -> JointPhysics:
    """Learn from motion of many frequencies and amplitudes, as LIMO motion has."""
    return JointPhysics(rigid).fit([record(seed, 15.0) for seed in range(11, 27)])


@pytest.fixture
def folder(model: JointPhysics, tmp_path: Path) -> Path:
    model.save(tmp_path / "model")
    return tmp_path / "model"


def errors(torque: np.ndarray, recording: Recording) -> np.ndarray:
    return (torque - recording.filtered_torque(BANDWIDTH))[~recording.edges(BANDWIDTH)]


def test_learns_the_hysteresis_of_other_motion(
    model: JointPhysics, test_recording: Recording
) -> None:
    found = model.estimate(test_recording)
    before = np.mean(errors(found.simulation, test_recording) ** 2, axis=0)
    after = np.mean(errors(model.predict(test_recording), test_recording) ** 2, axis=0)
    assert (after < 0.02 * before).all()
    np.testing.assert_allclose(found.torque, model.predict(test_recording), atol=1e-12)


def test_the_interval_holds_what_it_says_on_motion_held_out(
    model: JointPhysics, record: Callable[[int, float], Recording]
) -> None:
    recordings = [record(seed, 30.0) for seed in (3, 4, 5, 6)]
    estimates = [model.estimate(recording) for recording in recordings]
    within = [
        np.abs(errors(estimate.torque, recording))
        <= 1.96 * estimate.std[~recording.edges(BANDWIDTH)]
        for estimate, recording in zip(estimates, recordings, strict=True)
    ]
    coverage = np.concatenate(within).mean(axis=0)
    assert (coverage > 0.90).all()
    assert (coverage < 0.99).all()


def test_motion_like_that_of_training_is_inside(
    model: JointPhysics, test_recording: Recording
) -> None:
    estimate = model.estimate(test_recording)
    assert estimate.outside[200:].mean() < 0.03
    np.testing.assert_array_equal(estimate.torque, model.predict(test_recording))


def test_motion_unlike_that_of_training_is_outside_and_less_sure(
    model: JointPhysics, true_arm: Simulation, test_recording: Recording
) -> None:
    t = np.arange(2000) / 100.0
    swing = np.stack([1.2 * np.sin(2.0 * t), 1.5 * np.sin(2.5 * t)], axis=1)
    motion = Motion(t, swing, np.gradient(swing, t, axis=0), np.zeros_like(swing))
    recording = Recording.from_arrays(t, swing, true_arm.predict(motion))
    far, near = model.estimate(recording), model.estimate(test_recording)
    assert far.outside.mean() > 0.9
    assert (far.std.mean(axis=0) > 2 * near.std.mean(axis=0)).all()


def test_a_joint_that_has_not_turned_yet_is_outside(model: JointPhysics) -> None:
    still = np.array([0.4, -0.8])
    state, zero = model.init(), np.zeros(2)
    estimate, state = model.advance(state, JointSample(0.0, still, zero, zero).motion())
    assert estimate.outside.all()
    for i in range(1, 40):
        q = still + np.array([0.001 * i, 0.0])
        moved = JointSample(0.01 * i, q, np.array([0.1, 0.0]), zero)
        estimate, state = model.advance(state, moved.motion())
        assert estimate.outside[0, 1]
    assert SETTLED < 0.001 * 39
    assert not estimate.outside[0, 0]
    assert estimate.torque.shape == estimate.std.shape == (1, 2)


def test_stepping_estimates_what_a_recording_does(
    model: JointPhysics, test_recording: Recording
) -> None:
    recording = test_recording[:300]
    whole, motion = model.estimate(recording), recording.motion(BANDWIDTH)
    state = model.init()
    for t in range(len(recording)):
        estimate, state = model.advance(state, motion[t : t + 1])
        np.testing.assert_allclose(estimate.torque[0], whole.torque[t], rtol=0, atol=1e-9)
        np.testing.assert_allclose(estimate.std[0], whole.std[t], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(estimate.outside[0], whole.outside[t])


def _predicted(given: Prediction, columns: FloatArray) -> FloatArray:
    result = np.empty((2, columns.shape[1], len(columns)))  # torque [N m], leverage [N² m²]
    predict(columns, *vars(given).values(), *result)
    return result


def test_packed_weights_predict_what_whole_matrices_do(
    model: JointPhysics, test_recording: Recording
) -> None:
    fitted, motion = model.fitted, test_recording.motion(BANDWIDTH)[:200]
    torque = model.simulation.predict(motion)
    X = model.columns.advance(model.columns.init(), motion, torque)[0].columns
    learned, leverage = _predicted(fitted.prediction, X)
    for j, x in enumerate(X):
        np.testing.assert_allclose(learned[:, j], x @ fitted.weights[j], rtol=0, atol=1e-9)
        expected = leverage_of(x, fitted.root[j])
        # Roots are of single precision, weights are not.
        np.testing.assert_allclose(leverage[:, j], expected, rtol=1e-5, atol=1e-9)
    # the second joint does not move the first link
    assert fitted.prediction.sizes[1] < fitted.prediction.sizes[0] < model.columns.count + 1


def test_the_estimate_is_made_of_its_parts_to_the_bit(
    model: JointPhysics, test_recording: Recording
) -> None:
    fitted, motion = model.fitted, test_recording.motion(BANDWIDTH)[:200]
    torque, _ = model.simulation.advance(model.simulation.init(), motion)
    rows, _ = model.columns.advance(model.columns.init(), motion, torque)
    learned, leverage = _predicted(fitted.prediction, rows.columns)
    memory, unknown = fitted.unknown, np.empty(motion.velocity.shape)
    fill_variance(rows.columns, rows.about, memory.heights, memory.moments, memory.place, unknown)
    certain, unsure, farthest, once, twice, usual, fastest = fitted.calibration.rows
    faster = np.maximum(np.abs(motion.velocity) / fastest - 1.0, 0.0)
    fading, unknown = (once + twice * leverage) * leverage, unknown + usual * faster * faster
    whole, _ = model.advance(model.init(), motion)
    np.testing.assert_array_equal(whole.learned, learned / (1.0 + fading))
    np.testing.assert_array_equal(whole.std, np.sqrt(certain + unsure * leverage + unknown))
    outside = (leverage > farthest) | ~rows.settled | (faster > FASTER)
    np.testing.assert_array_equal(whole.outside, outside)


def test_what_grows_with_speed_stays_beyond_the_fastest_of_training(model: JointPhysics) -> None:
    columns, zero = model.columns, np.zeros((1, 2))
    arm, base, step_time, count, _ = columns.constants

    def friction(speed: float, fastest: float) -> FloatArray:
        X, about = np.empty((2, 1, count)), np.empty((2, 1, 2))
        velocity, most = np.full((1, 2), speed), np.full(2, fastest)
        scan(columns.init(), zero, velocity, zero, zero, arm, base, step_time, most, 1, X, about)
        return X[:, 0, columns.of_family("viscous")]

    np.testing.assert_array_equal(friction(-4.0, 1.5), friction(-1.5, np.inf))
    assert (friction(1.4, 1.5) != friction(1.5, 1.5)).all()


def test_parts_of_the_motion_that_disagree_widen_the_covariance() -> None:
    random = np.random.default_rng(2)
    x = random.standard_normal((500, 3))
    x[:, 2] = 0.0  # the data say nothing of it
    slope = np.repeat([0.8, 0.9, 1.0, 1.1, 1.2], 100)  # of the first column, drifting over parts
    y = slope * x[:, 0] + 0.5 * x[:, 1] + 0.01 * random.standard_normal(500)

    def sums(rows: np.ndarray) -> NormalEquations:
        own, target = x[rows], y[rows]
        return NormalEquations(
            own.T @ own, own.T @ target, float(target @ target), float(rows.sum())
        )

    part = np.arange(500) // 100
    found = fit(sums(part >= 0), [sums(part != f) for f in range(5)], np.array([0, 1, 1]))
    weights = np.array([without.weights for without in found.without])
    jackknife = 0.8 * (weights - weights.mean(axis=0)).T @ (weights - weights.mean(axis=0))
    root = found.posterior.root
    np.testing.assert_array_equal(root, np.tril(root))
    added = root.T @ root - jackknife
    assert np.linalg.eigvalsh(added[:2, :2]).min() > 0  # what the posterior alone says
    assert jackknife[0, 0] > 10 * jackknife[1, 1]
    assert not root[2].any()
    assert not root[:, 2].any()


def test_rows_in_between_are_remembered(rigid: Simulation, test_recording: Recording) -> None:
    columns, motion = JointColumns(rigid.body, BANDWIDTH), test_recording.motion(BANDWIDTH)[:500]
    torque = rigid.predict(motion)
    every, _ = columns.advance(columns.init(), motion, torque)
    some, _ = columns.advance(columns.init(), motion, torque, every=4)
    np.testing.assert_allclose(some.columns, every.columns[:, ::4], atol=1e-12)
    np.testing.assert_array_equal(some.settled, every.settled[::4])


def test_families_fill_all_columns(rigid: Simulation, test_recording: Recording) -> None:
    columns, motion = JointColumns(rigid.body, BANDWIDTH), test_recording.motion(BANDWIDTH)[:50]
    rows, _ = columns.advance(columns.init(), motion, rigid.predict(motion))
    assert rows.columns.shape == (2, 50, sum(family.size for family in columns.families))
    by_name = {family.name: k for k, family in enumerate(columns.families)}
    viscous = rows.columns[0][:, columns.family == by_name["viscous"]]
    np.testing.assert_array_equal(viscous[:, 0], motion.velocity[:, 0])


def test_evidence_switches_off_what_explains_nothing() -> None:
    random = np.random.default_rng(0)
    x = random.standard_normal((2000, 6))
    y = x[:, :3] @ [1.0, -2.0, 0.5] + 0.1 * random.standard_normal(2000)
    family = np.array([0, 0, 0, 1, 1, 1])
    evidence = NormalEquations(x.T @ x, x.T @ y, float(y @ y), 2000.0)
    prior = most_probable_prior(evidence, family)
    assert prior.precision[3] > 100 * prior.precision[0]
    assert prior.noise == pytest.approx(0.01, rel=0.1)
    halves = [
        NormalEquations(x[s].T @ x[s], x[s].T @ y[s], float(y[s] @ y[s]), 1000.0)
        for s in (slice(0, 1000), slice(1000, 2000))
    ]
    found = fit(evidence, halves, family)
    np.testing.assert_allclose(found.posterior.weights[:3], [1.0, -2.0, 0.5], atol=0.02)
    assert found.held_out == pytest.approx(0.01, rel=0.15)


def test_a_column_that_is_zero_gets_no_weight() -> None:
    x = np.random.default_rng(0).standard_normal((500, 2)) * [1.0, 0.0]
    y = 2.0 * x[:, 0]
    evidence = NormalEquations(x.T @ x, x.T @ y, float(y @ y), 500.0)
    found = fit(evidence, [evidence], np.array([0, 1]))
    np.testing.assert_allclose(found.posterior.weights, [2.0, 0.0], atol=1e-3)


def test_a_joint_that_hardly_moves_is_named(
    rigid: Simulation, training_recording: Recording
) -> None:
    position = training_recording.position * [1.0, 0.1]
    recording = Recording.from_arrays(training_recording.time, position, training_recording.torque)
    with pytest.raises(RecordingError, match=r"too little of joint 2: .* more than 0.02 rad"):
        JointPhysics(rigid).fit([recording])


def test_too_short_a_recording_is_refused(rigid: Simulation, training_recording: Recording) -> None:
    with pytest.raises(RecordingError, match="too little of joint 1"):
        JointPhysics(rigid).fit([training_recording[:15]])


def test_fewer_rows_than_weights_are_refused(
    rigid: Simulation, training_recording: Recording
) -> None:
    brisk = Recording.from_arrays(
        training_recording.time[:250],
        training_recording.position[:2500:10],
        training_recording.torque[:2500:10],
    )
    with pytest.raises(RecordingError, match=r"joint \d: 1\d\d rows .* at least 154, as many as"):
        JointPhysics(rigid).fit([brisk])


@pytest.mark.slow("fits three recordings")
def test_folds_of_a_short_recording_do_not_narrow_the_interval(
    rigid: Simulation, record: Callable[[int, float], Recording], test_recording: Recording
) -> None:
    for seed in range(40, 43):
        short = JointPhysics(rigid).fit([record(seed, 8.0)])
        assert (short.fitted.calibration.factor >= 1.0).all()
        found = short.estimate(test_recording)
        known = ~found.outside[~test_recording.edges(BANDWIDTH)]
        std = found.std[~test_recording.edges(BANDWIDTH)]
        within = np.abs(errors(found.torque, test_recording)) <= 1.96 * std
        assert within[known].mean() > 0.9


def test_a_joint_that_rests_in_a_part_of_the_motion_is_named(
    rigid: Simulation, training_recording: Recording
) -> None:
    position = training_recording.position.copy()
    position[-1500:, 1] = position[-1500, 1]
    time = training_recording.time
    recording = Recording.from_arrays(time, position, training_recording.torque)
    with pytest.raises(RecordingError, match=r"too little of joint 2: .* each of 5 parts"):
        JointPhysics(rigid).fit([recording])


def test_a_loaded_model_estimates_the_same(
    model: JointPhysics, folder: Path, test_recording: Recording
) -> None:
    loaded = load_model(folder)
    assert isinstance(loaded, JointPhysics)
    mine, theirs = model.estimate(test_recording), loaded.estimate(test_recording)
    np.testing.assert_array_equal(mine.torque, theirs.torque)
    np.testing.assert_array_equal(mine.std, theirs.std)
    np.testing.assert_array_equal(mine.outside, theirs.outside)
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["estimator"] == "joint-physics"
    assert manifest["training"]["recordings"][0]["samples"] == 1500


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 2}, "schema is not 1"),
        ({"estimator": "oracle"}, "estimator is 'oracle', expected one of hybrid, joint-physics"),
        ({"joints": ["a", "b"]}, "joints a, b, but sim.yaml of shoulder, elbow"),
        ({"families": []}, "train it again"),
        ({"families": None}, "families is None, expected a list of objects"),
        ({"bandwidth": None}, "bandwidth is None, expected a number above 0"),
        ({"weights": {"sha256": "0"}}, "sha256 differs"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(
    folder: Path, changes: dict[str, object], message: str
) -> None:
    entries = dict(read_manifest(folder).content) | changes
    (folder / "manifest.json").write_text(as_manifest(entries))
    with pytest.raises(ModelStoreError, match=message):
        load_model(folder)


@pytest.mark.parametrize("name", ["manifest.json", "model.safetensors", "sim.yaml"])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(ModelStoreError, match=name):
        load_model(folder)


def test_a_folder_of_another_estimator_is_refused(folder: Path) -> None:
    with pytest.raises(ModelStoreError, match="is of 'joint-physics', expected 'hybrid'"):
        HybridModel.load(folder)


@pytest.mark.slow("trains and evaluates through the commands")
def test_the_commands_train_and_evaluate_it(
    rigid: Simulation, training_recording: Recording, tmp_path: Path, limo: Limo
) -> None:
    sim, run = tmp_path / "sim.yaml", tmp_path / "run.parquet"
    rigid.save(sim)
    training_recording.save(run)
    given = ("--sim", sim, "--model", "joint-physics", "--out", tmp_path / "model")
    refused = limo("train", run, *given, "--epochs", "3")
    assert refused.returncode == 2
    assert "--epochs is of networks" in refused.stderr
    trained = limo("train", run, *given, "--json")
    assert trained.returncode == 0, trained.stderr
    rmse = json.loads(trained.stdout)["rmse"]
    assert max(rmse["held_out"]) < 0.1 * min(rmse["simulation"])
    evaluated = limo("evaluate", run, *given[:2], "--model", given[-1], "--out", tmp_path / "out")
    assert evaluated.returncode == 0, evaluated.stderr
    assert "95 % interval" in evaluated.stdout
    figures = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert figures["model"] == "joint-physics"
    assert min(figures["coverage_of_95_percent"]) > 0.9
    assert max(figures["outside"]) < 0.1
