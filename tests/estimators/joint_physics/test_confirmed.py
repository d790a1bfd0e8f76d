"""Joint physics of the families that other poses confirm, and of some joints only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.joint_physics import JointPhysics, Learning
from estimators.joint_physics.calibration import lower_root
from estimators.model_folder import load_model
from limo_driver.physics import Simulation, ViscousFriction

BANDWIDTH = 10.0


@pytest.fixture(scope="module")
def recordings(record):
    return [record(seed, 15.0) for seed in range(11, 19)]


@pytest.fixture(scope="module")
def model(rigid, recordings):
    return JointPhysics(rigid, BANDWIDTH, Learning(confirmed=True, without=(1,))).fit(recordings)


def squares(torque, recording):
    error = recording.filtered_torque(BANDWIDTH) - recording.filtered(torque, BANDWIDTH)
    return np.mean(error[~recording.edges(BANDWIDTH)] ** 2, axis=0)


def test_learns_hysteresis_where_it_may_and_leaves_the_other_joint_alone(model, test_recording):
    found = model.estimate(test_recording)
    before, after = (squares(one, test_recording) for one in (found.simulation, found.torque))
    assert after[0] < 0.05 * before[0]
    assert (found.learned[:, 1] == 0.0).all()


def test_says_how_large_the_error_is_of_a_joint_that_learned_nothing(model, test_recording):
    found = model.estimate(test_recording)
    error = test_recording.filtered_torque(BANDWIDTH) - found.torque
    inside = ~test_recording.edges(BANDWIDTH)
    within = np.abs(error) < 1.96 * found.std
    assert (within[inside].mean(axis=0) > 0.85).all()


def test_a_folder_gives_the_same_and_says_what_was_learned(model, test_recording, tmp_path):
    model.save(tmp_path / "model")
    loaded = load_model(tmp_path / "model")
    assert loaded.fitted.record["learning"] == {"confirmed": True, "joints": [True, False]}
    found, known = (one.estimate(test_recording) for one in (loaded, model))
    np.testing.assert_allclose(found.torque, known.torque, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.std, known.std, rtol=1e-9)


def test_noise_teaches_nothing(arm, recordings):
    """Where the simulation is right, hardly anything is confirmed."""
    smooth = Simulation(str(arm), tuple(ViscousFriction(joint=j, f_v=0.5) for j in (1, 2)))
    random = np.random.default_rng(3)
    exact = [
        replace(
            one, torque=smooth.predict(one, BANDWIDTH) + random.normal(0, 0.05, one.torque.shape)
        )
        for one in recordings[:3]
    ]
    learned = (
        JointPhysics(smooth, BANDWIDTH, Learning(confirmed=True)).fit(exact).estimate(exact[0])
    )
    assert np.abs(learned.learned).max() < 0.01 * np.abs(learned.simulation).max()


@pytest.mark.parametrize("rows", [3, 5, 9])
def test_a_root_is_lower_triangular_and_has_the_products_of_its_rows(rows):
    given = np.random.default_rng(rows).normal(size=(rows, 5))
    given[:, 2] = 0.0
    root = lower_root(given)
    np.testing.assert_allclose(root.T @ root, given.T @ given, atol=1e-12)
    np.testing.assert_array_equal(root, np.tril(root))
