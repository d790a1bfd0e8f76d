"""Evidence: equal to that of a dense Gaussian, with bounds that bind where they should."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from estimators.regression.evidence import (
    REACH,
    Evidence,
    NormalEquations,
    Prior,
    Priors,
    joined,
    posterior,
)

ROWS = 40
RANDOM = np.random.default_rng(5)
COLUMNS = RANDOM.standard_normal((ROWS, 6))  # white noise of unit size
COLUMNS[:, 3] += 0.8 * COLUMNS[:, 0]
NUISANCE = Prior.free(np.array([0, 1]), np.array([0.3, 2.0]))
SET = Prior.free(np.array([3, 5]), np.array([1.5, 0.7]))


def products_of(y):
    return NormalEquations(COLUMNS.T @ COLUMNS, COLUMNS.T @ y)


def density(y, *priors):
    """Return the log density of y with every coefficient integrated out, all rows at once."""
    covariance = np.eye(ROWS)
    for prior in priors:
        A = COLUMNS[:, prior.index] * prior.deviation
        covariance += A @ A.T
    return multivariate_normal(np.zeros(ROWS), covariance).logpdf(y)


@pytest.mark.parametrize("seed", range(5))
def test_gain_is_the_log_evidence_of_a_dense_gaussian(seed):
    random = np.random.default_rng(seed)
    y = COLUMNS @ random.standard_normal(6) + random.standard_normal(ROWS)
    evidence = Evidence(products_of(y), NUISANCE)
    expected = density(y, NUISANCE, SET) - density(y, NUISANCE)
    assert evidence.gain(SET) == pytest.approx(expected, abs=1e-5)


def test_no_columns_gain_nothing():
    evidence = Evidence(products_of(COLUMNS[:, 2]), NUISANCE)
    assert evidence.gain(SET.of(np.zeros(2, dtype=bool))) == 0.0


def test_what_the_nuisance_explains_is_no_gain_but_a_loss():
    y = 0.5 * COLUMNS[:, 1] + 0.3 * RANDOM.standard_normal(ROWS)
    assert Evidence(products_of(y), NUISANCE).gain(SET) < 0


def test_a_column_with_the_wrong_sign_is_dropped():
    y = -2.0 * COLUMNS[:, 3] + 3.0 * COLUMNS[:, 5] + 0.1 * RANDOM.standard_normal(ROWS)
    evidence = Evidence(products_of(y), NUISANCE)
    positive = Prior(SET.index, SET.deviation, np.array([True, True]))
    alone = SET.of(np.array([False, True]))
    assert evidence.gain(positive) == pytest.approx(evidence.gain(alone))
    assert evidence.gain(positive) < evidence.gain(SET)
    found = evidence.posterior(positive)
    assert found.mean[2] == 0.0
    assert found.mean[3] > 0
    none = Prior(np.array([3]), np.array([1.5]), np.array([True]))
    assert Evidence(products_of(-2.0 * COLUMNS[:, 3]), NUISANCE).gain(none) == 0.0


def test_a_column_whose_coefficient_would_be_larger_than_it_may_does_not_compete():
    y = 2.0 * COLUMNS[:, 3] + 3.0 * COLUMNS[:, 5] + 0.1 * RANDOM.standard_normal(ROWS)
    evidence = Evidence(products_of(y), NUISANCE)
    both, other = np.array([True, True]), SET.of(np.array([False, True]))

    def up_to(most):
        ends = np.array([most, np.inf]) / SET.deviation
        return Prior(SET.index, SET.deviation, both, most=ends)

    assert evidence.gain(up_to(2.5)) == pytest.approx(evidence.gain(SET))
    assert evidence.gain(up_to(1.5)) == pytest.approx(evidence.gain(other))
    assert evidence.posterior(up_to(2.5)).mean[2] == pytest.approx(2.0, abs=0.1)
    assert evidence.posterior(up_to(1.5)).mean[2] == pytest.approx(1.5)
    limited = up_to(1.5).of(np.array([True, False]))
    for base, more in ((limited, other), (other, limited)):
        gains = evidence.gains(Priors.of_each([base, more]), [0], np.array([1]))
        np.testing.assert_allclose(gains, evidence.gain(other))


def test_columns_of_a_block_are_left_out_with_the_one_of_the_wrong_sign():
    y = COLUMNS @ np.array([0.0, 0.0, 1.0, -2.0, 0.0, 3.0]) + 0.1 * RANDOM.standard_normal(ROWS)
    evidence = Evidence(products_of(y), NUISANCE)
    body = Prior(SET.index, SET.deviation, np.array([True, False]), np.zeros(2, dtype=np.int64))
    other = Prior.free(np.array([2]), np.array([1.5]))
    assert evidence.gain(body) == 0.0
    np.testing.assert_array_equal(evidence.posterior(body).mean[2:], 0.0)
    for several in (joined(body, other), joined(other, body), joined(other, body, body)):
        assert evidence.gain(several) == pytest.approx(evidence.gain(other))
        found = evidence.posterior(several)
        np.testing.assert_array_equal(found.mean[2:] != 0.0, several.index == 2)
    np.testing.assert_allclose(
        evidence.gains(Priors.of_each([other, body, SET]), [0], np.array([1, 2])),
        [evidence.gain(other), evidence.gain(joined(other, SET))],
    )


def test_where_nothing_binds_the_posterior_is_ridge_regression():
    random = np.random.default_rng(8)
    y = COLUMNS @ np.array([0.1, 1.0, 0.0, 0.7, 0.0, -0.4]) + 0.5 * random.standard_normal(ROWS)
    found = posterior(products_of(y), NUISANCE, SET)
    both = joined(NUISANCE, SET)
    A = COLUMNS[:, both.index]
    inverse = np.linalg.inv(A.T @ A + np.diag(both.deviation**-2.0))
    np.testing.assert_array_equal(found.index, [0, 1, 3, 5])
    np.testing.assert_allclose(found.mean, inverse @ A.T @ y, rtol=1e-6)
    np.testing.assert_allclose(found.covariance, inverse, rtol=1e-5, atol=1e-9)


def test_a_nuisance_parameter_stays_within_reach_and_the_rest_fits_what_it_leaves():
    y = 50 * 0.3 * COLUMNS[:, 0] + 1.0 * COLUMNS[:, 5]
    found = posterior(products_of(y), NUISANCE, SET)
    assert found.mean[0] == pytest.approx(REACH * 0.3)
    assert abs(found.mean[1]) < REACH * 2.0
    free = joined(NUISANCE.of(np.array([False, True])), SET)
    A, left = COLUMNS[:, free.index], y - found.mean[0] * COLUMNS[:, 0]
    expected = np.linalg.solve(A.T @ A + np.diag(free.deviation**-2.0), A.T @ left)
    np.testing.assert_allclose(found.mean[1:], expected, rtol=1e-6)
    np.testing.assert_array_equal(found.covariance[0], 0.0)


def test_amplitudes_of_a_set_have_no_reach():
    y = 40 * 0.7 * COLUMNS[:, 5]
    found = posterior(products_of(y), NUISANCE, SET)
    assert found.mean[3] > 0.9 * 40 * 0.7


def test_the_price_of_a_column_that_says_nothing_grows_with_its_prior():
    y = RANDOM.standard_normal(ROWS)
    y -= COLUMNS @ np.linalg.lstsq(COLUMNS, y, rcond=None)[0]
    evidence = Evidence(products_of(y), NUISANCE)
    gains = [evidence.gain(Prior.free(np.array([4]), np.array([a]))) for a in (0.1, 1.0, 10.0)]
    assert gains[0] > gains[1] > gains[2]
    assert gains[1] - gains[2] == pytest.approx(np.log(10.0), abs=0.05)


def test_gains_of_many_are_those_of_each_with_signs_that_bind_on_either_side():
    y = COLUMNS @ np.array([0.0, 0.0, -3.0, 2.0, -1.0, 3.0]) + RANDOM.standard_normal(ROWS)
    evidence = Evidence(products_of(y), NUISANCE)

    def positive(*index):
        return Prior(np.array(index), np.full(len(index), 2.0), np.ones(len(index), dtype=bool))

    more = [positive(2), positive(4), positive(2, 4), positive(2, 5), SET.of(SET.index == 5)]
    for base in (positive(3), positive(3, 2), SET):
        expected = [evidence.gain(joined(base, prior)) for prior in more]
        table, every = Priors.of_each([base, *more]), np.arange(1, 6)
        gains = evidence.gains(table, [0], every)
        np.testing.assert_allclose(gains, expected, rtol=1e-9)
        some = np.array([3, 1])
        np.testing.assert_array_equal(evidence.gains(table, [0], some), gains[some - 1])


def test_with_values_held_at_their_limit_the_rest_is_worth_what_they_leave():
    """Column 3 resembles a nuisance that would have to move five times its reach."""
    y = 5 * REACH * 0.3 * COLUMNS[:, 0] + 0.1 * RANDOM.standard_normal(ROWS)
    free = Evidence(products_of(y), NUISANCE)
    limits = free.at_limit(free.posterior(SET.of(np.zeros(2, dtype=bool))))
    assert limits[0] == pytest.approx(REACH * 0.3)
    assert np.isnan(limits[1])
    held = Evidence(products_of(y), NUISANCE, limits)
    left = y - limits[0] * COLUMNS[:, 0]
    other = NUISANCE.of(np.array([False, True]))
    expected = density(left, other, SET) - density(left, other)
    assert held.gain(SET) == pytest.approx(expected, rel=1e-6)
    assert held.gain(SET) > free.gain(SET) + 10


@pytest.mark.parametrize("known", [2, 4, 5])
def test_columns_that_come_later_are_worth_what_they_are_beside_all_at_once(known):
    y = COLUMNS @ np.arange(6.0) + np.random.default_rng(known).standard_normal(ROWS)
    products = products_of(y)
    earlier = NormalEquations(products.gram[:known, :known], products.product[:known])
    extended = Evidence(earlier, NUISANCE).extended(products)
    assert extended.gain(SET) == pytest.approx(Evidence(products, NUISANCE).gain(SET), rel=1e-9)
    assert extended.extended(products).gain(SET) == extended.gain(SET)  # by none


@pytest.mark.parametrize("size", [1e5, 1e6, 1e9])
def test_exact_data_keep_evidence_and_covariance_positive(size):
    """Errors of a millionth of the torque outweigh a prior by nearly all digits of a number."""
    columns = size * np.column_stack([COLUMNS, COLUMNS[:, 3] * (1 + 1e-15), COLUMNS[:, 5]])
    y = columns @ np.array([0.1, 0.1, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    products = NormalEquations(columns.T @ columns, columns.T @ y)
    alike = Prior.free(np.array([3, 5, 6, 7]), np.array([1.5, 0.7, 1.5, 0.7]))
    evidence = Evidence(products, NUISANCE)
    assert np.isfinite(evidence.gain(alike))
    table = Priors.of_each([SET, alike])
    assert np.isfinite(evidence.gains(table, [0], np.array([1]))).all()
    found = evidence.posterior(alike)
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert np.isfinite(found.mean).all()
    assert (found.deviation > 0.0).all()
    if size == 1e5:  # columns that are one are as unsure as they were, but for their sum
        np.testing.assert_allclose(found.deviation[[2, 4]], 1.5 / np.sqrt(2.0), rtol=0.01)
