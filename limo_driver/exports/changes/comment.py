"""Comments at the end of a file, in which an export says to a later one what it did."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.exports.xml_edits import XmlText


def read_comment(text: XmlText, title: str) -> Any:  # noqa: ANN401  # any JSON
    """Return what a comment says; None where there is none, or it is no JSON.

    Args:
        text: The file.
        title: With which the comment begins, such as `limo wrote`.
    """
    found = _found(text, title)
    try:
        return None if found is None else json.loads(found[1])
    except ValueError:
        return None


def write_comment(text: XmlText, title: str, entries: Mapping[str, Any]) -> None:
    """Write a comment anew, where it has to say something else.

    Args:
        text: The file.
        title: With which the comment begins.
        entries: What it says; of none there is no comment.
    """
    said = json.dumps(entries).replace("--", "-\\u002d")  # which no comment may hold
    found = _found(text, title)
    if found is not None:
        if not entries:
            text.cut(found.start(), found.end())
        elif found[1].decode() != said:
            text.cut(found.start(1), found.end(1), said)
    elif entries:
        end = len(text.data[: text.root.end].rstrip())
        text.cut(end, end, f"\n  <!-- {title}: {said} -->")


def _found(text: XmlText, title: str) -> re.Match[bytes] | None:
    return re.search(rb"\s*<!-- " + re.escape(title.encode()) + rb": (\{.*?\}) -->", text.data)
