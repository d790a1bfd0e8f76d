"""Texts of pages: figures, units and names as a reader expects them."""

import numpy as np
import pytest

from limo_driver.pages.markup import UNSAID, columns, command, percent, prose


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


def test_units_and_names_of_laws_are_written_as_people_write_them():
    assert prose("coulomb friction of 12%").replace("\N{NO-BREAK SPACE}", " ") == (
        "Coulomb friction of 12 %"
    )
    assert "coulomb_friction" in prose("the effect `coulomb_friction`")


def test_numbers_of_a_table_have_as_many_digits_as_each_other():
    drawn = columns({"joint": ["1", "2"], "error": [0.27, 0.3416]})
    assert '<td class="n">0.270</td>' in drawn
    assert '<td class="n">0.342</td>' in drawn


def test_a_command_breaks_into_lines_between_words_only():
    drawn = command("limo export sim.yaml --to <urdf> --out-dir improved/")
    assert (
        '<span class="whole">--to</span> &lt;urdf&gt; <span class="whole">--out-dir</span>' in drawn
    )
