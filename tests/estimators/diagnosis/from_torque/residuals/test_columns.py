"""Columns: the table gives back what was put in, and sums of products are those of a dense fit."""

from __future__ import annotations

import numpy as np

from estimators.diagnosis.from_torque.residuals.noise import ColumnTable, Noise, normal_equations

ROWS = 60
RANDOM = np.random.default_rng(0)
FIRST = RANDOM.standard_normal((2, ROWS, 3))  # on joints 0 and 2
SECOND = RANDOM.standard_normal((1, ROWS, 2))  # on joint 2
USE = RANDOM.uniform(size=(ROWS, 3)) > 0.3


def table():
    columns = ColumnTable(ROWS, 3)
    return columns, columns.add((0, 2), FIRST), columns.add((2,), SECOND)


def dense():
    """Every column on every joint, (K, 3, 5)."""
    full = np.zeros((ROWS, 3, 5))
    full[:, 0, :3], full[:, 2, :3], full[:, 2, 3:] = FIRST[0], FIRST[1], SECOND[0]
    return full


def test_columns_are_numbered_in_the_order_they_come():
    columns, first, second = table()
    assert first.tolist() == [0, 1, 2]
    assert second.tolist() == [3, 4]
    assert columns.count == 5
    values, at = columns.of_joint(2)
    assert at.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(values, np.concatenate([FIRST[1], SECOND[0]], axis=1))


def test_a_joint_on_which_nothing_acts_has_no_columns():
    columns, _, _ = table()
    values, at = columns.of_joint(1)
    assert values.shape == (ROWS, 0)
    assert at.size == 0


def test_columns_added_after_a_look_are_there_too():
    columns, _, _ = table()
    columns.of_joint(2)
    columns.add((1, 2), FIRST)
    assert columns.of_joint(2)[1].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert columns.of_joint(1)[1].tolist() == [5, 6, 7]


def test_apply_is_the_sum_of_columns_and_adds_up_what_is_named_twice():
    columns, _, _ = table()
    index = np.array([0, 4, 0])
    found = columns.apply(index, np.array([1.0, -2.0, 0.5]))
    expected = dense() @ np.array([1.5, 0.0, 0.0, 0.0, -2.0])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_size_is_that_on_the_joint_where_a_column_is_largest():
    columns, _, _ = table()
    expected = np.sqrt(np.mean(dense() ** 2, axis=0)).max(axis=0)
    np.testing.assert_allclose(columns.size(), expected)


def test_products_are_those_of_the_used_rows_in_units_of_the_noise():
    columns, _, _ = table()
    residual = np.random.default_rng(1).standard_normal((ROWS, 3))
    deviation = np.array([0.5, 1.0, 2.0])
    products = normal_equations(columns, residual, Noise.independent(deviation, USE), USE)
    A = (dense() / deviation[:, None])[USE]
    y = (residual / deviation)[USE]
    np.testing.assert_allclose(products.gram, A.T @ A, atol=1e-10)
    np.testing.assert_allclose(products.product, A.T @ y, atol=1e-10)


def test_sums_go_on_with_columns_that_came_later():
    columns, _, _ = table()
    residual = np.random.default_rng(2).standard_normal((ROWS, 3))
    noise = Noise.of(residual, USE, np.zeros(ROWS, dtype=np.int64))
    before = normal_equations(columns, residual, noise, USE)
    assert normal_equations(columns, residual, noise, USE, before) is before
    columns.add((1, 2), FIRST)
    columns.add((0,), SECOND)
    gone_on = normal_equations(columns, residual, noise, USE, before)
    anew = normal_equations(columns, residual, noise, USE)
    np.testing.assert_allclose(gone_on.gram, anew.gram, atol=1e-12)
    np.testing.assert_allclose(gone_on.product, anew.product, atol=1e-12)
