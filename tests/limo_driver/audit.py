"""Whether a page can be used by everybody: axe-core in a browser, and its keys."""

from __future__ import annotations

import json
from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from browser import Tab

AXE = resources.files("axe_core_python") / "axe.min.js"
DRAWN = (
    "(!document.querySelector('section.arm') || document.body.dataset.arm) && "
    "(!document.querySelector('.chart') || document.body.dataset.charts === 'drawn')"
)
_FOUND = """axe.run(document, OPTIONS).then((found) =>
  found.violations.flatMap((rule) => rule.nodes.map((node) =>
    `${rule.id}: ${node.html.slice(0, 160)} (${node.failureSummary})`)))"""
_STOPS = """[...document.querySelectorAll(
  "a[href], button, input, select, summary, [tabindex='0']")]
  .filter((item) => item.checkVisibility() && item.tabIndex >= 0).length"""


def violations(
    tab: Tab,
    address: str,
    width: int,
    *,
    dark: bool,
    ready: str = DRAWN,
    tags: tuple[str, ...] = (),
) -> list[str]:
    """Open a page and return what axe-core finds wrong: contrast, names, order, keyboard.

    Args:
        tab: Of a browser.
        address: Of the page.
        width: Of the window [px], which the page must not exceed.
        dark: Whether the reader prefers the dark.
        ready: What holds in the page once it is drawn.
        tags: Kinds of rules, as axe-core names them; all without any.
    """
    tab.look(address, width, 900, dark=dark)
    tab.wait(ready)
    assert tab.value("document.documentElement.scrollWidth") <= width
    tab.value(AXE.read_text(encoding="utf-8") + "; 1")
    only = {"runOnly": {"type": "tag", "values": list(tags)}} if tags else {}
    options = json.dumps({"resultTypes": ["violations"]} | only)
    return tab.value(_FOUND.replace("OPTIONS", options))


def reached_by_tab(tab: Tab) -> tuple[int, int]:
    """Press Tab through a page that is open; returns the stops made, and those there are."""
    there = tab.value(_STOPS)
    tab.value("document.body.focus(); window.stops = new Set(); 1")
    for _ in range(there + 2):
        for kind in ("keyDown", "keyUp"):
            tab.ask("Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab",
                    windowsVirtualKeyCode=9)  # fmt: skip
        tab.value("window.stops.add(document.activeElement); 1")
    made = tab.value("window.stops.delete(document.body); window.stops.size")
    return made, there
