"""Slip elements in an MJCF file: plastic springs, which MuJoCo has from 4.0 on.

`<fixed stiffness springyield springlength><joint joint coef="1"/></fixed>` is a spring of one joint
that slips. Its rest is where MuJoCo starts: at `qpos0`, and in each keyframe that the file has.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.origin import alike
from limo_driver.exports.mjcf.servos import append_lines
from limo_driver.exports.xml_edits import as_list
from limo_driver.model.descriptions.mjcf.plasticity import plastic_springs, relax
from limo_driver.quoting import in_xml
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.exports.changes.target import Target
    from limo_driver.exports.xml_edits import Element, XmlText
    from limo_driver.model.descriptions.description import JointDynamics

_SECTION: Final = "tendon"
_YIELD: Final = "springyield"
_STATE: Final = "plastic"  # of a keyframe
_PLAIN: Final = 'damping="0" frictionloss="0" armature="0" limited="false" '  # whatever default is


def have_changed(target: Target) -> bool:
    """Say whether slip elements are others than the file states."""
    return any(not alike(stated.slips, wanted.slips) for _, stated, wanted in target.joints())


def write_slips(texts: Sequence[XmlText], target: Target, into: Path) -> None:
    """Write slip elements, where they are others than the file states.

    Args:
        texts: Of the file and its includes.
        target: What has to change.
        into: The file, for messages.

    Raises:
        ConfigError: What the file has stands in a default class, which others may share.
    """
    if not have_changed(target):
        return
    elements = [(text, element) for text in texts for element in text.root.walk()]
    parents = {e.parent.tag for _, e in elements if e.tag == _SECTION and e.parent is not None}
    plain = _PLAIN if "default" in parents else ""
    model: Any = mujoco.MjModel.from_xml_path(str(into))
    lines = list[str]()
    for joint, stated, wanted in target.joints():
        if alike(stated.slips, wanted.slips):
            continue
        _remove(elements, joint, stated, wanted, into)
        rest = as_list(model.joint(joint).qpos0[0])
        lines += [
            f'<fixed name="{in_xml(f"{joint}_slip_{number}")}" {plain}'
            f'stiffness="{as_list(slip.stiffness)}" {_YIELD}="{as_list(slip.width)}" '
            f'springlength="{rest}"><joint joint="{in_xml(joint)}" coef="1"/></fixed>'
            for number, slip in enumerate(wanted.slips, start=1)
        ]
    append_lines(texts[0], _SECTION, lines)
    for text, element in elements:
        if element.tag == "key":
            text.remove(element, _STATE)  # of so many springs as there were


def _remove(
    elements: Sequence[tuple[XmlText, Element]],
    joint: str,
    stated: JointDynamics,
    wanted: JointDynamics,
    into: Path,
) -> None:
    """Remove the plastic springs of a joint, but leave tendons that others may count on."""
    own = [(text, element) for text, element in elements if _is_plastic(element, joint)]
    if len(own) != len(stated.slips):
        raise ConfigError(
            f"{_YIELD} of joint {joint} has to change, but is stated in a default class; state it "
            "in its own tendon",
            path=into,
        )
    for text, element in own:
        if element.attributes.get("name", "").startswith(f"{joint}_slip_"):
            text.drop(element)
            continue
        text.remove(element, _YIELD)
        if element.tag == "fixed" or not (wanted.stiffness or wanted.cubic):
            text.set(element, "stiffness", "0")


def _is_plastic(element: Element, joint: str) -> bool:
    """Say whether an element is a plastic spring of a joint alone: itself, or a tendon."""
    ends = [child.attributes.get("joint") for child in element.children]
    is_joint = element.tag == "joint" and element.attributes.get("name") == joint
    return _YIELD in element.attributes and (is_joint or ends == [joint])


def write_rests(texts: Sequence[XmlText], file: Path) -> None:
    """Write into keyframes that no plastic spring is bent in them, where there are any of both.

    Args:
        texts: Of the file and its includes.
        file: As they have been written.
    """
    keys = [(text, x) for text in texts for x in text.root.walk() if x.tag == "key"]
    model: Any = mujoco.MjModel.from_xml_path(str(file)) if keys else None
    if model is None or not plastic_springs(model) or len(keys) != model.nkey:
        return
    data = mujoco.MjData(model)
    for number, (text, element) in enumerate(keys):
        mujoco.mj_resetDataKeyframe(model, data, number)
        relax(model, data)
        text.set(element, _STATE, as_list(*data.plastic))
