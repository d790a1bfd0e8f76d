"""Families of columns: one quantity of all joints, found by what the names have in common."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from limo_driver.logs.readers.columns.names import (
    COMMANDED,
    DERIVED,
    MEASURED,
    NO_COLUMN,
    PLAIN,
    TIME,
    read_name,
)
from limo_driver.runtime.display import spanned

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from limo_driver.logs.readers.columns.names import Name

_SAID = {MEASURED: "measured", PLAIN: "", COMMANDED: "commanded", DERIVED: "derived"}


@dataclass(frozen=True)
class ColumnFamily:
    """Columns of one quantity, one for each joint."""

    quantity: str
    rank: int
    names: tuple[Name, ...]  # in the order of the joints
    missing: tuple[str, ...] = ()  # joints that have none
    beyond: tuple[str, ...] = ()  # columns of more joints than the robot has
    by_order: bool = False  # whether joints are told by nothing but the order of the columns

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(name.column for name in self.names)

    @property
    def unit(self) -> str:
        """The unit that the names say; empty where they say none, or several."""
        units = {name.unit for name in self.names}
        return units.pop() if len(units) == 1 else ""

    def beside(self, other: ColumnFamily) -> ColumnFamily | None:
        """Return this with `NO_COLUMN` for joints that only another has; None if it has others.

        Args:
            other: Which has all joints, in their order.
        """
        own = {name.joint: name for name in self.names}
        every = [name.joint for name in other.names]
        if self.by_order or self.beyond or None in own or not own.keys() <= {*every}:
            return None
        first = self.names[0]
        lacking = replace(first, column=NO_COLUMN)
        names = tuple(own.get(joint, replace(lacking, joint=joint)) for joint in every)
        return replace(self, names=names, missing=())

    def __str__(self) -> str:
        """Name its columns, and whether they are measured."""
        said = _SAID[self.rank]
        known = [column for column in self.columns if column != NO_COLUMN]
        return f"{spanned(known)}{f' ({said})' if said else ''}"


def families_of(columns: Iterable[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families of columns that have to do with joints, those of times left aside.

    Args:
        columns: Names of all columns.
        joints: Names of the robot's joints; empty where the robot is not known.
    """
    spelled = [joint for joint in joints if any(sign.isalpha() for sign in joint)]
    names = [read_name(column, spelled) for column in columns]
    by_kind: dict[tuple[str, int, tuple[str, ...]], dict[str | int, Name]] = defaultdict(dict)
    loose: dict[tuple[str, int], list[Name]] = defaultdict(list)
    for name in names:
        if name.quantity == TIME:
            continue
        if name.joint is None:
            loose[name.quantity, name.rank].append(name)
        else:
            by_kind[name.kind].setdefault(name.joint, name)
    found = [_family(kind[0], kind[1], members, joints) for kind, members in by_kind.items()]
    in_order = [
        ColumnFamily(quantity, rank, tuple(members), by_order=True)
        for (quantity, rank), members in loose.items()
        if quantity and (len(members) == len(joints) if joints else len(members) > 1)
    ]
    return [family for family in (*found, *in_order) if family.names]


def _family(
    quantity: str, rank: int, members: Mapping[str | int, Name], joints: Sequence[str]
) -> ColumnFamily:
    named = [joint for joint in joints if joint in members]
    if named:
        missing = tuple(joint for joint in joints if joint not in members)
        return ColumnFamily(quantity, rank, tuple(members[joint] for joint in named), missing)
    numbers = sorted(key for key in members if isinstance(key, int))
    ordered = tuple(members[number] for number in numbers)
    first = 0 if numbers[0] == 0 else 1
    wanted = range(first, first + (len(joints) or len(numbers)))
    missing = tuple(f"number {k}" for k in wanted if k not in members)
    beyond = tuple(members[k].column for k in numbers if k not in wanted)
    kept = tuple(name for k, name in zip(numbers, ordered, strict=True) if k in wanted)
    return ColumnFamily(quantity, rank, kept, missing, beyond)
