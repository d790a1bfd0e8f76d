"""Noise of positions, twice differentiated, is not compared with torques."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.residuals.noise import clear_bandwidth
from limo_driver.app.library.diagnosing import diagnose
from limo_driver.physics import Armature, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types.motion import Motion

RATE, SECONDS, USUAL = 30.0, 40.0, 10.0  # [Hz], [s], [Hz]
LINKS = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
<body><joint name="shoulder" axis="0 1 0" range="-3 3"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.06" mass="8"/>
<body pos="0 0 0.5"><joint name="elbow" axis="0 1 0" range="-3 3"/>
<geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05" mass="5"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(LINKS)
    return Simulation(path, ())


def recorded(arm, of_encoder, speed=1.0, seconds=SECONDS):
    """Return slow motion by encoders with white noise [rad]; torques are known to 0.02 N m."""
    time = np.arange(round(seconds * RATE)) / RATE
    rate = speed * 2 * np.pi * np.array([0.11, 0.17])
    phase = np.outer(time, rate)
    position, velocity = np.sin(phase), rate * np.cos(phase)
    torque = arm.predict(Motion(time, position, velocity, -(rate**2) * position))
    noise = np.random.default_rng(3)
    return Recording.from_arrays(
        time,
        position + noise.normal(0.0, of_encoder, position.shape),
        torque + noise.normal(0.0, 0.02, torque.shape),
    )


def test_motion_that_is_known_well_is_compared_as_far_as_it_was_sampled(arm):
    assert clear_bandwidth(arm, [recorded(arm, 1e-6)], USUAL) == USUAL


def test_frequencies_at_which_accelerations_are_noise_are_left_out(arm):
    noisy = recorded(arm, 1e-3)
    assert 1.0 <= clear_bandwidth(arm, [noisy], USUAL) <= USUAL / 2
    assert clear_bandwidth(arm, [noisy, recorded(arm, 1e-3, 1.3)], USUAL) <= USUAL / 2


def test_few_rows_stay(arm):
    for seconds, expected in ((4.7, USUAL), (5.0, USUAL / 2)):
        assert clear_bandwidth(arm, [recorded(arm, 1e-3, seconds=seconds)], USUAL) == expected


def test_what_rotors_need_counts_as_what_links_need(arm):
    """Those of a wrist with harmonic drives need a hundred times as much as its links."""
    rotors = Armature(joint=1, inertia=100.0), Armature(joint=2, inertia=9.0)
    geared = replace(arm, effects=rotors)
    slight = recorded(geared, 1e-5)
    assert clear_bandwidth(geared, [slight], USUAL) < USUAL
    assert clear_bandwidth(arm, [slight], USUAL) == USUAL


def test_noise_counts_beside_errors_however_large_where_no_lag_would_leave_so_little(arm):
    """A lag was named that took the noise of a hundred times the torque out of a simulation."""
    geared = replace(
        arm, effects=(Armature(joint=1, inertia=100.0), Armature(joint=2, inertia=9.0))
    )
    clear, noisy = recorded(geared, 1e-6), recorded(geared, 1e-4)
    off = 200.0 * np.sin(clear.time)[:, None]  # [N m], of what is not known of the arm
    clear, noisy = (
        Recording.from_arrays(one.time, one.position, one.torque + off) for one in (clear, noisy)
    )
    assert clear_bandwidth(geared, [noisy], USUAL) < USUAL
    assert clear_bandwidth(geared, [clear], USUAL) == USUAL


def test_fast_motion_is_no_noise_even_of_bodies_that_are_half_too_heavy(arm):
    fast = recorded(arm, 1e-6, speed=25.0)
    light = Recording.from_arrays(fast.time, fast.position, fast.torque / 1.5)
    assert clear_bandwidth(arm, [light], USUAL) == USUAL


def test_a_diagnosis_says_so_and_one_that_is_told_a_bandwidth_keeps_it(arm):
    noisy = recorded(arm, 1e-3)
    lower = diagnose(arm, noisy, budget=1.0)
    told = diagnose(arm, noisy, bandwidth=USUAL, budget=1.0)
    assert lower.bandwidth <= USUAL / 2 < told.bandwidth == USUAL
    notes = [
        any("noise of the positions" in note for note in found.verdict.notes)
        for found in (lower, told)
    ]
    assert notes == [True, False]
