"""What every torque estimator keeps to."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import later, sampled

from estimators.base import InverseDynamics
from estimators.hybrid import HybridModel
from estimators.hybrid.features import FEATURE_SETS
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.neural import NETWORKS
from estimators.rigid_body import RigidBodyModel
from estimators.stream import Stream
from limo_driver.errors import NotFittedError, RecordingError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types import JointSample, Motion

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from estimators.stream import LiveEstimate

RATE = 200.0
BANDWIDTH = 10.0


def hybrid(robot: str, model: str, features: str) -> HybridModel:
    settings = TrainingSettings(
        model=model, features=features, epochs=1, sequence_length=20, rate=50.0, hidden=4, folds=2
    )
    return HybridModel(nominal(robot), settings)


def nominal(robot: str) -> Simulation:
    n = RobotModel.load(robot).n
    return Simulation(robot, tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, n + 1)))


# Each makes an estimator of a robot, which is not fitted yet.
ESTIMATORS: dict[str, Callable[[str], InverseDynamics]] = {
    "rigid-body": RigidBodyModel,
    **{
        f"{model} {features}": lambda robot, model=model, features=features: hybrid(
            robot, model, features
        )
        for model in NETWORKS
        for features in FEATURE_SETS
    },
    "joint-physics": lambda robot: JointPhysics(nominal(robot)),
}


def recorded(robot: str, seed: int = 0) -> Recording:
    """Return 8 s of LIMO motion with a gap, torque from a hysteretic joint and noise."""
    random, n = np.random.default_rng(seed), RobotModel.load(robot).n
    t = np.arange(1600) / RATE
    t[800:] += 0.5
    angle = 2 * np.pi * t[:, None] * random.uniform(0.3, 1.2, n) + random.uniform(0, 6, n)
    position = np.deg2rad([10, 40, -20, -70, 30, 50, -40])[:n] + 0.04 * np.sin(angle)
    motion = Motion(t, position, np.gradient(position, t, axis=0), np.zeros_like(position))
    slip = PreslidingHysteresis(joint=n, stiffness=(300.0,), width=(0.004,))
    torque = Simulation(robot, (slip,)).predict(motion)
    return Recording.from_arrays(t, position, torque + 0.02 * random.standard_normal(torque.shape))


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded("iiwa14")


QUICK = ("rigid-body", "mlp7 all-joints", "lstm-fcl own-joint")


@pytest.fixture(
    scope="module",
    params=later(
        [*QUICK, *(name for name in ESTIMATORS if name not in QUICK)],
        "each is fitted, and streamed step by step",
        first=len(QUICK),
    ),
)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def estimator(kind: str, recording: Recording) -> InverseDynamics:
    return ESTIMATORS[kind]("iiwa14").fit([recording])


@pytest.fixture(scope="module")
def robots(two_links_urdf: Path) -> dict[int, str]:
    """Name a robot of one joint and one of two."""
    one = re.sub(r'<link name="lower">.*?</link>|<joint name="b".*?</joint>', "",
                 two_links_urdf.read_text(), flags=re.DOTALL)  # fmt: skip
    path = two_links_urdf.with_name("one_link.urdf")
    path.write_text(one)
    return {1: str(path), 2: str(two_links_urdf)}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_follows_the_protocol(name: str) -> None:
    assert isinstance(ESTIMATORS[name]("iiwa14"), InverseDynamics)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_predicts_nothing_before_fit(name: str, recording: Recording) -> None:
    with pytest.raises(NotFittedError, match="not fitted"):
        ESTIMATORS[name]("iiwa14").predict(recording)
    with pytest.raises(NotFittedError, match="not fitted"):
        ESTIMATORS[name]("iiwa14").init()


@pytest.mark.slow("fits every estimator twice")
def test_fitting_again_forgets_what_was_fitted_before(
    kind: str, estimator: InverseDynamics, recording: Recording
) -> None:
    other = recorded("iiwa14", seed=1)
    again = ESTIMATORS[kind]("iiwa14")
    assert again.fit([other]) is again
    again.fit([recording])
    np.testing.assert_array_equal(again.predict(recording), estimator.predict(recording))


@sampled("name", ESTIMATORS, "fits each estimator", first=2)
def test_a_robot_of_one_joint(name: str, robots: dict[int, str]) -> None:
    measured = recorded(robots[1])
    predicted = ESTIMATORS[name](robots[1]).fit([measured]).predict(measured)
    assert predicted.shape == (1600, 1)
    assert np.isfinite(predicted).all()


@pytest.mark.parametrize("name", ESTIMATORS)
def test_nothing_to_fit_to_is_refused(name: str) -> None:
    with pytest.raises(RecordingError, match="no recording"):
        ESTIMATORS[name]("iiwa14").fit([])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_recording_of_another_robot_is_refused(
    name: str, recording: Recording, robots: dict[int, str]
) -> None:
    with pytest.raises(RecordingError, match="2 joints"):
        ESTIMATORS[name]("iiwa14").fit([recording, recorded(robots[2])])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_recording_shorter_than_its_filter_is_refused(name: str, recording: Recording) -> None:
    with pytest.raises(RecordingError, match=r"short|too low"):
        ESTIMATORS[name]("iiwa14").fit([recording[:8]])


@pytest.mark.parametrize("samples", [0, 1])
def test_a_recording_without_length_is_refused(
    kind: str, estimator: InverseDynamics, recording: Recording, samples: int
) -> None:
    nothing = recording[:samples]
    with pytest.raises(RecordingError, match="too short"):
        estimator.predict(nothing)
    for given in ([nothing], [recording, nothing]):
        with pytest.raises(RecordingError, match=r"no sample|too short|no torque ever changes"):
            ESTIMATORS[kind]("iiwa14").fit(given)


def test_scanning_step_equals_predict(estimator: InverseDynamics, recording: Recording) -> None:
    predicted = estimator.predict(recording)
    motion = recording.motion(BANDWIDTH)
    assert len(recording.segments) == 2
    for rows in recording.segments:
        state, scanned = estimator.init(RATE), []
        for t in range(rows.start, rows.stop):
            torque, state = estimator.step(state, motion.sample(t))
            scanned.append(torque)
        np.testing.assert_allclose(scanned, predicted[rows], atol=1e-6)


def test_scanning_a_stream_equals_its_batch(
    estimator: InverseDynamics, recording: Recording
) -> None:
    check_stream(estimator, recording)


def test_a_bare_simulation_streams_as_well(recording: Recording) -> None:
    late = check_stream(nominal("iiwa14"), recording)
    assert np.isnan(late.std).all()
    assert not late.learned.any()
    assert not late.outside.any()


def check_stream(model: InverseDynamics | Simulation, recording: Recording) -> LiveEstimate:
    """Step over the gap of the recording, and from where some of it was taken as a batch."""
    stream, rows = Stream(model, RATE, 0.05), slice(700, 1000)
    signals = recording.time[rows], recording.position[rows], recording.torque[rows]
    whole, _ = stream.advance(stream.init(), *signals)
    taken = 60
    _, state = stream.advance(stream.init(), *(values[:taken] for values in signals))
    for t in range(taken, len(signals[0])):
        one, state = stream.step(state, *(values[t] for values in signals))
        for name in ("time", "simulation", "learned", "torque", "std", "outside", "measured"):
            expected = getattr(whole, name)[t]
            np.testing.assert_allclose(getattr(one, name), expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(whole.torque, whole.simulation + whole.learned)
    np.testing.assert_allclose(whole.time, signals[0] - stream.delay)
    assert whole.outside.shape == whole.std.shape == signals[1].shape
    return whole


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
