"""Each number of the gate, held from both sides, and its intervals beside their formulas."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from estimators.service.comparison import Shadow
from estimators.service.gate import Comparison, ConfidenceInterval, accuracy, compare, plain
from limo_driver.errors import DivergedError, ShapeError

TINY = 1e-12
ROWS = 7  # of a block


def interval(value, influence, level=0.95):
    """Return low and high of one number from what each block adds to it, as the module says."""
    K = len(influence)
    off = influence - np.mean(influence)
    size = float(np.sum(off**2))
    between = float(np.sum(off[1:] * off[:-1])) / size if size else 0.0
    between = min(max(between, 0.0), 0.9)
    deviation = np.sqrt(size / (K - 1) / K * (1 + between) / (1 - between))
    width = deviation * student.ppf(0.5 + level / 2, K - 1)
    return value - width, value + width


def wandering(seed, K, keep, n=3):
    """Return errors of K blocks whose size wanders; of one model, (T, n)."""
    random = np.random.default_rng(seed)
    size = random.standard_normal((K, n))
    for k in range(1, K):
        size[k] = keep * size[k - 1] + np.sqrt(1 - keep**2) * size[k]
    blocks = np.exp(0.5 * size)[:, None] * random.standard_normal((K, ROWS, n))
    return blocks.reshape(-1, n)


def means(errors):
    return (errors**2).reshape(-1, ROWS, errors.shape[1]).mean(axis=1)


# Blocks that hardly depend on each other, that alternate, that share much, and all but everything.
@pytest.mark.parametrize("keep", [0.0, -0.9, 0.7, 0.995])
@pytest.mark.parametrize("K", [10, 11, 60, 400])
class TestIntervals:
    def test_are_those_of_students_t_for_what_blocks_share(self, K, keep):
        champion, challenger = wandering(1, K, keep), 0.9 * wandering(2, K, keep)
        looks = 4
        found = compare(champion, challenger, ROWS, looks)
        a, b = means(challenger), means(champion)
        d = a / a.mean(axis=0) - b / b.mean(axis=0)
        logs = np.log(a.mean(axis=0) / b.mean(axis=0))
        assert found.blocks == K
        assert found.champion == pytest.approx(np.sqrt(b.mean(axis=0)))
        assert found.challenger == pytest.approx(np.sqrt(a.mean(axis=0)))
        assert found.ratio.value == pytest.approx(np.exp(logs))
        for j in range(3):
            ends = (found.ratio.low[j], found.ratio.high[j])
            assert np.log(ends) == pytest.approx(interval(logs[j], d[:, j]), rel=1e-9)
        mean = interval(logs.mean(), d.mean(axis=1), 1 - 0.05 / looks)
        assert float(found.mean_ratio.value) == pytest.approx(np.exp(logs.mean()))
        ends = (float(found.mean_ratio.low), float(found.mean_ratio.high))
        assert np.log(ends) == pytest.approx(mean, rel=1e-9)

    def test_of_rmse_are_to_first_order(self, K, keep):
        champion, challenger = wandering(1, K, keep), 0.9 * wandering(2, K, keep)
        found = compare(champion, challenger, ROWS)
        one = accuracy(champion, ROWS)
        a, b = means(challenger), means(champion)
        A, B = np.sqrt(a.mean(axis=0)), np.sqrt(b.mean(axis=0))
        for j in range(3):
            given = interval(A[j] - B[j], a[:, j] / (2 * A[j]) - b[:, j] / (2 * B[j]))
            ends = (found.difference.low[j], found.difference.high[j])
            assert ends == pytest.approx(given, rel=1e-9)
            ends = (one.low[j], one.high[j])
            assert ends == pytest.approx(interval(B[j], b[:, j] / (2 * B[j])), rel=1e-9)
        assert one.value == pytest.approx(B)

    def test_say_what_is_surely_worse_of_all_joints_in_all_looks(self, K, keep):
        """A joint just beyond the interval of one look is worse; surely only beyond all of them."""
        champion = wandering(1, K, keep)
        other = wandering(2, K, keep)
        logs, d = difference(champion, other)
        for looks in (1, 5):
            low, _ = interval(logs[1], d[:, 1], 1 - 0.05 / looks / 3)
            for beyond, worse in ((-1e-6, ()), (1e-6, (2,))):
                # This much worse, its interval begins just beyond 1.
                scale = np.exp([-20.0, 0.5 * (beyond - low), -20.0])
                assert compare(champion, other * scale, ROWS, looks).surely_worse == worse


@pytest.mark.parametrize("K", [10, 400])
def test_blocks_that_share_nearly_all_count_as_if_they_shared_nine_tenths(K):
    errors = np.repeat(np.sqrt(np.linspace(1.0, 2.0, K)), ROWS)[:, None]
    a = means(errors)[:, 0]
    off = a - a.mean()
    assert (np.sum(off[1:] * off[:-1]) / np.sum(off**2) > 0.9) == (K == 400)
    found, rmse = accuracy(errors, ROWS), np.sqrt(a.mean())
    ends = (found.low[0], found.high[0])
    assert ends == pytest.approx(interval(rmse, a / (2 * rmse)), rel=1e-9)


def difference(champion, challenger):
    a, b = means(challenger), means(champion)
    logs = np.log(a.mean(axis=0) / b.mean(axis=0))
    return logs, a / a.mean(axis=0) - b / b.mean(axis=0)


@pytest.mark.parametrize("K", [1, 2, 9])
def test_fewer_than_ten_blocks_say_nothing(K):
    found = compare(wandering(1, K, 0.0), 0.01 * wandering(2, K, 0.0), ROWS)
    assert (found.blocks, found.needed) == (K, 10)
    assert (found.enough, found.promote, found.drop) == (False, False, False)
    for given, lowest in ((found.difference, -np.inf), (found.ratio, 0.0), (found.mean_ratio, 0.0)):
        assert np.isposinf(given.high).all()
        assert (given.low == lowest).all()
    assert found.surely_worse == ()
    assert found.reason == f"only {K} blocks, at least 10 are needed"
    few = accuracy(wandering(1, K, 0.0), ROWS)
    assert np.isposinf(few.high).all()
    assert np.isneginf(few.low).all()


def test_ten_blocks_may_be_enough():
    found = compare(wandering(1, 10, 0.0), 0.01 * wandering(2, 10, 0.0), ROWS)
    assert found.enough
    assert found.promote
    assert np.isfinite(found.ratio.high).all()


def test_one_look_is_taken_for_the_only_one():
    champion, challenger = wandering(1, 20, 0.0), wandering(2, 20, 0.0)
    once = compare(champion, challenger, ROWS).as_values()
    assert once == compare(champion, challenger, ROWS, 1).as_values()
    assert once != compare(champion, challenger, ROWS, 2).as_values()


def test_what_remains_of_a_block_is_left_out():
    champion, challenger = wandering(1, 12, 0.0), wandering(2, 12, 0.0)
    whole = compare(champion, challenger, ROWS)
    more = np.vstack([champion, np.full((ROWS - 1, 3), 99.0)])
    other = np.vstack([challenger, np.full((ROWS - 1, 3), 1.0)])
    assert compare(more, other, ROWS).as_values() == whole.as_values()


class TestNeeded:
    """The width falls with the root of the number of blocks."""

    @pytest.mark.parametrize("K", [10, 40])
    @pytest.mark.parametrize("looks", [1, 6])
    @pytest.mark.parametrize("better", [0.9, 0.97, 1.0, 1.05])
    def test_is_what_tells_the_mean_from_1(self, better, looks, K):
        champion = wandering(1, K, 0.0)
        found = compare(champion, better * wandering(2, K, 0.0), ROWS, looks)
        value, high = np.log(float(found.mean_ratio.value)), np.log(float(found.mean_ratio.high))
        needed = K * ((high - value) / max(abs(value), 1e-3)) ** 2
        assert found.needed == max(10, int(np.ceil(needed - 1e-6)))

    def test_is_no_more_than_for_a_change_of_a_thousandth(self):
        champion, other = wandering(1, 40, 0.0), wandering(2, 40, 0.0)
        logs, _ = difference(champion, other)
        equal = other * np.exp(-0.5 * logs.mean())

        def needed(change):
            return compare(champion, equal * np.exp(0.5 * change), ROWS).needed

        assert needed(0.0) == needed(0.9e-3) == needed(-0.95e-3)
        assert needed(0.0) == pytest.approx(needed(1.0e-3), rel=1e-6)
        assert needed(1.05e-3) == pytest.approx(needed(0.0) / 1.05**2, rel=1e-4)

    def test_is_ten_at_least(self):
        assert compare(wandering(1, 40, 0.0), 0.01 * wandering(2, 40, 0.0), ROWS).needed == 10


def judged(*, ratio=(0.5, 0.5), mean=(0.4, 0.8), surely=(), blocks=10):
    """Return a comparison of two joints whose ratios begin at `ratio`."""
    ones = np.ones(2)
    of_joints = ConfidenceInterval(ones, np.array(ratio), ones + 9.0)
    of_all = ConfidenceInterval(*map(np.array, (0.6, *mean)))
    return Comparison(ones, ones, of_joints, of_joints, of_all, surely, blocks, 17)


class TestVerdict:
    """Better beyond the interval on average, worse beyond it on no joint."""

    @pytest.mark.parametrize(("blocks", "enough"), [(9, False), (10, True), (11, True)])
    def test_takes_ten_blocks(self, blocks, enough):
        assert judged(blocks=blocks).enough == enough
        assert judged(blocks=blocks).promote == enough
        assert judged(mean=(1.1, 1.2), blocks=blocks).drop == enough
        assert judged(surely=(1,), blocks=blocks).drop == enough

    @pytest.mark.parametrize(
        ("high", "better"), [(1 - TINY, True), (1.0, False), (1 + TINY, False), (0.5, True)]
    )
    def test_is_better_below_1(self, high, better):
        found = judged(mean=(0.4, high))
        assert (found.better, found.promote, found.drop) == (better, better, False)
        assert found.reason.startswith("better on average" if better else "not better beyond")

    @pytest.mark.parametrize("j", [0, 1])
    @pytest.mark.parametrize(("low", "worse"), [(1 - TINY, False), (1.0, False), (1 + TINY, True)])
    def test_is_worse_above_1(self, j, low, worse):
        found = judged(ratio=np.where(np.arange(2) == j, low, 0.5))
        assert found.worse == ((j + 1,) if worse else ())
        assert found.promote != worse
        assert not found.drop  # a joint that only seems worse may still prove not to be
        if worse:
            assert found.reason == (
                f"worse on joint {j + 1}; mean ratio of squared errors 0.6 (0.4 to 0.8)"
            )

    @pytest.mark.parametrize(("low", "drop"), [(1 - TINY, False), (1.0, False), (1 + TINY, True)])
    def test_is_dropped_above_1(self, low, drop):
        assert judged(mean=(low, 1.5)).drop == drop

    def test_says_all_joints_and_how_many_blocks_would_tell(self):
        assert judged(ratio=(2.0, 3.0)).reason.startswith("worse on joint 1, 2; ")
        assert judged(mean=(0.9, 1.1)).reason.endswith("; about 17 blocks would tell")
        assert judged(blocks=4).reason == "only 4 blocks, at least 17 are needed"

    def test_has_values_for_json(self):
        values = judged(surely=(2,)).as_values()
        assert values["promote"] is True
        assert (values["level"], values["blocks"], values["blocks_needed"]) == (0.95, 10, 17)
        assert values["rmse_champion"] == [1.0, 1.0]
        assert values["mean_ratio"] == {"value": 0.6, "low": 0.4, "high": 0.8}
        assert values["surely_worse"] == [2]
        unknown = replace(judged(), champion=np.array([np.nan, np.inf])).as_values()
        assert unknown["rmse_champion"] == [None, None]
        assert plain(np.array([[1.0, np.inf]])) == [[1.0, None]]
        assert plain(np.float64(2.5)) == 2.5
        assert plain(-np.inf) is None


class TestErrorsThatCannotBe:
    @pytest.mark.parametrize(
        ("T", "block", "fine"),
        [(20, 1, 1), (20, 2, 1), (20, 20, 1), (20, 21, 0), (20, 0, 0), (20, -1, 0)],
    )
    def test_have_no_block(self, T, block, fine):
        errors = np.ones((T, 2))
        if fine:
            assert compare(errors, errors, block).blocks == T // block
            accuracy(errors, block)
        else:
            for call in (lambda: compare(errors, errors, block), lambda: accuracy(errors, block)):
                with pytest.raises(ShapeError, match=r"\(T, n\) with T at least"):
                    call()

    @pytest.mark.parametrize("shape", [(20,), (20, 2, 1)])
    def test_have_no_joints(self, shape):
        with pytest.raises(ShapeError, match=r"\(T, n\)"):
            compare(np.ones((20, 2)), np.ones(shape), 2)

    @pytest.mark.parametrize("shape", [(19, 2), (21, 2), (20, 3)])
    def test_are_of_other_instants(self, shape):
        with pytest.raises(ShapeError, match="errors of the challenger"):
            compare(np.ones((20, 2)), np.ones(shape), 2)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_are_not_finite(self, bad):
        errors = np.ones((20, 2))
        errors[7, 1] = errors[9, 0] = bad
        with pytest.raises(DivergedError, match=r"of the champion on joint 2 at sample 7 is"):
            compare(errors, np.ones((20, 2)), 2)
        with pytest.raises(DivergedError, match=r"of the model on joint 2 at sample 7 is"):
            accuracy(errors, 2)


@pytest.mark.parametrize(("rate", "stride", "rows"), [(20.0, 1, 100), (1000.0, 50, 100)])
def test_a_block_lasts_5_seconds(rate, stride, rows):
    service = SimpleNamespace(arm=SimpleNamespace(rate=rate))
    assert Shadow.block.fget(SimpleNamespace(_service=service, _stride=stride)) == rows


def test_errors_of_nothing_are_no_worse_than_nothing():
    nothing = np.zeros((100, 2))
    found = compare(nothing, nothing, 5)
    assert found.ratio.value.tolist() == [1.0, 1.0]
    assert (found.promote, found.drop) == (False, False)
    assert compare(nothing, nothing + 1.0, 5).drop
    assert compare(nothing + 1.0, nothing, 5).promote
