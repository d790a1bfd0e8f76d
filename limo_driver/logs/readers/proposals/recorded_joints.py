"""The joints of a robot that a log is of, where it names some of them and not all.

A log of an arm seldom holds the wheels, head and fingers of the robot that carries it. The joints
that it names are taken, all others locked: where the log says that they are, else as near to zero
as they can be. Where that changes what gravity asks of the recorded ones, it is asked where they
were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.logs.readers.columns import (
    CURRENT,
    MEASURED,
    PLAIN,
    POSITION,
    TORQUE,
    UNITS,
    families_of,
    read_name,
    words_of,
)
from limo_driver.model.descriptions.description import split_reference
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from limo_driver.logs.readers.columns import ColumnFamily
    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_MOVES: Final = 0.02  # [rad, m], by which a joint that rests does not move
_MATTERS: Final = 0.05  # of the largest gravity torque, that another place of a joint changes
_POSES: Final = 20
_ELSEWHERE: Final = 1e-3  # [rad, m], from where a joint would be locked
_BESIDE: Final = 0.1  # of the range of a gripper that slides, by which its positions may be beyond
_OF_POSITIONS: Final = frozenset({"qpos"})
_OF_VELOCITIES: Final = frozenset({"qvel", "qacc", "qfrc"})


@dataclass(frozen=True)
class RecordedPart:
    """A robot with the joints that a log is of."""

    model: RobotModel
    told: str = ""  # which joints are taken, and where others are locked; empty where all are taken
    questions: tuple[str, ...] = ()


def recorded_part(table: LogTable, model: RobotModel) -> RecordedPart:
    """Return a robot with the joints that a log names, if it names some of them alone.

    Where it holds torques, too, those that have one are taken, and the others of their series
    (`arm_1`, `arm_2`, ...). A choice that was made stays, and so does a robot of which the log
    names all joints, none, or only the first ones of a series: what is missing there may well be
    moving.

    Args:
        table: What the log holds.
        model: The robot.
    """
    if (whole := _columns_of_whole_log(table, model)) is not None:
        return _placed(table, model, {name: (column, "rad") for name, column in whole.items()})
    every = _named(table, model, (POSITION,), (*model.joint_names, *model.description.locked))
    if any("=" not in part for part in model.chosen):
        return _placed(table, model, every)
    positions = _named(table, model, (POSITION,))
    torques = _named(table, model, (TORQUE, CURRENT))
    known = positions.keys() & torques.keys() if torques else positions.keys()
    # of a series, joints that lack a torque move like the others
    known = {*known, *(name for name in positions if _is_cut(known, (name,)))}
    taken = [name for name in model.joint_names if name in known]
    missing = [name for name in model.joint_names if name not in taken]
    if not taken or not missing or _is_cut(taken, missing):
        return _placed(table, model, every)
    places, questions = _places(table, model, every, taken)
    weighing = _weighing(model, taken, missing)
    for name in missing:
        at, question = _place(name, positions.get(name), table, weighs=name in weighing)
        if at is not None:
            places[name] = at
        if question:
            questions.append(question)
    stated = [part for part in model.chosen if "=" in part]
    part = model.with_joints((*taken, *stated, *(f"{k}={v:.6g}" for k, v in places.items())))
    text = (
        f"of the {model.n} joints of {model.urdf.name} those that the log names are taken: "
        f"{shortened(taken)}; locked: {_where(part, missing)}"
    )
    return RecordedPart(part, text, tuple(questions))


def with_places(model: RobotModel, chosen: Sequence[str]) -> RobotModel:
    """Return a robot whose locked joints are where a choice of joints locks them.

    What was stated for the robot itself stays.

    Args:
        model: The robot.
        chosen: After the # of a robot, of which only `name=position` counts here.
    """
    stated = [part for part in model.chosen if "=" in part]
    known = model.description.locked.keys() - {_name_in(part) for part in stated}
    places = [part for part in chosen if "=" in part and _name_in(part) in known]
    if not places:
        return model
    return model.with_joints((*model.joint_names, *stated, *places))


def _name_in(part: str) -> str:
    return part.partition("=")[0].strip()


def _columns_of_whole_log(table: LogTable, model: RobotModel) -> dict[str, str] | None:
    """Return the column of each joint in a log of a whole MJCF model; None if it is none."""
    families = (
        family
        for family in families_of(table.columns, model.joint_names)
        if family.quantity == POSITION and family.rank in (MEASURED, PLAIN)
    )
    return next(filter(None, (columns_of_joints(x, model) for x in families)), None)


def _placed(
    table: LogTable, model: RobotModel, columns: Mapping[str, tuple[str, str]]
) -> RecordedPart:
    """Return a robot whose locked joints stand where a log has them."""
    places, questions = _places(table, model, columns, model.joint_names)
    if not places:
        return RecordedPart(model, questions=tuple(questions))
    part = with_places(model, [f"{name}={at:.6g}" for name, at in places.items()])
    text = f"locked where the log has them: {_where(part, [*places])}"
    return RecordedPart(part, text, tuple(questions))


def _places(
    table: LogTable,
    model: RobotModel,
    columns: Mapping[str, tuple[str, str]],
    recorded: Sequence[str],
) -> tuple[dict[str, float], list[str]]:
    """Return where a log has joints that are locked elsewhere, and what is open.

    A gripper is locked where it was, as far as the log says that. Places that were stated stay, and
    joints that follow others go where those are.

    Args:
        table: What the log holds.
        model: The robot.
        columns: Column of positions and its unit by joint; empty where the log does not say it.
        recorded: Names of the joints that are not locked.
    """
    locked, led = model.description.locked, model.description.led
    stated = [part for part in model.chosen if "=" in part]
    asked = columns.keys() - led.keys() - {_name_in(part) for part in stated}
    names = [name for name in locked if name in asked]
    if not names:
        return {}, []
    free = model.with_joints((*model.joint_names, *names, *stated))
    values: dict[str, FloatArray] = {}
    for name in names:
        own = _in_si(table, *columns[name], free, free.joint_names.index(name))
        if own is not None and np.isfinite(own).any():
            values[name] = own
    moves = {name: float(np.nanmax(own) - np.nanmin(own)) for name, own in values.items()}
    median = {name: float(np.nanmedian(own)) for name, own in values.items()}
    moving = [name for name in values if moves[name] > _MOVES]
    weighing = _weighing(free, list(recorded), moving) if moving else set[str]()
    questions = [
        f"robot: the place of joint {name} changes what gravity asks of the others; it moves by "
        f"{moves[name]:.3g} and is not among those that are taken: is it to be taken for locked at "
        f"{median[name]:.3g}?"
        for name in moving
        if name in weighing
    ]
    return {k: at for k, at in median.items() if abs(at - locked[k]) > _ELSEWHERE}, questions


def _in_si(
    table: LogTable, column: str, unit: str, model: RobotModel, joint: int
) -> FloatArray | None:
    """Return the positions of a joint [rad, m]; None where nothing says in which unit they are."""
    values = table.column(column).astype(np.float64)
    if unit or table.is_si:
        return values * UNITS[POSITION][unit or "rad"]
    low, high = (
        float(end[joint]) for end in (model.limits.position_min, model.limits.position_max)
    )
    room = _BESIDE * (high - low)
    known = values[np.isfinite(values)]
    within = bool(((low - room <= known) & (known <= high + room)).all())
    return values if model.sliding[joint] and within else None  # a slide of mm goes farther


def mapped_part(mapping: LogMapping, model: RobotModel) -> RobotModel:
    """Return a robot with the joints that a mapping is of, locked where its `robot` says.

    Args:
        mapping: Of some joints of the robot, or of all.
        model: The robot.
    """
    others = set(model.joint_names) - set(mapping.joints)
    _, chosen = split_reference(mapping.robot)
    if not others or not set(mapping.joints) <= set(model.joint_names):
        return with_places(model, chosen)
    locked = [part for part in (*model.chosen, *chosen) if "=" in part]
    return model.with_joints((*mapping.joints, *dict.fromkeys(locked)))


def _named(
    table: LogTable, model: RobotModel, quantities: Sequence[str], joints: Sequence[str] = ()
) -> dict[str, tuple[str, str]]:
    """Return the column and stated unit of a quantity by joint, of the family that names most.

    Args:
        table: What the log holds.
        model: The robot.
        quantities: That count as one.
        joints: Names that are looked for; those of the robot if none are given.
    """
    known = (
        name
        for name, values in table.columns.items()
        if values.dtype.kind != "f" or np.isfinite(values).any()
    )
    found = [
        family
        for family in families_of(known, joints or model.joint_names)
        if family.quantity in quantities
        and family.rank in (MEASURED, PLAIN)
        and all(isinstance(name.joint, str) for name in family.names)
    ]
    if not found:
        return {}
    best = min(found, key=lambda family: (-len(family.names), family.rank))
    return {str(name.joint): (name.column, name.unit) for name in best.names}


def _is_cut(taken: Iterable[str], missing: Iterable[str]) -> bool:
    """Say whether names that differ in their numbers alone are on both sides."""

    def series(name: str) -> tuple[str, ...]:
        return tuple(word for word in words_of(name) if not word.isdigit())

    return not {series(name) for name in taken}.isdisjoint(map(series, missing))


def _weighing(model: RobotModel, taken: list[str], missing: list[str]) -> set[str]:
    """Return the missing joints whose place changes what gravity asks of the recorded ones."""
    if model.massless:
        return set()
    random, limits = np.random.default_rng(0), model.limits
    low = np.maximum(limits.position_min, -np.pi)
    high = np.minimum(limits.position_max, np.pi)
    own = [model.joint_names.index(name) for name in taken]
    poses = np.clip(np.zeros((_POSES, model.n)), low, high)
    poses[:, own] = random.uniform(low[own], high[own], (_POSES, len(own)))
    before = model.gravity_torque(poses)[:, own]
    largest = np.abs(before).max(axis=0)
    slides = np.array(model.sliding)[own]
    least = np.where(slides, *(_MATTERS * largest[x].max(initial=0.0) for x in (slides, ~slides)))
    found: set[str] = set()
    for name in missing:
        j = model.joint_names.index(name)
        for end in (low[j], high[j]):
            elsewhere = poses.copy()
            elsewhere[:, j] = end
            change = np.abs(model.gravity_torque(elsewhere)[:, own] - before).max(axis=0)
            if (change > least).any():
                found.add(name)
    return found


def _place(
    name: str, column: tuple[str, str] | None, table: LogTable, *, weighs: bool
) -> tuple[float | None, str]:
    """Return where a joint is locked, None for as near to zero as it can be, and what is open."""
    unit = "" if column is None else column[1] or ("rad" if table.is_si else "")
    if column is None or not unit:
        if not weighs:
            return None, ""
        return None, (
            f"robot: the place of joint {name} changes what gravity asks of the recorded ones, and "
            f"the log does not say it: where was it? `{name}=...` [rad, m] after the # of the robot"
        )
    values = table.column(column[0]) * UNITS[POSITION][unit]
    at, moved = float(np.nanmedian(values)), float(np.nanmax(values) - np.nanmin(values))
    if moved > _MOVES and weighs:
        return at, (
            f"robot: the place of joint {name} changes what gravity asks of the recorded ones; it "
            f"moves by {moved:.3g} and has no torque: is it to be taken for locked at {at:.3g}?"
        )
    return at, ""


def _where(model: RobotModel, names: Sequence[str]) -> str:
    """List where joints are locked."""
    by_place: dict[float, list[str]] = {}
    for name in names:
        by_place.setdefault(model.description.locked[name], []).append(name)
    return "; ".join(f"{shortened(own)} at {at:.4g}" for at, own in by_place.items())


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
