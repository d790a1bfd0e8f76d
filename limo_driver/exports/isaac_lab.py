"""Actuators of Isaac Lab: armature and friction of each joint, as a file of Python beside a URDF.

Dry friction there is an effort that resists at rest (`friction`) and in motion
(`dynamic_friction`), and `viscous_friction` goes with speed: in N m, from Isaac Sim 5 on.
"""

from __future__ import annotations

import ast
import json
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.descriptions.description import JointDynamics

_TABLES: Final = {
    "ARMATURE": ("armature", "inertia of the drive, as seen at the joint [kg m^2]"),
    "FRICTION": ("friction", "dry [N m]"),
    "VISCOUS": ("damping", "viscous [N m s/rad]"),
}


def actuators(asset: str, names: Sequence[str], joints: Sequence[JointDynamics]) -> str:
    """Return the text of a module with an `ImplicitActuatorCfg` of an arm.

    Args:
        asset: Name of the URDF beside it.
        names: Of the joints.
        joints: Physics of each.
    """
    lines = [
        f'"""Friction and armature of the joints of {asset}, whose inertias are in that file.',
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
        lines += [f"    {json.dumps(name)}: {getattr(joint, field):.10g}," for name, joint in pairs]
        lines += ["}"]
    lines += [
        "",
        "ARM = ImplicitActuatorCfg(",
        "    joint_names_expr=list(ARMATURE),",
        "    stiffness=None,  # of the drive: the asset's own",
        "    damping=None,",
        "    armature=ARMATURE,",
        "    friction=FRICTION,",
        "    dynamic_friction=FRICTION,",
        "    viscous_friction=VISCOUS,",
        ")",
        "",
    ]
    return "\n".join(lines)


def tables_of(text: str) -> Mapping[str, Mapping[str, float]]:
    """Return the tables in the text of such a module, by `armature`, `friction` and `damping`."""
    found: dict[str, Mapping[str, float]] = {}
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or not isinstance(name := node.targets[0], ast.Name):
            continue
        if name.id in _TABLES:
            found[_TABLES[name.id][0]] = ast.literal_eval(node.value)
    return found
