"""FileOrigin: what of the joints of a file an earlier export wrote, and what stood there before.

A comment at the end of the file says it, so that a later export can tell limo's own numbers from
the user's: `<!-- limo wrote: {"elbow": {"friction": [0.9, 0.5]}} -->` is a friction of 0.9 over the
0.5 that the user's file had. A number that somebody has changed since is the user's again.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final

from limo_driver.descriptions.description import JointDynamics, StatedBristles, StatedRipple

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.exports.xml_edits import XmlText

_COMMENT: Final = re.compile(rb"\s*<!-- limo wrote: (\{.*?\}) -->")
_NAMES: Final = tuple(item.name for item in fields(JointDynamics))
_TUPLES: Final = {"bristles": StatedBristles, "ripples": StatedRipple}
_SAME: Final = 1e-8  # relative: files round to ten digits
_ADDED: Final = "added"  # attributes that the file's own elements did not have


@dataclass(frozen=True)
class FileOrigin:
    """What an earlier export wrote of each joint, and over what."""

    wrote: Mapping[str, JointDynamics] = field(default_factory=dict)
    over: Mapping[str, JointDynamics] = field(default_factory=dict)
    own: Mapping[str, frozenset[str]] = field(default_factory=dict)  # fields that it wrote
    added: Mapping[str, frozenset[str]] = field(default_factory=dict)  # attributes, by joint

    @classmethod
    def of(cls, text: XmlText) -> FileOrigin:
        """Read the comment of a file; of none, or one that says nothing, limo wrote nothing.

        Args:
            text: The file.
        """
        found = _COMMENT.search(text.data)
        try:
            entries = {} if found is None else json.loads(found[1])
            parts = {name: _entry(entry) for name, entry in entries.items()}
        except (ValueError, TypeError, AttributeError):
            return cls()
        return cls(
            {name: part[0] for name, part in parts.items()},
            {name: part[1] for name, part in parts.items()},
            {name: part[2] for name, part in parts.items()},
            {name: part[3] for name, part in parts.items()},
        )

    def users(self, joint: str, stated: JointDynamics) -> JointDynamics:
        """Return what the user's file states of a joint, without what limo wrote.

        Args:
            joint: Its name.
            stated: What the file has by now.
        """
        if joint not in self.wrote:
            return stated
        wrote, over = self.wrote[joint], self.over[joint]
        back = {
            name: getattr(over, name)
            for name in self.own[joint]
            if alike(getattr(wrote, name), getattr(stated, name))
        }
        return replace(stated, **back)


def write_origin(
    text: XmlText,
    users: Mapping[str, JointDynamics],
    written: Mapping[str, JointDynamics],
    added: Mapping[str, frozenset[str]],
) -> None:
    """Write the comment anew, where it has to say something else.

    Args:
        text: The file.
        users: What the user's file states of each joint.
        written: What it has after this export.
        added: Attributes that are in it only since an export, by joint.
    """
    entries: dict[str, dict[str, Any]] = {}
    for joint, own in users.items():
        pairs = [(name, getattr(written[joint], name), getattr(own, name)) for name in _NAMES]
        changed = {name: [_rounded(new), _rounded(old)] for name, new, old in pairs if new != old}
        changed = {name: pair for name, pair in changed.items() if not alike(*pair)}
        if changed:
            more = {_ADDED: sorted(added[joint])} if added.get(joint) else {}
            entries[joint] = {**changed, **more}
    said = json.dumps(entries).replace("--", "-\\u002d")  # which no comment may hold
    found = _COMMENT.search(text.data)
    if found is not None:
        if not entries:
            text.cut(found.start(), found.end())
        elif found[1].decode() != said:
            text.cut(found.start(1), found.end(1), said)
    elif entries:
        end = len(text.data[: text.root.end].rstrip())
        text.cut(end, end, f"\n  <!-- limo wrote: {said} -->")


def alike(first: Any, second: Any) -> bool:  # noqa: ANN401  # a number, or tuples of them
    """Say whether numbers are the same but for the rounding of files."""
    if isinstance(first, (tuple, list)):
        return len(first) == len(second) and all(map(alike, first, second))
    return math.isclose(first, second, rel_tol=_SAME, abs_tol=1e-12)


def _entry(
    entry: Mapping[str, Any],
) -> tuple[JointDynamics, JointDynamics, frozenset[str], frozenset[str]]:
    own = [name for name in _NAMES if name in entry]
    wrote = {name: _value(name, entry[name][0]) for name in own}
    over = {name: _value(name, entry[name][1]) for name in own}
    added = frozenset(map(str, entry.get(_ADDED, ())))
    return JointDynamics(**wrote), JointDynamics(**over), frozenset(own), added


def _value(name: str, value: Any) -> Any:  # noqa: ANN401
    if name in _TUPLES:
        return tuple(_TUPLES[name](*map(float, item)) for item in value)
    return float(value)


def _rounded(value: Any) -> Any:  # noqa: ANN401
    """Return what a file makes of a value."""
    if isinstance(value, tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.10g}")
