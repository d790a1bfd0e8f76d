"""What a fit leaves open is an error on motion that shows it, and little on motion like it."""

from __future__ import annotations

import numpy as np
import pytest
from wandering import wander

from estimators.diagnosis.from_torque.fitting.intervals import Foreseen
from estimators.diagnosis.from_torque.fitting.linearised import Linearised
from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.physics import CoulombFriction, Simulation, Tolerances, ViscousFriction
from limo_driver.recordings.recording import Recording

RATE, NOISE = 100.0, 0.02  # [Hz], [N m]
RUBBING = (CoulombFriction(joint=1, tau_c=1.0), ViscousFriction(joint=1, f_v=2.0))
TRUE = (RUBBING[0], ViscousFriction(joint=1, f_v=2.5))
GIVEN = Simulation("iiwa14", RUBBING, tolerances=Tolerances(inertia=1e-4, friction=0.25))


def moved(seed, pace):
    """Record twenty seconds of wandering at a pace [Hz]."""
    time = np.arange(0.0, 20.0, 1.0 / RATE)
    motion = wander(time, np.zeros(7), seed, (0.5 * pace, pace), (0.2, 0.3))
    torque = Simulation("iiwa14", TRUE).predict(motion)
    torque += NOISE * np.random.default_rng(seed).standard_normal(torque.shape)
    recording = Recording.from_arrays(time, motion.position, torque, source=f"{pace} Hz")
    return Observations.of(GIVEN, [recording], 10.0)


@pytest.fixture(scope="module")
def slow():
    return Foreseen.of(moved(1, 0.02), GIVEN, ())


@pytest.mark.slow("fits an arm of seven joints to three recordings")
def test_a_slope_learned_from_slow_motion_is_open_at_speed(slow):
    near, far = slow.rms(moved(2, 0.02)), slow.rms(moved(3, 0.5))
    assert far[0] > 4 * near[0]
    assert near[0] < NOISE


def test_nothing_is_open_that_is_certain(slow):
    assert slow.rms(moved(3, 0.5))[4] < 0.1 * slow.rms(moved(3, 0.5))[0]


@pytest.fixture(scope="module")
def known(rigid, training_recording):
    """What recordings of an arm of two joints show beside what is stated of it."""
    return Observations.of(rigid, [training_recording], 10.0)


@pytest.mark.parametrize("joint", [1, 2])
def test_of_a_body_that_was_found_nothing_was_known(rigid, known, joint):
    found = Foreseen.of(known, rigid, [("link_inertia", (joint,), False)])
    expected = Linearised.of(known, (), [joint - 1], rigid).root()
    np.testing.assert_array_equal(found.root, expected)
    assert not np.array_equal(found.root, Foreseen.of(known, rigid, ()).root)


def test_nothing_is_foreseen_of_a_joint_that_rests(rigid, known, training_recording):
    position = training_recording.position * [1.0, 0.0]
    still = Recording.from_arrays(training_recording.time, position, training_recording.torque)
    found = Foreseen.of(known, rigid, ()).rms(Observations.of(rigid, [still], 10.0))
    assert found[0] > 0.0
    assert found[1] == 0.0


def test_the_same_motion_twice_foresees_the_same(rigid, known, training_recording):
    found, twice = Foreseen.of(known, rigid, ()), [training_recording, training_recording]
    np.testing.assert_allclose(found.rms(Observations.of(rigid, twice, 10.0)), found.rms(known))
