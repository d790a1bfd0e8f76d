"""Whether a robot that a file names is a given one: by its joints, not by the name of its file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import LimoError
from limo_driver.model.descriptions.description import joined_reference, split_reference
from limo_driver.model.robot_model import BUILT_IN, RobotModel
from limo_driver.types import same_robot

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_APART: Final = 0.005  # [m, rad] of axes, by which calibrations of one arm differ
_LIMITS: Final = 0.01  # [rad, m] of ranges, which formats round


def is_named(model: RobotModel, robot: str, source: str) -> bool:
    """Say whether a robot that a file names is this one.

    A copy, or the same arm in another format, has its joints at the same places, with the same
    ranges, whatever its file is called and whatever inertia was found for it. Where the file that
    is named is not there, its name decides.

    Args:
        model: The robot.
        robot: As the file names it: built in, or a description.
        source: File that names it, in whose folder it is sought, too.
    """
    if same_robot(robot, model.name):
        return True
    other = _found(robot, source, model)
    return other is not None and _are_alike(model, other)


def _found(robot: str, source: str, model: RobotModel) -> RobotModel | None:
    path, joints = split_reference(robot)
    if path in BUILT_IN:
        return _loaded(path, 0)
    for place in (Path(path), Path(source).parent / path):
        if place.is_file():
            taken = joints or model.chosen
            return _loaded(joined_reference(str(place), taken), place.stat().st_mtime_ns)
    return None


@lru_cache(maxsize=8)
def _loaded(reference: str, _changed: int) -> RobotModel | None:
    try:
        return RobotModel.load(reference)
    except LimoError:
        return None


def _are_alike(one: RobotModel, other: RobotModel) -> bool:
    if one.n != other.n or one.sliding != other.sliding or one.turning != other.turning:
        return False
    ends = [np.array([each.limits.position_min, each.limits.position_max]) for each in (one, other)]
    same = np.allclose(*ends, rtol=0.0, atol=_LIMITS)
    return same and np.allclose(_axes(one), _axes(other), rtol=0.0, atol=_APART)


def _axes(model: RobotModel) -> FloatArray:
    """Return each joint's axis at zero as a screw in the base frame, (n, 6) [m, 1].

    It is the same wherever along the axis, and however turned, a description puts its frames.
    """
    poses = model.joint_poses(np.zeros(model.n))
    found: list[FloatArray] = []
    for link in model.linkage.own.tolist():
        axis = np.ravel(model.pin_tree.joints[link + 1].createData().S)
        pose = poses[link]
        slide, turn = pose[:3, :3] @ axis[:3], pose[:3, :3] @ axis[3:]
        found.append(np.concatenate([slide + np.cross(pose[:3, 3], turn), turn]))
    return np.array(found)
