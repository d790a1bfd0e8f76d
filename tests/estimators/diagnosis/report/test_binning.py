"""Binning: what a residual follows is seen in its means, and cells without rows stay empty."""

from __future__ import annotations

import numpy as np

from estimators.diagnosis.report.binning import edges_of, profile, residual_map


def test_a_profile_finds_what_the_residual_follows():
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, 20_000)
    residual = 2 * x + 0.1 * random.standard_normal(x.size)
    found = profile(x, residual, edges_of(x))
    assert np.allclose(found.mean, 2 * found.centre, atol=0.03)
    assert np.allclose(
        found.spread, np.hypot(0.1, 2 * np.diff(edges_of(x))[0] / 12**0.5), atol=0.02
    )


def test_a_map_leaves_cells_without_rows_empty():
    x = np.repeat([0.1, 0.9], 50)
    edges = np.linspace(0, 1, 3)
    found = residual_map(x, x, x, edges, edges)
    assert np.allclose(np.diag(found.mean), [0.1, 0.9])
    assert np.isnan(found.mean[0, 1])
