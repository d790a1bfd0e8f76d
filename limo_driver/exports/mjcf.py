"""A simulation written into an MJCF file: attributes change, all else stays as it is.

Backlash in MJCF: a second hinge on the same body, about the same axis, within the gap.

MuJoCo has no attribute for play. A hinge without an actuator beside the joint's own, whose range is
the gap, is what its users write instead: the first hinge is the drive, both together the link. The
drive has to have an inertia of its own, the joint's armature.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.bodies import write_added
from limo_driver.exports.changes.origin import alike, write_comment, write_origin
from limo_driver.exports.servos import append_lines, write_motors, write_servos, write_slips
from limo_driver.exports.xml_edits import Element, XmlText, as_list, differ, write_folders
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.descriptions.mjcf import check_includes
from limo_driver.quoting import in_xml
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from limo_driver.exports.changes.target import Target
    from limo_driver.physics import Payload

_SAME: Final = 1e-9  # relative
NEEDS: Final = "limo needs"  # title of a comment
_TURNED: Final = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")
# Of the constraint that is dry friction, from soft to the firmest that MuJoCo allows; 0.9 and 20 ms
# if nothing is said. It may not answer quicker than in two steps.
FIRMNESS: Final = ("0.999 0.999", "0.9999 0.9999")
_QUICK_STEPS: Final = 2
_MAKING: Final = frozenset({"attach", "replicate"})  # elements that make others with new names
# What each attribute of a joint says; those of a constraint are there for its friction.
_SAYS: Final = {
    "frictionloss": ("friction",),
    "solimpfriction": ("friction",),
    "solreffriction": ("friction",),
    "armature": ("armature",),
    "damping": ("damping", "drag"),
    "stiffness": ("stiffness", "cubic"),
    "springref": ("stiffness", "cubic"),
}
_SMALLEST: Final = 1e-10  # [kg m²], of a payload that is a point: MuJoCo wants some inertia
_STEPS: Final = 2.0  # of the simulation, in which a flank answers: the least that MuJoCo takes
_FIRM: Final = "0.99 0.999 0.0001"  # else a flank gives way by as much as a gap is wide


def edited_mjcf(target: Target, firm: Mapping[int, str] | None = None) -> tuple[XmlText, ...]:
    """Return the texts of an MJCF file and its includes, with the edits in them.

    Args:
        target: What has to change.
        firm: Of joints (0-based) whose dry friction MuJoCo would make too soft, one of `FIRMNESS`:
            it gives way at low speed by as much as the joint is light.

    Raises:
        ConfigError: A body or joint that changes has no name, or the file states no inertias.
    """
    into = target.model.urdf
    texts = tuple(XmlText(path) for path in check_includes(into))
    spec = mujoco.MjSpec.from_file(str(into))
    for name, body in target.inertials.items():
        _write_inertial(texts, name, body, spec, into)
    motors, added = list[str](), dict[str, frozenset[str]]()
    for j, (name, stated, wanted) in enumerate(target.joints()):
        values = _joint_values(stated, wanted, degrees=bool(spec.compiler.degree))
        if firm and j in firm:
            values["solimpfriction"] = firm[j]
            if firm[j] == FIRMNESS[-1]:
                quick = _QUICK_STEPS * float(spec.option.timestep)
                values["solreffriction"] = as_list(quick, 1.0)
        before = target.origin.added.get(name, frozenset())
        gone = _back_to_users(target, j, before) if before else frozenset()
        added[name] = before - gone
        if values or gone:
            text, element = _found(texts, "joint", name, into)
            added[name] |= values.keys() - element.attributes.keys() - gone
            text.remove(element, *gone)
            for attribute, value in values.items():  # in order: sets have another in each process
                if attribute not in gone:
                    text.set(element, attribute, value)
        plays = target.model.description.plays
        write_play(texts, name, stated, wanted, plays, spec, into)
        motors += write_motors(texts, name, stated, wanted, into)
    append_lines(texts[0], "actuator", motors)
    write_slips(texts, target, into)
    write_comment(texts[0], NEEDS, _needs(target))
    names = target.model.joint_names
    write_origin(
        texts[0],
        {name: target.users.get(name, JointDynamics()) for name in names},
        dict(zip(names, target.split.joints, strict=True)),
        added,
    )
    _write_payloads(texts, target, into)
    write_folders(texts, into)
    write_servos(texts, target, float(spec.option.timestep), into)
    gravity = target.simulation.body.gravity
    if not np.allclose(gravity, target.model.gravity, rtol=_SAME, atol=1e-12):
        _write_gravity(texts[0], gravity)
    return texts


def _needs(target: Target) -> dict[str, str]:
    """Return what a reader has to be, if limo wrote what not every one has."""
    users = target.users
    is_new = any(
        not alike((own.slips, own.bristles, own.ripples), (x.slips, x.bristles, x.ripples))
        for name, _, x in target.joints()
        if (own := users.get(name, JointDynamics()))
    )
    return {"MuJoCo": needed} if is_new and (needed := target.needed_mujoco()) else {}


def _back_to_users(target: Target, j: int, added: frozenset[str]) -> frozenset[str]:
    """Return the attributes that exports added to a joint and that have nothing to say by now."""
    name, wanted = target.model.joint_names[j], target.split.joints[j]
    over = target.origin.over.get(name, JointDynamics())
    return frozenset(
        attribute
        for attribute in added
        if all(alike(getattr(over, of), getattr(wanted, of)) for of in _SAYS.get(attribute, ()))
    )


def rubs_anew(target: Target) -> frozenset[int]:
    """Return the joints (0-based) whose dry friction is another than in the file."""
    known = target.model.description.dynamics
    pairs = zip(target.model.joint_names, target.split.joints, strict=True)
    return frozenset(
        j
        for j, (name, wanted) in enumerate(pairs)
        if wanted.friction and differ(known.get(name, JointDynamics()).friction, wanted.friction)
    )


def _found(texts: Sequence[XmlText], tag: str, name: str, into: Path) -> tuple[XmlText, Element]:
    for text in texts:
        if (element := text.find(tag, name)) is not None:
            return text, element
    if (nameless := _by_number(texts, tag, name, into)) is not None:
        return texts[0], nameless
    tags = {element.tag for text in texts for element in text.root.walk()}
    if made := sorted(tags & _MAKING):
        raise ConfigError(
            f"{tag} {name} has to change, but it is made by <{made[0]}>, and no file has it by "
            "that name: let MuJoCo write the whole model to a file of its own first (compile() and "
            "to_xml() of its MjSpec), and take that for the robot",
            path=into,
        )
    raise ConfigError(
        f"{tag} {name} has to change, but the file gives it no name: state one, "
        f'<{tag} name="{name}" ...>',
        path=into,
    )


def _by_number(texts: Sequence[XmlText], tag: str, name: str, into: Path) -> Element | None:
    """Return the element without a name that MuJoCo counts so, `body_2`; None if that is unsure.

    MuJoCo counts bodies and joints in the order of the text, unless includes or copies are made.
    """
    kind, _, number = name.rpartition("_")
    world = texts[0].root.child("worldbody")
    if kind != tag or not number.isdigit() or world is None or len(texts) > 1:
        return None
    model = mujoco.MjModel.from_xml_path(str(into))
    tags = {"body"} if tag == "body" else {"joint", "freejoint"}
    found = [element for element in world.walk() if element.tag in tags]
    many = model.nbody - 1 if tag == "body" else model.njnt
    at = int(number) - (tag == "body")  # of bodies, the world is the first
    if len(found) != many or not 0 <= at < many or "name" in found[at].attributes:
        return None
    return found[at]


def _write_inertial(
    texts: Sequence[XmlText],
    name: str,
    body: Inertial,
    spec: Any,  # noqa: ANN401
    into: Path,
) -> None:
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        raise ConfigError(
            "its compiler takes every inertia from shapes (inertiafromgeom=true), so none that was "
            "found can be written; set it to auto",
            path=into,
        )
    text, element = _found(texts, "body", name, into)
    values = _inertial_values(body)
    stated = element.child("inertial")
    if stated is None:
        written = " ".join(f'{key}="{value}"' for key, value in values.items())
        text.insert(element, f"<inertial {written}/>")
        return
    text.remove(stated, *_TURNED)
    for key, value in values.items():
        text.set(stated, key, value)


def _inertial_values(body: Inertial) -> dict[str, str]:
    xx, xy, xz, yy, yz, zz = body.inertia
    return {
        "pos": as_list(*body.com),
        "mass": as_list(body.mass),
        "fullinertia": as_list(xx, yy, zz, xy, xz, yz),
    }


def _joint_values(stated: JointDynamics, wanted: JointDynamics, *, degrees: bool) -> dict[str, str]:
    """Return the attributes of a joint that have to change."""
    values: dict[str, str] = {}
    for attribute, of in (("frictionloss", "friction"), ("armature", "armature")):
        if differ(getattr(stated, of), getattr(wanted, of)):
            values[attribute] = as_list(getattr(wanted, of))
    if differ(stated.damping, wanted.damping) or differ(stated.drag, wanted.drag):
        more = (wanted.drag,) if wanted.drag or stated.drag else ()
        values["damping"] = as_list(wanted.damping, *more)
    if differ(stated.stiffness, wanted.stiffness) or differ(stated.cubic, wanted.cubic):
        more = (0.0, wanted.cubic) if wanted.cubic or stated.cubic else ()
        values["stiffness"] = as_list(wanted.stiffness, *more)
    pulls = wanted.stiffness or wanted.cubic
    if pulls and differ(stated.rest, wanted.rest):
        values["springref"] = as_list(np.rad2deg(wanted.rest) if degrees else wanted.rest)
    return values


def _write_payloads(texts: Sequence[XmlText], target: Target, into: Path) -> None:
    """Write loads as bodies: those that an earlier export added change, or go."""
    shift = target.model.description.shifts.get(target.last, np.zeros(3))
    written = {name: _load(payload, shift) for name, payload in target.loads.items()}
    for name in target.replaced:
        text, element = _found(texts, "body", name, into)
        stated = element.child("inertial")
        if name not in written or stated is None:
            text.drop(element)
            continue
        for key, value in _inertial_values(written[name]).items():
            text.set(stated, key, value)
    for name, body in written.items():
        if name not in target.replaced:
            text, element = _found(texts, "body", target.last, into)
            values = _inertial_values(body)
            words = " ".join(f'{key}="{value}"' for key, value in values.items())
            text.insert(element, f'<body name="{name}"><inertial {words}/></body>')
    write_added(texts[0], target.added_by_now(written))


def _load(payload: Payload, shift: Any) -> Inertial:  # noqa: ANN401
    """Return a load in the frame of the body that carries it."""
    x, y, z = (np.array(payload.com) + shift).tolist()
    xx, xy, xz, yy, yz, zz = payload.inertia
    if min(xx, yy, zz) < _SMALLEST:
        xx, yy, zz = (value + _SMALLEST for value in (xx, yy, zz))
    return Inertial(payload.mass, (x, y, z), (xx, xy, xz, yy, yz, zz))


def _write_gravity(text: XmlText, gravity: Sequence[float]) -> None:
    option = text.root.child("option")
    if option is None:
        text.insert(text.root, f'<option gravity="{as_list(*gravity)}"/>')
    else:
        text.set(option, "gravity", as_list(*gravity))


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
    same_damping = not differ(stated.gap_damping, wanted.gap_damping)
    if same_damping and not differ(stated.gap, wanted.gap):
        return
    half = wanted.gap / 2
    ends = as_list(*(np.rad2deg([-half, half]) if spec.compiler.degree else (-half, half)))
    if joint in plays:
        text, element = _found_joint(texts, plays[joint], into)
        if wanted.gap:
            text.set(element, "range", ends)
            if not same_damping:
                text.set(element, "damping", as_list(wanted.gap_damping))
        else:
            text.drop(element)
        return
    text, element = _found_joint(texts, joint, into)
    own = mujoco.MjModel.from_xml_path(str(into)).joint(joint)
    quick = as_list(_STEPS * float(spec.option.timestep), 1.0)
    text.insert_after(
        element,
        f'<joint name="{in_xml(joint)}_backlash" type="hinge" pos="{as_list(*own.pos)}" '
        f'axis="{as_list(*own.axis)}" range="{ends}" limited="true" ref="0" '
        f'damping="{as_list(wanted.gap_damping)}" stiffness="0" frictionloss="0" armature="0" '
        f'actuatorfrclimited="false" solreflimit="{quick}" solimplimit="{_FIRM}"/>',
    )


def _found_joint(texts: Sequence[XmlText], name: str, into: Path) -> tuple[XmlText, Element]:
    for text in texts:
        if (element := text.find("joint", name)) is not None:
            return text, element
    raise ConfigError(f"joint {name} has to change, but is not named in the file", path=into)
