"""What every torque estimator keeps to."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.base import InverseDynamics
from estimators.hybrid import HybridModel
from estimators.joint_physics import JointPhysics
from estimators.rigid_body import RigidBodyModel
from estimators.training import TrainingSettings
from limo_driver.errors import NotFittedError, ShapeError
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation
from limo_driver.recording import Recording
from limo_driver.types import JointSample, Motion

RATE = 200.0
NOMINAL = Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, 8)))
BANDWIDTH = 10.0


def hybrid(model: str, features: str) -> HybridModel:
    settings = TrainingSettings(
        model=model, features=features, epochs=1, sequence_length=20, rate=50.0, hidden=4
    )
    return HybridModel(NOMINAL, settings)


ESTIMATORS = {
    "rigid-body": lambda: RigidBodyModel("iiwa14"),
    "mlp7": lambda: hybrid("mlp7", "all-joints"),
    "mlp7 drive": lambda: hybrid("mlp7", "drive"),
    "lstm-fcl": lambda: hybrid("lstm-fcl", "all-joints"),
    "lstm-2": lambda: hybrid("lstm-2", "all-joints"),
    "transformer": lambda: hybrid("transformer", "all-joints"),
    "lstm-fcl own-joint": lambda: hybrid("lstm-fcl", "own-joint"),
    "joint-physics": lambda: JointPhysics(NOMINAL),
}


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Return 8 s of LIMO motion with a gap, torque from hysteretic joints."""
    random = np.random.default_rng(0)
    t = np.arange(1600) / RATE
    t[800:] += 0.5
    angle = 2 * np.pi * t[:, None] * random.uniform(0.3, 1.2, 7) + random.uniform(0, 6, 7)
    position = np.deg2rad([10, 40, -20, -70, 30, 50, -40]) + 0.04 * np.sin(angle)
    motion = Motion(t, position, np.gradient(position, t, axis=0), np.zeros_like(position))
    slip = PreslidingHysteresis(joint=2, stiffness=(300.0,), width=(0.004,))
    torque = Simulation("iiwa14", (slip,)).predict(motion)
    return Recording.from_arrays(t, position, torque + 0.02 * random.standard_normal(torque.shape))


@pytest.fixture(scope="module", params=ESTIMATORS)
def estimator(request: pytest.FixtureRequest, recording: Recording) -> InverseDynamics:
    return ESTIMATORS[request.param]().fit([recording])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_follows_the_protocol(name: str) -> None:
    assert isinstance(ESTIMATORS[name](), InverseDynamics)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_predicts_nothing_before_fit(name: str, recording: Recording) -> None:
    with pytest.raises(NotFittedError, match="not fitted"):
        ESTIMATORS[name]().predict(recording)


def test_scanning_step_equals_predict(estimator: InverseDynamics, recording: Recording) -> None:
    predicted = estimator.predict(recording)
    motion = recording.motion(BANDWIDTH)
    assert len(recording.segments) == 2
    for rows in recording.segments:
        # A hybrid is told how fast it will be called; others have no rate.
        fast = isinstance(estimator, HybridModel)
        state = estimator.init(RATE) if fast else estimator.init()
        for t in range(rows.start, rows.stop):
            torque, state = estimator.step(state, motion.sample(t))
            np.testing.assert_allclose(torque, predicted[t], atol=1e-6)


def test_step_leaves_the_state_it_was_given(
    estimator: InverseDynamics, recording: Recording
) -> None:
    motion = recording.motion(BANDWIDTH)
    state = estimator.init()
    for t in range(20):
        _, state = estimator.step(state, motion.sample(t))
    first, _ = estimator.step(state, motion.sample(20))
    again, _ = estimator.step(state, motion.sample(20))
    np.testing.assert_array_equal(first, again)


def test_shape_is_that_of_the_recording(estimator: InverseDynamics, recording: Recording) -> None:
    predicted = estimator.predict(recording)
    assert predicted.shape == recording.torque.shape
    assert np.isfinite(predicted).all()


def test_estimates_say_how_sure_they_are(estimator: InverseDynamics, recording: Recording) -> None:
    if isinstance(estimator, RigidBodyModel):
        pytest.skip("a rigid body says nothing of its errors")
    estimate = estimator.estimate(recording)
    np.testing.assert_array_equal(estimate.torque, estimator.predict(recording))
    assert estimate.std.shape == estimate.outside.shape == recording.torque.shape
    assert (estimate.std > 0).all()
    assert estimate.outside.dtype == bool


def test_torque_of_the_recording_is_not_looked_at(
    estimator: InverseDynamics, recording: Recording
) -> None:
    other = Recording.from_arrays(recording.time, recording.position, 0.5 * recording.torque + 1.0)
    np.testing.assert_array_equal(estimator.predict(other), estimator.predict(recording))


def test_another_number_of_joints_is_refused(estimator: InverseDynamics) -> None:
    six = np.zeros(6)
    with pytest.raises(ShapeError, match="7"):
        estimator.step(estimator.init(), JointSample(0.0, six, six, six))
