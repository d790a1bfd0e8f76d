"""Rotor inertias in a URDF as Drake reads them: of the actuator in a joint's transmission.

Drake reflects a rotor's inertia by the square of the gear ratio. Here the ratio is 1, and the
inertia that of the joint: `<drake:rotor_inertia>` where there was none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from limo_driver.exports.xml_edits import as_attribute

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.exports.xml_edits import Element, XmlText

_NAMESPACE: Final = "http://drake.mit.edu"
_INERTIA: Final = "drake:rotor_inertia"
_RATIO: Final = "drake:gear_ratio"


def write_rotors(text: XmlText, armature: Mapping[str, float]) -> None:
    """Write the inertia of drives, as seen at the joints, into a URDF.

    Args:
        text: The URDF.
        armature: By joint [kg m²]; those of 0 are left out.
    """
    if not any(armature.values()):
        return
    if "xmlns:drake" not in text.root.attributes:
        text.set(text.root, "xmlns:drake", _NAMESPACE)
    for joint, inertia in armature.items():
        if inertia:
            _write_rotor(text, joint, inertia)


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
    for transmission in text.root.children:
        its = transmission.child("joint")
        actuator = transmission.child("actuator")
        if transmission.tag != "transmission" or its is None or actuator is None:
            continue
        if its.attributes.get("name") != joint:
            continue
        stated, ratio = actuator.child(_INERTIA), _value(actuator, _RATIO) or 1.0
        if stated is None:
            text.insert(actuator, f'<{_INERTIA} value="{inertia / ratio**2:.10g}"/>')
        else:
            text.set(stated, "value", f"{inertia / ratio**2:.10g}")
        return
    name = as_attribute(joint)
    text.insert(
        text.root,
        f'<transmission name="{name}_transmission">'
        "<type>transmission_interface/SimpleTransmission</type>"
        f'<joint name="{name}"/><actuator name="{name}_actuator">{written}'
        f'<{_RATIO} value="1"/></actuator></transmission>',
    )


def _value(actuator: Element, tag: str) -> float | None:
    element = actuator.child(tag)
    return None if element is None else float(element.attributes.get("value", "0"))
