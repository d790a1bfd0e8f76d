"""Proof: a plain simulator that reads the exported file needs the torque that limo predicts."""

# MuJoCo and pinocchio ship no stubs.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from limo_driver.exports.urdf import rotors_of, tables_of
from limo_driver.exports.xml_edits import DRAKE, ISAAC_LAB, MJCF, URDF, USD, XmlText
from limo_driver.model.descriptions.chain import JOINT, read_chain
from limo_driver.model.descriptions.description import RobotDescription
from limo_driver.model.descriptions.mjcf import is_passive_motor, joint_name, play_of
from limo_driver.model.descriptions.mjcf.joints import keep_springs, plastic_springs, relax
from limo_driver.model.descriptions.reading import read_description
from limo_driver.physics import Simulation
from limo_driver.runtime.installed_mujoco import mujoco
from limo_driver.types import FloatArray, IntArray, Motion

_FINE: Final = 2e-3  # [s], steps in which memory goes on
_HEAVY: Final = 1e12  # [kg m²]
MOVING: Final = 0.02  # [rad/s], above which a joint counts as moving


def torque_in_mujoco(path: Path, joints: Sequence[str], locked: dict[str, float], motion: Motion):  # noqa: ANN201
    """Return what MuJoCo says that a motion needs, (T, n) [N m].

    Contacts, ends of joints and equalities are off: they are not of the arm's own physics. Joints
    that follow others are given as any, with their own motion.

    Args:
        path: MJCF file.
        joints: Names of the joints that move.
        locked: Positions of others, by name; the rest stays where the file has it.
        motion: T samples of n joints.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    remembering = copy(model)
    keep_springs(model, plastic=False)
    bits = mujoco.mjtDisableBit
    off = int(bits.mjDSBL_CONTACT | bits.mjDSBL_LIMIT | bits.mjDSBL_EQUALITY)
    model.opt.disableflags |= off | int(bits.mjDSBL_ACTUATION)
    remembering.opt.disableflags |= off
    data = mujoco.MjData(model)
    there = {joint_name(model, k): k for k in range(model.njnt)}
    for name, value in locked.items():
        if name not in there:
            continue  # the file was made of a robot on which it is fixed
        data.qpos[model.jnt_qposadr[there[name]]] = value
    positions = np.array([model.jnt_qposadr[there[name]] for name in joints])
    velocities = np.array([model.jnt_dofadr[there[name]] for name in joints])
    torque = np.zeros_like(motion.position)
    plays = _plays(model)
    # bound once, with ends of plays that are there: what is done for each row is as long as MuJoCo
    qpos, qvel, qacc, needed = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
    qpos[plays.position] = middle = plays.low + plays.width / 2
    rows = zip(motion.position, motion.velocity, motion.acceleration, torque, strict=True)
    for position, velocity, acceleration, found in rows:
        qpos[positions], qvel[velocities], qacc[velocities] = position, velocity, acceleration
        mujoco.mj_inverse(model, data)
        if plays.position.size:  # once more, with the teeth where the load presses them
            pressed = needed[plays.velocity] > 0
            qpos[plays.position] = plays.low + np.where(pressed, 0.0, plays.width)
            mujoco.mj_inverse(model, data)
            qpos[plays.position] = middle
        found[:] = needed[velocities]
    return torque + _torque_of_memory(remembering, data.qpos, positions, velocities, motion)


class _Plays(NamedTuple):
    """Hinges that are the play of other joints."""

    position: IntArray  # (P,), where each stands in qpos
    velocity: IntArray  # (P,)
    low: FloatArray  # (P,) [rad]
    width: FloatArray  # (P,) [rad]


def _plays(model: Any) -> _Plays:  # noqa: ANN401

    by_body = (
        list(range(first, first + many))
        for first, many in zip(model.body_jntadr, model.body_jntnum, strict=True)
    )
    found = [play for joints in by_body if (play := play_of(model, joints)) is not None]
    ranges = np.array(model.jnt_range[found]).reshape(-1, 2)
    return _Plays(
        np.array(model.jnt_qposadr[found], dtype=np.int64),
        np.array(model.jnt_dofadr[found], dtype=np.int64),
        ranges[:, 0],
        np.ptp(ranges, axis=1),
    )


def _torque_of_memory(  # noqa: ANN202
    model: Any,  # noqa: ANN401
    start: FloatArray,
    positions: Any,  # noqa: ANN401
    velocities: Any,  # noqa: ANN401
    motion: Motion,
):
    """Return what has to be held against motors without input and plastic springs, (T, n) [N m].

    What they remember goes on as MuJoCo steps it, along the motion: of joints so heavy that no
    torque changes it.
    """
    torque = np.zeros_like(motion.position)
    every = range(len(model.actuator_trntype))
    passive = np.array([is_passive_motor(model, u) for u in every], dtype=np.bool_)
    if not (passive.any() or plastic_springs(model)):
        return torque
    model.actuator_gainprm[~passive] = model.actuator_biasprm[~passive] = 0.0
    keep_springs(model, plastic=True)
    model.dof_armature[:] = _HEAVY
    data = mujoco.MjData(model)
    steps = np.diff(motion.time, append=2 * motion.time[-1] - motion.time[-2])
    parts = np.ceil(steps / _FINE).astype(int)
    row, fine = np.repeat(np.arange(len(steps)), parts), np.repeat(steps / parts, parts)
    first = np.cumsum(parts) - parts
    since = ((np.arange(len(row)) - first[row]) * fine)[:, None]
    place = motion.position[row] + motion.velocity[row] * since
    place += 0.5 * motion.acceleration[row] * since**2
    rate = np.diff(place, axis=0, append=place[-1:]) / fine[:, None]
    option, qpos, qvel = model.opt, data.qpos, data.qvel
    driven, sprung = data.qfrc_actuator, data.qfrc_spring
    held = np.zeros_like(rate)
    qpos[:], qpos[positions] = start, place[0]
    relax(model, data)
    for q, v, step, found in zip(place, rate, fine.tolist(), held, strict=True):
        option.timestep, qpos[positions], qvel[velocities] = step, q, v
        mujoco.mj_step(model, data)
        found[:] = driven[velocities] + sprung[velocities]
    torque -= held[first]
    return torque


def torque_in_pinocchio(
    path: Path, joints: Sequence[str], locked: dict[str, float], motion: Motion, kind: str = URDF
) -> FloatArray:
    """Return what pinocchio, with the damping and friction of the file, says a motion needs.

    Args:
        path: URDF.
        kind: `urdf`, or what else reads it.
        joints: Names of the joints that move.
        locked: Positions of others, by name.
        motion: T samples of n joints.
    """
    import pinocchio as pin

    held = [f"{name}={value!r}" for name, value in locked.items()]
    description = read_description(path, [*joints, *held])
    model = read_chain(description).tree
    model.gravity.linear = np.array(description.gravity)
    data = model.createData()
    torque = np.array(
        [
            pin.rnea(model, data, *row)
            for row in zip(motion.position, motion.velocity, motion.acceleration, strict=True)
        ]
    )
    names, written = list(model.names)[1:], _beside_rigid_body(path, kind, description)
    armature, friction, damping = (
        np.array(
            [written[key].get(name.removesuffix(JOINT), 0.0) for name in names]
            if key in written
            else stated
        )
        for key, stated in (
            ("armature", np.zeros(model.nv)),
            ("friction", model.upperDryFrictionLimit),
            ("damping", model.damping),
        )
    )
    torque += armature * motion.acceleration
    return torque + damping * motion.velocity + friction * np.sign(motion.velocity)


def _beside_rigid_body(
    path: Path, kind: str, description: RobotDescription
) -> Mapping[str, Mapping[str, float]]:
    """Return what a target reads elsewhere than in a URDF's dynamics: by what, and joint."""
    if kind == ISAAC_LAB:
        return tables_of(path.with_suffix(".py").read_text(encoding="utf-8"))
    if kind == DRAKE:
        return {"armature": rotors_of(XmlText(path)), "friction": {}}
    if kind == USD:
        return {
            key: {name: getattr(own, key) for name, own in description.dynamics.items()}
            for key in ("armature", "friction", "damping")
        }
    return {}


def errors(
    path: Path, kind: str, expressed: Simulation, motion: Motion
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return RMS of the difference, and of the torque, of each joint [N m].

    Counted where a joint moves: as it reverses, dry friction may be anything within its band, and
    simulators that all are right differ in when it changes sides.

    Args:
        path: The exported file.
        kind: One of `KINDS`.
        expressed: The simulation, with the effects that the file expresses.
        motion: On which they are compared.
    """
    wanted = expressed.predict(motion)
    linkage = expressed.model.linkage
    of_links = replace(
        motion,
        position=linkage.positions(motion.position),
        velocity=linkage.rates(motion.velocity),
        acceleration=linkage.rates(motion.acceleration),
    )
    of = (path, expressed.model.link_joints, _locked(expressed), of_links)
    found = torque_in_mujoco(*of) if kind == MJCF else torque_in_pinocchio(*of, kind)
    found = linkage.torques(found)
    moving = np.abs(motion.velocity) > MOVING
    many = np.maximum(moving.sum(axis=0), 1)
    error = np.sqrt(np.sum((found - wanted) ** 2, axis=0, where=moving) / many)
    torque = np.sqrt(np.sum(wanted**2, axis=0, where=moving) / many)
    return tuple(error.tolist()), tuple(torque.tolist())


def _locked(simulation: Simulation) -> dict[str, float]:
    """Return the joints that the simulation's robot locks elsewhere than at zero."""
    return {name: at for name, at in simulation.model.description.locked.items() if at}
