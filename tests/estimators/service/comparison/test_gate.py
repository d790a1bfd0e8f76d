"""The gate: a better challenger passes, noise and a harmed joint do not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from lanes import sampled
from scipy.signal import lfilter

from estimators.service.gate import FEWEST_BLOCKS, LEVEL, accuracy, compare
from limo_driver.errors import DivergedError, ShapeError

RATE = 20.0  # [Hz]
BLOCK = 100  # samples, 5 s


def noise(random: np.random.Generator, T: int, n: int, remembers: float) -> np.ndarray:
    """Return (T, n) noise of variance 1 that forgets within `remembers` seconds."""
    keep = np.exp(-1 / (remembers * RATE))
    white = random.standard_normal((T + 2000, n))
    return np.sqrt(1 - keep**2) * lfilter([1.0], [1.0, -keep], white, axis=0)[2000:]


def test_a_better_challenger_is_promoted() -> None:
    random = np.random.default_rng(0)
    champion = noise(random, 12000, 3, 0.5) * [1.0, 2.0, 0.5]
    challenger = 0.8 * champion + 0.1 * noise(random, 12000, 3, 0.5)
    found = compare(champion, challenger, BLOCK)
    assert found.promote
    assert found.reason.startswith("better on average and worse on no joint; mean ratio")
    np.testing.assert_allclose(found.champion, np.sqrt(np.mean(champion**2, axis=0)))
    np.testing.assert_allclose(found.ratio.value, (found.challenger / found.champion) ** 2)
    assert (found.difference.low < found.difference.value).all()
    assert (found.difference.high < 0).all()


def test_one_harmed_joint_forbids_it() -> None:
    random = np.random.default_rng(1)
    champion = noise(random, 12000, 3, 0.5)
    found = compare(champion, champion * [0.3, 0.3, 1.1], BLOCK)
    assert found.better
    assert found.worse == (3,)
    assert not found.promote
    assert found.reason.startswith("worse on joint 3; mean ratio")


def test_the_same_model_is_no_better() -> None:
    champion = noise(np.random.default_rng(2), 2000, 3, 0.5)
    found = compare(champion, champion, BLOCK)
    assert not found.promote
    assert found.worse == ()
    assert found.mean_ratio.low == found.mean_ratio.high == 1.0


def test_too_little_data_promotes_nothing_and_says_what_is_needed() -> None:
    champion = noise(np.random.default_rng(3), 9 * BLOCK + 99, 2, 0.5)
    found = compare(champion, 0.1 * champion, BLOCK)
    assert not found.promote
    assert found.reason == f"only 9 blocks, at least {FEWEST_BLOCKS} are needed"
    values = json.loads(json.dumps(found.as_values(), allow_nan=False))
    assert values["mean_ratio"]["high"] is None
    assert values["blocks"] == 9
    assert compare(champion[:1], champion[:1], 1).blocks == 1


def test_what_is_said_to_be_needed_is_about_enough() -> None:
    """Twice the data that are asked for tell nearly every challenger that is a little better."""
    random = np.random.default_rng(4)
    told = 0
    for _ in range(40):
        champion = noise(random, 40 * BLOCK, 2, 0.5)
        challenger = 0.97 * champion + 0.35 * noise(random, 40 * BLOCK, 2, 0.5) * 0.3
        needed = compare(champion, challenger, BLOCK).needed
        T = 2 * needed * BLOCK
        champion = noise(random, T, 2, 0.5)
        challenger = 0.97 * champion + 0.35 * noise(random, T, 2, 0.5) * 0.3
        told += compare(champion, challenger, BLOCK).better
    assert told >= 30


@sampled("remembers", [0.05, 1.0, 5.0], "400 comparisons each")
def test_equal_models_are_seldom_promoted(remembers: float) -> None:
    """Errors that are as large but not the same; a one-sided test at 95 % errs in 2.5 %."""
    random = np.random.default_rng(5)
    trials, promoted, outside = 400, 0, np.zeros(2)
    for _ in range(trials):
        shared = noise(random, 40 * BLOCK, 2, remembers)
        champion, challenger = (
            0.6 * shared + 0.8 * noise(random, 40 * BLOCK, 2, remembers) for _ in "ab"
        )
        found = compare(champion, challenger, BLOCK)
        promoted += found.promote
        outside += (found.ratio.low > 1) | (found.ratio.high < 1)
    assert promoted / trials <= 1 - LEVEL
    assert (outside / trials <= 2 * (1 - LEVEL)).all()


def test_the_accuracy_of_one_model_has_an_interval_that_holds_it() -> None:
    random, held = np.random.default_rng(6), np.zeros(2)
    for _ in range(200):
        found = accuracy(noise(random, 40 * BLOCK, 2, 1.0) * [1.0, 3.0], BLOCK)
        held += (found.low <= [1.0, 3.0]) & (found.high >= [1.0, 3.0])
    assert (held / 200 >= 1 - 2 * (1 - LEVEL)).all()


def test_a_joint_without_errors_and_a_diverging_challenger() -> None:
    champion = noise(np.random.default_rng(7), 2000, 2, 0.5) * [1.0, 0.0]
    found = compare(champion, 0.5 * champion, BLOCK)
    assert found.promote
    assert found.ratio.value[1] == 1.0
    challenger = champion.copy()
    challenger[70, 1] = np.nan
    with pytest.raises(DivergedError, match="challenger on joint 2 at sample 70 is nan"):
        compare(champion, challenger, BLOCK)


def test_errors_that_do_not_fit_together_are_refused() -> None:
    errors = np.ones((200, 2))
    with pytest.raises(ShapeError, match=r"challenger has shape \(199, 2\), expected \(200, 2\)"):
        compare(errors, errors[1:], BLOCK)
    with pytest.raises(ShapeError, match=r"expected \(T, n\) with T at least 300"):
        compare(errors, errors, 300)
    with pytest.raises(ShapeError, match=r"errors of the champion has shape \(200,\)"):
        compare(errors[:, 0], errors[:, 0], BLOCK)


LOOKS = (12, 24, 48, 96, 192)  # blocks, after which a verdict is looked for
JOINTS = 7


def block_errors(random: np.random.Generator, better: float) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of two models whose blocks are of varying size, alike for both in part.

    Args:
        random: Source of what is drawn.
        better: Part of the champion's squared error that the challenger has, on three joints.
    """
    shape = LOOKS[-1], JOINTS
    common, models = random.standard_normal(shape), []
    for factor in (1.0, better):
        size = np.exp(0.5 * (common + 0.5 * random.standard_normal(shape)))
        size[:, :3] *= np.sqrt(factor)
        models.append(size[:, None] * random.standard_normal((shape[0], 5, JOINTS)))
    champion, challenger = (errors.reshape(-1, JOINTS) for errors in models)
    return champion, challenger


@pytest.mark.parametrize(("better", "least", "most"), [(1.0, 0.0, 0.1), (0.3, 0.85, 1.0)])
def test_looking_often_promotes_few_by_luck_and_drops_few_that_are_better(
    better: float, least: float, most: float
) -> None:
    random, promoted = np.random.default_rng(3), 0
    for _ in range(80):
        champion, challenger = block_errors(random, better)
        for blocks in LOOKS:
            rows = slice(0, 5 * blocks)
            verdict = compare(champion[rows], challenger[rows], 5, len(LOOKS))
            if verdict.promote or verdict.drop:
                promoted += verdict.promote
                break
    assert least <= promoted / 80 <= most


def test_what_is_worse_on_one_joint_is_dropped_by_name() -> None:
    random = np.random.default_rng(4)
    champion, challenger = random.standard_normal((2, 500, 3))
    challenger[:, 1] *= 2.0
    verdict = compare(champion, challenger, 5, 6)
    assert verdict.surely_worse == (2,)
    assert verdict.drop
    assert not verdict.promote
    assert verdict.as_values()["surely_worse"] == [2]
