"""Actuators of MuJoCo's model that are drives: servos of position and velocity, and motors."""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from limo_driver.model.descriptions.description import StatedMotor, StatedServo
from limo_driver.model.descriptions.mjcf.joints import actuators, joint_name

if TYPE_CHECKING:
    from collections.abc import Sequence

_ON_JOINT: Final = int(mujoco.mjtTrn.mjTRN_JOINT)
_FIXED: Final = int(mujoco.mjtGain.mjGAIN_FIXED)
_DIRECT: Final = int(mujoco.mjtDyn.mjDYN_NONE)
_AFFINE: Final = int(mujoco.mjtBias.mjBIAS_AFFINE)
_NO_BIAS: Final = int(mujoco.mjtBias.mjBIAS_NONE)


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
            abs(kp), kd + beside, limits[0] if limits else None, _delay(model, first), beside
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
        if model.actuator_ctrllimited[u]:
            limits.append(gain * _most(model.actuator_ctrlrange[u]))
        found[joint_name(model, joint)] = StatedMotor(
            gain, min(limits, default=None), _delay(model, u)
        )
    return found


def _by_joint(model: Any) -> dict[int, list[int]]:  # noqa: ANN401
    """Return the actuators of each joint that has any."""
    found: dict[int, list[int]] = {}
    for u in range(actuators(model)):
        if int(model.actuator_trntype[u]) == _ON_JOINT:
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


def _most(limits: Sequence[float]) -> float:
    return float(np.abs(limits).max())


def _delay(model: Any, u: int) -> float:  # noqa: ANN401
    return float(np.ravel(model.actuator_delay[u])[0])
