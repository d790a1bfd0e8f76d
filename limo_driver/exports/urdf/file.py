"""A simulation written into a URDF: inertias, payload, friction and damping; nothing else fits."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.loads import write_added
from limo_driver.exports.changes.origin import write_origin
from limo_driver.exports.formats import DRAKE, URDF, WITH_FRICTION
from limo_driver.exports.urdf.drake import write_rotors
from limo_driver.exports.xml_edits import Element, XmlText, as_list, differ
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.quoting import in_xml

if TYPE_CHECKING:
    from limo_driver.exports.changes.target import Target
    from limo_driver.model.descriptions.inertial import Inertial

_KEYS: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


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
