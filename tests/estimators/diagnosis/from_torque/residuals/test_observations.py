"""Observations: one filter for torque and columns, rows thinned, rest and edges left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.responses import response
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.settings.residuals import ROWS
from limo_driver.errors import RecordingError
from limo_driver.physics import CoulombFriction, TorqueOffset
from limo_driver.physics.effects.friction import SIGN_WIDTH
from limo_driver.recordings.recording import Recording

BANDWIDTH = 10.0  # [Hz]


@pytest.fixture(scope="module")
def observed(rigid, training_recording):
    return Observations.of(rigid, [training_recording], BANDWIDTH)


def test_a_joint_rests_where_it_dwells_within_the_sign_of_the_stated_friction(rigid):
    """At 5 mrad/s for 3 s, friction stated over 20 mrad/s can be anything; a reversal is motion."""
    t = np.arange(0.0, 30.0, 0.01)
    creeps = (t > 12.0) & (t < 15.0)
    velocity = np.where(creeps, 0.005, 0.4 * np.cos(1.3 * t))
    position = np.stack([np.cumsum(velocity) * 0.01, 0.5 * np.sin(t)], axis=1)
    recording = Recording.from_arrays(t, position, np.zeros_like(position))
    wide = CoulombFriction(joint=1, tau_c=1.0, v_eps=0.02)
    sharp, smooth = (
        Observations.of(replace(rigid, effects=effects), [recording], 10.0)
        for effects in ((), (wide,))
    )
    assert smooth.sign_width.tolist() == [0.02, *sharp.sign_width[1:]]
    inside = (sharp.slow.time > 12.3) & (sharp.slow.time < 14.7)
    assert sharp.moving[inside, 0].all()
    assert not smooth.moving[inside, 0].any()
    away = (sharp.slow.time < 11.0) | (sharp.slow.time > 16.0)
    assert (smooth.moving[away] == sharp.moving[away]).all()


def test_torque_and_columns_pass_the_same_filter(observed, training_recording):
    """A column that equals the recorded torque explains it entirely, noise and all."""
    np.testing.assert_allclose(
        observed.filter(training_recording.torque), observed.measured, atol=1e-9
    )


def test_the_residual_of_what_made_the_torque_is_its_noise(true_arm, training_recording):
    observed = Observations.of(true_arm, [training_recording], BANDWIDTH)
    passed = np.sqrt(2 * BANDWIDTH / training_recording.rate)  # of white noise
    size = np.sqrt(np.mean(observed.residual[observed.moving.all(axis=1)] ** 2, axis=0))
    assert np.all(size < 1.3 * 0.02 * passed)


def test_a_response_is_what_the_simulation_itself_would_add(observed, rigid):
    offset, friction = TorqueOffset(joint=2, offset=0.3), CoulombFriction(joint=1, tau_c=0.4)
    for effect in (offset, friction):
        added = replace(rigid, effects=(*rigid.effects, effect))
        joints, values = response(effect, observed)
        difference = observed.filter(observed.predict(added) - observed.predicted)
        assert joints == (effect.joint - 1,)
        np.testing.assert_allclose(values[0], difference[:, effect.joint - 1], atol=1e-9)


def test_rows_are_thinned_to_what_the_bandwidth_leaves(observed, training_recording):
    expected = training_recording.duration * ROWS.per_bandwidth * BANDWIDTH
    assert observed.kept.size == pytest.approx(expected, rel=0.02)
    assert observed.row_period == pytest.approx(1 / (ROWS.per_bandwidth * BANDWIDTH), rel=0.05)
    assert not training_recording.edges(BANDWIDTH)[observed.kept].any()


def test_a_fast_recording_is_thinned_before_and_gives_the_same_rows(true_arm, rigid):
    rate = 4 * ROWS.samples_per_bandwidth * BANDWIDTH
    t = np.arange(int(20 * rate)) / rate
    angle = 2 * np.pi * np.array([0.3, 0.4]) * t[:, None]
    position = np.array([0.4, -0.8]) + 0.05 * np.sin(angle)
    fast = Recording.from_arrays(t, position, true_arm.predict(
        Recording.from_arrays(t, position, np.cos(angle))))  # fmt: skip
    thin = Observations.of(rigid, [fast], BANDWIDTH)
    assert len(thin.motion) == pytest.approx(len(fast) / 4, abs=1)
    slow = Observations.of(rigid, [fast[::4]], BANDWIDTH)
    assert slow.kept.size == thin.kept.size
    np.testing.assert_allclose(thin.measured, slow.measured, atol=2e-3)


@pytest.mark.parametrize("bandwidth", [5.0, 10.0])
def test_rows_as_near_to_rest_as_the_filter_reaches_are_not_moving(
    rigid, training_recording, bandwidth
):
    observed = Observations.of(rigid, [training_recording], bandwidth)
    speed = np.abs(observed.motion.velocity)
    time, kept = observed.motion.time, observed.kept
    reach = 1.0 / bandwidth
    assert reach == 1.0 / bandwidth
    moves = observed.moving[:, 0]
    for row, moving in zip(kept[::7], moves[::7], strict=True):
        away = np.abs(time - time[row])
        assert speed[away <= 1.2 * reach + 0.01, 0].min() < ROWS.rest * SIGN_WIDTH or moving
        assert speed[away <= 0.8 * reach, 0].min() >= ROWS.rest * SIGN_WIDTH or not moving
    assert 0.2 < moves.mean() < 0.99


def test_a_held_joint_is_at_rest_throughout(rigid):
    t = np.arange(3000) / 100.0
    position = np.stack([0.3 * np.sin(t), np.full(t.size, 0.5)], axis=1)
    recording = Recording.from_arrays(t, position, np.cos(t)[:, None] * np.ones(2))
    observed = Observations.of(rigid, [recording], BANDWIDTH)
    assert not observed.moving[:, 1].any()
    assert observed.moving[:, 0].mean() > 0.8


def test_the_distance_since_reversal_starts_at_nothing_and_grows(observed):
    since, v = observed.since_reversal[:, 0], observed.motion.velocity[:, 0]
    turned = np.flatnonzero(np.diff(np.sign(v)) != 0) + 1
    np.testing.assert_array_equal(since[turned], 0.0)
    between = np.setdiff1d(np.arange(1, v.size), turned)
    assert np.all(np.diff(since)[between - 1] > -1e-9)


def test_recordings_stay_apart(rigid, training_recording, test_recording):
    both = Observations.of(rigid, [training_recording, test_recording], BANDWIDTH)
    alone = Observations.of(rigid, [test_recording], BANDWIDTH)
    second = both.recording == 1
    assert second.sum() == alone.kept.size
    np.testing.assert_allclose(both.residual[second], alone.residual, atol=1e-9)
    assert np.unique(both.segment).tolist() == [0, 1]


def test_a_gap_makes_two_segments_in_one_recording(rigid, training_recording):
    rows = np.r_[0:2500, 3000:6000]
    observed = Observations.of(rigid, [training_recording[rows]], BANDWIDTH)
    assert len(observed.segments) == 2
    assert np.unique(observed.segment).tolist() == [0, 1]
    assert np.unique(observed.recording).tolist() == [0]
    time = observed.slow.time[observed.segment == 1]
    assert time.min() >= training_recording.time[3000] + 0.5 / BANDWIDTH


def test_too_short_is_refused_in_one_line(rigid, training_recording):
    with pytest.raises(RecordingError, match=r"leave \d+ independent rows .* record for longer"):
        Observations.of(rigid, [training_recording[:200]], BANDWIDTH)


def test_a_bandwidth_that_the_sampling_does_not_allow_is_refused(rigid, training_recording):
    with pytest.raises(RecordingError, match="give more than 0 and at most 40 Hz"):
        Observations.of(rigid, [training_recording], 45.0)


def test_derivatives_by_position_are_those_of_the_body(observed, rigid):
    slow, step = observed.slow, 1e-4
    moved = slow.position + np.array([step, 0.0])
    body = rigid.body
    change = body.inverse_dynamics(moved, slow.velocity, slow.acceleration)
    change -= body.inverse_dynamics(slow.position, slow.velocity, slow.acceleration)
    np.testing.assert_allclose(observed.stiffness[0], change.T / step, atol=2e-3)


def test_rows_of_the_mass_matrix_are_symmetric_and_positive(observed):
    M = observed.inertia.transpose(2, 0, 1)  # (K, n, n)
    np.testing.assert_allclose(M, M.transpose(0, 2, 1), atol=1e-9)
    assert np.linalg.eigvalsh(M).min() > 0


def test_what_is_kept_beside_another_simulation_is_what_it_would_be_anew(
    rigid, true_arm, training_recording
):
    observed = Observations.of(rigid, [training_recording], BANDWIDTH)
    names = ("residual", "load", "predicted", "stiffness", "inertia", "moving", "since_reversal")
    for name in names:
        getattr(observed, name)
    pushed = np.arange(observed.kept.size) < 50
    for near, anew in (
        (observed.under(true_arm), Observations.of(true_arm, [training_recording], BANDWIDTH)),
        (
            observed.under(true_arm, around=rigid),
            replace(Observations.of(true_arm, [training_recording], BANDWIDTH), around=rigid),
        ),
        (
            observed.undisturbed(pushed),
            replace(Observations.of(rigid, [training_recording], BANDWIDTH), disturbed=pushed),
        ),
    ):
        for name in names:
            np.testing.assert_array_equal(getattr(near, name), getattr(anew, name), err_msg=name)
    assert not observed.undisturbed(pushed).moving[:50].any()
    assert observed.undisturbed(pushed).undisturbed(None).moving[:50].any()


def test_signals_that_are_filtered_together_are_filtered_as_each_alone(observed):
    signals = [np.sign(observed.motion.velocity), observed.motion.position[:, :1]]
    expected = np.concatenate([observed.filter(values) for values in signals], axis=1)
    found = observed.filter_together(signals)
    assert found.shape == (observed.kept.size, observed.n + 1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
