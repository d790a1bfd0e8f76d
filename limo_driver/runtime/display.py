"""Display of values: one line as text, a table of joints in a notebook."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isnan
from typing import Final

from limo_driver.quoting import in_html, in_line, on_terminal


class Displayed:
    """A value with a short `repr`, a longer `str`, and a table in notebooks.

    A subclass says what it is in one line, and, where it has figures of each joint, those. A frozen
    dataclass of it is made with `repr=False`, which keeps arrays out of the line.
    """

    def __init_subclass__(cls, **given: object) -> None:
        """Let a subclass that says more say names as data, too."""
        super().__init_subclass__(**given)
        if (said := vars(cls).get("__str__")) is not None:
            cls.__str__ = lambda self: on_terminal(said(self))

    def headline(self) -> str:
        """Say in one line what this is, with the figures that matter most and their units."""
        raise NotImplementedError

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the columns of the table by heading, with units; one row for each joint."""
        return {}

    def __repr__(self) -> str:
        return in_line(f"<{type(self).__name__}: {self.headline()}>")

    def __str__(self) -> str:
        columns = {name: [name, *map(_text, values)] for name, values in self.figures().items()}
        if not columns:
            return on_terminal(self.headline())
        widths = [max(map(len, column)) for column in columns.values()]
        rows = zip(*columns.values(), strict=True)
        lines = ["  ".join(map(str.rjust, row, widths)) for row in rows]
        return on_terminal("\n".join([self.headline(), *lines]))

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        line, columns = f"<p>{in_html(self.headline())}</p>", self.figures()
        if not columns:
            return line
        head = "".join(f"<th>{in_html(name)}</th>" for name in columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{in_html(_text(value))}</td>" for value in row) + "</tr>"
            for row in zip(*columns.values(), strict=True)
        )
        return f"{line}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def naturally(name: str) -> list[tuple[int, str]]:
    """Return what sorts names with numbers in them by the numbers."""
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _text(value: object) -> str:
    """Return a value of the table; four digits behind the point are enough of a torque."""
    if isinstance(value, float):
        return "-" if isnan(value) else f"{value:.4f}"
    return str(value)


def spanned(names: Sequence[str]) -> str:
    """Return the first and the last of names that go together, or both of two."""
    few = 2
    return f"{names[0]} … {names[-1]}" if len(names) > few else ", ".join(names)


def shortened(names: Sequence[str], most: int = 8) -> str:
    """List names, the first few of many."""
    listed = ", ".join(names[:most]) or "none"
    return listed + (f" and {len(names) - most} more" if len(names) > most else "")


def joint_called(joint: int, name: str) -> str:
    """Return a joint by its number, and by its name where that says more than the number."""
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    return str(joint) if not plain or plain.endswith(f"joint{joint}") else f"{joint} ({name})"


def joints_called(names: Sequence[str]) -> tuple[str, ...]:
    """Return joints as tables call them, in their order: `3 (stick)`, or `3` alone."""
    return tuple(joint_called(j, name) for j, name in enumerate(names, start=1))


def joint_labels(names: Sequence[str]) -> tuple[str, ...]:
    """Return joints as charts call them, in their order."""
    return tuple(f"joint {called}" for called in joints_called(names))


_JOINTS: Final = re.compile(
    r"\b(?:[Jj]oint \d+|[Jj]oints \d+(?:(?:, | and | or )\d+)*)(?!\d|\.\d| \()"
)


def call_joints(text: str, names: Sequence[str]) -> str:
    """Return a text in which joints that stand by number stand by name, too.

    Args:
        text: Such as "at joint 2 the error grows".
        names: Of all joints of the arm.
    """

    def called(number: re.Match[str]) -> str:
        joint = int(number[0])
        return joint_called(joint, names[joint - 1]) if 0 < joint <= len(names) else number[0]

    return _JOINTS.sub(lambda found: re.sub(r"\d+", called, found[0]), text)
