"""Friction with memory and cogging in MJCF: of DC motors that have no input, as MuJoCo has them.

`<dcmotor input="none" lugre="stiffness damping sliding breakaway speed"/>` is LuGre friction of a
joint, and `cogging="amplitude cycles phase"` a torque that repeats with its angle. Neither counts
among the controls of a model.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError
from limo_driver.exports.xml_edits import as_list
from limo_driver.quoting import in_xml

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.exports.xml_edits import Element, XmlText
    from limo_driver.model.descriptions.description import JointDynamics

_TAG: Final = "dcmotor"
_SECTION: Final = "actuator"
_SAME: Final = 1e-9  # relative; and rad


def write_motors(
    texts: Sequence[XmlText],
    joint: str,
    stated: JointDynamics,
    wanted: JointDynamics,
    into: Path,
) -> list[str]:
    """Write LuGre friction and cogging of a joint, where they are others than the file states.

    Args:
        texts: Of the file and its includes.
        joint: Its name.
        stated: What the file has.
        wanted: What it shall have.
        into: The file, for messages.

    Returns:
        Lines of motors that the file lacks, for `append_motors`.

    Raises:
        ConfigError: What the file has stands in a default class, which others may share.
    """
    lines = list[str]()
    for attribute, had, has in (
        ("lugre", stated.bristles, wanted.bristles),
        ("cogging", stated.ripples, wanted.ripples),
    ):
        if len(had) == len(has) and all(map(_alike, had, has)):
            continue
        own = _motors_of(texts, joint, attribute)
        if len(own) != len(had):
            raise ConfigError(
                f"{attribute} of joint {joint} has to change, but is stated in a default class; "
                "state it in its own dcmotor",
                path=into,
            )
        for (text, element), values in zip(own, has, strict=False):
            text.set(element, attribute, as_list(*values))
        for text, element in own[len(has) :]:
            if _is_own(element, joint, attribute):
                text.drop(element)
            else:
                text.remove(element, attribute)
        for number, values in enumerate(has[len(own) :], start=len(own) + 1):
            name = in_xml(f"{joint}_{attribute}" + (f"_{number}" if len(has) > 1 else ""))
            lines.append(
                f'<{_TAG} name="{name}" joint="{in_xml(joint)}" input="none" resistance="1" '
                f'{attribute}="{as_list(*values)}"/>'
            )
    return lines


def append_motors(text: XmlText, lines: Sequence[str]) -> None:
    """Write motors behind all actuators that there are, whose numbers stay.

    Args:
        text: Of the file.
        lines: Of `write_motors`.
    """
    if not lines:
        return
    sections = [child for child in text.root.children if child.tag == _SECTION]
    if sections and not sections[-1].is_empty:
        for line in lines:
            text.append(sections[-1], line)
    else:
        text.append(text.root, f"<{_SECTION}>")
        for line in lines:
            text.append(text.root, f"  {line}")
        text.append(text.root, f"</{_SECTION}>")


def _motors_of(
    texts: Sequence[XmlText], joint: str, attribute: str
) -> list[tuple[XmlText, Element]]:
    return [
        (text, element)
        for text in texts
        for element in text.root.walk()
        if element.tag == _TAG
        and element.attributes.get("joint") == joint
        and attribute in element.attributes
    ]


def _is_own(element: Element, joint: str, attribute: str) -> bool:
    """Say whether an export wrote a motor, which says nothing else."""
    name = element.attributes.get("name", "")
    known = {"name", "joint", "input", "resistance", attribute}
    return name.startswith(f"{joint}_{attribute}") and element.attributes.keys() == known


def _alike(first: Sequence[float], second: Sequence[float]) -> bool:
    return all(
        math.isclose(a, b, rel_tol=_SAME, abs_tol=_SAME) for a, b in zip(first, second, strict=True)
    )
