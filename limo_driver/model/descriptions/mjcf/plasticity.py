"""Plastic springs, which MuJoCo has from 4.0 on: Maxwell-slip elements of joints.

A spring with a `springyield` pulls back until it is bent that far, and its rest follows from there
on. MuJoCo moves that rest, `plastic`, at the end of a step alone: where positions are set by hand,
it has to be set as well, or the next step has springs that are bent by radians.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from limo_driver.runtime.installed_mujoco import mujoco

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
