"""Each promise of docs/safety.md names tests, and there are such tests."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text()
PROMISES = PAGE[PAGE.index("## What is promised") : PAGE.index("## What is not promised")]
ROWS = [
    row for row in re.findall(r"^\| (.+) \|$", PROMISES, flags=re.MULTILINE) if "---" not in row
]
ROWS = [row for row in ROWS if not row.startswith("promise |")]


def test_the_page_promises_something():
    assert len(ROWS) > 25


@pytest.mark.parametrize("row", ROWS)
def test_each_promise_names_its_tests(row):
    named = re.findall(r"`([\w/]+\.py)((?:::\w+)*)`", row)
    assert named
    for file, names in named:
        text = (ROOT / "tests" / file).read_text()
        for name in names.split("::")[1:]:
            assert re.search(rf"^\s*(?:def|class) {name}\b", text, flags=re.MULTILINE), name
