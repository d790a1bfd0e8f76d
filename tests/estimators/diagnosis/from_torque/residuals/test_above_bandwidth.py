"""Most of the error above the bandwidth is told, with where it lies and what would show it."""

from __future__ import annotations

import numpy as np
import pytest
from wandering import wander

from estimators.diagnosis.from_torque.residuals.noise import above_note
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording


@pytest.fixture
def noted(arm):
    """Make a function that records an arm of two joints with a hum at the second [N m]."""
    simulation = Simulation(str(arm))

    def note(hum: float, rate: float = 500.0) -> str:
        time = np.arange(0.0, 10.0, 1.0 / rate)
        moved = wander(time, np.zeros(2), 1, (0.03, 0.12), (0.2, 0.5))
        torque = simulation.predict(moved)
        torque += 0.02 * np.random.default_rng(2).standard_normal(torque.shape)
        torque[:, 1] += hum * np.sin(2.0 * np.pi * 61.0 * time)
        return above_note(simulation, [Recording.from_arrays(time, moved.position, torque)], 10.0)

    return note


def test_a_hum_is_told_with_its_frequency_and_the_bandwidth_that_shows_it(noted):
    note = noted(0.3)

    assert "joint 2" in note
    assert "99% of the squares" in note
    assert "from 60.5 to 61.5 Hz" in note
    assert "`--bandwidth 80` looks at it" in note


def test_a_hum_that_no_bandwidth_shows_is_told_to_be_so(noted):
    assert "with 130 samples a second, no bandwidth shows it" in noted(0.3, rate=130.0)


def test_white_noise_is_no_band(noted):
    assert not noted(0.0)
