"""What names of columns say: quantity, joint, unit, and which columns are of one kind.

A name is cut into words at signs, at digits and where a capital follows a small letter; the words
of the field are looked up. `actual_q_0`, `axisQMsr[3]`, `joint1_pos_deg` and
`observation.state.shoulder_pan.pos` are all read so.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from limo_driver.model.units import unit_of
from limo_driver.runtime.display import spanned

SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TURN: Final = 2 * math.pi

# By quantity: what one unit is in rad, rad/s, N m; K for a temperature.
UNITS: Final[dict[str, dict[str, float]]] = {
    "position": {
        "rad": 1.0,
        "deg": math.pi / 180,
        "mrad": 1e-3,
        "turn": _TURN,
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
    },
    "velocity": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "mrad/s": 1e-3,
        "turn/s": _TURN,
        "rpm": _TURN / 60,
        "m/s": 1.0,
        "cm/s": 1e-2,
        "mm/s": 1e-3,
    },
    # currents and parts of a rated torque say nothing without a `factor` in N m for each of them
    "torque": {
        "N m": 1.0,
        "mN m": 1e-3,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "kN m": 1e3,
        "A": 1.0,
        "mA": 1e-3,
        "%": 1.0,
        "‰": 1.0,
        "N": 1.0,
        "kN": 1e3,
    },
    "temperature": {"°C": 1.0},
}
UNITS["command"] = UNITS["position"]
UNITS["command_velocity"] = UNITS["velocity"]
UNITS["command_torque"] = UNITS["estimate"] = UNITS["external_torque"] = UNITS["torque"]
CURRENTS: Final = ("A", "mA")
OF_RATED: Final = ("%", "‰")  # of the rated torque, as drives of CANopen count it

# How names and brackets write them; a name is cut into words, in lower case, without signs.
WRITTEN: Final = {
    "rad": "rad",
    "radian": "rad",
    "radians": "rad",
    "deg": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "mrad": "mrad",
    "m": "m",
    "n": "N",
    "metres": "m",
    "meters": "m",
    "cm": "cm",
    "mm": "mm",
    "rev": "turn",
    "revs": "turn",
    "turns": "turn",
    "rad/s": "rad/s",
    "rads": "rad/s",
    "radps": "rad/s",
    "deg/s": "deg/s",
    "°/s": "deg/s",
    "degs": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "rpm": "rpm",
    "m/s": "m/s",
    "cm/s": "cm/s",
    "mm/s": "mm/s",
    "%": "%",
    "percent": "%",
    "pct": "%",
    "‰": "‰",
    "permille": "‰",
    "nm": "N m",
    "n m": "N m",
    "n*m": "N m",
    "n.m": "N m",
    "n·m": "N m",
    "mnm": "mN m",
    "nmm": "N mm",
    "ncm": "N cm",
    "cnm": "N cm",
    "kn": "kN",
    "knm": "kN m",
    "a": "A",
    "amp": "A",
    "amps": "A",
    "ma": "mA",
    "c": "°C",
    "°c": "°C",
    "s": "s",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "us": "us",
    "usec": "us",
    "micros": "us",
    "ns": "ns",
    "nsec": "ns",
    "nanos": "ns",
    "nanosec": "ns",
    "nanoseconds": "ns",
}
TIME, POSITION, VELOCITY, ACCELERATION = "time", "position", "velocity", "acceleration"
TORQUE, CURRENT, TEMPERATURE, NOTHING = "torque", "current", "temperature", ""
NO_COLUMN: Final = "-"  # stands for a column that a log does not have
_DIGITS: Final = 4  # of the number of a joint, at most
COMMAND = "command"  # positions that were commanded, beside those that were measured
COMMAND_VELOCITY = "command_velocity"  # velocities that were commanded
MEASURED, PLAIN, COMMANDED, DERIVED = 0, 1, 2, 3  # ranks: which of two is the measurement

_SAYS: Final = {
    TIME: "time times t timestamp timestamps stamp clock elapsed zeit zeitin",
    POSITION: "q qpos pos position positions angle angles theta jpos",
    VELOCITY: "dot dq qd qdot qvel vel velocity velocities speed speeds omega jvel dtheta",
    ACCELERATION: "ddot ddq qdd qddot qacc acc accel acceleration accelerations",
    TORQUE: "tau torque torques force forces effort efforts eff trq moment moments mom tq qfrc",
    CURRENT: "current currents cur curr i iq",
    TEMPERATURE: "temp temperature temperatures",
}
_QUANTITY: Final = {word: quantity for quantity, words in _SAYS.items() for word in words.split()}
_RANKS: Final = {
    MEASURED: "measured meas msr actual act fbk feedback real sensed present observation",
    COMMANDED: "cmd command commanded commands target des desired d ref reference setpoint goal "
    "action ipo sp ff feedforward",
    DERIVED: "ext external est estimated estimate model gravity coriolis error err hat residual "
    "predicted pred noise std sim output bias passive constraint gravcomp smooth computed "
    "cmptd calculated",
}
_RANK: Final = {word: rank for rank, words in _RANKS.items() for word in words.split()}
# of what is no joint: a name that holds one of these is left alone
_NO_JOINT: Final = (
    "tcp cartesian pose ee eef tool wrench ft imu camera image images odom quat orientation flange "
    "voltage mode status safety digital analog index bits"
)
_ELSEWHERE: Final = frozenset(_NO_JOINT.split())
# what a name may say beside its joint without being another robot's
_NO_ROBOT: Final = (
    "joint joints jnt axis axes ax motor motors drive link arm manipulator robot left right side "
    "state states data value values list array vector log channel signal topic msg raw filtered "
    "filt filter lowpass encoder sensor input in per rot rotation load abs total num idx "
    "controller control actuator observation observations obs field signals logsout"
)
_USUAL: Final = frozenset(_NO_ROBOT.split())
_BRACKETED: Final = re.compile(r"[\[(]\s*([^\]()\[\d][^\])]*?)\s*[\])]")
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[°%‰]")
# the letter before the number of an axis, as in `tau_A1`, which is no ampere; `mA_1` is
_AXIS: Final = re.compile(r"(?:(?<![A-Za-z])a|(?<![A-Z])(?<!\bm)(?<!_m)A)(?=[ _.-]?\d)")
_IN_BRACKETS: Final = ("m", "n")  # units there; elsewhere the motor, as in `theta_m`, or a number
_DOTS: Final = re.compile(r"\b(?:d dot|dot dot)\b")  # of an acceleration, as in `qDDot`
_UNITS: Final = {TIME: SECONDS, CURRENT: CURRENTS, **UNITS}
_LEROBOT: Final = ({"observation", "state"}, {"action"})  # features that are positions of motors
_SPEED: Final = {unit: f"{unit}/s" for unit in UNITS["position"]}
_SAID = {MEASURED: "measured", PLAIN: "", COMMANDED: "commanded", DERIVED: "derived"}


def si_unit(quantity: str, *, is_sliding: bool = False) -> str:
    """Return the SI unit of a quantity of a joint that turns, or slides."""
    return unit_of(next(iter(UNITS[quantity])), (is_sliding,))


def quantity_of(unit: str) -> str:
    """Return the quantity that is measured in a unit; `time` for seconds, or nothing."""
    if unit in SECONDS:
        return "time"
    return next((quantity for quantity, units in UNITS.items() if unit in units), "")


@dataclass(frozen=True)
class Name:
    """The name of a column, read."""

    column: str
    quantity: str  # empty where it says none
    rank: int  # MEASURED, PLAIN, COMMANDED, DERIVED
    joint: str | int | None  # name of a joint of the robot, or the number in the name
    unit: str  # empty where it says none
    family: tuple[str, ...]  # what is left of it without the joint: alike for one quantity

    @property
    def kind(self) -> tuple[str, int, tuple[str, ...]]:
        """What columns of one family share."""
        return (self.quantity, self.rank, self.family)


def words_of(text: str) -> tuple[str, ...]:
    """Cut a name into words, in lower case."""
    words = " ".join(word.lower() for word in _WORD.findall(text))
    return tuple(_DOTS.sub("ddot", words).split())


def read_name(column: str, joints: Sequence[str] = ()) -> Name:
    """Read the name of a column.

    Args:
        column: The name.
        joints: Names of the robot's joints, which are looked for in it, the longest first.
    """
    unit = ""
    rest = column
    for match in _BRACKETED.finditer(column):
        if found := WRITTEN.get(match[1].strip().lower()):
            unit, rest = found, rest.replace(match[0], " ")
    stated = unit
    words = words_of(rest)
    joint, words = _joint_in(words, joints)
    if isinstance(joint, int):
        joint, words = _joint_in(words_of(_AXIS.sub(" axis ", rest)), ())
    if not unit:
        # a unit alone is a name of a time, as `sec`, and of nothing else
        is_time = joint is None and WRITTEN.get("".join(words)) in SECONDS and len(column) > 1
        unit, words = _unit_at_end(words, least=0 if is_time or isinstance(joint, str) else 1)
    quantities = [word for word in words if word in _QUANTITY]
    quantity = _QUANTITY[quantities[-1]] if quantities else NOTHING
    if quantity == CURRENT and any(_QUANTITY[word] == TORQUE for word in quantities):
        quantity = TORQUE  # computed of a current, as `torque_current` is
    if not quantities and unit in SECONDS and joint is None:
        quantity = TIME  # if it runs evenly, which no name says
    if not quantities and isinstance(joint, str) and any(known <= {*words} for known in _LEROBOT):
        quantity = POSITION
    if not quantities and unit and joint is not None:
        quantity = CURRENT if stated in CURRENTS else _of_unit(unit)
    if quantity == VELOCITY:
        unit = _SPEED.get(unit, unit)
    if quantity != TIME and any(word in _ELSEWHERE for word in words):
        quantity = NOTHING
    if unit not in _UNITS.get(quantity, ()):
        unit = ""
    ranks = [_RANK[word] for word in words if word in _RANK]
    return Name(column, quantity, max(ranks, default=PLAIN), joint, unit, words)


def says_time(name: Name) -> bool:
    """Say whether a name has a word for a time, and not its unit alone."""
    return any(_QUANTITY.get(word) == TIME for word in name.family)


def is_commanded(words: Iterable[str]) -> bool:
    """Say whether words name what was commanded."""
    return any(_RANK.get(word) == COMMANDED for word in words)


def strange_words(name: Name, own: Iterable[str]) -> tuple[str, ...]:
    """Return the words of a name that say of which other robot it may be.

    Args:
        name: Of a column of a joint.
        own: Words of the robot: where the name has one of them, no word is strange.
    """
    known = _QUANTITY.keys() | _RANK.keys() | _USUAL | WRITTEN.keys()
    parts = [word for word in name.family if len(word) > 1 and word.isalpha() and word not in known]
    return () if name.joint is None or set(own) & set(parts) else tuple(parts)


def own_word(name: Name, others: Iterable[Name]) -> str:
    """Return a word of a name that says whose it is and that no other has; nothing if none does.

    Args:
        name: Of a column, such as `left_q0`.
        others: Of columns of the same quantity.
    """
    known = _QUANTITY.keys() | _RANK.keys() | WRITTEN.keys()
    elsewhere = {word for other in others for word in other.family}
    own = (word for word in name.family if word not in known and word not in elsewhere)
    return next((word for word in own if word.isalpha() and len(word) > 1), "")


def _joint_in(
    words: tuple[str, ...], joints: Sequence[str]
) -> tuple[str | int | None, tuple[str, ...]]:
    """Return the joint that the words name, and the other words."""
    for joint in sorted(joints, key=len, reverse=True):
        wanted = words_of(joint)
        for start in range(len(words) - len(wanted) + 1):
            if wanted and words[start : start + len(wanted)] == wanted:
                return joint, (*words[:start], *words[start + len(wanted) :])
    for index in reversed(range(len(words))):
        if words[index].isdecimal() and len(words[index]) <= _DIGITS:
            return int(words[index]), (*words[:index], *words[index + 1 :])
    return None, words


def _unit_at_end(words: tuple[str, ...], *, least: int) -> tuple[str, tuple[str, ...]]:
    """Return the unit that the last words write, and the `least` words or more before it."""
    for many in (2, 1):
        last, before = words[len(words) - many :], words[: len(words) - many]
        if len(before) < least or len(last) < many:
            continue
        for written in ("/".join(last), "".join(last)):
            if written in WRITTEN and written not in _IN_BRACKETS:
                return WRITTEN[written], before
    return "", words


def _of_unit(unit: str) -> str:
    """Return the quantity that a unit alone gives away; a letter or a percentage gives none."""
    return NOTHING if unit in (*CURRENTS, *OF_RATED) else quantity_of(unit)


@dataclass(frozen=True)
class ColumnFamily:
    """Columns of one quantity, one for each joint."""

    quantity: str
    rank: int
    names: tuple[Name, ...]  # in the order of the joints
    missing: tuple[str, ...] = ()  # joints that have none
    beyond: tuple[str, ...] = ()  # columns of more joints than the robot has
    by_order: bool = False  # whether joints are told by nothing but the order of the columns

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(name.column for name in self.names)

    @property
    def unit(self) -> str:
        """The unit that the names say; empty where they say none, or several."""
        units = {name.unit for name in self.names}
        return units.pop() if len(units) == 1 else ""

    @property
    def stated(self) -> tuple[str, ...]:
        """The unit of each joint, or the one of all; empty where a name says none."""
        units = tuple(name.unit for name in self.names)
        return (units if len(set(units)) > 1 else units[:1]) if all(units) else ()

    def beside(self, other: ColumnFamily) -> ColumnFamily | None:
        """Return this with `NO_COLUMN` for joints that only another has; None if it has others.

        Args:
            other: Which has all joints, in their order.
        """
        own = {name.joint: name for name in self.names}
        every = [name.joint for name in other.names]
        if self.by_order or self.beyond or None in own or not own.keys() <= {*every}:
            return None
        first = self.names[0]
        lacking = replace(first, column=NO_COLUMN)
        names = tuple(own.get(joint, replace(lacking, joint=joint)) for joint in every)
        return replace(self, names=names, missing=())

    def __str__(self) -> str:
        """Name its columns, and whether they are measured."""
        said = _SAID[self.rank]
        known = [column for column in self.columns if column != NO_COLUMN]
        return f"{spanned(known)}{f' ({said})' if said else ''}"


def families_of(columns: Iterable[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families of columns that have to do with joints, those of times left aside.

    Args:
        columns: Names of all columns.
        joints: Names of the robot's joints; empty where the robot is not known.
    """
    spelled = [joint for joint in joints if any(sign.isalpha() for sign in joint)]
    names = [read_name(column, spelled) for column in columns]
    by_kind: dict[tuple[str, int, tuple[str, ...]], dict[str | int, Name]] = defaultdict(dict)
    loose: dict[tuple[str, int], list[Name]] = defaultdict(list)
    for name in names:
        if name.quantity == TIME:
            continue
        if name.joint is None:
            loose[name.quantity, name.rank].append(name)
        else:
            by_kind[name.kind].setdefault(name.joint, name)
    by_kind = _merged(by_kind)
    found = [_family(kind[0], kind[1], members, joints) for kind, members in by_kind.items()]
    in_order = [
        ColumnFamily(quantity, rank, tuple(members), by_order=True)
        for (quantity, rank), members in loose.items()
        if quantity and (len(members) == len(joints) if joints else len(members) > 1)
    ]
    return [family for family in (*found, *in_order) if family.names]


def _merged(
    by_kind: Mapping[tuple[str, int, tuple[str, ...]], dict[str | int, Name]],
) -> dict[tuple[str, int, tuple[str, ...]], dict[str | int, Name]]:
    """Return the same with kinds as one that name the same quantity of other joints.

    Such as `lift_force` of a slide and `elbow_torque`.
    """
    merged = dict[tuple[str, int, tuple[str, ...]], dict[str | int, Name]]()
    for (quantity, rank, family), members in by_kind.items():
        plain = tuple(quantity if _QUANTITY.get(word) == quantity else word for word in family)
        there = merged.get((quantity, rank, plain), {})
        named = all(isinstance(joint, str) for joint in (*there, *members))
        is_new = bool(there) and (not named or bool(there.keys() & members.keys()))
        kind = (quantity, rank, family if is_new or not named else plain)
        merged[kind] = {**merged.get(kind, {}), **members}
    return merged


def _family(
    quantity: str, rank: int, members: Mapping[str | int, Name], joints: Sequence[str]
) -> ColumnFamily:
    named = [joint for joint in joints if joint in members]
    if named:
        missing = tuple(joint for joint in joints if joint not in members)
        return ColumnFamily(quantity, rank, tuple(members[joint] for joint in named), missing)
    numbers = sorted(key for key in members if isinstance(key, int))
    ordered = tuple(members[number] for number in numbers)
    first = 0 if numbers[0] == 0 else 1
    wanted = range(first, first + (len(joints) or len(numbers)))
    missing = tuple(f"number {k}" for k in wanted if k not in members)
    beyond = tuple(members[k].column for k in numbers if k not in wanted)
    kept = tuple(name for k, name in zip(numbers, ordered, strict=True) if k in wanted)
    return ColumnFamily(quantity, rank, kept, missing, beyond)
