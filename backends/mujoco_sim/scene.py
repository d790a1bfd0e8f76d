"""From a robot's URDF to a compiled MuJoCo model, with the actuators that carry joint physics.

The URDF is the file that pinocchio loads. Inertias come from the RobotModel, so that overrides and
locked joints (a gripper's fingers) mean the same to both engines. Contacts and constraints are
off: the safety contract, not an end stop, keeps the arm inside its range.

What the simulated arm picks up while it moves: the bodies of MuJoCo's model change in place.
"""

from __future__ import annotations

import re
from copy import deepcopy
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET  # the URDF is the user's own file

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.installed_mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from backends.mujoco_sim.realisation import Draft, Plant
    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import JointCoupling

# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
# MuJoCo ships no stubs.


# Visuals may lie in files that are not here; friction and damping come from effects alone.
_NEXT_TO_NOTHING = 1e-9, 1e-12  # [kg], [kg m²], which MuJoCo needs of what moves
_LEFT_OUT = ("visual", "mujoco", "transmission", "gazebo")
# Of an equality: as firm as MuJoCo allows, and as quick as it integrates.
_FIRM, _QUICK_STEPS = 0.9999, 2
_VALUE = re.compile(r'"[^"]*"')
_ENDS = str.maketrans({"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})
_LEFT_OUT_OF_JOINTS = ("dynamics", "safety_controller", "mimic", "calibration")


def compile_model(
    robot: RobotModel, plant: Plant, timestep: float, shafts: Sequence[JointCoupling] = ()
) -> mujoco.MjModel:
    """Compile the arm with one damper per joint and one spring per hysteresis element.

    Actuators 1 to n are the dampers, the next the springs in the order of `plant.element_joint`,
    the last the dampers of the shafts.

    Args:
        robot: Rigid body; joints of the MuJoCo model come in the same order.
        plant: Joint physics.
        timestep: Integration step [s].
        shafts: Shafts that two joints turn.

    Raises:
        ConfigError: MuJoCo cannot read the URDF.
    """
    spec = _read(robot)
    spec.option.timestep = timestep
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # diverging fails
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = np.array(robot.pin_model.gravity.linear)
    if any(body.mass <= 0 for body in robot.inertials.values()):  # frames between two axes
        spec.compiler.boundmass, spec.compiler.boundinertia = _NEXT_TO_NOTHING
    _leave_out_constraints(spec, robot)
    _couple(spec, robot)
    for name, inertia in zip(robot.joint_names, plant.armature, strict=True):
        spec.joint(name).armature = inertia
        _add_damper(spec, name, mujoco.mjtTrn.mjTRN_JOINT)
    for j, stiffness, width in zip(
        plant.element_joint, plant.element_stiffness, plant.element_width, strict=True
    ):
        _add_slipping_spring(spec, robot.joint_names[j], stiffness, width)
    for index, shaft in enumerate(shafts):
        tendon = spec.add_tendon(name=f"shaft_{index}")
        tendon.wrap_joint(robot.joint_names[shaft.joint - 1], 1.0)
        tendon.wrap_joint(robot.joint_names[shaft.other - 1], shaft.ratio)
        _add_damper(spec, tendon.name, mujoco.mjtTrn.mjTRN_TENDON)
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"MuJoCo cannot build it: {error}", path=robot.urdf) from None
    names = {model.joint(j).name for j in range(model.njnt)}
    if names != set(robot.link_joints):
        raise ConfigError(
            f"MuJoCo finds the joints {sorted(names)}, expected {robot.link_joints}",
            path=robot.urdf,
        )
    return model


def _leave_out_constraints(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Leave no constraint but those that hold joints to the ones that they follow."""
    off = mujoco.mjtDisableBit
    spec.option.disableflags |= off.mjDSBL_CONTACT
    spec.option.disableflags |= (
        off.mjDSBL_CONSTRAINT
        if robot.linkage.is_plain
        else off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
    )
    for name in robot.link_joints:
        joint = spec.joint(name)
        joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE


def _couple(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Hold joints to those that they follow."""
    for name, item in robot.description.followers.items():
        law = np.zeros(mujoco.mjNEQDATA)
        law[:2] = item.offset, item.ratio
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=name,
            name2=item.leader,
            data=law,
            solref=[_QUICK_STEPS * spec.option.timestep, 1.0],
            solimp=[_FIRM, _FIRM, 0.001, 0.5, 2.0],
        )


def bare_mjcf(robot: RobotModel) -> str:
    """Return a robot as MJCF, with its inertias and simple shapes and nothing else.

    Args:
        robot: Rigid body.

    Raises:
        ConfigError: MuJoCo cannot read its description.
    """
    spec = _read(robot)
    spec.option.gravity = np.array(robot.pin_model.gravity.linear)
    _couple(spec, robot)
    spec.compile()
    text = str(spec.to_xml())  # with line ends of names as they are, which XML reads as spaces
    return _VALUE.sub(lambda found: found[0].translate(_ENDS), text)


def _read(robot: RobotModel) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_string(_plain_urdf(robot))
    except ValueError as error:
        raise ConfigError(f"MuJoCo cannot read it: {error}", path=robot.urdf) from None
    spec.compiler.fusestatic = True
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    return spec


def _add_damper(spec: mujoco.MjSpec, target: str, kind: mujoco.mjtTrn) -> None:
    """Add an actuator of force -ctrl·v, whose derivative -ctrl the integrator takes implicitly."""
    spec.add_actuator(
        name=f"{target}_damper",
        target=target,
        trntype=kind,
        gaintype=mujoco.mjtGain.mjGAIN_AFFINE,
        gainprm=_parameters(0.0, 0.0, -1.0),
        biastype=mujoco.mjtBias.mjBIAS_NONE,
        dyntype=mujoco.mjtDyn.mjDYN_NONE,
    )


def _add_slipping_spring(spec: mujoco.MjSpec, joint: str, stiffness: float, width: float) -> None:
    """Add a Maxwell-slip element: an integrator of ctrl = velocity, clipped to ±width.

    `actearly` applies the deflection at the end of the step, so that it is in phase with position.
    """
    spec.add_actuator(
        name=f"{joint}_element_{len(spec.actuators)}",
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=_parameters(-stiffness),
        biastype=mujoco.mjtBias.mjBIAS_NONE,
        dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
        actlimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        actrange=[-width, width],
        actearly=True,
    )


def _parameters(*values: float) -> Any:  # noqa: ANN401  # a MuJoCo parameter vector
    padded = np.zeros(mujoco.mjNGAIN)
    padded[: len(values)] = values
    return padded


def _plain_urdf(robot: RobotModel) -> str:
    """Return the URDF without meshes, with locked joints welded and the inertias of `robot`."""
    root = deepcopy(robot.description.root)
    for name in _LEFT_OUT:
        for parent in list(root.iter()):
            for child in parent.findall(name):
                parent.remove(child)
    for joint in root.findall("joint"):
        for name in _LEFT_OUT_OF_JOINTS:
            for child in joint.findall(name):
                joint.remove(child)
        for again in joint.findall("origin")[1:]:  # the first counts, as for other readers
            joint.remove(again)
        if joint.get("name") in robot.locked_joints:
            joint.set("type", "fixed")
    for link in root.findall("link"):
        _remove_meshes(link)
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if (moving := robot.inertials.get(str(link.get("name")))) is not None:
            link.append(_inertial(moving))
    return ET.tostring(root, encoding="unicode")


def _remove_meshes(link: ET.Element) -> None:
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        if geometry is None or geometry.find("mesh") is not None:
            link.remove(collision)


def _inertial(body: Inertial) -> ET.Element:
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(map(repr, body.com)), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(body.mass))
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ET.SubElement(element, "inertia", {k: repr(v) for k, v in zip(keys, body.inertia, strict=True)})
    return element


# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
# MuJoCo ships no stubs.


# All of a model that follows from its bodies' inertias.
_OF_BODIES = (
    "body_mass", "body_subtreemass", "body_inertia", "body_ipos", "body_iquat", "body_invweight0",
    "dof_M0", "dof_invweight0", "body_sameframe", "body_simple", "dof_simplenum",
)  # fmt: skip


class PickedUpLoads:
    """The loads of an arm, each from its time on.

    Args:
        draft: Which, and from when.
        model: MuJoCo's model of the arm without them, which is changed.
        robot: Rigid body without them.
        plant: Joint physics.
        period: Integration step [s].
    """

    def __init__(
        self, draft: Draft, model: mujoco.MjModel, robot: RobotModel, plant: Plant, period: float
    ) -> None:
        self._model = model
        self._starts: list[float] = []  # [s], in order
        self._bodies = [_of_bodies(model)]  # with none of the loads, one, ...
        for start, load in sorted(draft.loads, key=lambda pair: pair[0]):
            robot = load.body(robot)
            self._starts.append(start)
            self._bodies.append(_of_bodies(compile_model(robot, plant, period, draft.shafts)))
        self._carried = 0

    def __bool__(self) -> bool:
        return bool(self._starts)

    def carry(self, time: float) -> None:
        """Carry what is carried at a time [s], be it later or earlier than the last one."""
        carried = sum(start <= time for start in self._starts)
        if carried != self._carried:
            self._carried = carried
            for name, values in self._bodies[carried].items():
                getattr(self._model, name)[:] = values


def _of_bodies(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    return {name: getattr(model, name).copy() for name in _OF_BODIES}
