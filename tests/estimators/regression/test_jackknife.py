"""The jackknife over fits that each leave a part of the data out."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.regression.definite import jackknife


def test_jackknife_of_a_mean_is_its_variance():
    values = np.random.default_rng(1).standard_normal(5)
    means = [np.delete(values, k).mean(keepdims=True) for k in range(5)]
    deviation = np.linalg.norm(jackknife(means), axis=0)
    assert deviation.item() == pytest.approx(values.std(ddof=1) / np.sqrt(5))


def test_what_all_fits_agree_on_has_no_spread_at_all():
    fits = np.full((7, 3), [0.1, 1 / 3, 1e9])  # whose mean rounding moves
    assert not jackknife(fits).any()
