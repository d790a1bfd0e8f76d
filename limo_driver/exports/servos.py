"""Drives in an MJCF file: position servos and DC motors.

Friction with memory and cogging in MJCF: of DC motors that have no input, as MuJoCo has them.

`<dcmotor input="none" lugre="stiffness damping sliding breakaway speed"/>` is LuGre friction of a
joint, and `cogging="amplitude cycles phase"` a torque that repeats with its angle. Neither counts
among the controls of a model.

Slip elements in an MJCF file: plastic springs, which MuJoCo has from 4.0 on.

`<fixed stiffness springyield springlength><joint joint coef="1"/></fixed>` is a spring of one joint
that slips. Its rest is where MuJoCo starts: at `qpos0`, and in each keyframe that the file has.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.origin import alike
from limo_driver.exports.xml_edits import Element, XmlText, as_list, differ
from limo_driver.model.descriptions.description import JointDynamics, StatedMotor, StatedServo
from limo_driver.model.descriptions.mjcf.joints import plastic_springs, relax
from limo_driver.physics.drives import as_described
from limo_driver.quoting import in_xml
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from limo_driver.exports.changes.target import Target

_GENERAL: Final = "general"
_ROUNDING: Final = 1e-9  # time steps
_TAG: Final = "dcmotor"
_SAME: Final = 1e-9  # relative; and rad
_LEAST: Final = "1e-6"  # [N m/A], without which MuJoCo 3 takes no motor: it damps with 1e-12


def write_servos(texts: Sequence[XmlText], target: Target, timestep: float, into: Path) -> None:
    """Write gains, limits and delays of drives.

    What these actuators have no attribute for (dead band, play, profile, integrator, motor,
    supply) is not written, and told by `unwritten`.

    Args:
        texts: Of the file and its includes.
        target: What has to change.
        timestep: Of the file's simulation [s]: a delay keeps so many commands.
        into: The file, for messages.

    Raises:
        ConfigError: A joint that has a drive is moved by another kind of actuator in the file.
    """
    names, known = target.model.joint_names, target.model.description
    new: list[str] = []
    for drive in target.simulation.drives:
        if (wanted := as_described(drive)) is None:
            continue
        name, tag = names[drive.joint - 1], _tag(wanted)
        stated = (known.motors if tag == "motor" else known.servos).get(name)
        if stated is not None and _alike(stated, wanted):
            continue
        values = _attributes(wanted, stated, timestep)
        placed = _actuators(texts, name)
        if not placed:
            new.append(f'<{tag} joint="{in_xml(name)}" {_written(values)}/>')
            continue
        text, element = next((own for own in placed if own[1].tag == tag), placed[0])
        if element.tag not in (tag, _GENERAL) or stated is None:
            raise ConfigError(
                f"joint {name} is moved by <{element.tag}>; expected <{tag}>, or no actuator, "
                "to write its drive",
                path=into,
            )
        if isinstance(wanted, StatedServo) and isinstance(stated, StatedServo) and stated.beside:
            velocities = [own for own in placed if own[1].tag == "velocity"]
            if not velocities:
                raise ConfigError(
                    f"joint {name} is moved by several <{_GENERAL}>; expected one of them, to "
                    "write its drive",
                    path=into,
                )
            _share(wanted.kd, stated.beside, values, velocities)
        for key, value in (_as_general(values) if element.tag == _GENERAL else values).items():
            text.set(element, key, value)
    if new:
        root = texts[0].root
        actuator = root.child("actuator")
        if actuator is None:
            texts[0].append(root, f"<actuator>{''.join(new)}</actuator>")
        else:
            texts[0].insert(actuator, "".join(new))


def _written(values: Mapping[str, str]) -> str:
    return " ".join(f'{key}="{value}"' for key, value in values.items())


def _tag(drive: StatedServo | StatedMotor) -> str:
    """Return which actuator a drive is."""
    if isinstance(drive, StatedMotor):
        return "motor"
    return "velocity" if drive.kp == 0.0 else "position"


def _actuators(texts: Sequence[XmlText], joint: str) -> list[tuple[XmlText, Element]]:
    """Return the actuators that move a joint, and the text that each stands in."""
    return [
        (text, item)
        for text in texts
        for item in text.root.walk()
        if item.parent is not None and item.parent.tag == "actuator"
        if item.attributes.get("joint") == joint
        if not (item.tag == _TAG and item.attributes.get("input") == "none")
    ]


def _share(
    kd: float, beside: float, values: dict[str, str], velocities: Sequence[tuple[XmlText, Element]]
) -> None:
    """Leave to actuators of velocity what they have of a servo's damping, as far as it goes.

    Args:
        kd: Of the servo, all in all [N m s/rad].
        beside: What they have of it as the file is [N m s/rad].
        values: Attributes of the actuator of position; changed.
        velocities: The actuators of velocity beside it.
    """
    values["kv"] = f"{max(kd - beside, 0.0):.10g}"
    if kd < beside:
        for k, (text, element) in enumerate(velocities):
            text.set(element, "kv", f"{0.0 if k else kd:.10g}")


def _as_general(values: Mapping[str, str]) -> dict[str, str]:
    """Return the attributes of a <general> that is the same actuator."""
    own = dict(values)
    if "gear" in own:
        return {**own, "gainprm": "1"}
    kp, kv = own.pop("kp", "0"), own.pop("kv")
    gain = kv if kp == "0" else kp
    return own | {"gainprm": gain, "biasprm": f"0 -{kp} -{kv}"}


def _attributes(
    drive: StatedServo | StatedMotor, stated: StatedServo | StatedMotor | None, timestep: float
) -> dict[str, str]:
    values, force = dict[str, str](), 1.0
    limited = frozenset[str]() if stated is None else stated.limited
    if isinstance(drive, StatedMotor):
        values["gear"], force = f"{drive.gain:.10g}", 1.0 / drive.gain
    else:
        values |= {"kp": f"{drive.kp:.10g}"} if drive.kp else {}
        values["kv"] = f"{drive.kd:.10g}"
    if drive.limit is not None:
        most = force * drive.limit
        values["forcerange"] = f"{-most:.10g} {most:.10g}"
        if "force" not in limited:
            values["forcelimited"] = "true"  # whatever an earlier export or the compiler says
    elif "force" in limited:
        values["forcelimited"] = "false"
    if isinstance(drive, StatedMotor) and "ctrl" in limited:
        values["ctrllimited"] = "false"  # its force is limited instead
    if drive.delay == 0.0 and stated is not None and stated.delay > 0.0:
        values["delay"] = "0"
    if drive.delay > 0.0:
        values["delay"] = f"{drive.delay:.10g}"
        # One command more, and rounded time would let MuJoCo take it instead, now and then.
        values["nsample"] = str(max(math.ceil(drive.delay / timestep - _ROUNDING), 1))
    return values


def _alike(first: StatedServo | StatedMotor, second: StatedServo | StatedMotor) -> bool:
    pairs = zip(_numbers(first), _numbers(second), strict=True)
    return not any(differ(a, b) for a, b in pairs)


def _numbers(drive: StatedServo | StatedMotor) -> tuple[float, ...]:
    gains = (drive.gain,) if isinstance(drive, StatedMotor) else (drive.kp, drive.kd)
    return (*gains, drive.limit or 0.0, drive.delay)


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
        Lines of motors that the file lacks, for `append_lines`.

    Raises:
        ConfigError: What the file has stands in a default class, which others may share.
    """
    lines = list[str]()
    for attribute, had, has in (
        ("lugre", stated.bristles, wanted.bristles),
        ("cogging", stated.ripples, wanted.ripples),
    ):
        if len(had) == len(has) and all(map(_alike_numbers, had, has)):
            continue
        own = [
            (text, element)
            for text in texts
            for element in text.root.walk()
            if element.tag == _TAG
            and element.attributes.get("joint") == joint
            and attribute in element.attributes
        ]
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
                f'motorconst="{_LEAST}" {attribute}="{as_list(*values)}"/>'
            )
    return lines


def append_lines(text: XmlText, section: str, lines: Sequence[str]) -> None:
    """Write actuators or tendons behind all that there are, whose numbers stay.

    Args:
        text: Of the file.
        section: Tag of the element that holds such lines.
        lines: Of `write_motors` or `write_slips`.
    """
    if not lines:
        return
    sections = [child for child in text.root.children if child.tag == section]
    if sections and not sections[-1].is_empty:
        for line in lines:
            text.append(sections[-1], line)
    else:
        text.append(text.root, f"<{section}>")
        for line in lines:
            text.append(text.root, f"  {line}")
        text.append(text.root, f"</{section}>")


def _is_own(element: Element, joint: str, attribute: str) -> bool:
    """Say whether an export wrote a motor, which says nothing else."""
    name = element.attributes.get("name", "")
    known = {"name", "joint", "input", "resistance", attribute}
    stated = element.attributes.keys() - {"motorconst"}
    return name.startswith(f"{joint}_{attribute}") and stated == known


def _alike_numbers(first: Sequence[float], second: Sequence[float]) -> bool:
    return all(
        math.isclose(a, b, rel_tol=_SAME, abs_tol=_SAME) for a, b in zip(first, second, strict=True)
    )


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
        # The plastic springs of the joint go, but tendons that others may count on stay.
        own = [(text, element) for text, element in elements if _is_plastic(element, joint)]
        if len(own) != len(stated.slips):
            raise ConfigError(
                f"{_YIELD} of joint {joint} has to change, but is stated in a default class; state "
                "it in its own tendon",
                path=into,
            )
        for text, element in own:
            if element.attributes.get("name", "").startswith(f"{joint}_slip_"):
                text.drop(element)
                continue
            text.remove(element, _YIELD)
            if element.tag == "fixed" or not (wanted.stiffness or wanted.cubic):
                text.set(element, "stiffness", "0")
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
