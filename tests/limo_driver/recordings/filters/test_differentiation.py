"""Differentiation: the filter that every signal passes is the textbook's, both ways through it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt_zi, sosfiltfilt, sosfreqz

from limo_driver.recordings.filters.differentiation import ORDER, _filter, smooth

RATE, BANDWIDTH = 100.0, 5.0  # [Hz]


@pytest.mark.parametrize("columns", [1, 3, 40])
def test_away_from_the_ends_it_is_scipys_filter_of_each_column(columns):
    signal = np.cumsum(np.random.default_rng(columns).standard_normal((3000, columns)), axis=0)
    time = np.arange(3000) / RATE
    found = smooth(time, signal, BANDWIDTH, [slice(0, 3000)])
    sections = butter(ORDER, BANDWIDTH, fs=RATE, output="sos")
    expected = sosfiltfilt(sections, signal, axis=0, padlen=0)
    np.testing.assert_allclose(found[500:-500], expected[500:-500], atol=1e-5)


@pytest.mark.parametrize(("bandwidth", "rate"), [(10.0, 1000.0), (1.0, 1000.0), (20.0, 50.0)])
def test_the_filter_is_scipys_and_starts_in_its_steady_state(bandwidth, rate):
    sections, steady = _filter(bandwidth, 1.0 / rate)
    expected = butter(ORDER, bandwidth, fs=rate, output="sos")
    frequencies = np.linspace(0.0, 3.0, 100)
    found, reference = (sosfreqz(s, frequencies)[1] for s in (sections, expected))
    np.testing.assert_allclose(found, reference, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(steady, sosfilt_zi(sections), rtol=1e-9)


def test_a_column_does_not_depend_on_those_beside_it_nor_is_what_was_given_changed():
    signal = np.random.default_rng(0).standard_normal((500, 30))  # wider than few
    given, time = signal.copy(), np.arange(500) / RATE
    together = smooth(time, signal, BANDWIDTH, [slice(0, 200), slice(200, 500)])
    np.testing.assert_array_equal(signal, given)
    for k in range(30):
        alone = smooth(time, signal[:, k : k + 1], BANDWIDTH, [slice(0, 200), slice(200, 500)])
        np.testing.assert_allclose(together[:, k], alone[:, 0], atol=1e-12)
