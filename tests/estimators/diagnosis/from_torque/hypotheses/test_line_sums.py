"""Sums of lines are those of every line on every row that the filter lets through."""

from __future__ import annotations

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.line_sums import line_sums

ROWS, COUNT, BLOCK = 50, 40, 16  # two blocks and a half
FIRST, STEP, BANDWIDTH, LEAST = 5.0, 0.7, 10.0, 0.25
RANDOM = np.random.default_rng(0)


def test_sums_are_those_of_each_line_as_the_filter_leaves_it():
    position = RANDOM.uniform(-3.0, 3.0, ROWS)
    speed = RANDOM.uniform(0.0, 6.0, ROWS)  # the fastest pass no line, the slowest all
    residual = RANDOM.standard_normal(ROWS)
    found = line_sums(position, speed, residual, FIRST, STEP, COUNT, BANDWIDTH, LEAST, BLOCK)
    cycles = FIRST + STEP * np.arange(COUNT)
    gain = 1.0 / (1.0 + (speed[:, None] * cycles / (2 * np.pi * BANDWIDTH)) ** 8)
    gain[gain < LEAST] = 0.0
    assert (gain > 0).any(axis=0).all()
    assert 0 < (gain > 0).all(axis=1).sum() < ROWS
    turned = residual @ (gain * np.exp(1j * position[:, None] * cycles))
    expected = [turned.real, turned.imag, residual**2 @ gain**2, (gain > 0).sum(axis=0)]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)
