"""Frozen values are compared with what they count beside."""

from __future__ import annotations

import pytest
from frozen_values import FITS, differences

MOVED = 10.0 * FITS


@pytest.mark.parametrize(
    ("frozen", "moved"),
    [
        ({"rmse": 0.5}, {"rmse": 0.5 * (1 + MOVED)}),
        ({"share": 1e-3}, {"share": 1e-3 + MOVED}),  # of a whole
        ({"value": 1e-3, "deviation": 2.0}, {"value": 1e-3 + 2.0 * MOVED, "deviation": 2.0}),
        ({"com": [0.0, 4.0]}, {"com": [4.0 * MOVED, 4.0]}),
        ({"rows": 3}, {"rows": 4}),
        ({"effects": ["play", "lag"]}, {"effects": ["lag", "play"]}),
        ({"said": "joint 2 has play"}, {"said": "joint 2 has a lag"}),
    ],
)
def test_what_moves_by_more_than_its_scale_allows_is_told(frozen, moved):
    (found,) = differences(frozen, moved, FITS, figures_in_texts=False)[:1]
    assert str(found).startswith(next(iter(frozen)))


@pytest.mark.parametrize(
    ("frozen", "moved"),
    [
        ({"share": 1e-3}, {"share": 1e-3 + 0.5 * FITS}),
        ({"value": 1e-9, "deviation": 2.0}, {"value": 5e-9, "deviation": 2.0}),
        ({"value": None, "deviation": 2.0}, {"value": None, "deviation": 2.0}),
        ({"com": [0.0, 4.0]}, {"com": [FITS, 4.0]}),
        ({"said": "joint 2 errs by 0.123 N m"}, {"said": "joint 2 errs by 0.124 N m"}),
    ],
)
def test_what_rounding_moves_is_not(frozen, moved):
    assert differences(frozen, moved, FITS, figures_in_texts=False) == []
