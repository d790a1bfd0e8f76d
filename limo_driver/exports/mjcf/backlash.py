"""Backlash in MJCF: a second hinge on the same body, about the same axis, within the gap.

MuJoCo has no attribute for play. A hinge without an actuator beside the joint's own, whose range is
the gap, is what its users write instead: the first hinge is the drive, both together the link. The
drive has to have an inertia of its own, the joint's armature.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.xml_edits import as_list, differ
from limo_driver.quoting import in_xml

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from limo_driver.exports.xml_edits import Element, XmlText
    from limo_driver.model.descriptions.description import JointDynamics

_STEPS: Final = 2.0  # of the simulation, in which a flank answers: the least that MuJoCo takes
_FIRM: Final = "0.99 0.999 0.0001"  # else a flank gives way by as much as a gap is wide


def write_play(
    texts: Sequence[XmlText],
    joint: str,
    stated: JointDynamics,
    wanted: JointDynamics,
    plays: Mapping[str, str],
    spec: Any,  # noqa: ANN401  # a MuJoCo spec
    into: Path,
) -> None:
    """Write the play of a joint, where it is another than the file states.

    Args:
        texts: Of the file and its includes.
        joint: Its name.
        stated: What the file has.
        wanted: What it shall have.
        plays: Names of the hinges that are the play of joints, by joint.
        spec: The file, as MuJoCo reads it.
        into: The file, for messages.

    Raises:
        ConfigError: The joint, or the hinge that is its play, is not named in the file.
    """
    if not differ(stated.gap, wanted.gap):
        return
    half = wanted.gap / 2
    ends = as_list(*(np.rad2deg([-half, half]) if spec.compiler.degree else (-half, half)))
    if joint in plays:
        text, element = _found(texts, plays[joint], into)
        if wanted.gap:
            text.set(element, "range", ends)
        else:
            text.drop(element)
        return
    text, element = _found(texts, joint, into)
    own = mujoco.MjModel.from_xml_path(str(into)).joint(joint)
    quick = as_list(_STEPS * float(spec.option.timestep), 1.0)
    text.insert_after(
        element,
        f'<joint name="{in_xml(joint)}_backlash" type="hinge" pos="{as_list(*own.pos)}" '
        f'axis="{as_list(*own.axis)}" range="{ends}" limited="true" ref="0" damping="0" '
        'stiffness="0" frictionloss="0" armature="0" actuatorfrclimited="false" '
        f'solreflimit="{quick}" solimplimit="{_FIRM}"/>',
    )


def _found(texts: Sequence[XmlText], name: str, into: Path) -> tuple[XmlText, Element]:
    for text in texts:
        if (element := text.find("joint", name)) is not None:
            return text, element
    raise ConfigError(f"joint {name} has to change, but is not named in the file", path=into)
