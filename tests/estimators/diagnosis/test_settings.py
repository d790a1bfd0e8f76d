"""Settings: each says what it is and trades, and the page lists all of them as they are."""

from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from estimators.diagnosis.settings import settings_of
from estimators.diagnosis.settings.residuals import NOISE
from estimators.diagnosis.settings.table import groups, table

PAGE = Path(__file__).parents[3] / "docs" / "diagnosis_settings.md"
GROUPS = list(groups())
NAMES = [name for name, _ in GROUPS]


def test_the_page_is_the_table():
    assert PAGE.read_text(encoding="utf-8") == table()


@pytest.mark.parametrize(("name", "group"), GROUPS, ids=NAMES)
def test_each_says_what_it_is_what_it_trades_and_why(name, group):
    for item in settings_of(group):
        assert item.meaning, name
        assert item.trades, name
        assert item.chosen, name
        assert item.value == getattr(group, item.name)


def test_names_of_groups_are_unique():
    assert len(set(NAMES)) == len(NAMES) > 20


def test_nothing_changes_them():
    with pytest.raises(FrozenInstanceError):
        NOISE.order = 4
