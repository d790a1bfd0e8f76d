"""Positive matrices whose rank is not full: named, and no noise."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from estimators.regression.definite import SHOWN, RegularisedInverse, SymmetricSpectrum, root_of


def columns(rank, size=6, rows=50, seed=0, units=1.0):
    """Columns (rows, size) of a rank, each in other units."""
    random = np.random.default_rng(seed)
    X = random.normal(size=(rows, rank)) @ random.normal(size=(rank, size))
    return X * units ** np.arange(size)


def test_full_rank_is_inverted_as_ever():
    X = columns(6, units=1e3)
    size = np.linalg.norm(X, axis=0)
    inverse = np.linalg.pinv(X / size)
    found = SymmetricSpectrum.of(X.T @ X)
    assert found.rank == 6
    assert found.shown.all()
    expected = inverse @ inverse.T / np.outer(size, size)
    np.testing.assert_allclose(found.inverse().T @ found.inverse(), expected, rtol=1e-8)
    np.testing.assert_allclose(found.deviation(), np.sqrt(np.diag(expected)), rtol=1e-8)
    assert found.condition == pytest.approx(np.linalg.cond(X / size))


@pytest.mark.parametrize("units", [1.0, 1e4])
def test_two_columns_that_are_one_are_not_shown_and_the_others_are(units):
    X = columns(6, units=units)
    X[:, 1] = 3.0 * X[:, 4]
    found = SymmetricSpectrum.of(X.T @ X)
    assert found.rank == 5
    assert found.condition == np.inf
    assert found.shown.tolist() == [True, False, True, True, False, True]
    assert np.isinf(found.deviation()).tolist() == (~found.shown).tolist()


def test_a_column_of_nothing_is_not_shown():
    X = columns(6)
    X[:, 2] = 0.0
    found = SymmetricSpectrum.of(X.T @ X)
    assert found.rank == 5
    assert not found.shown[2]
    assert found.shown.sum() == 5
    assert found.inverse().shape == (5, 6)
    assert not found.inverse()[:, 2].any()


def test_a_matrix_of_nothing_shows_nothing():
    found = SymmetricSpectrum.of(np.zeros((3, 3)))
    assert found.rank == 0
    assert not found.shown.any()
    assert np.isinf(found.deviation()).all()
    assert not root_of(np.zeros((3, 3))).any()


@given(
    st.integers(1, 6),
    st.integers(0, 5),
    st.sampled_from([1e-6, 1.0, 1e3]),
    st.sampled_from([1e-12, 1.0, 1e9]),
)
def test_what_comes_out_is_positive_and_symmetric_whatever_goes_in(rank, seed, units, size):
    X = size * columns(rank, seed=seed, units=units)
    gram = X.T @ X
    prior = np.diag(1.0 / (1.0 + np.arange(6)))
    found = RegularisedInverse.of(gram, prior)
    matrix = found.matrix
    assert np.isfinite(matrix).all()
    assert (matrix == matrix.T).all()
    assert (np.diag(matrix) >= 0.0).all()
    # never less sure than before any data
    assert (np.diag(matrix) <= (1.0 + np.arange(6)) ** 2 * (1 + 1e-6)).all()
    root = root_of(gram)
    np.testing.assert_allclose(root.T @ root, gram, atol=1e-12 * np.abs(gram).max())


def test_beside_a_prior_data_of_full_rank_give_the_usual_posterior():
    X, prior = columns(6), np.diag(np.full(6, 0.3))
    y = X @ np.arange(6.0)
    found = RegularisedInverse.of(X.T @ X, prior)
    precision = X.T @ X + prior**2
    np.testing.assert_allclose(found.matrix, np.linalg.inv(precision), rtol=1e-9)
    expected = np.linalg.solve(precision, X.T @ y)
    np.testing.assert_allclose(found.estimate(X.T @ y), expected, rtol=1e-9)
    assert found.log_determinant == pytest.approx(-np.linalg.slogdet(precision)[1])
    assert found.shown.all()


def test_what_data_do_not_show_stays_where_it_was_and_as_unsure():
    X = columns(3, size=4)
    X[:, 3] = X[:, 0] * (1.0 + 1e-14)  # the same, but for rounding
    y = 1e9 * X @ np.array([1.0, 2.0, 3.0, 1.0])  # exact data of large products
    found = RegularisedInverse.of(1e18 * X.T @ X, np.eye(4) / 100.0)
    assert found.shown.tolist() == [False, True, True, False]
    estimate = found.estimate(1e9 * X.T @ y)
    np.testing.assert_allclose(estimate, [1.0, 2.0, 3.0, 1.0], rtol=1e-4)  # halves of their sum
    deviation = np.sqrt(np.diag(found.matrix))
    np.testing.assert_allclose(deviation[[0, 3]], 100.0 / np.sqrt(2.0), rtol=1e-6)
    assert (deviation[[1, 2]] < 1e-8).all()


def test_the_covariance_of_estimates_counts_no_rounding_along_what_is_not_shown():
    X = columns(3, size=4)
    X[:, 3] = X[:, 0]
    gram, prior = 1e18 * X.T @ X, np.eye(4) / 100.0
    found = RegularisedInverse.of(gram, prior)
    spread = found.spread(root_of(4.0 * gram))  # errors that count for a quarter of the rows
    deviation = np.linalg.norm(spread, axis=0)
    np.testing.assert_allclose(deviation[[0, 3]], 100.0 / np.sqrt(2.0), rtol=1e-6)
    np.testing.assert_allclose(deviation[1], 2.0 * np.sqrt(found.matrix[1, 1]), rtol=1e-4)


def test_the_limit_of_what_is_shown_is_as_it_is_stated():
    def rank(apart):
        X = np.linalg.qr(columns(2, size=2))[0]
        X[:, 1] = X[:, 0] + apart * X[:, 1]
        return SymmetricSpectrum.of(X.T @ X).rank

    near = 2.0 * np.sqrt(SHOWN)  # half of the square is the lower eigenvalue, 2 the upper one
    assert rank(1.01 * near) == 2
    assert rank(0.99 * near) == 1
