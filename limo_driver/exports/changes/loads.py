"""Loads: bodies that an earlier export added to a file, and which of them an export puts anew.

A comment at the end of the file lists them: `<!-- limo added: {"payload": {"on": "link7", "mass":
0.9, "com": [0, 0, 0.1], "inertia": [...]}} -->`. A body that somebody has changed since is the
user's, and stays. So does one that the simulation counts to the link: who goes on with the exported
file as robot has the load in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.exports.changes.bodies import moved, pseudo_inertia
from limo_driver.exports.changes.origin import read_comment, write_comment
from limo_driver.model.descriptions.geometry import Inertial

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from limo_driver.exports.changes.bodies import BodyPart
    from limo_driver.exports.xml_edits import XmlText
    from limo_driver.physics import Payload
    from limo_driver.types import FloatArray

_TITLE: Final = "limo added"
_NAME: Final = "payload"
_SAME: Final = 1e-6  # relative, of second moments: files round to ten digits, simulators turn axes


@dataclass(frozen=True)
class AddedBody:
    """A body that an export added."""

    on: str  # link that carries it
    body: Inertial  # in its own frame, as it was written


def added_bodies(text: XmlText) -> dict[str, AddedBody]:
    """Return the bodies that earlier exports added, by name; of no or an unusable comment, none.

    Args:
        text: The file.
    """
    said = read_comment(text, _TITLE)
    try:
        return {str(name): _entry(entry) for name, entry in (said or {}).items()}
    except (ValueError, TypeError, KeyError, AttributeError):
        return {}


def still_there(
    added: Mapping[str, AddedBody], parts: Iterable[Sequence[BodyPart]]
) -> dict[str, AddedBody]:
    """Return those of the added bodies that are still in a file as they were written.

    Args:
        added: By name.
        parts: Bodies that move with each link, its own first.
    """
    return {
        part.name: added[part.name]
        for of_link in parts
        for part in of_link[1:]
        if part.name in added
        and added[part.name].on == of_link[0].name
        and part.inertial is not None
        and _alike(added[part.name].body, part.inertial)
    }


def write_added(text: XmlText, added: Mapping[str, AddedBody]) -> None:
    """Write which bodies exports added.

    Args:
        text: The file.
        added: By name.
    """
    write_comment(
        text,
        _TITLE,
        {
            name: {
                "on": each.on,
                "mass": _rounded(each.body.mass),
                "com": [_rounded(x) for x in each.body.com],
                "inertia": [_rounded(x) for x in each.body.inertia],
            }
            for name, each in added.items()
        },
    )


def replaced_bodies(
    parts: Sequence[BodyPart], added: Mapping[str, AddedBody], wanted: Inertial
) -> tuple[str, ...]:
    """Return the added bodies that a simulation does not count to a link, by name.

    One after the other is taken away, as long as what is left comes nearer to the simulation's
    link.

    Args:
        parts: Bodies of the file that move with the link, its own first.
        added: Bodies that exports added, as far as they are still there.
        wanted: The link in the simulation, in its own frame and without loads.
    """
    there = {
        part.name: moved(part.inertial, part.pose)
        for part in parts
        if part.inertial is not None and part.name in added
    }
    whole = sum(
        (moved(part.inertial, part.pose) for part in parts if part.inertial is not None),
        np.zeros((4, 4)),
    )
    target, gone = pseudo_inertia(wanted), list[str]()
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole))) + np.finfo(float).tiny
    while there:
        nearest = min(there, key=lambda name: _apart(whole - there[name], target, scale))
        less = whole - there.pop(nearest)
        if _apart(less, target, scale) >= _apart(whole, target, scale):
            break
        whole, gone = less, [*gone, nearest]
    return tuple(part.name for part in parts if part.name in gone)


def placed(
    payloads: Sequence[Payload], replaced: Sequence[str], taken: Collection[str]
) -> dict[str, Payload]:
    """Return under which name each load stands: those of replaced bodies first.

    Args:
        payloads: Of the simulation.
        replaced: Names of bodies that stand in the file and are put anew.
        taken: Names that the file has.
    """
    fresh = (
        name
        for number in count()
        if (name := _NAME if not number else f"{_NAME}_{number}") not in taken
    )
    names = [*replaced, *(next(fresh) for _ in payloads[len(replaced) :])]
    return dict(zip(names, payloads, strict=False))


def gone_lines(
    replaced: Iterable[str], loads: Collection[str], added: Mapping[str, AddedBody]
) -> tuple[str, ...]:
    """Say which bodies go, as the simulation has fewer loads.

    Args:
        replaced: Names of bodies that are put anew, or go.
        loads: Names of those that stay.
        added: Bodies that exports added.
    """
    return tuple(
        f"body {name} of {added[name].body.mass:.4g} kg on {added[name].on}, which an earlier "
        "export added; the simulation has it no longer"
        for name in replaced
        if name not in loads
    )


def _entry(entry: Mapping[str, Any]) -> AddedBody:
    x, y, z = map(float, entry["com"])
    xx, xy, xz, yy, yz, zz = map(float, entry["inertia"])
    body = Inertial(float(entry["mass"]), (x, y, z), (xx, xy, xz, yy, yz, zz))
    return AddedBody(str(entry["on"]), body)


def _alike(first: Inertial, second: Inertial) -> bool:
    one, other = (pseudo_inertia(body) for body in (first, second))
    size = np.abs(np.diag(one))
    return bool((np.abs(one - other) <= _SAME * np.sqrt(np.outer(size, size)) + 1e-12).all())


def _apart(first: FloatArray, second: FloatArray, scale: FloatArray) -> float:
    return float(np.linalg.norm((first - second) / scale))


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")
