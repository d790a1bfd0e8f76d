"""What a diagnosis reads of recordings that are longer than memory and time should bear."""

import numpy as np
from lanes import sampled

from limo_driver.app.library import diagnosing
from limo_driver.recordings.recording import Recording


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
