"""The rate of joint states, from their numbers and stamps."""

import numpy as np
import pytest

from estimators.service.inference.live_model import RateFinder, RateWatch

NANOSECONDS = 1_000_000_000


def found(rate: float, numbers: np.ndarray) -> list[float]:
    finder = RateFinder()
    rates = [finder.take(int(k), round(k * NANOSECONDS / rate)) for k in numbers]
    return [value for value in rates if value is not None]


@pytest.mark.parametrize("rate", [30.0, 125.0, 250.0, 1000.0, 5000.0])
def test_is_found_from_a_hundred_states(rate: float) -> None:
    assert found(rate, np.arange(101)) == [pytest.approx(rate)]
    assert found(rate, np.arange(100)) == []


def test_is_found_though_most_states_are_lost() -> None:
    kept = np.flatnonzero(np.random.default_rng(0).random(3000) < 0.1)[:101]
    assert found(1000.0, kept) == [pytest.approx(1000.0)]


@pytest.mark.parametrize("where", [[50], [3], [97], [20, 50, 80]])
def test_a_driver_that_stood_still_has_no_other_rate(where: list[int]) -> None:
    steps = np.full(101, 4e6)
    steps[where] += 34e6  # [ns]
    finder = RateFinder()
    *_, rate = [finder.take(k, int(stamp)) for k, stamp in enumerate(np.cumsum(steps))]
    assert rate == pytest.approx(250.0)


def test_stamps_in_pairs_are_no_stalls() -> None:
    finder = RateFinder()
    steps = np.tile([1e6, 7e6], 51)  # [ns], of 4 ms on average
    rates = [finder.take(k, int(stamp)) for k, stamp in enumerate(np.cumsum(steps))]
    assert next(filter(None, rates)) == pytest.approx(250.0, rel=0.04)


def test_begins_anew_with_the_source() -> None:
    numbers = np.r_[500:560, 0:101]
    assert found(1000.0, numbers) == [pytest.approx(1000.0)]


@pytest.mark.parametrize("rate", [0.1, 1e6])
def test_no_arm_has_any_rate(rate: float) -> None:
    assert found(rate, np.arange(300)) == []


@pytest.mark.parametrize(("came", "told"), [(100.0, False), (100.5, False), (102.0, True)])
def test_another_rate_is_told(came: float, told: bool) -> None:
    watch = RateWatch(100.0)
    found = [watch.take(k, round(k * NANOSECONDS / came)) for k in range(500)]
    assert any(found) == told
    assert set(found) <= {None, came}


def doubts(
    stamps: np.ndarray, numbers: np.ndarray | None = None, rate: float = 100.0
) -> list[bool]:
    """Return which states, after those of a service that runs, are doubtful."""
    watch, told = RateWatch(rate), []
    for k, stamp in zip(range(len(stamps)) if numbers is None else numbers, stamps, strict=True):
        watch.take(int(k), int(stamp))
        told.append(watch.doubtful)
    return told


@pytest.mark.parametrize("came", [50.0, 80.0, 97.0, 103.0, 125.0, 250.0, 1000.0])
def test_another_rate_is_doubted_before_it_is_told(came: float) -> None:
    steps = np.r_[np.full(300, 1e7), np.full(150, 1e9 / came)]
    told = doubts(np.cumsum(steps))
    assert not any(told[:300])
    assert all(told[310:])
    if abs(came - 100.0) >= 20.0:
        assert all(told[303:])


def test_losses_and_gaps_are_no_reason_to_doubt() -> None:
    kept = np.flatnonzero(np.random.default_rng(0).random(3000) < 0.5)
    assert not any(doubts(1e7 * kept, kept))
    steps = np.full(1000, 1e7)
    steps[100:900:50] *= np.random.default_rng(0).integers(2, 6, 16)  # not numbered
    assert not any(doubts(np.cumsum(steps)))


def test_uneven_stamps_are_seldom_doubted() -> None:
    noise = np.random.default_rng(0).normal(0.0, 5e5, 5000)  # [ns], of 10 ms
    told = doubts(1e7 * np.arange(5000) + noise)
    assert sum(told) < 50
    assert not any(told[300:])


def test_uneven_stamps_are_no_other_rate() -> None:
    watch, noise = RateWatch(1000.0), np.random.default_rng(0).normal(0.0, 2e4, 5000)
    assert not any(watch.take(k, round(1e6 * k + noise[k])) for k in range(5000))
