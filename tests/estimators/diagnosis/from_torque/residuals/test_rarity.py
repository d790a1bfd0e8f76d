"""Rarity: large errors are rare where errors are alike, and ordinary where they scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.diagnosis.from_torque.residuals.reversals import surprisal

FREEDOM = 4.0
RANDOM = np.random.default_rng(3)
ALIKE = RANDOM.chisquare(FREEDOM, 20000)
SCATTERED = ALIKE / RANDOM.chisquare(3.0, 20000)


def times(factor: float, others: np.ndarray) -> float:
    """Return the rarity of so many times the usual energy."""
    return float(surprisal(factor * np.median(others, keepdims=True), others, FREEDOM)[0])


def test_among_errors_that_are_alike_it_is_the_chance_of_such_noise() -> None:
    chance = -chi2.logsf(5.0 * chi2.median(FREEDOM) * FREEDOM / chi2.median(FREEDOM), FREEDOM)

    assert times(5.0, ALIKE) == pytest.approx(chance, rel=0.3)


def test_among_errors_that_scatter_it_is_how_often_such_ones_are_there() -> None:
    for part in (1e-2, 1e-3):
        factor = np.quantile(SCATTERED, 1.0 - part) / np.median(SCATTERED)
        assert times(float(factor), SCATTERED) == pytest.approx(-np.log(part), rel=0.25)
    assert times(100.0, SCATTERED) < 10.0 < times(100.0, ALIKE)


def test_of_an_event_among_others_it_stays_large() -> None:
    disturbed = np.where(np.arange(ALIKE.size) % 10 == 0, 300.0 * ALIKE, ALIKE)

    assert times(300.0, disturbed) > 50.0
    assert np.isfinite(times(1e9, disturbed))
