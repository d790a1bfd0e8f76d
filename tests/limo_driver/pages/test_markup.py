"""Figures in the report are rounded towards what they do not quite reach."""

import numpy as np
import pytest

from limo_driver.pages.markup import UNSAID, percent


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (0.001, "less than 1 %"),
        (0.873, "87 %"),
        (0.9969, "99.6 %"),
        (0.99999, "99.9 %"),
        (1.0, "100 %"),
        (np.nan, UNSAID),
    ],
)
def test_nearly_all_is_not_called_all_nor_hardly_any_none(share, text):
    assert percent(share).replace("\N{NO-BREAK SPACE}", " ") == text
