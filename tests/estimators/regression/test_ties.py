"""What differs by rounding alone is the same, and the first of it counts."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.regression.definite import ALIKE, best_first, first_best, is_more, ranked


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_of_values_alike_the_first_counts_whichever_is_larger_by_rounding(sign):
    values = np.array([3.0, 5.0, 5.0 + sign * 1e-12, 1.0])
    assert best_first(values).tolist() == [1, 2, 0, 3]
    assert first_best("abcd", dict(zip("abcd", values, strict=True)).__getitem__) == "b"


def test_what_is_clearly_more_comes_first():
    assert best_first(np.array([5.0, 5.0 + 2 * ALIKE])).tolist() == [1, 0]
    assert is_more(5.0 + 2 * ALIKE, 5.0)
    assert not is_more(5.0 + 0.5 * ALIKE, 5.0)
    assert not is_more(1e7 + 1e-3, 1e7)  # sums of so many nat are not known better
    assert is_more(1e7 + 1.0, 1e7)


def test_ranked_keeps_the_order_of_what_is_alike():
    sizes = {"one": 1.0, "two": 2.0, "again two": 2.0 + 1e-13, "three": 3.0}
    assert ranked(sizes, sizes.__getitem__) == ["three", "two", "again two", "one"]


def test_what_is_out_of_the_question_comes_last_and_in_its_order():
    assert best_first(np.array([-np.inf, 1.0, -np.inf, 2.0])).tolist() == [3, 1, 0, 2]
    assert is_more(-1e6, -np.inf)
    assert not is_more(-np.inf, -np.inf)
    assert not is_more(-np.inf, 0.0)


def test_nothing_has_no_order():
    assert best_first(np.zeros(0)).size == 0
    assert ranked([], float) == []
