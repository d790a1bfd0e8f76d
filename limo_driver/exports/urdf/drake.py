"""Rotor inertias in a URDF as Drake reads them: of the actuator in a joint's transmission.

Drake reflects a rotor's inertia by the square of the gear ratio. Here the ratio is 1, and the
inertia that of the joint: `<drake:rotor_inertia>` where there was none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.quoting import in_xml

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from limo_driver.exports.changes.origin import FileOrigin
    from limo_driver.exports.xml_edits import Element, XmlText

_NAMESPACE: Final = "http://drake.mit.edu"
_INERTIA: Final = "drake:rotor_inertia"
_RATIO: Final = "drake:gear_ratio"
_OF_LIMO: Final = "_transmission"  # behind the joint's name, of a transmission where there was none


def write_rotors(
    text: XmlText, armature: Mapping[str, float], origin: FileOrigin, *, keep: bool = False
) -> tuple[dict[str, float], dict[str, float]]:
    """Write the inertia of drives, as seen at the joints, into a URDF.

    Where a joint has none by now, that of an earlier export goes, and that of the user stays.

    Args:
        text: The URDF.
        armature: By joint [kg m²].
        origin: What an earlier export wrote.
        keep: Whether that stays, too, where a joint has none by now.

    Returns:
        By joint, what the user's file states [kg m²], and what it has after this export.
    """
    stated = rotors_of(text)
    users = {
        joint: origin.users(joint, JointDynamics(armature=stated.get(joint, 0.0))).armature
        for joint in armature
    }
    instead = stated if keep else users
    wanted = {joint: own or instead.get(joint, 0.0) for joint, own in armature.items()}
    if any(armature.values()) and "xmlns:drake" not in text.root.attributes:
        text.set(text.root, "xmlns:drake", _NAMESPACE)
    for joint, inertia in wanted.items():
        if inertia:
            _write_rotor(text, joint, inertia)
        elif joint in stated:
            _drop_rotor(text, joint)
    return users, wanted


def rotors_of(text: XmlText) -> dict[str, float]:
    """Return the inertia of drives as seen at the joints [kg m²], by joint, as Drake reads it."""
    found: dict[str, float] = {}
    for transmission in text.root.children:
        joint, actuator = transmission.child("joint"), transmission.child("actuator")
        if transmission.tag != "transmission" or joint is None or actuator is None:
            continue
        inertia, ratio = (_value(actuator, tag) for tag in (_INERTIA, _RATIO))
        if inertia is not None:
            gear = 1.0 if ratio is None else ratio
            found[joint.attributes.get("name", "")] = inertia * gear**2
    return found


def _write_rotor(text: XmlText, joint: str, inertia: float) -> None:
    written = f'<{_INERTIA} value="{inertia:.10g}"/>'
    for actuator in _actuators(text, joint):
        stated, ratio = actuator.child(_INERTIA), _value(actuator, _RATIO) or 1.0
        if stated is None:
            text.insert(actuator, f'<{_INERTIA} value="{inertia / ratio**2:.10g}"/>')
        else:
            text.set(stated, "value", f"{inertia / ratio**2:.10g}")
        return
    name = in_xml(joint)
    text.insert(
        text.root,
        f'<transmission name="{name}{_OF_LIMO}">'
        "<type>transmission_interface/SimpleTransmission</type>"
        f'<joint name="{name}"/><actuator name="{name}_actuator">{written}'
        f'<{_RATIO} value="1"/></actuator></transmission>',
    )


def _drop_rotor(text: XmlText, joint: str) -> None:
    for actuator in _actuators(text, joint):
        transmission, stated = actuator.parent, actuator.child(_INERTIA)
        if transmission is not None and transmission.attributes.get("name") == f"{joint}{_OF_LIMO}":
            text.drop(transmission)
        elif stated is not None:
            text.drop(stated)


def _actuators(text: XmlText, joint: str) -> Iterator[Element]:
    """Yield the actuators of a joint's transmissions."""
    for transmission in text.root.children:
        its, actuator = transmission.child("joint"), transmission.child("actuator")
        is_its = its is not None and its.attributes.get("name") == joint
        if transmission.tag == "transmission" and is_its and actuator is not None:
            yield actuator


def _value(actuator: Element, tag: str) -> float | None:
    element = actuator.child(tag)
    return None if element is None else float(element.attributes.get("value", "0"))
