"""MuJoCo's own arrays: of a whole model, whose joints stand where the model has them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from limo_driver.logs.readers.columns.names import read_name, words_of

if TYPE_CHECKING:
    from limo_driver.logs.readers.columns.families import ColumnFamily
    from limo_driver.model import RobotModel

_OF_POSITIONS: Final = frozenset({"qpos"})
_OF_VELOCITIES: Final = frozenset({"qvel", "qacc", "qfrc"})


def whole_of_mujoco(family: ColumnFamily, model: RobotModel) -> ColumnFamily | None:
    """Return the columns of a robot's joints among those of all joints of its MJCF file.

    Args:
        family: Numbered columns, `qpos[0]` to `qpos[5]` and more beyond them.
        model: The robot.

    Returns:
        Its columns in the order of the joints; None if it is not named like an array of MuJoCo, or
        not as wide as that of the file.
    """
    columns = columns_of_joints(family, model)
    if columns is None:
        return None
    chosen = [columns[name] for name in model.joint_names]
    return replace(family, names=tuple(map(read_name, chosen)), beyond=())


def columns_of_joints(family: ColumnFamily, model: RobotModel) -> dict[str, str] | None:
    """Return the column of each joint of an MJCF file; None if the family is no array of all.

    Args:
        family: Numbered columns, `qpos[0]` to `qpos[5]` and more beyond them.
        model: A robot of that file.
    """
    columns = (*family.columns, *family.beyond)
    words = {word for column in columns for word in words_of(column)}
    velocities = not words & _OF_POSITIONS
    places, width = model.description.places, model.description.widths[velocities]
    if not family.beyond or len(columns) != width or not words & (_OF_POSITIONS | _OF_VELOCITIES):
        return None
    return {name: columns[place[velocities]] for name, place in places.items()}
