"""Binning: what a residual follows is seen in its means, and cells without rows stay empty."""

from __future__ import annotations

import numpy as np

from estimators.diagnosis.report import figures
from estimators.diagnosis.report.binning import bins_of, cells_of, edges_of, profile, residual_map


def test_a_profile_finds_what_the_residual_follows():
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, 20_000)
    residual = 2 * x + 0.1 * random.standard_normal(x.size)
    found = profile(x, residual, edges_of(x, 32))
    assert np.allclose(found.mean, 2 * found.centre, atol=0.03)
    assert np.allclose(
        found.spread, np.hypot(0.1, 2 * np.diff(edges_of(x, 32))[0] / 12**0.5), atol=0.02
    )


def test_a_map_leaves_cells_without_rows_empty():
    x = np.repeat([0.1, 0.9], 50)
    edges = np.linspace(0, 1, 3)
    found = residual_map(x, x, x, edges, edges)
    assert np.allclose(np.diag(found.mean), [0.1, 0.9])
    assert np.isnan(found.mean[0, 1])


def test_bins_follow_the_number_of_rows():
    assert (bins_of(3), bins_of(120), bins_of(10**6)) == (5, 12, 32)
    assert (cells_of(3), cells_of(300), cells_of(10**6)) == (5, 10, 32)


def test_a_few_seconds_are_seen_in_most_bins():
    """120 rows: some 6 s of a joint that swings."""
    x = np.sin(np.linspace(0, 9, 120))
    found = profile(x, x, edges_of(x, bins_of(x.size)))
    assert np.isfinite(found.mean).mean() > 0.9
    v = np.cos(np.linspace(0, 9, 120))
    cells = cells_of(x.size)
    shown = residual_map(x, v, x, edges_of(x, cells), edges_of(v, cells))
    assert np.isfinite(shown.mean).sum() >= 10


def test_a_curve_does_not_lead_across_bins_without_rows():
    x = np.concatenate([np.linspace(0, 1, 60), np.linspace(3, 4, 60)])
    found = profile(x, x, edges_of(x, 12))
    assert len(found.runs()) == 2
    at, mean = found.drawn(found.mean)
    assert (np.isnan(at) == np.isnan(mean)).all()
    assert np.isnan(at).sum() == 2
    within = at[np.isfinite(at)]
    assert not ((within > 1.5) & (within < 2.5)).any()


def test_a_band_of_bins_without_rows_is_empty():
    nothing = profile(np.zeros(0), np.zeros(0), np.linspace(0.0, 1.0, 6))
    assert nothing.runs() == []
    drawn = figures._band(nothing, next(iter(figures._BANDS)))
    assert len(drawn["x"]) == len(drawn["y"]) == 0
