"""Actuators of Isaac Lab: drive, armature and friction of joints, in Python beside a URDF.

Dry friction there is an effort that resists at rest (`friction`) and in motion
(`dynamic_friction`), and `viscous_friction` goes with speed: in N m, from Isaac Sim 5 on. A
position servo is `stiffness`, `damping` and `effort_limit_sim`, one of velocity a `damping` without
stiffness, a drive that is told torques neither; comments say what else they have.
"""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Final

from limo_driver.exports.unwritten import BEYOND_ACTUATORS, beyond_default, unit_of
from limo_driver.physics.drives import as_described
from limo_driver.quoting import in_docstring

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from limo_driver.model.descriptions.description import JointDynamics
    from limo_driver.physics import JointDrive

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
        told = [(names[s.joint - 1], beyond_default(s, key)) for s in own]
        if told:
            unit = _OWN.get(key) or unit_of(own[0], key)
            values = ", ".join(f"{name!a}: {value:.4g}" for name, value in told)
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
