"""Probation: a new champion goes back where it is worse than the old one was."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.service.comparison.gate import FEWEST_BLOCKS, compare
from estimators.service.retraining.judge import broken

BLOCK = 50  # samples


def found(ratios: tuple[float, float], blocks: int = 40):
    """Compare errors of which those of the new champion have squares so many times as large."""
    old = np.random.default_rng(0).standard_normal((blocks * BLOCK, 2))
    new = np.random.default_rng(1).standard_normal((blocks * BLOCK, 2))
    return compare(old, np.sqrt(ratios) * new, BLOCK)


@pytest.mark.parametrize(
    ("ratios", "predicted", "told"),
    [
        ((0.25, 1.5), (0.25, 1.2), "worse on joint 2 than before and than predicted"),
        ((0.25, 1.5), (0.25, 2.0), ""),  # as the shadow said before it was promoted
        ((0.25, 0.8), (0.25, 0.5), ""),  # less of a gain than was promised is no harm
        ((0.25, 1.05), (0.25, 1.0), ""),  # which may be chance
        ((1.5, 1.5), (2.0, 2.0), "worse than before"),
    ],
)
def test_a_champion_is_broken_where_a_joint_is_worse_than_before_and_than_predicted(
    ratios, predicted, told
):
    said = broken(found(ratios), np.array(predicted))
    assert said.startswith(told) if told else not said


@pytest.mark.parametrize("blocks", [FEWEST_BLOCKS - 1, FEWEST_BLOCKS])
def test_few_blocks_of_motion_say_nothing(blocks):
    assert bool(broken(found((4.0, 4.0), blocks), np.ones(2))) == (blocks == FEWEST_BLOCKS)
