"""What a diagnosis reads of long recordings, and the bandwidth at which it compares noisy ones."""

from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled

from limo_driver.app.library import diagnosing
from limo_driver.physics import Armature, CoulombFriction, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types.motion import Motion


def still(seconds, rate):
    time = np.arange(round(seconds * rate)) / rate
    return Recording.from_arrays(time, np.zeros((time.size, 1)), np.zeros((time.size, 1)))


@sampled(
    ("rate", "bandwidth", "read"),
    [
        (100.0, 10.0, 800.0),  # 20 000 rows of 1/25 s
        (100.0, 5.0, 1600.0),  # as many rows, of 1/12.5 s
        (1000.0, 10.0, 500.0),  # 500 000 samples are fewer rows than that
    ],
    "an hour at 1 kHz",
    first=2,
)
def test_of_an_hour_it_reads_as_many_rows_as_time_and_memory_bear(rate, bandwidth, read):
    (part,) = diagnosing._within_memory((still(3600.0, rate),), bandwidth)
    assert read / 2 < len(part) / rate <= read
    assert part.time[-1] > 3400.0  # from all of it
    assert "stretches" in part.warnings[-1]


def test_of_two_recordings_it_reads_the_same_part():
    long, short = still(3600.0, 100.0), still(1800.0, 100.0)
    parts = diagnosing._within_memory((long, short), 10.0)
    assert sum(map(len, parts)) <= 800.0 * 100.0
    assert len(parts[0]) > len(parts[1])


def test_ten_minutes_are_read_whole():
    recording = still(600.0, 250.0)
    assert diagnosing._within_memory((recording,), 10.0) == (recording,)


def test_recordings_that_are_shorter_than_a_stretch_are_read_whole_however_many():
    many = tuple(still(20.0, 100.0) for _ in range(60))
    parts = diagnosing._within_memory(many, 10.0)
    assert all(part is whole for part, whole in zip(parts, many, strict=True))


@pytest.fixture(scope="module")
def arm(two_links_urdf):
    return Simulation(str(two_links_urdf), ())


def recorded(arm, of_encoder, seconds=40.0, rate=30.0):
    """Return slow motion by encoders with white noise [rad]; torques are known to 0.02 N m."""
    time = np.arange(round(seconds * rate)) / rate
    speed = 2 * np.pi * np.array([0.11, 0.17])
    phase = np.outer(time, speed)
    position, velocity = np.sin(phase), speed * np.cos(phase)
    torque = arm.predict(Motion(time, position, velocity, -(speed**2) * position))
    noise = np.random.default_rng(3)
    return Recording.from_arrays(
        time,
        position + noise.normal(0.0, of_encoder, position.shape),
        torque + noise.normal(0.0, 0.02, torque.shape),
    )


@pytest.fixture(scope="module")
def noisy(arm):
    return recorded(arm, 3e-3)


def test_motion_that_is_known_well_is_compared_at_the_usual_bandwidth(arm):
    assert diagnosing._bandwidth(arm, (recorded(arm, 1e-6),), None) == (10.0, ())


def test_noisy_motion_is_compared_at_a_lower_one_unless_one_is_told(arm, noisy):
    lower, (why,) = diagnosing._bandwidth(arm, (noisy,), None)
    assert lower < 10.0
    assert f"filtered at {lower:g} Hz" in why
    assert diagnosing._bandwidth(arm, (noisy,), 10.0) == (10.0, ())
    known = replace(arm, bandwidth=8.0)
    assert diagnosing._bandwidth(known, (noisy,), None) == (8.0, ())


def test_it_is_the_same_whether_what_needs_the_torque_is_stated_or_missing(arm):
    """Noise was looked for in the torque of what is stated alone, where rotors were missing."""
    rotors = Armature(joint=1, inertia=20.0), Armature(joint=2, inertia=9.0)
    geared = replace(arm, effects=rotors)
    slight = recorded(geared, 3e-4)
    lower, _ = diagnosing._bandwidth(arm, (slight,), None)
    assert lower == diagnosing._bandwidth(geared, (slight,), None)[0] < 10.0


def test_enough_rows_are_left(arm):
    short, long = (recorded(arm, 3e-3, seconds) for seconds in (4.5, 40.0))
    widths = [diagnosing._bandwidth(arm, (one,), None)[0] for one in (short, long)]
    assert widths[0] * 2.5 * 4.5 >= 60.0 > widths[1] * 2.5 * 4.5


def test_what_was_found_at_a_lower_bandwidth_is_written_with_it(arm):
    rubbing = replace(arm, effects=tuple(CoulombFriction(joint=j, tau_c=1.0) for j in (1, 2)))
    found = diagnosing.diagnose(arm, recorded(rubbing, 3e-3))
    assert found.bandwidth < 10.0
    assert found.simulation.bandwidth == found.bandwidth
    assert any("by the error on motion held out" in note for note in found.verdict.notes)
