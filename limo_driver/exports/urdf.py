"""The edits of a URDF, and what Drake and Isaac Lab take with it.

Rotor inertias in a URDF as Drake reads them: of the actuator in a joint's transmission.

Drake reflects a rotor's inertia by the square of the gear ratio. Here the ratio is 1, and the
inertia that of the joint: `<drake:rotor_inertia>` where there was none.

Actuators of Isaac Lab: drive, armature and friction of joints, in Python beside a URDF.

Dry friction there is an effort that resists at rest (`friction`) and in motion
(`dynamic_friction`), and `viscous_friction` goes with speed: in N m, from Isaac Sim 5 on. A
position servo is `stiffness`, `damping` and `effort_limit_sim`, one of velocity a `damping` without
stiffness, a drive that is told torques neither; comments say what else they have.
"""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.bodies import write_added
from limo_driver.exports.changes.origin import write_origin
from limo_driver.exports.remainder import BEYOND_ACTUATORS, beyond_default, unit_of
from limo_driver.exports.xml_edits import (
    DRAKE,
    URDF,
    WITH_FRICTION,
    Element,
    XmlText,
    as_list,
    differ,
)
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics.drives import as_described
from limo_driver.quoting import in_docstring, in_xml

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from limo_driver.exports.changes.origin import FileOrigin
    from limo_driver.exports.changes.target import Target
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import JointDrive

_KEYS: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NAMESPACE: Final = "http://drake.mit.edu"
_INERTIA: Final = "drake:rotor_inertia"
_RATIO: Final = "drake:gear_ratio"
_OF_LIMO: Final = "_transmission"  # behind the joint's name, of a transmission where there was none
_ESCAPED: Final = re.compile(r"\\(.)", re.DOTALL)
_TABLES: Final = {
    "ARMATURE": ("armature", "inertia of the drive, as seen at the joint [kg m^2]"),
    "FRICTION": ("friction", "dry [N m]"),
    "VISCOUS": ("damping", "viscous [N m s/rad]"),
}
_SERVO: Final = {
    "STIFFNESS": ("stiffness", "kp", "of the servo [N m/rad]"),
    "SERVO_DAMPING": ("damping", "kd", "of the servo [N m s/rad]"),
    "EFFORT": ("effort_limit_sim", "limit", "most of the servo [N m]"),
}
_OWN: Final = {  # what no `ImplicitActuatorCfg` says, beside what no actuator of MJCF does
    "delay": "s; `DelayedPDActuatorCfg` has delays in steps of its simulation",
    "gain": "1; efforts are torques at the joint",
}


def edited_urdf(target: Target, kind: str = URDF) -> tuple[XmlText, ...]:
    """Return the text of a URDF with the edits in it.

    Args:
        target: What has to change.
        kind: `urdf`, `drake` or `isaaclab`.

    Raises:
        ConfigError: A link or joint that changes is not in the file.
    """
    text = XmlText(target.model.urdf)
    written = dict[str, JointDynamics]()
    for name, body in target.inertials.items():
        _write_inertial(text, _found(text, "link", name), body)
    for j, name in enumerate(target.model.joint_names):
        stated = target.model.description.dynamics.get(name, JointDynamics())
        wanted = target.split.joints[j]
        if kind not in WITH_FRICTION:
            wanted = replace(wanted, friction=stated.friction)  # nobody's number there
        _write_joint(text, _found(text, "joint", name), stated, wanted)
        written[name] = JointDynamics(friction=wanted.friction, damping=wanted.damping)
    _write_payloads(text, target)
    users = {x: target.users.get(x, JointDynamics()) for x in target.model.joint_names}
    if kind == DRAKE:
        armature = {x: y.armature for x, y in zip(users, target.split.joints, strict=True)}
        # limo reads no rotors of a URDF: who goes on with the exported file says nothing of them
        is_own = target.simulation.model.urdf.resolve() == target.model.urdf.resolve()
        own, kept = write_rotors(text, armature, target.origin, keep=is_own)
        users = {x: replace(user, armature=own[x]) for x, user in users.items()}
        written = {x: replace(new, armature=kept[x]) for x, new in written.items()}
    write_origin(text, users, written, {})
    return (text,)


def _found(text: XmlText, tag: str, name: str) -> Element:
    element = next(
        (x for x in text.root.children if x.tag == tag and x.attributes.get("name") == name), None
    )
    if element is None:
        raise ConfigError(f"has no {tag} {name}", path=text.path)
    return element


def _write_inertial(text: XmlText, link: Element, body: Inertial) -> None:
    stated = link.child("inertial")
    if stated is None:
        text.insert(link, _inertial(body))
        return
    origin, mass, inertia = (stated.child(tag) for tag in ("origin", "mass", "inertia"))
    if origin is None:
        text.insert(stated, f'<origin xyz="{as_list(*body.com)}" rpy="0 0 0"/>')
    else:
        text.set(origin, "xyz", as_list(*body.com))
        if any(float(part) for part in origin.attributes.get("rpy", "0").split()):
            text.set(origin, "rpy", "0 0 0")
    for element, values in (
        (mass, {"value": body.mass}),
        (inertia, dict(zip(_KEYS, body.inertia, strict=True))),
    ):
        if element is None:
            raise ConfigError(
                f"link {link.attributes.get('name')} states an <inertial> without mass or inertia",
                path=text.path,
            )
        for key, value in values.items():
            if float(element.attributes.get(key, "nan")) != value:
                text.set(element, key, as_list(value))


def _inertial(body: Inertial) -> str:
    inertia = " ".join(
        f'{key}="{as_list(value)}"' for key, value in zip(_KEYS, body.inertia, strict=True)
    )
    return (
        f'<inertial><origin xyz="{as_list(*body.com)}" rpy="0 0 0"/>'
        f'<mass value="{as_list(body.mass)}"/><inertia {inertia}/></inertial>'
    )


def _write_joint(
    text: XmlText, joint: Element, stated: JointDynamics, wanted: JointDynamics
) -> None:
    values = {
        attribute: as_list(getattr(wanted, attribute))
        for attribute in ("damping", "friction")
        if differ(getattr(stated, attribute), getattr(wanted, attribute))
    }
    if not values:
        return
    element = joint.child("dynamics")
    if element is None:
        written = " ".join(f'{key}="{value}"' for key, value in values.items())
        text.insert(joint, f"<dynamics {written}/>")
        return
    for key, value in values.items():
        text.set(element, key, value)


def _write_payloads(text: XmlText, target: Target) -> None:
    """Write loads as links: those that an earlier export added change, or go."""
    for name in target.replaced:
        link = _found(text, "link", name)
        if name in target.loads:
            _write_inertial(text, link, target.loads[name].load)
            continue
        text.drop(link)
        for joint in text.root.children:
            child = joint.child("child")
            if child is not None and child.attributes.get("link") == name:
                text.drop(joint)
    carrier = in_xml(target.last)
    for name, payload in target.loads.items():
        if name not in target.replaced:
            text.insert(
                text.root,
                f'<joint name="{name}_mount" type="fixed"><parent link="{carrier}"/>'
                f'<child link="{name}"/></joint>',
            )
            text.insert(text.root, f'<link name="{name}">{_inertial(payload.load)}</link>')
    loads = {name: payload.load for name, payload in target.loads.items()}
    write_added(text, target.added_by_now(loads))


def write_rotors(
    text: XmlText, armature: Mapping[str, float], origin: FileOrigin, *, keep: bool
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


def actuators(
    asset: str,
    names: Sequence[str],
    joints: Sequence[JointDynamics],
    drives: Sequence[JointDrive] = (),
) -> str:
    """Return the text of a module with an `ImplicitActuatorCfg` of an arm.

    Args:
        asset: Name of the URDF beside it.
        names: Of the joints.
        joints: Physics of each.
        drives: Their drives, of which servos are written.
    """
    pairs = [(drive, as_described(drive)) for drive in drives]
    servos = [drive for drive, own in pairs if own is not None]
    stated = {drive.joint - 1: own for drive, own in pairs if own is not None}
    lines = [
        '"""Friction and armature of joints, whose inertias are in the URDF beside this file:',
        in_docstring(asset),
        "",
        "Written by limo for Isaac Lab 2.2 with Isaac Sim 5, or later.",
        '"""',
        "",
        "from isaaclab.actuators import ImplicitActuatorCfg",
        "",
    ]
    for table, (field, said) in _TABLES.items():
        lines += [f"{table} = {{  # {said}"]
        pairs = zip(names, joints, strict=True)
        lines += [f"    {_key(name)}: {getattr(joint, field):.10g}," for name, joint in pairs]
        lines += ["}"]
    given = dict[str, str]()
    for table, (argument, key, said) in _SERVO.items():
        known = {names[j]: getattr(servo, key, 0.0) for j, servo in stated.items()}
        known = {name: value for name, value in known.items() if value is not None}
        if known:
            lines += [f"{table} = {{  # {said}"]
            lines += [f"    {_key(name)}: {value:.10g}," for name, value in known.items()]
            lines += ["}"]
            given[argument] = table
    lines += _beyond(servos, names)
    lines += [
        "",
        "ARM = ImplicitActuatorCfg(",
        "    joint_names_expr=list(ARMATURE),",
        *(
            f"    {argument}={given.get(argument, 'None,  # of the drive: the asset has its own')}"
            + ("," if argument in given else "")
            for argument in ("stiffness", "damping")
        ),
        *(f"    {name}={given[name]}," for name in ("effort_limit_sim",) if name in given),
        "    armature=ARMATURE,",
        "    friction=FRICTION,",
        "    dynamic_friction=FRICTION,",
        "    viscous_friction=VISCOUS,",
        ")",
        "",
    ]
    return "\n".join(lines)


def _beyond(servos: Sequence[JointDrive], names: Sequence[str]) -> Iterator[str]:
    """Yield comments on what of servos is not written."""
    for key in (*_OWN, *BEYOND_ACTUATORS):
        own = [s for s in servos if beyond_default(s, key) is not None]
        pairs = [(names[s.joint - 1], beyond_default(s, key)) for s in own]
        if pairs:
            unit = _OWN.get(key) or unit_of(own[0], key)
            values = ", ".join(f"{name!a}: {value:.4g}" for name, value in pairs)
            yield f"# not written: {key} [{unit}] of {values}"


def _key(name: str) -> str:
    """Return the name of a joint as a pattern that matches it alone, as Isaac Lab takes keys."""
    return ascii(re.escape(name))


def tables_of(text: str) -> Mapping[str, Mapping[str, float]]:
    """Return the tables in the text of such a module, by `armature`, `friction` and `damping`."""
    found: dict[str, Mapping[str, float]] = {}
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or not isinstance(name := node.targets[0], ast.Name):
            continue
        if name.id in _TABLES:
            table = ast.literal_eval(node.value)
            found[_TABLES[name.id][0]] = {_ESCAPED.sub(r"\1", key): table[key] for key in table}
    return found
