"""Checks of what is to be a recording, and of one that is to be of a certain robot.

A robot that a file names is known by its joints, not by the name of its file.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from limo_driver.errors import LimoError, RecordingError, ShapeError
from limo_driver.model.descriptions.description import joined_reference, split_reference
from limo_driver.model.robot_model import BUILT_IN, RobotModel
from limo_driver.types import FloatArray, same_robot

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


MOST_NORMALISED = 100.5  # what LeRobot makes of the end of a joint, rounded
_BEYOND_EFFORT = 10.0  # times the limit; limits of a URDF are often some factor from the drive's
_BEYOND_LIMIT = 0.5  # [rad]; limits in a URDF are often a little narrower than the arm's


def numbers(name: str, values: ArrayLike) -> FloatArray:
    """Return an array of real numbers.

    Raises:
        RecordingError: It holds something else.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordingError(f"{name} is no array of real numbers: {type(values)}") from None


def check_shapes(
    time: FloatArray, position: FloatArray, others: Mapping[str, FloatArray | None]
) -> None:
    """Check that positions are (T, n), all else by name likewise, and times (T,).

    Raises:
        ShapeError: One is not.
    """
    shape = np.shape(position)
    if len(shape) != 2 or not shape[1]:  # noqa: PLR2004  # (T, n)
        raise ShapeError("position", shape, "(T, n)")
    for name, values in others.items():
        if values is not None and np.shape(values) != shape:
            raise ShapeError(name, np.shape(values), f"{shape}")
    if np.shape(time) != shape[:1]:
        raise ShapeError("time", np.shape(time), f"({shape[0]},)")


def check_seconds(time: ArrayLike, source: str) -> None:
    """Check that times (T,) are real numbers: whole ones may count anything.

    Raises:
        RecordingError: They are not.
    """
    kind = np.asarray(time).dtype
    if kind.kind != "f":
        raise RecordingError(
            f"time holds {kind} values, expected seconds as real numbers; `Recording.from_arrays` "
            "takes dates and whole micro- and nanoseconds",
            path=source or None,
        )


def check_values(time: FloatArray, position: FloatArray, torque: FloatArray, source: str) -> None:
    """Check what every door checks: of the rest, filters and fits would make nonsense.

    Args:
        time: (T,) [s].
        position: (T, n) [rad].
        torque: (T, n) [N m].
        source: File that they are from, for messages.

    Raises:
        RecordingError: A value is not finite, or time does not increase.
    """
    bad = ~np.isfinite(time)
    for values in (position, torque):
        bad |= ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise RecordingError(
            f"time, position or torque is not finite in {bad.sum()} of {bad.size} rows; "
            "`Recording.from_arrays` leaves such rows out",
            path=source or None,
            rows=np.flatnonzero(bad).tolist(),
        )
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        row = int(back[0]) + 1
        raise RecordingError(
            f"time does not increase at row {row}, from {time[row - 1]:.9g} s to {time[row]:.9g} s;"
            " expected samples in order of time",
            path=source or None,
            rows=[row],
        )


def _about_count(recorded: int, model: RobotModel) -> str:
    """Say what joints may be that recording or description has alone."""
    if recorded == model.n + 1:
        return (
            f"; is joint {recorded} a gripper that the description lacks? then leave its columns "
            f"(position_{recorded} and others) out, or describe it"
        )
    path, chosen = split_reference(model.name)
    if recorded > model.n or not PurePath(path).suffix:  # joints of a file alone are chosen
        return ""
    lacking = [f"{name}=0" for name in model.joint_names[recorded:]]
    return (
        "; joints that no column is of are locked by name where they stand: if it is the last, the "
        f"robot is '{joined_reference(path, (*chosen, *lacking))}'"
    )


def check_arm(
    model: RobotModel, position: FloatArray, torque: FloatArray, robot: str, source: str
) -> None:
    """Check that a recording can be of a robot.

    Args:
        model: The robot.
        position: (T, n) [rad].
        torque: (T, n) [N m].
        robot: As the recording names it, or "".
        source: Where the recording is from, for messages.

    Raises:
        RecordingError: Another robot, joint count, or positions that the joints cannot reach; or
            there is no sample.
    """
    if not len(position):
        raise RecordingError("holds no sample", path=source or None)
    n = position.shape[1]
    if robot and not is_named(model, robot, source):
        raise RecordingError(f"is of robot {robot}, expected {model.name}", path=source or None)
    if n != model.n:
        raise RecordingError(
            f"has {n} joints{f' of {robot}' if robot else ''}, but {model.name} has {model.n}"
            + _about_count(n, model),
            path=source or None,
        )
    beyond = np.maximum(
        model.limits.position_min - position.min(axis=0),
        position.max(axis=0) - model.limits.position_max,
    )
    beyond[np.array(model.turning)] = 0.0  # turns are counted on
    j = int(beyond.argmax())
    if beyond[j] > _BEYOND_LIMIT:
        low, high = float(position[:, j].min()), float(position[:, j].max())
        unit, other = ("m", "mm") if model.sliding[j] else ("rad", "degrees")
        if not model.sliding[j] and max(-low, high) <= MOST_NORMALISED:
            other = "degrees or normalised, as -100 to 100"
        raise RecordingError(
            f"position_{j + 1} spans {low:.3g} to {high:.3g} {unit}, but joint {j + 1} of "
            f"{model.name} only {model.limits.position_min[j]:.3g} to "
            f"{model.limits.position_max[j]:.3g} {unit}; is it in {other}, or another robot?",
            path=source or None,
        )
    # Refuse torques that the drives cannot make, and not by a little: another unit
    usual, most = np.median(np.abs(torque), axis=0), model.limits.torque
    stated = np.isfinite(most) & (most > 0)  # a description may leave them out
    factor = np.where(stated, usual / np.where(stated, most, 1.0), 0.0)
    j = int(factor.argmax())
    if factor[j] > _BEYOND_EFFORT:
        raise RecordingError(
            f"torque_{j + 1} is {usual[j]:.3g} N m in the median, {factor[j]:.3g} times what "
            f"joint {j + 1} of {model.name} can do ({most[j]:.3g} N m); expected N m; is it in "
            "N mm or mA?",
            path=source or None,
        )
