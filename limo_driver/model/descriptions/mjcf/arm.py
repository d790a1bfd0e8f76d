"""MJCF as MuJoCo compiles it, written as the URDF of one arm.

Defaults, classes, includes, meshes without inertia and angles in degrees are so what MuJoCo makes
of them.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import (
    MOST_JOINTS,
    RobotDescription,
    StatedMotor,
    StatedServo,
)
from limo_driver.model.descriptions.mjcf.joints import (
    HINGE,
    OWN,
    SLIDE,
    actuators,
    body_name,
    check_assets,
    check_includes,
    check_numbers,
    is_passive_motor,
    is_plain,
    joint_name,
    loops,
    most_command,
    plastic_springs,
)
from limo_driver.model.descriptions.mjcf.writer import ArmWriter
from limo_driver.model.descriptions.urdf_checks import LARGEST
from limo_driver.runtime.given_files import apart
from limo_driver.runtime.installed_mujoco import PLASTIC, RELEASE, VERSION, mujoco

_PLACED: Final = (  # what an arm is written from
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("jnt_pos", "jnt_axis", "jnt_range", "geom_pos", "geom_quat", "geom_size"),
)
_OF_OTHERS: Final = ("Schema violation", "invalid keyword", "no longer supported")
_FEWEST: Final = 2  # arms, of which one has to be chosen
_ON_JOINT: Final = int(mujoco.mjtTrn.mjTRN_JOINT)
_FIXED: Final = int(mujoco.mjtGain.mjGAIN_FIXED)
_DIRECT: Final = int(mujoco.mjtDyn.mjDYN_NONE)
_AFFINE: Final = int(mujoco.mjtBias.mjBIAS_AFFINE)
_NO_BIAS: Final = int(mujoco.mjtBias.mjBIAS_NONE)


def read_mjcf(path: Path, joints: Sequence[str] = ()) -> RobotDescription:
    """Read the arm of an MJCF file: of its trees of bodies, the one with the most hinges.

    Args:
        path: The file.
        joints: Names or patterns of joints, of which the arm has the most, where any are given.

    Raises:
        ConfigError: MuJoCo cannot compile it, it includes files from elsewhere, a mass or the
            like is no finite number, its arm floats, or several trees could be the arm.
    """
    model = compiled_mjcf(path)
    if model.njnt > MOST_JOINTS:
        raise ConfigError(f"has {model.njnt} joints, expected at most {MOST_JOINTS}", path=path)
    for name in _PLACED:
        if not (np.abs(getattr(model, name)) <= LARGEST).all():
            raise ConfigError(f"its {name}, as MuJoCo has it, is no finite number", path=path)
    root = _arm(model, path, joints)
    writer = ArmWriter(model, root)
    writer.write(root)
    coupled = writer.couple()
    return RobotDescription(
        writer.robot,
        path,
        "MJCF",
        writer.dynamics,
        tuple(np.array(model.opt.gravity).tolist()),  # type: ignore[arg-type]  # three
        writer.shifts,
        writer.hulls,
        tuple(_left_aside(model, root, coupled) + writer.notes),
        servos(model),
        motors(model),
        writer.plays,
        places={
            joint_name(model, j): (int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]))
            for j in range(model.njnt)
        },
        widths=(int(model.nq), int(model.nv)),
        loops=loops(model, root),
    )


def compiled_mjcf(path: Path) -> Any:  # noqa: ANN401  # a MuJoCo model
    """Compile an MJCF file that somebody gave, in a process apart where it may end that.

    Raises:
        ConfigError: MuJoCo cannot compile it, it includes files from elsewhere, or a mass or the
            like is no finite number.
    """
    files = check_includes(path)
    check_numbers(files)
    check_assets(files)
    return compile_mjcf(path) if is_plain(files) else apart(compile_mjcf, path, ConfigError)


def compile_mjcf(path: Path) -> Any:  # noqa: ANN401  # a MuJoCo model
    """Compile an MJCF file.

    Raises:
        ConfigError: It cannot be; in one line.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        mujoco.MjData(model)  # which has a size of its own
        return model
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        if "springyield" in reason and RELEASE[0] < PLASTIC:
            reason += f"; it needs MuJoCo {PLASTIC}, {VERSION} is installed"
        elif any(words in reason for words in _OF_OTHERS):
            reason += f"; was it written for another MuJoCo than {VERSION}? That can save it anew"
        raise ConfigError(f"MuJoCo cannot compile it: {reason}", path=path) from None


def _arm(model: Any, path: Path, joints: Sequence[str]) -> int:  # noqa: ANN401
    """Return the body at the root of the tree that is the arm."""
    hinges = _joints_by_tree(model, HINGE)
    if not any(hinges.values()):
        hinges = _joints_by_tree(model, SLIDE)
    patterns = [joint.partition("=")[0].strip() for joint in joints]
    chosen = {
        root: sum(any(fnmatchcase(name, pattern) for pattern in patterns) for name in names)
        for root, names in hinges.items()
    }
    counts = chosen if any(chosen.values()) else {root: len(x) for root, x in hinges.items()}
    most = max(counts.values(), default=0)
    if not most:
        raise ConfigError("has no joint that turns or slides", path=path)
    arms = [root for root, many in counts.items() if many == most]
    names = ", ".join(body_name(model, root) for root in arms)
    if len(arms) >= _FEWEST:
        all_names = [joint_name(model, joint) for joint in range(model.njnt)]
        one = _pattern_of(hinges[arms[0]], all_names)
        raise ConfigError(
            f"holds several arms of {most} hinges, {names}; choose the joints of one, as in "
            f"{path.name}#{one}",
            path=path,
        )
    balls = [
        joint_name(model, j)
        for j in range(model.njnt)
        if int(model.body_rootid[model.jnt_bodyid[j]]) == arms[0]
        and int(model.jnt_type[j]) == mujoco.mjtJoint.mjJNT_BALL
    ]
    if balls:
        raise ConfigError(
            f"{names} has the ball joint {balls[0]}, expected one axis a joint: three hinges in "
            "its place can be read",
            path=path,
        )
    return arms[0]


def _joints_by_tree(model: Any, kind: int) -> dict[int, list[str]]:  # noqa: ANN401
    """Return the names of the joints of a kind, by the body at the root of their tree."""
    found: dict[int, list[str]] = {}
    for joint in range(model.njnt):
        of_tree = found.setdefault(int(model.body_rootid[model.jnt_bodyid[joint]]), [])
        if int(model.jnt_type[joint]) == kind:
            of_tree.append(joint_name(model, joint))
    return found


def _pattern_of(names: Sequence[str], every: Sequence[str]) -> str:
    """Return what chooses these joints of all: how they alone begin, else their names."""
    last = max(names)
    start = next(last[:k] for k in range(len(last), -1, -1) if min(names).startswith(last[:k]))
    alone = set(names) == {name for name in every if name.startswith(start)}
    return f"{start}*" if alone else ",".join(names)


def _left_aside(model: Any, root: int, coupled: int) -> list[str]:  # noqa: ANN401
    """Say what the file holds that is not represented; so many equalities are."""
    notes: list[str] = []
    others = {int(model.body_rootid[b]) for b in range(1, model.nbody)} - {root}
    if others:
        notes.append(f"left aside: {', '.join(body_name(model, b) for b in sorted(others))}")
    if left := model.neq - coupled:
        notes.append(f"not represented: {left} equality constraint{'s' * (left > 1)}")
    springs = sum(spring.tendon != OWN for spring in plastic_springs(model))
    if tendons := model.ntendon - springs:
        notes.append(f"not represented: {tendons} tendon{'s' * (tendons > 1)}")
    for values, what in (
        (model.dof_dampingpoly[:, 1:], "damping of higher powers of the speed"),
        (
            model.jnt_stiffnesspoly[:, [0, *range(2, model.jnt_stiffnesspoly.shape[1])]],
            "springs other than linear and cubic",
        ),
        (model.body_gravcomp, "gravity compensation"),
    ):
        if np.any(values):
            notes.append(f"not represented: {what}")
    if np.any(model.actuator_armature) or np.any(model.actuator_damping):
        notes.append("not represented: armature and damping of actuators")
    moving = [
        u
        for u in range(actuators(model))
        if int(model.actuator_dyntype[u]) != 0 and not is_passive_motor(model, u)
    ]
    if moving:
        notes.append(f"not represented: the dynamics of {len(moving)} actuators")
    if np.any(model.actuator_delay):
        notes.append("not represented: delays of actuators")
    return notes


def servos(model: Any) -> dict[str, StatedServo]:  # noqa: ANN401
    """Return the actuators of position that move a joint, by the name of that joint.

    One of velocity beside it stands for damping. By itself, it is a servo where a joint has no
    other actuator.
    """
    found: dict[str, StatedServo] = {}
    for joint, own in _by_joint(model).items():
        positions = [u for u in own if _follows(model, u) == "position"]
        velocities = [u for u in own if _follows(model, u) == "velocity"]
        if not positions and (not velocities or len(own) > 1):
            continue
        first = (positions or velocities)[-1]
        kp = -float(model.actuator_biasprm[first][1])
        kd = -float(model.actuator_biasprm[first][2])
        beside = sum(-float(model.actuator_biasprm[u][2]) for u in velocities if u != first)
        limits = _limits(model, first, joint)
        found[joint_name(model, joint)] = StatedServo(
            abs(kp),
            kd + beside,
            limits[0] if limits else None,
            _delay(model, first),
            beside,
            _limited(model, first),
        )
    return found


def motors(model: Any) -> dict[str, StatedMotor]:  # noqa: ANN401
    """Return the actuators of torque that move a joint alone, by the name of that joint."""
    found: dict[str, StatedMotor] = {}
    for joint, own in _by_joint(model).items():
        u, gear = own[0], float(model.actuator_gear[own[0]][0])
        gain = gear * float(model.actuator_gainprm[u][0])
        pushes = int(model.actuator_biastype[u]) == _NO_BIAS and _is_direct(model, u)
        if len(own) > 1 or not pushes or gain <= 0.0:
            continue
        limits = _limits(model, u, joint)
        if (most := most_command(model, u)) is not None:
            limits.append(gain * most)
        found[joint_name(model, joint)] = StatedMotor(
            gain, min(limits, default=None), _delay(model, u), _limited(model, u)
        )
    return found


def _by_joint(model: Any) -> dict[int, list[int]]:  # noqa: ANN401
    """Return the actuators of each joint that has any, without what is friction and cogging."""
    found: dict[int, list[int]] = {}
    for u in range(actuators(model)):
        if int(model.actuator_trntype[u]) == _ON_JOINT and not is_passive_motor(model, u):
            found.setdefault(int(model.actuator_trnid[u][0]), []).append(u)
    return found


def _is_direct(model: Any, u: int) -> bool:  # noqa: ANN401
    return int(model.actuator_gaintype[u]) == _FIXED and int(model.actuator_dyntype[u]) == _DIRECT


def _follows(model: Any, u: int) -> str:  # noqa: ANN401
    """Return what an actuator is told, `position` or `velocity` of its joint, or nothing."""
    gain, bias = float(model.actuator_gainprm[u][0]), model.actuator_biasprm[u]
    affine = int(model.actuator_biastype[u]) == _AFFINE and _is_direct(model, u)
    if not affine or gain <= 0 or float(model.actuator_gear[u][0]) != 1.0:
        return ""  # of another gear, the command is not one of the joint
    if bias[1] == -gain:
        return "position"
    return "velocity" if bias[1] == 0 and bias[2] == -gain else ""


def _limits(model: Any, u: int, joint: int) -> list[float]:  # noqa: ANN401
    """Return what limits the torque of an actuator at its joint [N m]: its own limit first."""
    found = list[float]()
    if model.actuator_forcelimited[u]:
        gear = abs(float(model.actuator_gear[u][0]))
        found.append(gear * _most(model.actuator_forcerange[u]))
    if model.jnt_actfrclimited[joint]:
        found.append(_most(model.jnt_actfrcrange[joint]))
    return found


def _limited(model: Any, u: int) -> frozenset[str]:  # noqa: ANN401
    """Return what of an actuator itself is limited: its force, its control."""
    force, ctrl = bool(model.actuator_forcelimited[u]), most_command(model, u) is not None
    return frozenset(name for name, is_so in (("force", force), ("ctrl", ctrl)) if is_so)


def _most(limits: Sequence[float]) -> float:
    return float(np.abs(limits).max())


def _delay(model: Any, u: int) -> float:  # noqa: ANN401
    return float(np.ravel(model.actuator_delay[u])[0])
