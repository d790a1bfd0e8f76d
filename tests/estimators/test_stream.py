"""A stream: scanning live positions equals its batch, and nearly the zero-phase prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lanes import later
from wandering import wander

from estimators.hybrid import HybridModel
from estimators.hybrid.features import FEATURE_SETS
from estimators.hybrid.training.settings import TrainingSettings
from estimators.stream import Stream
from limo_driver.errors import (
    ConfigError,
    ModelStoreError,
    NotFittedError,
    RecordingError,
    ShapeError,
)
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

POSE = np.deg2rad([10, 40, -20, -70, 30, 50, -40])
NOMINAL = Simulation(
    "iiwa14",
    tuple(
        effect
        for j in range(1, 8)
        for effect in (CoulombFriction(joint=j, tau_c=1.0), ViscousFriction(joint=j, f_v=2.0))
    ),
)
TRUE = Simulation("iiwa14", (PreslidingHysteresis(joint=2, stiffness=(300.0,), width=(0.004,)),))


def record(rate: float, duration: float = 5.0, seed: int = 0) -> Recording:
    """Return small motion of an iiwa 14, with a gap in the middle."""
    t = np.arange(int(duration * rate)) / rate
    t[t.size // 2 :] += 0.4
    motion = wander(t, POSE, seed, (0.1, 0.8), (0.01, 0.04))
    return Recording.from_arrays(t, motion.position, TRUE.predict(motion))


KINDS = [(model, features) for model in ("mlp7", "lstm-fcl") for features in FEATURE_SETS]


@pytest.fixture(
    scope="module", params=later(KINDS, "each is trained, and streamed step by step"), ids="-".join
)
def model(request: pytest.FixtureRequest) -> HybridModel:
    kind, features = request.param
    settings = TrainingSettings(
        model=kind, features=features, epochs=1, sequence_length=20, rate=50.0, hidden=6, folds=1
    )
    return HybridModel(NOMINAL, settings).fit([record(200.0)])


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_scanning_equals_predict_and_a_gap_starts_anew(model: HybridModel, rate: float) -> None:
    recording, stream = record(rate, 2.4, seed=1), Stream(model, rate, 0.05)
    assert len(recording.segments) == 2
    predicted, state, scanned = stream.predict(recording), stream.init(), []
    for time, position in zip(recording.time, recording.position, strict=True):
        late, state = stream.step(state, time, position)
        assert late.measured is None
        scanned.append(late.torque)
    np.testing.assert_allclose(scanned, predicted, rtol=0, atol=1e-9)
    second = recording[recording.segments[1]]
    np.testing.assert_allclose(
        predicted[recording.segments[1]], stream.predict(second), rtol=0, atol=1e-9
    )


def test_a_stream_is_the_zero_phase_prediction_a_delay_late(model: HybridModel) -> None:
    rate = 500.0
    t = np.arange(int(8 * rate)) / rate
    # It starts at rest, as a stream takes it for granted.
    position = POSE + (wander(t, POSE, 3, (0.1, 0.8), (0.01, 0.04)).position - POSE) * (
        1 - np.exp(-((t[:, None] / 1.5) ** 4))
    )
    recording = Recording.from_arrays(t, position, position)
    stream = Stream(model, rate, 0.1)
    late, zero = stream.predict(recording), model.predict(recording)
    D = round(stream.delay * rate)
    error = (late[D:] - zero[:-D])[500:-500]
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.02 * zero.std(axis=0).max()


def test_a_step_leaves_its_state(model: HybridModel) -> None:
    stream, recording = Stream(model, 200.0), record(200.0, 1.0)
    state = stream.init()
    for time, position in zip(recording.time[:30], recording.position[:30], strict=True):
        _, state = stream.step(state, time, position)
    first, _ = stream.step(state, recording.time[30], recording.position[30])
    again, _ = stream.step(state, recording.time[30], recording.position[30])
    np.testing.assert_array_equal(first.torque, again.torque)


def test_what_does_not_fit_is_refused(model: HybridModel) -> None:
    with pytest.raises(ConfigError, match=r"delay of 0\.01 s is 2 samples at 200 Hz"):
        Stream(model, 200.0, 0.01)
    with pytest.raises(ConfigError, match="10 Hz is too high for positions at 20 Hz"):
        Stream(model, 20.0)
    with pytest.raises(RecordingError, match="sampled at 250 Hz, expected 200 Hz"):
        Stream(model, 200.0).predict(record(250.0, 1.0))
    stream = Stream(model, 200.0)
    with pytest.raises(ShapeError, match=r"position .*expected \(7,\)"):
        stream.step(stream.init(), 0.0, np.zeros(6))
    with pytest.raises(ShapeError, match=r"torque .*expected \(7,\)"):
        stream.step(stream.init(), 0.0, np.zeros(7), np.zeros(6))
    with pytest.raises(ShapeError, match=r"position .*expected \(2, 7\)"):
        stream.advance(stream.init(), np.arange(2.0), np.zeros((3, 7)))
    with pytest.raises(ShapeError, match="T at least 1"):
        stream.advance(stream.init(), np.zeros(0), np.zeros((0, 7)))
    with pytest.raises(RecordingError, match="have to be finite"):
        stream.step(stream.init(), 0.0, np.full(7, np.nan))


def test_torque_comes_with_every_position_or_with_none(model: HybridModel) -> None:
    stream = Stream(model, 200.0)
    _, state = stream.step(stream.init(), 0.0, POSE, np.zeros(7))
    with pytest.raises(
        RecordingError, match=r"0\.005 s comes without torque, those before came with"
    ):
        stream.step(state, 0.005, POSE)
    _, state = stream.step(stream.init(), 0.0, POSE)
    with pytest.raises(RecordingError, match="comes with torque, those before came without"):
        stream.step(state, 0.005, POSE, np.zeros(7))
    with pytest.raises(RecordingError, match="values have to be finite"):
        stream.step(stream.init(), 0.0, POSE, np.full(7, np.nan))


def test_measured_torque_is_as_late_and_as_smooth_as_the_estimate() -> None:
    recording, stream = record(500.0, 8.0, seed=4)[:2000], Stream(TRUE, 500.0, 0.1)
    rough = 0.5 * np.random.default_rng(0).standard_normal(recording.torque.shape)
    late, _ = stream.advance(
        stream.init(), recording.time, recording.position, recording.torque + rough
    )
    assert late.measured is not None
    settled = slice(2 * round(stream.delay * 500.0), None)
    external = (late.measured - late.torque)[settled]
    # 10 Hz of 250 Hz are left of the noise
    assert 0.02 < external.std() < 0.15
    assert abs(external.mean()) < 0.01


def reversed_and_rested(rate: float) -> tuple[Recording, np.ndarray]:
    """Return a recording that a simulation is right about, and what its velocities truly are."""
    t = np.arange(int(9 * rate)) / rate
    grown = np.clip((t[:, None] - 2.0) / 0.5, 0, 1) * np.clip((7.0 - t[:, None]) / 0.5, 0, 1)
    position = POSE + 0.2 * (3 * grown**2 - 2 * grown**3) * np.sin(2 * np.pi * 0.5 * t[:, None])
    velocity = np.gradient(position, t, axis=0)
    torque = NOMINAL.predict(Motion(t, position, velocity, np.gradient(velocity, t, axis=0)))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(position.shape)
    return Recording.from_arrays(t, position + noise, torque), velocity


@pytest.mark.parametrize("delay", [0.1, 0.04])
def test_friction_of_physics_alone_does_not_chatter_at_rest(delay: float) -> None:
    recording, velocity = reversed_and_rested(500.0)
    pushed = recording.torque.copy()
    pushed[3900:, 1] += 0.5  # [N m], on an arm at rest
    stream = Stream(NOMINAL, 500.0, delay)
    late, _ = stream.advance(stream.init(), recording.time, recording.position, pushed)
    assert late.measured is not None
    external = (late.measured - late.torque)[stream.samples :]
    rest = recording.time[: -stream.samples] < 1.8
    rest[: 2 * stream.samples + 100] = False
    assert np.abs(external[rest]).max() < 0.01  # of 1 N m of dry friction
    after = recording.time[: -stream.samples] > 7.9
    assert external[after, 1] == pytest.approx(0.5, abs=0.01)
    moves = np.abs(velocity).max(axis=1)[: -stream.samples] > 0.01
    assert np.sqrt(np.mean(external[moves] ** 2)) < {0.1: 0.06, 0.04: 0.3}[delay]


def test_physics_alone_is_filtered_after_its_friction_where_there_is_time() -> None:
    sharp, smooth = Stream(NOMINAL, 500.0, 0.1), Stream(NOMINAL, 500.0, 0.04)
    assert (sharp.delay, smooth.delay) == (0.1, 0.04)
    assert sharp.smoother is not None
    assert sharp.differentiator.samples + sharp.smoother.samples == 50
    assert smooth.smoother is None
    assert Stream(NOMINAL, 30.0, 0.1).smoother is None  # of 3 samples
    assert not sharp.remembers_like(smooth)
    assert sharp.remembers_like(Stream(NOMINAL, 500.0, 0.1))


def test_a_memory_needs_a_rate_that_it_can_reach(model: HybridModel) -> None:
    if model.fitted.network.recurrent:
        with pytest.raises(ModelStoreError, match="remembers at 50 Hz"):
            Stream(model, 70.0)
    else:
        assert Stream(model, 70.0).delay == pytest.approx(0.1)


def test_an_untrained_model_has_no_stream() -> None:
    with pytest.raises(NotFittedError, match="not fitted"):
        Stream(HybridModel(NOMINAL), 200.0)


@pytest.mark.parametrize(("own", "expected"), [(None, 10.0), (20.0, 20.0), (7.0, 7.0)])
def test_a_bare_simulation_is_streamed_at_its_own_bandwidth(own, expected):
    stream = Stream(replace(TRUE, bandwidth=own), 500.0, 0.2)
    assert stream.model.bandwidth == expected
