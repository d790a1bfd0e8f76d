"""Proof: rows held out are never fitted to, and the interval of what is removed is honest."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from estimators.diagnosis.from_torque.residuals.noise import ColumnTable, Noise, normal_equations
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import (
    Split,
    block_of,
    bootstrap,
    guard_of,
    reducible_removed,
    rmse,
    surely_positive,
)
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.regression.evidence import Prior, posterior


@pytest.fixture(scope="module")
def observed(rigid, training_recording, test_recording):
    return Observations.of(rigid, [training_recording, test_recording], 10.0)


@pytest.fixture(scope="module")
def split(observed):
    return Split.of(observed)


def test_no_row_is_fitted_to_and_held_out(split, observed):
    assert not (split.fitted & split.held_out).any()
    for rows in (split.fitted, split.held_out):
        assert not (rows & ~observed.moving).any()
    held, moving = split.held_out.sum(), observed.moving.sum()
    assert 0.15 < held / moving < 0.35
    assert split.fitted.sum() > 0.5 * moving


def test_every_recording_has_rows_of_both_kinds_and_a_guard_between(split, observed):
    for recording in (0, 1):
        own = observed.recording == recording
        time = observed.slow.time
        held = time[own & split.held_out.any(axis=1)]
        fitted = time[own & split.fitted.any(axis=1)]
        assert np.abs(held[:, None] - fitted[None]).min() >= 0.9


@pytest.mark.parametrize(("bandwidth", "before"), [(1e9, 0), (2, 1)])
@pytest.mark.parametrize("block", [0, 3, HELD_OUT.blocks - 1])
def test_blocks_are_of_one_length_from_the_first_row_to_the_last(block, bandwidth, before):
    """The rows near to them are within 3 % of the time, and as far as the filter reaches."""
    time = 5.0 + np.arange(4 * HELD_OUT.blocks + 1.0)
    rows = SimpleNamespace(
        kept=np.arange(time.size), recordings=[None], recording=np.zeros(time.size),
        slow=SimpleNamespace(time=time), bandwidth=bandwidth,
        moving=np.ones((time.size, 2), dtype=bool),
    )  # fmt: skip
    split = Split.of(rows, [block])
    np.testing.assert_array_equal(time[split.apart], 5.0 + 4.0 * block + np.arange(4))
    near = np.clip([4 * block - before, 4 * block + 5], 0, time.size)
    np.testing.assert_array_equal(np.flatnonzero(~split.fitted[:, 0]), np.arange(*near))
    assert (split.held_out == split.apart[:, None]).all()


def test_what_happens_on_held_out_rows_changes_no_fit(split, observed):
    columns = ColumnTable(*observed.residual.shape)
    sign = observed.filter(np.tanh(observed.motion.velocity / 0.002))
    index = columns.add((0,), sign[None, :, :1])
    prior = Prior.free(index, np.ones(1))
    nuisance = prior.of(np.zeros(1, dtype=bool))
    fits = []
    for residual in (observed.residual, observed.residual + 100.0 * split.held_out):
        noise = Noise.of(residual, split.fitted, observed.segment)
        products = normal_equations(columns, residual, noise, split.fitted)
        fits.append(posterior(products, nuisance, prior).mean)
    np.testing.assert_array_equal(*fits)


def test_rmse_is_over_the_rows_that_count():
    residual = np.array([[3.0, 1.0], [4.0, 7.0], [100.0, 7.0]])
    rows = np.array([[True, True], [True, False], [False, False]])
    np.testing.assert_allclose(rmse(residual, rows), [np.sqrt(12.5), 1.0])
    np.testing.assert_array_equal(rmse(residual, np.zeros_like(rows)), 0.0)


@pytest.mark.parametrize(
    ("after", "removed"), [(1.0, 1.0), (0.5, 1.0), (5.0, 0.0), (np.sqrt(13.0), 0.5), (9.0, -1.0)]
)
def test_the_part_of_the_reducible_error_that_is_gone(after, removed):
    before, floor = np.array([5.0]), np.array([1.0])
    assert reducible_removed(before, np.array([after]), floor) == pytest.approx(removed)


def test_where_nothing_is_reducible_nothing_is_removed():
    one = np.ones(2)
    assert reducible_removed(0.9 * one, 0.8 * one, one) == 0.0


def test_a_joint_that_is_below_its_floor_already_takes_nothing_from_the_others():
    floor, before = np.ones(2), np.array([3.0, 0.5])
    assert reducible_removed(before, before, floor) == 0.0
    assert reducible_removed(before, np.array([1.0, 0.5]), floor) == pytest.approx(1.0)


@pytest.mark.slow("forty bootstraps")
def test_the_interval_contains_the_truth_as_often_as_it_says(observed):
    """Errors of known size before and after, drawn anew; 95 % of the intervals hold the truth."""
    shape, rows = observed.residual.shape, np.ones(observed.residual.shape, dtype=bool)
    floor, before, after = 0.1 * np.ones(2), 1.0, 0.5
    truth = 1 - (after**2 - 0.01) / (before**2 - 0.01)
    held = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        drawn = [size * random.standard_normal(shape) for size in (before, after)]
        low, high = bootstrap(*drawn, floor, observed, rows)
        assert low <= high
        held += low <= truth <= high
    assert held >= 33  # 38 expected; fewer than 33 happen to an honest interval once in 50


def test_one_block_leaves_nothing_to_resample(observed):
    rows = np.zeros(observed.residual.shape, dtype=bool)
    rows[:10] = True
    residual = observed.residual
    assert bootstrap(residual, residual, np.ones(2), observed, rows) == (-1.0, 1.0)


def test_a_joint_without_held_out_rows_does_not_spoil_the_interval(observed):
    rows = np.ones(observed.residual.shape, dtype=bool)
    rows[:, 1] = False
    residual = 100.0 * observed.residual
    low, high = bootstrap(residual, 0.1 * residual, np.ones(2), observed, rows)
    assert np.isfinite([low, high]).all()
    assert 0.9 < low <= high <= 1.0


def test_a_short_recording_is_not_spent_on_guards():
    """Of 6 s, four guards of 1 s left 18 % of the rows to fit to."""
    assert guard_of(60.0, 10.0) == 1.0
    assert guard_of(6.0, 10.0) == pytest.approx(0.2)  # the reach of the filter
    assert 4 * guard_of(20.0, 10.0) < 0.15 * 20.0
    assert guard_of(6.0, 2.0) == pytest.approx(1.0)  # of a slower one


def test_a_short_recording_has_blocks_to_resample(rigid, test_recording):
    short = Observations.of(rigid, [test_recording[:600]], 10.0)
    length = block_of(short, 3.0)
    assert length.max() == pytest.approx(short.recordings[0].duration / 16)
    whole = Observations.of(rigid, [test_recording], 10.0)
    assert block_of(whole, 1.0).min() == 1.0


@pytest.mark.parametrize(("gained", "sure"), [(1.0, True), (-1.0, False)])
def test_a_gain_everywhere_is_sure(observed, split, gained, sure):
    rows = np.full(split.held_out.shape, gained)
    assert surely_positive(rows, observed, split.held_out) is sure


def test_a_gain_in_one_moment_is_not_sure(observed, split):
    """Another recording need not have that moment, whatever it weighs in this one."""
    rows = np.full(split.held_out.shape, -0.01)
    first = np.flatnonzero(split.held_out.any(axis=1))[:3]
    rows[first] = 100.0
    assert rows[split.held_out].sum() > 0
    assert not surely_positive(rows, observed, split.held_out)


def test_the_blocks_held_out_have_the_rows_that_do_not_count_too(split, observed):
    assert not (split.held_out & ~split.apart[:, None]).any()
    assert (split.held_out == split.apart[:, None] & observed.moving).all()


def test_blocks_of_two_recordings_are_two_whatever_their_clocks_say():
    """Of a clock that counts from some day long ago, and one that counts from the start."""
    slow = SimpleNamespace(time=np.array([3e6, 3e6 + 1.0, 0.0, 1.0]))
    recordings = [SimpleNamespace(duration=60.0)] * 2
    of = np.array([0, 0, 1, 1])
    observed = SimpleNamespace(slow=slow, recordings=recordings, recording=of)
    gained = np.array([[5.0], [5.0], [-3.0], [-3.0]])
    assert not surely_positive(gained, observed, np.ones((4, 1), dtype=bool))


@pytest.mark.parametrize(("lead", "sure"), [(3.0, True), (1.3, False)])
def test_a_gain_is_sure_that_nineteen_of_twenty_recordings_would_show(lead, sure):
    """Blocks that gain unequally: their mean is so many of its own deviations above nothing."""
    of_block = norm.ppf((np.arange(40) + 0.5) / 40)
    of_block = of_block / of_block.std() + lead / np.sqrt(40)
    observed = SimpleNamespace(
        slow=SimpleNamespace(time=HELD_OUT.block * np.arange(40.0)),
        recordings=[SimpleNamespace(duration=40 * HELD_OUT.block)],
        recording=np.zeros(40, dtype=int),
    )
    assert surely_positive(of_block[:, None], observed, np.ones((40, 1), dtype=bool)) is sure


def test_rounding_is_no_gain(observed):
    """Of two residuals that are one, the last bit makes either the smaller."""
    residual, rows = observed.residual, np.ones(observed.residual.shape, dtype=bool)
    scale = np.maximum(rmse(residual, rows) ** 2, 1e-24)
    for last_bit, gain in ((1e-15, False), (1e-3, True)):
        less = residual * (1.0 - last_bit)
        assert surely_positive((residual**2 - less**2) / scale, observed, rows) is gain
