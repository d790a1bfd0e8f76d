"""Proposal: the mapping that names, limits and gravity suggest, with reasons and open questions.

Nothing is guessed in silence: where two readings fit, the mapping is made with one of them and a
question under `undecided`, with which it cannot be used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.columns import (
    COMMAND,
    COMMAND_VELOCITY,
    COMMANDED,
    CURRENT,
    CURRENTS,
    MEASURED,
    NO_COLUMN,
    NOTHING,
    OF_RATED,
    PLAIN,
    POSITION,
    TEMPERATURE,
    TORQUE,
    UNITS,
    VELOCITY,
    ColumnFamily,
    families_of,
    own_word,
    strange_words,
    words_of,
)
from limo_driver.logs.readers.formats.lerobot import KIND as LEROBOT
from limo_driver.logs.readers.mapping import Channels, LogMapping, template_for, values_of
from limo_driver.logs.readers.proposals.clock import clock_question
from limo_driver.logs.readers.proposals.gravity import (
    current_factors,
    other_unit_from,
    torque_reading,
)
from limo_driver.logs.readers.proposals.motion_units import (
    Beside,
    are_rates,
    position_reading,
    velocity_unit,
)
from limo_driver.logs.readers.proposals.recorded_joints import recorded_part, whole_of_mujoco
from limo_driver.logs.readers.proposals.times import COUNTS
from limo_driver.logs.readers.proposals.unnamed import families_by_numbers
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from limo_driver.logs.readers.mapping import TimeColumns
    from limo_driver.logs.readers.proposals.times import TimeFound
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


_MUJOCO, _MUJOCO_FORCE = "qpos", "qfrc"
_OF_DRIVES = " If they were told to drives, name them under `command_torque:`, not `torque:`"
_NORMALISED = 100.0
_GRIPPER = "gripper"
_MUCH_NEARER = 4.0  # times, that commands in another unit have to lie to positions; units are 57
_LOOKED_AT = 200_000  # rows that tell names, units and rates apart; the rest is like them


@dataclass(frozen=True)
class Taken:
    """What was taken for a quantity, and why."""

    quantity: str
    columns: str
    unit: str
    why: str


@dataclass(frozen=True)
class Proposal:
    """A mapping and the reasons for it."""

    mapping: LogMapping
    taken: tuple[Taken, ...]
    model: RobotModel  # with the joints that the log is of
    told: str = ""  # where the other joints are locked


class NothingProposedError(RecordingError):
    """No column can be taken for the positions of a robot's joints.

    Args:
        message: Why.
        table: What the log holds.
        model: The robot.
    """

    def __init__(self, message: str, table: LogTable, model: RobotModel) -> None:
        super().__init__(message, path=table.source or None)
        self.template = template_for(table, model)


@dataclass
class _Draft:
    """What is found so far."""

    table: LogTable
    model: RobotModel
    families: list[ColumnFamily]
    taken: list[Taken] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    asked: set[str] = field(default_factory=set)  # words that may be another robot's

    def values(self, family: ColumnFamily) -> FloatArray:
        """Return the columns of a family as the log has them, (T, n)."""
        columns = [values_of(self.table, name) for name in family.columns]
        return np.stack(columns, axis=1).astype(np.float64)

    def take(
        self, quantity: str, family: ColumnFamily, unit: tuple[str, ...], why: str
    ) -> Channels:
        """Note what is taken, and return it."""
        text = ", ".join(dict.fromkeys(unit))
        every = zip(self.model.joint_names, family.columns, strict=True)
        if lacking := [joint for joint, column in every if column == NO_COLUMN]:
            why += f"; the log has none of {shortened(lacking)}"
        self.taken.append(Taken(quantity, str(family), text, why))
        if family.by_order and self.model.n > 1:
            self.questions.append(
                f"{quantity}: the columns {shortened(list(family.columns))} do not name joints of "
                f"{self.model.name}: are they in the order {', '.join(self.model.joint_names)}?"
            )
        self._ask_of_another_robot(quantity, family)
        return Channels(columns=family.columns, unit=unit)

    def _ask_of_another_robot(self, quantity: str, family: ColumnFamily) -> None:
        """Ask, once for each of them, about words that may be the name of another robot."""
        stated = (self.model.name, *self.model.joint_names)
        own = [word for text in stated for word in words_of(text)]
        strange = dict.fromkeys(w for name in family.names for w in strange_words(name, own))
        if new := [word for word in strange if word not in self.asked]:
            self.asked.update(new)
            self.questions.append(
                f"{quantity}: the columns {family} name {', '.join(new)}, which {self.model.name} "
                f"does not (its joints are {', '.join(self.model.joint_names)}): are they of this "
                "robot?"
            )


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of numbers that are no measurement
def propose(table: LogTable, model: RobotModel) -> Proposal:
    """Propose how to read a log of a robot.

    Args:
        table: What the log holds.
        model: The robot, whose joints are looked for by name, else by number. Of a log that names
            some of them, the others are locked.

    Raises:
        RecordingError: It has no positions of the robot's joints, or goes on in another unit.
    """
    if not table.rows:
        raise RecordingError("holds no rows of numbers", path=table.source or None)
    table = table.without_empty().first(_LOOKED_AT)
    part = recorded_part(table, model)
    model = part.model
    found = families_by_numbers(table, families_of(table.columns, model.joint_names), model)
    draft = _Draft(table, model, found.families)
    draft.questions += (*part.questions, *((found.question,) if found.question else ()))
    time = found.time
    draft.questions += time.questions
    draft.taken.append(Taken("time", ", ".join(time.columns.columns), time.unit, time.why))
    positions = _position_family(draft)
    torques = _best(draft, TORQUE) or _best(draft, CURRENT) or _of_some_joints(draft, positions)
    position = _positions(draft, positions, _beside(draft, time, torques))
    torque = _torques(draft, torques, position)
    rates = _best(draft, VELOCITY)
    velocity = rates and _rates(draft, VELOCITY, rates, time.columns, position)
    _ask_of_clock(draft, time, position, torque)
    command = _commands(draft, position, torque)
    led = torque is None and command is None  # by velocities, if by anything
    command_velocity = _commanded_velocities(draft, time.columns, position) if led else None
    temperature = None
    if warmth := _best(draft, TEMPERATURE):
        temperature = draft.take(TEMPERATURE, warmth, ("°C",), "by name")
    used = [position, torque, velocity, command, command_velocity, temperature]
    kept = {*time.columns.columns, *(name for c in used if c for name in c.columns)}
    mapping = LogMapping(
        joints=model.joint_names,
        time=time.columns,
        position=position,
        torque=torque,
        velocity=velocity,
        command=command,
        command_velocity=command_velocity,
        temperature=temperature,
        robot=model.name,
        left_out=tuple(name for name in table.columns if name not in kept),
        undecided=tuple(dict.fromkeys(draft.questions)),
    )
    return Proposal(mapping, tuple(draft.taken), model, part.told)


def _complete(draft: _Draft, quantity: str) -> list[ColumnFamily]:
    found = [f for f in draft.families if f.quantity == quantity and not f.missing]
    return [f for f in found if len(f.names) == draft.model.n]


def _best(draft: _Draft, quantity: str, worst: int = PLAIN) -> ColumnFamily | None:
    """Return the family of a quantity, if there is one alone of the best rank; or note a question.

    Columns that are equal in every row are one family; a family that never changes, as of a sensor
    that is not there, is none beside others that do.
    """
    found = _complete(draft, quantity)
    found = [f for f in found if np.ptp(draft.values(f), axis=0).any()] or found
    if not found:
        return None
    rank = min(family.rank for family in found)
    alike = [family for family in found if family.rank == rank]
    named = [family for family in alike if not family.by_order]
    alike = named or alike
    first, *others = alike
    values = draft.values(first)
    others = [o for o in others if not np.array_equal(draft.values(o), values, equal_nan=True)]
    if others and quantity in {POSITION, TORQUE, CURRENT}:
        listed = " or ".join(map(str, (first, *others)))
        word = own_word(first.names[0], [other.names[0] for other in others])
        choice = f"; an inspection with `columns` as '*{word}*' is of the first" if word else ""
        draft.questions.append(f"{quantity}: {listed}? both fit the names{choice}")
    if others and quantity in {VELOCITY, TEMPERATURE}:
        return None
    if rank > worst:
        if quantity not in {POSITION, TORQUE}:
            return None
        text = "commanded" if rank == COMMANDED else "derived"
        draft.questions.append(
            f"{quantity}: only {text} values are named ({first}): are they to stand for measured "
            f"ones?{_of_drives(draft) if quantity == TORQUE and rank == COMMANDED else ''}"
        )
    if (whole := whole_of_mujoco(first, draft.model)) is not None:
        return whole
    if first.beyond:
        draft.questions.append(
            f"{quantity}: {first} has columns for more than {draft.model.n} joints "
            f"({shortened(first.beyond)} beyond): are the first {draft.model.n} meant?"
        )
    return first


def _of_drives(draft: _Draft) -> str:
    """Say what else commanded torques may be, and that currents were measured."""
    currents = [f for f in _complete(draft, CURRENT) if f.rank == MEASURED]
    if not currents:
        return _OF_DRIVES
    return f"{_OF_DRIVES}; {currents[0]} are currents, torques with a `factor:` in N m/A"


def _position_family(draft: _Draft) -> ColumnFamily:
    if found := _best(draft, POSITION):
        return found
    if unnamed := _complete(draft, NOTHING):
        draft.questions.append(
            f"position: no name says so; is it {' or '.join(map(str, unnamed))}?"
        )
        return unnamed[0]
    lacking = [f for f in draft.families if f.quantity == POSITION and f.missing]
    named = [f for f in lacking if len(f.names) > len(f.missing)] or lacking
    what = (
        f"{named[0]} lacks {shortened(named[0].missing)}"
        if named
        else f"its columns are {shortened(list(draft.table.columns))}"
    )
    if unread := draft.table.lost(POSITION, joints=draft.model.joint_names):
        what += f", and {shortened(unread)}"
    raise NothingProposedError(
        f"has no positions of the {draft.model.n} joints of {draft.model.name}: {what}; "
        f"its joints are {shortened(draft.model.joint_names)}; those named after a # of it are "
        "chosen, and the others locked",
        draft.table,
        draft.model,
    )


def _of_some_joints(draft: _Draft, positions: ColumnFamily) -> ColumnFamily | None:
    """Return the torques or currents that a log has of some joints of its positions alone."""
    some = (
        (family, family.beside(positions))
        for family in draft.families
        if family.quantity in {TORQUE, CURRENT} and family.rank in {MEASURED, PLAIN}
    )
    found = [(family, filled) for family, filled in some if filled is not None]
    if not found:
        return None
    return min(found, key=lambda pair: (pair[0].quantity != TORQUE, -len(pair[0].names)))[1]


def _beside(draft: _Draft, time: TimeFound, torques: ColumnFamily | None) -> Beside:
    """Return what may tell the unit of positions."""
    is_timed = not time.questions and not draft.table.is_si  # which is in rad, if that fits at all
    found = Beside(time=time.columns.read(draft.table)[0] if is_timed else None)
    if torques is not None:
        stated = None if torques.unit in (*CURRENTS, *OF_RATED) else UNITS[TORQUE].get(torques.unit)
        found = replace(found, torque=draft.values(torques), torque_unit=stated)
    velocities = _best(draft, VELOCITY)
    if velocities is not None and velocities.stated:
        scale = np.array([UNITS[VELOCITY][unit] for unit in velocities.stated])
        found = replace(found, velocity=scale * draft.values(velocities))
    return found


def _positions(draft: _Draft, family: ColumnFamily, beside: Beside) -> Channels:
    if not np.isfinite(draft.values(family)).all(axis=1).any():
        raise RecordingError(
            f"has no row with a number in each of {family}", path=draft.table.source or None
        )
    if (row := other_unit_from(draft.values(family))) is not None:
        raise RecordingError(
            f"the positions {family} jump by a factor of 57.3 at row {row}: degrees and radians in "
            "one column; expected one unit",
            path=draft.table.source or None,
        )
    if stated := family.stated:
        return draft.take(POSITION, family, stated, "the names say so")
    found = position_reading(draft.values(family), beside, draft.model)
    why = found.why
    if found.fits_both and draft.table.is_si:
        why = "messages of ROS are in SI units, and the values fit"
    elif found.fits_both and all(_MUJOCO in name.family for name in family.names):
        why = "MuJoCo has positions in rad, and the values fit"
    elif found.question:
        draft.questions.append(found.question)
    elif draft.table.is_si and "deg" in found.units:
        draft.questions.append(
            f"position: messages of ROS are in rad, but these are {why}: are they in deg, or of "
            "another robot?"
        )
    unit = found.units if len(set(found.units)) > 1 else found.units[:1]
    if "deg" in unit and _may_be_normalised(draft, family):
        draft.questions.append(
            f"position: {family} stay within ±{_NORMALISED:g}: are they degrees (LeRobot's "
            "`use_degrees`), or normalised to the calibrated range of each joint (its default)? "
            "Those need, as `factor:`, the degrees of one hundredth of half of that range, and as "
            "`zero:` what the column says where the description has 0"
        )
    return _grippers_in_percent(draft, family, draft.take(POSITION, family, unit, why))


def _grippers_in_percent(draft: _Draft, family: ColumnFamily, read: Channels) -> Channels:
    """Return positions with the range of a gripper for columns from 0 to 100, and ask about it."""
    model, values = draft.model, draft.values(family)
    low, high = model.limits.position_min, model.limits.position_max
    n, factor, zero = model.n, np.ones(model.n), np.zeros(model.n)
    unit = np.resize(read.unit, n)
    for j, joint in enumerate(model.joint_names):
        own, span = values[np.isfinite(values[:, j]), j], float(high[j] - low[j])
        scale = UNITS[POSITION][unit[j]]
        is_percent = _GRIPPER in words_of(joint) and own.min() >= 0 and own.max() <= _NORMALISED
        is_plain = unit[j] in {"rad", "m"} and own.max() <= high[j]
        if not is_percent or is_plain or not math.isfinite(span):
            continue
        factor[j] = span / _NORMALISED / scale
        zero[j] = -float(low[j]) * _NORMALISED / span
        draft.questions.append(
            f"position: does {family.columns[j]} count a gripper from 0 to {_NORMALISED:g} % of "
            f"its range? `factor:` and `zero:` take that for the range of {joint} in the "
            f"description; 1 and 0 there read it in {unit[j]}"
        )
    if (factor == 1.0).all():
        return read
    return replace(read, factor=tuple(factor.tolist()), zero=tuple(zero.tolist()))


def _may_be_normalised(draft: _Draft, family: ColumnFamily) -> bool:
    """Say whether LeRobot may have stretched the range of each joint to -100 to 100."""
    values = draft.values(family)
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return draft.table.kind.startswith(LEROBOT) and bool(largest <= _NORMALISED)


def _torques(draft: _Draft, family: ColumnFamily | None, position: Channels) -> Channels | None:
    if family is None:
        none = ", ".join(draft.table.lost(TORQUE, CURRENT))
        why = none or "no column is named like a measured torque"
        others = [f for f in _complete(draft, NOTHING) if f.columns != position.columns]
        if others:
            why += f"; no name says what {shortened(list(map(str, others)))} are"
        draft.taken.append(Taken(TORQUE, "none", "", why))
        return None
    stated = family.stated
    if family.quantity == CURRENT or not {*stated}.isdisjoint(OF_RATED):
        unit = (family.unit or "A",)
        what = "currents" if unit[0] in CURRENTS else f"{unit[0]} of the rated torque"
        draft.questions.append(
            f"torque: {family} are {what}: how many N m does one {unit[0]} make at each joint "
            f"(`factor:`)?{_by_gravity(draft, family, position)}"
        )
        return draft.take(TORQUE, family, unit, what)
    if stated:
        return draft.take(TORQUE, family, stated, "the names say so")
    motion = position.read(draft.table, POSITION)
    found = torque_reading(motion, draft.values(family), draft.model)
    if all(_MUJOCO_FORCE in name.family for name in family.names):
        si = tuple("N" if slides else "N m" for slides in draft.model.sliding)
        found = replace(found, units=si, why="MuJoCo has forces in N m and N", question="")
    if found.question:
        draft.questions.append(found.question)
    return draft.take(TORQUE, family, found.units, found.why)


def _by_gravity(draft: _Draft, currents: ColumnFamily, position: Channels) -> str:
    """Say what the weight of the described bodies makes of currents; nothing if it is no help."""
    motion = position.read(draft.table, POSITION)
    factors = current_factors(motion, draft.values(currents), draft.model)
    every = zip(draft.model.joint_names, factors.tolist(), strict=True)
    parts = [f"{factor:.3g} at {joint}" for joint, factor in every if math.isfinite(factor)]
    if not parts:
        return ""
    return f" If the arm carries nothing, the weight of its bodies says {', '.join(parts)}"


def _ask_of_clock(
    draft: _Draft, time: TimeFound, position: Channels, torque: Channels | None
) -> None:
    """Ask whether the clock runs at half or double, where all else is known."""
    asked = {x.partition(":")[0] for x in draft.questions if "both fit limits" not in x}
    if not {"time", POSITION}.isdisjoint(asked) or not time.columns.columns:
        return
    known = torque is not None and TORQUE not in asked and NO_COLUMN not in torque.columns
    felt = torque.read(draft.table, TORQUE) if torque is not None and known else None
    seconds, motion = time.columns.read(draft.table)[0], position.read(draft.table, POSITION)
    if question := clock_question(seconds, motion, felt, draft.model):
        draft.questions.append(question)


def _commanded_velocities(draft: _Draft, time: TimeColumns, position: Channels) -> Channels | None:
    """Return the commanded velocities, if one family alone names them.

    A drive that follows them makes positions change at about that rate, which tells their unit.
    """
    found = [f for f in _complete(draft, VELOCITY) if f.rank == COMMANDED]
    if len(found) != 1 or not np.isfinite(draft.values(found[0])).any():
        return None
    return _rates(draft, COMMAND_VELOCITY, found[0], time, position)


def _rates(
    draft: _Draft, quantity: str, family: ColumnFamily, time: TimeColumns, position: Channels
) -> Channels:
    """Take velocities, in the unit that their names say or that the rate of positions tells."""
    stated = (family.unit,) if family.unit in UNITS[VELOCITY] else ()
    seconds = time.read(draft.table)[0]
    rising = np.append(True, np.diff(seconds) > 0) & np.isfinite(seconds)
    motion = position.read(draft.table, POSITION)
    values = draft.values(family)[rising]
    sliding = draft.model.sliding
    found = velocity_unit(seconds[rising], motion[rising], values, sliding, stated)
    if found.question and quantity == VELOCITY and (time.columns or time.rate != 1.0):
        draft.questions.append(found.question)
    why = "the names say so" if stated else found.why
    taken = draft.take(quantity, family, stated or found.units, why)
    if quantity == VELOCITY and COUNTS in draft.questions:
        rates = taken.read(draft.table, VELOCITY)[rising]
        if are_rates(seconds[rising], motion[rising], rates):
            draft.questions.remove(COUNTS)  # no other clock makes them the same
    return taken


def _commands(draft: _Draft, position: Channels, torque: Channels | None) -> Channels | None:
    """Return the commanded positions beside measured ones, if one family alone names them.

    Beside a torque they are not needed, and cost no row that they lack.
    """
    found = [
        family
        for family in _complete(draft, POSITION)
        if family.rank == COMMANDED and family.columns != position.columns
    ]
    found = [family for family in found if not family.by_order] or found
    if not found and torque is None:
        _require_all_joints(draft)
    if len(found) != 1:
        return None
    (family,) = found
    values = draft.values(family)
    known = np.isfinite(values)
    if not known.any() or (torque is not None and not known.all()):
        return None
    unit = (family.unit,) if family.unit else _unit_beside(draft, values, position)
    why = "the names say so" if family.unit else "as positions"
    command = draft.take(COMMAND, family, unit, why)
    if family.unit or unit != tuple(dict.fromkeys(position.unit)):
        return command
    return replace(command, factor=position.factor, zero=position.zero)


def _require_all_joints(draft: _Draft) -> None:
    """Refuse set-points of some joints, where no torque stands in for the others'."""
    commanded = [f for f in draft.families if f.quantity == POSITION and f.rank == COMMANDED]
    for family in commanded:
        if family.missing:
            raise RecordingError(
                f"has neither a measured torque nor the set-points of all joints: {family} lacks "
                f"{', '.join(family.missing)}",
                path=draft.table.source or None,
            )


def _unit_beside(draft: _Draft, values: FloatArray, position: Channels) -> tuple[str, ...]:
    """Return the unit of commands: that of the positions, unless in another they lie far nearer.

    A joint that follows badly lies as near to commands that are read as next to nothing.
    """
    measured = position.read(draft.table, POSITION)

    def apart(unit: str) -> float:
        return float(np.nanmedian(np.abs(values * UNITS[COMMAND][unit] - measured)))

    stated = tuple(dict.fromkeys(position.unit))
    if len(stated) > 1:  # of joints that turn and others that slide
        return position.unit
    nearest = min((*stated, "rad", "deg"), key=apart)
    is_other = all(_MUCH_NEARER * apart(nearest) < apart(unit) for unit in stated)
    return (nearest,) if is_other else stated


def without_questions(proposal: Proposal) -> LogMapping:
    """Return the mapping as it would be with every question answered as proposed."""
    return replace(proposal.mapping, undecided=())
