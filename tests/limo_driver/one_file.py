"""What every page of limo has to be: one file that fetches nothing, small, and whole."""

from __future__ import annotations

import json
import re

LARGEST = 3_000_000  # bytes


def check_page(text: str) -> None:
    """Assert that a page needs nothing but itself, and that its parts find each other."""
    assert len(text.encode()) <= LARGEST
    body, _, scripts = text.partition('<script type="application/json" id="figures">')
    assert not re.findall(r'(?:src|href)="(?!#|data:)[a-z]+:', body)
    assert not re.search(r"@import|url\(", body)
    assert len(re.findall("<h1>", body)) == 1
    assert "nan" not in re.sub(r"<[^>]*>", " ", body).lower().split()
    named = set(re.findall(r'\bid="([^"]+)"', body))
    assert set(re.findall(r'href="#([^"]+)"', body)) <= named
    for picture in re.findall(r'<[^>]*role="img"[^>]*>', body):
        assert re.search(r'aria-label="[^"]+"', picture), picture
    figures = json.loads(scripts.partition("</script>")[0])
    placed = [int(number) for number in re.findall(r'data-figure="(\d+)"', body)]
    assert placed
    assert sorted(placed) == list(range(len(figures)))


def title_of(text: str) -> str:
    """Return the head sentence of a page."""
    return re.findall(r"<h1>(.*?)</h1>", text, re.DOTALL)[0]


def drawn(text: str) -> list[dict]:
    """Return the charts of a page."""
    return json.loads(text.partition('id="figures">')[2].partition("</script>")[0])


def arm_of(text: str) -> dict:
    """Return what a page draws of the arm."""
    return json.loads(text.partition('id="arm-data">')[2].partition("</script>")[0])
