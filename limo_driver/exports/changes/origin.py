"""FileOrigin: what of the joints of a file an earlier export wrote, and what stood there before.

A comment at the end of the file says it, so that a later export can tell limo's own numbers from
the user's: `<!-- limo wrote: {"elbow": {"friction": [0.9, 0.5]}} -->` is a friction of 0.9 over the
0.5 that the user's file had. A number that somebody has changed since is the user's again.
"""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final

from limo_driver.model.descriptions.description import (
    JointDynamics,
    StatedBristles,
    StatedRipple,
    StatedSlip,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.exports.xml_edits import XmlText

TITLE: Final = "limo wrote"  # of the comment
_NAMES: Final = tuple(item.name for item in fields(JointDynamics))
_TUPLES: Final = {"bristles": StatedBristles, "slips": StatedSlip, "ripples": StatedRipple}
_SAME: Final = 1e-8  # relative: files round to ten digits
_SAME_FLOAT: Final = 1e-6  # relative: in USD, numbers are floats of 32 bits
_ADDED: Final = "added"  # attributes that the file's own elements did not have


@dataclass(frozen=True)
class FileOrigin:
    """What an earlier export wrote of each joint, and over what."""

    wrote: Mapping[str, JointDynamics] = field(default_factory=dict)
    over: Mapping[str, JointDynamics] = field(default_factory=dict)
    own: Mapping[str, frozenset[str]] = field(default_factory=dict)  # fields that it wrote
    added: Mapping[str, frozenset[str]] = field(default_factory=dict)  # attributes, by joint
    rounding: float = _SAME  # relative, of the numbers in the file

    @classmethod
    def of(cls, text: XmlText) -> FileOrigin:
        """Read the comment of a file; of none, or one that says nothing, limo wrote nothing.

        Args:
            text: The file.
        """
        return cls.of_entries(read_comment(text, TITLE))

    @classmethod
    def of_layer(cls, path: Path) -> FileOrigin:
        """Read what a layer of USD says in its own data.

        Args:
            path: Of the layer.
        """
        from pxr import Sdf

        said = Sdf.Layer.FindOrOpen(str(path)).customLayerData.get(TITLE)
        try:
            entries = json.loads(said) if isinstance(said, str) else None
        except ValueError:
            entries = None
        return cls.of_entries(entries, _SAME_FLOAT)

    @classmethod
    def of_entries(cls, entries: Any, rounding: float = _SAME) -> FileOrigin:  # noqa: ANN401
        """Read what `origin_entries` returned; of what makes no sense, limo wrote nothing.

        Args:
            entries: As a file has them.
            rounding: Relative, of the numbers in it.
        """
        try:
            parts = {name: _entry(entry) for name, entry in (entries or {}).items()}
        except (ValueError, TypeError, AttributeError):
            return cls()
        return cls(
            {name: part[0] for name, part in parts.items()},
            {name: part[1] for name, part in parts.items()},
            {name: part[2] for name, part in parts.items()},
            {name: part[3] for name, part in parts.items()},
            rounding,
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
            if alike(getattr(wrote, name), getattr(stated, name), self.rounding)
        }
        return replace(stated, **back)


def origin_entries(
    users: Mapping[str, JointDynamics],
    written: Mapping[str, JointDynamics],
    added: Mapping[str, frozenset[str]],
) -> dict[str, dict[str, Any]]:
    """Return what a later export has to know, as JSON has it.

    Args:
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
    return entries


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
    write_comment(text, TITLE, origin_entries(users, written, added))


def alike(first: Any, second: Any, rounding: float = _SAME) -> bool:  # noqa: ANN401
    """Say whether numbers, or tuples of them, are the same but for the rounding of files."""
    if isinstance(first, (tuple, list)):
        pairs = zip(first, second, strict=True)
        return len(first) == len(second) and all(alike(*pair, rounding) for pair in pairs)
    return math.isclose(first, second, rel_tol=rounding, abs_tol=1e-12)


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
    entry = json.dumps(entries).replace("--", "-\\u002d")  # which no comment may hold
    found = _found(text, title)
    if found is not None:
        if not entries:
            text.cut(found.start(), found.end())
        elif found[1].decode() != entry:
            text.cut(found.start(1), found.end(1), entry)
    elif entries:
        end = len(text.data[: text.root.end].rstrip())
        text.cut(end, end, f"\n  <!-- {title}: {entry} -->")


def _found(text: XmlText, title: str) -> re.Match[bytes] | None:
    return re.search(rb"\s*<!-- " + re.escape(title.encode()) + rb": (\{.*?\}) -->", text.data)
