"""Spectra are those of Welch's method as scipy has it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from estimators.spectra import mean_density, median_density

RATE = 500.0  # [Hz]


@pytest.mark.parametrize("samples", [64, 65, 96, 1000])
def test_densities_are_those_of_scipy(samples: int) -> None:
    rng = np.random.default_rng(0)
    drifting = np.cumsum(rng.normal(size=(samples, 3)), axis=0) + rng.normal(size=(samples, 3))
    for own, window, average in (
        (mean_density, "hann", "mean"),
        (median_density, "blackmanharris", "median"),
    ):
        given = {"detrend": "linear", "average": average}
        frequency, density = welch(drifting, RATE, window, 64, axis=0, **given)
        found = own(drifting, RATE, 64)
        np.testing.assert_allclose(found[0], frequency)
        np.testing.assert_allclose(found[1], density, rtol=1e-9)
