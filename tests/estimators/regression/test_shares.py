"""Shares of predictions that parts of the motion confirm."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.regression.empirical_bayes import confirmed_shares

PARTS, ROWS = 8, 400


def products(truth: np.ndarray, *predicted: np.ndarray) -> list[np.ndarray]:
    """Return the products of predictions and truth (T,) in parts of the rows."""
    rows = np.stack([*predicted, truth])
    return [part @ part.T for part in np.array_split(rows, PARTS, axis=1)]


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(5)


def test_what_every_part_confirms_is_kept_whole(random):
    truth = random.normal(size=ROWS)
    assert 0.95 < confirmed_shares(products(truth, truth))[0] <= 1.0


@pytest.mark.parametrize("seed", range(6))
def test_noise_gets_no_share(seed):
    random = np.random.default_rng(seed)
    truth, noise = random.normal(size=(2, ROWS))
    assert confirmed_shares(products(truth, noise))[0] < 0.05


def test_what_one_part_alone_confirms_is_luck(random):
    truth = random.normal(size=ROWS)
    predicted = np.where(np.arange(ROWS) < ROWS // PARTS, truth, 0.0)
    predicted += random.normal(size=ROWS) * (np.arange(ROWS) >= ROWS // PARTS)
    assert confirmed_shares(products(truth, predicted))[0] == 0.0


def test_two_predictions_of_one_truth_share_it(random):
    truth = random.normal(size=ROWS)
    both = [truth + random.normal(size=ROWS) for _ in range(2)]
    shares = confirmed_shares(products(truth, *both))
    assert shares == pytest.approx([shares[0]] * 2, abs=0.15)
    assert 0.4 < shares.sum() <= 1.0


def test_shares_are_no_more_than_the_whole_and_never_negative(random):
    truth = random.normal(size=ROWS)
    shares = confirmed_shares(products(truth, 0.2 * truth, -truth))
    assert (shares >= 0.0).all()
    assert shares.sum() <= 1.0
    assert shares[1] == 0.0


def test_one_part_confirms_nothing(random):
    truth = random.normal(size=ROWS)
    assert confirmed_shares(products(truth, truth)[:1]).tolist() == [0.0]
    assert confirmed_shares([np.zeros((2, 2))] * PARTS).tolist() == [0.0]
