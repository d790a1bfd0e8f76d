"""What MuJoCo's model states of joints: physics, actuators, and the play of one joint.

Plastic springs, which MuJoCo has from 4.0 on, are Maxwell-slip elements: one pulls back until it is
bent by its `springyield`, and its rest follows. MuJoCo moves that rest, `plastic`, at the end of a
step alone: where positions are set by hand, it has to be set too, or the next step has springs that
are bent by radians.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import (
    JointDynamics,
    StatedBristles,
    StatedRipple,
    StatedSlip,
    read_xml,
)
from limo_driver.runtime.given_files import ReadingBudget
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from xml.etree import ElementTree as ET

OWN: Final = -1  # the spring of a joint itself, which is no tendon
_WIDEST: Final = 1.0  # [rad], as the effect has it
_ON_JOINT: Final = int(mujoco.mjtWrap.mjWRAP_JOINT)
_SINGLE: Final = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class PlasticSpring(NamedTuple):
    """A plastic spring that bends with one joint."""

    joint: int
    tendon: int  # or `OWN`
    stiffness: float  # [N m/rad]
    width: float  # [rad], bent by which it slips


def plastic_springs(model: Any) -> tuple[PlasticSpring, ...]:  # noqa: ANN401
    """Return the plastic springs of single joints: a joint's own, then those of fixed tendons.

    Args:
        model: MuJoCo's model; before 4.0 none has any.
    """
    if not hasattr(model, "tendon_springyield"):
        return ()
    own = (
        PlasticSpring(j, OWN, float(model.jnt_stiffness[j]), float(model.jnt_springyield[j]))
        for j in range(model.njnt)
        if int(model.jnt_type[j]) in _SINGLE and not np.any(model.jnt_stiffnesspoly[j])
    )
    tendons = (_of_tendon(model, t) for t in range(model.ntendon))
    found = (*own, *(spring for spring in tendons if spring is not None))
    return tuple(x for x in found if x.stiffness > 0 and 0 < x.width <= _WIDEST)


def _of_tendon(model: Any, tendon: int) -> PlasticSpring | None:  # noqa: ANN401
    at = int(model.tendon_adr[tendon])
    low, high = model.tendon_lengthspring[tendon].tolist()
    is_single = int(model.tendon_num[tendon]) == 1 and int(model.wrap_type[at]) == _ON_JOINT
    if not is_single or low != high or np.any(model.tendon_stiffnesspoly[tendon]):
        return None
    ratio = abs(float(model.wrap_prm[at]))
    stiffness, width = model.tendon_stiffness[tendon], model.tendon_springyield[tendon]
    joint = int(model.wrap_objid[at])
    return PlasticSpring(joint, tendon, stiffness * ratio**2, width / ratio if ratio else 0.0)


def relax(model: Any, data: Any) -> None:  # noqa: ANN401
    """Let no plastic spring be bent where the joints stand.

    Args:
        model: MuJoCo's model.
        data: Its state, with the positions; changed.
    """
    mujoco.mj_fwdPosition(model, data)
    for spring in plastic_springs(model):
        if spring.tendon == OWN:
            at = int(model.jnt_qposadr[spring.joint])
            data.plastic[model.jnt_plasticadr[spring.joint]] = data.qpos[at]
        else:
            first = int(model.tendon_plasticadr[spring.tendon])
            data.plastic[first : first + 2] = data.ten_length[spring.tendon]


def keep_springs(model: Any, *, plastic: bool) -> None:  # noqa: ANN401
    """Take the springs out of a model that are not plastic, or those that are.

    Args:
        model: MuJoCo's model; changed.
        plastic: Which stay.
    """
    springs = plastic_springs(model)
    for values, found in (
        (model.jnt_stiffness, [x.joint for x in springs if x.tendon == OWN]),
        (model.tendon_stiffness, [x.tendon for x in springs if x.tendon != OWN]),
    ):
        values[np.isin(np.arange(len(values)), found) != plastic] = 0.0
    if plastic:
        model.jnt_stiffnesspoly[:] = model.tendon_stiffnesspoly[:] = 0.0


HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
ROOT: Final = "LIMO_DESCRIPTIONS"  # variable of a folder, within which files may include others
_PAIR: Final = 2  # joints of a body, of which one may be the play of the other
_WIDEST_PLAY: Final = 0.2  # [rad], as the effect has it
_ALIKE: Final = 1e-9  # of axes and their places [m]
_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
_ASSETS: Final = ("mesh", "texture", "hfield", "skin")
_SIZED: Final = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
_MOST_VALUES: Final = ReadingBudget.memory // 4  # of one asset, bytes of each
_MULTIPLYING: Final = frozenset({"replicate", "composite", "flexcomp", "attach", "model", "plugin"})
_COUNT: Final = re.compile(r"\+?(?P<number>\d+(\.0*)?([eE]\+?\d+)?)(?P<unit>[KMGTPE]?)")
_MANY: Final = 10_000.0  # rows, times as many columns, are some hundred MB
_FEW: Final = 8  # words that say sizes; more are points of a mesh
# By element: a mass that is no number, MuJoCo replaces by one of a density, and hands others on.
_FINITE: Final = {
    "inertial": ("mass", "pos", "quat", "diaginertia", "fullinertia"),
    "geom": ("mass", "density"),
    "joint": ("damping", "armature", "frictionloss", "stiffness", "springref"),
}


def body_name(model: Any, body: int) -> str:  # noqa: ANN401
    """Return what a body is called."""
    return model.body(body).name or f"body_{body}"


def joint_name(model: Any, joint: int) -> str:  # noqa: ANN401
    """Return what a joint is called."""
    return model.joint(joint).name or f"joint_{joint}"


def effort(model: Any, joint: int) -> float:  # noqa: ANN401
    """Return the torque that joint and actuators can have [N m]; 0 where nothing is stated."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    total = 0.0
    for u in range(actuators(model)):
        of_joint = int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not of_joint or int(model.actuator_trnid[u][0]) != joint:
            continue
        gear = abs(float(model.actuator_gear[u][0]))
        direct = (
            int(model.actuator_gaintype[u]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            and int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_NONE)
            and int(model.actuator_dyntype[u]) == int(mujoco.mjtDyn.mjDYN_NONE)
        )
        if model.actuator_forcelimited[u]:
            total += gear * float(np.abs(model.actuator_forcerange[u]).max())
        elif direct and (most := most_command(model, u)) is not None:
            total += gear * abs(float(model.actuator_gainprm[u][0])) * most
    return total


def dynamics(model: Any, joint: int) -> JointDynamics:  # noqa: ANN401
    """Return what a file states of a joint beside its body."""
    dof = int(model.jnt_dofadr[joint])
    plastic = [spring for spring in plastic_springs(model) if spring.joint == joint]
    is_elastic = all(spring.tendon != OWN for spring in plastic)
    return JointDynamics(
        friction=float(model.dof_frictionloss[dof]),
        damping=float(model.dof_damping[dof]),
        armature=float(model.dof_armature[dof]),
        stiffness=float(model.jnt_stiffness[joint]) if is_elastic else 0.0,
        rest=float(model.qpos_spring[model.jnt_qposadr[joint]]),
        cubic=float(model.jnt_stiffnesspoly[joint][1]),
        drag=float(model.dof_dampingpoly[dof][0]),
        slips=tuple(StatedSlip(spring.stiffness, spring.width) for spring in plastic),
        **_motors(model, joint),
    )


def loops(model: Any, root: int) -> tuple[frozenset[str], ...]:  # noqa: ANN401
    """Return the joints of each loop that equalities of bodies close in a tree, by name.

    Args:
        model: MuJoCo's model.
        root: The body at the root of the tree.
    """
    found: list[frozenset[str]] = []
    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    for k in range(model.neq):
        if int(model.eq_type[k]) not in kinds or not model.eq_active0[k]:
            continue
        ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        if int(model.eq_objtype[k]) == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[site]) for site in ends]
        if any(int(model.body_rootid[body]) != root for body in ends):
            continue
        one, other = (_carriers(model, body) for body in ends)
        joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in one ^ other]
        found.append(frozenset(joint_name(model, j) for j in joints))
    return tuple(found)


def _carriers(model: Any, body: int) -> set[int]:  # noqa: ANN401
    """Return a body and all that carry it."""
    found = set[int]()
    while body:
        found.add(body)
        body = int(model.body_parentid[body])
    return found


def is_passive_motor(model: Any, actuator: int) -> bool:  # noqa: ANN401
    """Say whether an actuator is a DC motor without inputs: friction and cogging of its joint."""
    return (
        int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_DCMOTOR)
        and int(model.actuator_ctrlnum[actuator]) == 0
    )


def most_command(model: Any, actuator: int) -> float | None:  # noqa: ANN401
    """Return the largest command that an actuator takes; None where nothing limits it."""
    control = int(model.actuator_ctrladr[actuator])  # those without inputs have none
    if not model.actuator_ctrlnum[actuator] or not model.actuator_ctrllimited[control]:
        return None
    return float(np.abs(model.actuator_ctrlrange[control]).max())


def actuators(model: Any) -> int:  # noqa: ANN401
    """Return how many actuators there are."""
    return len(model.actuator_trntype)  # `nu` counts their inputs


def _motors(model: Any, joint: int) -> dict[str, Any]:  # noqa: ANN401
    """Return LuGre friction and cogging of the DC motors on a joint."""
    bristles, ripples = list[StatedBristles](), list[StatedRipple]()
    for u in range(actuators(model)):
        of_joint = (
            int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
            and int(model.actuator_trnid[u][0]) == joint
        )
        is_motor = int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_DCMOTOR)
        if not (of_joint and is_motor and float(model.actuator_gear[u][0]) == 1.0):
            continue
        amplitude, cycles, phase, sliding, breakaway, speed, *_ = model.actuator_biasprm[u].tolist()
        *_, stiffness, damping = model.actuator_dynprm[u].tolist()[:7]
        if stiffness:
            bristles.append(StatedBristles(stiffness, damping, sliding, breakaway, speed))
        if amplitude:
            ripples.append(StatedRipple(amplitude, cycles, phase))
    return {"bristles": tuple(bristles), "ripples": tuple(ripples)}


def play_of(model: Any, joints: Sequence[int]) -> int | None:  # noqa: ANN401
    """Return which of the two joints of a body is nothing but the play of the other.

    Both are hinges about the same axis; the play has no actuator, and a range that is narrow beside
    that of the other.

    Args:
        model: MuJoCo's model.
        joints: Of one body, by index.
    """
    if len(joints) != _PAIR or any(int(model.jnt_type[j]) != HINGE for j in joints):
        return None
    first, second = (np.array(model.jnt_axis[j]) for j in joints)
    apart = np.ptp(np.array(model.jnt_pos[list(joints)]), axis=0).max()
    if abs(float(first @ second)) < 1.0 - _ALIKE or apart > _ALIKE:
        return None
    moved = {
        int(model.actuator_trnid[u][0])
        for u in range(actuators(model))
        if int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
    }
    wide = [_width(model, j) for j in joints]
    narrow = int(np.argmin(wide))
    play, other = joints[narrow], 1 - narrow
    is_play = wide[narrow] <= min(_WIDEST_PLAY, wide[other] / _PAIR) and play not in moved
    return play if is_play else None


def _width(model: Any, joint: int) -> float:  # noqa: ANN401
    low, high = model.jnt_range[joint].tolist()
    return high - low if model.jnt_limited[joint] else np.inf


def check_includes(path: Path) -> tuple[Path, ...]:
    """Return the files that an MJCF file is made of, itself first.

    Raises:
        ConfigError: One lies outside the folder of the first, and of the one that the user states
            in `LIMO_DESCRIPTIONS`; or declares entities.
    """
    folder = path.resolve().parent
    trusted = [folder, *(Path(stated).resolve() for stated in [os.environ.get(ROOT)] if stated)]
    found, waiting = [path], [(path, folder)]
    while waiting:
        current, beside = waiting.pop()
        root = read_xml(current)
        for element in (*root.iter("include"), *root.iter("model")):
            if (name := element.get("file")) is None:
                continue
            file = beside / name
            if not any(map(file.resolve().is_relative_to, trusted)):
                raise ConfigError(
                    f"includes {name}, which is outside its folder; if you trust that, set {ROOT} "
                    "to a folder that holds both",
                    path=current,
                )
            if not file.is_file():
                raise ConfigError(f"includes {name}, which is not there", path=path)
            if file not in found:
                found.append(file)
                waiting.append((file, beside if element.tag == "include" else file.parent))
    return tuple(found)


def check_numbers(files: Iterable[Path]) -> None:
    """Refuse masses, inertias and physics of joints that are not finite, by the element's name."""
    for path in files:
        for parent in read_xml(path).iter():
            for element in parent:
                for key in _FINITE.get(element.tag, ()):
                    _check_finite(element, key, parent, path)


def check_assets(files: Sequence[Path]) -> None:
    """Refuse meshes and textures that are devices, pipes or the like, or beyond all measure.

    MuJoCo says of what no memory holds that it caught an unknown exception.

    Args:
        files: That an MJCF file is made of, itself first.

    Raises:
        ConfigError: One is.
    """
    folder = files[0].resolve().parent
    elements = [(path, element) for path in files for element in read_xml(path).iter()]
    stated = {e.get(key, "") for _, e in elements if e.tag == "compiler" for key in _FOLDERS}
    for path, element in elements:
        _check_size(element, path)
        if element.tag not in _ASSETS or not (name := element.get("file")):
            continue
        for base in {"", *stated}:
            file = folder / base / name
            if file.exists() and not file.is_file():
                raise ConfigError(f"names {name} as a {element.tag}, which is no file", path=path)


def _check_size(element: ET.Element, path: Path) -> None:
    copies = element.tag == "replicate"
    keys = ("count",) if copies else _SIZED.get(element.tag, ())
    stated = [element.get(key, "") for key in keys]
    if not stated or not all(map(str.isdecimal, stated)):
        return  # a file has them, or MuJoCo says what is wrong
    most, what = (int(_MANY), "copies") if copies else (_MOST_VALUES, "values")
    if math.prod(sizes := [float(word) for word in stated]) > most:
        named = f"{element.tag} {element.get('name', '')!r}"
        size = " x ".join(f"{size:.15g}" for size in sizes)
        raise ConfigError(f"its {named} has {size} {what}, expected at most {most}", path=path)


def is_plain(files: Iterable[Path]) -> bool:
    """Say whether MuJoCo makes no more of files than stands in them.

    Copies, grids, models in models and large sizes may be anything, and take any time.
    """
    elements = [element for path in files for element in read_xml(path).iter()]
    return not any(
        element.tag in _MULTIPLYING
        or any(map(_is_large, (w for text in element.attrib.values() for w in text.split()[:_FEW])))
        for element in elements
    )


def _is_large(word: str) -> bool:
    """Say whether a word is a number of so many that it could be too many."""
    found = _COUNT.fullmatch(word)
    return found is not None and (bool(found["unit"]) or float(found["number"]) >= _MANY)


def _check_finite(element: ET.Element, key: str, parent: ET.Element, path: Path) -> None:
    for word in element.get(key, "").split():
        try:
            value = float(word)
        except ValueError:
            continue  # MuJoCo says so
        if not np.isfinite(value):
            place = " ".join(filter(None, (parent.tag, parent.get("name") or parent.get("class"))))
            raise ConfigError(
                f"{place}: {key} of its {element.tag} is {word}, expected a finite number",
                path=path,
            )
