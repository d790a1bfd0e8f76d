"""What the name of a column says: which quantity of which joint, measured or commanded, its unit.

A name is cut into words at signs, at digits and where a capital follows a small letter; the words
of the field are looked up. `actual_q_0`, `axisQMsr[3]`, `joint1_pos_deg` and
`observation.state.shoulder_pan.pos` are all read so.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from limo_driver.logs.readers.columns.units import CURRENTS, SECONDS, UNITS, WRITTEN, quantity_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

TIME, POSITION, VELOCITY, ACCELERATION = "time", "position", "velocity", "acceleration"
TORQUE, CURRENT, TEMPERATURE, NOTHING = "torque", "current", "temperature", ""
NO_COLUMN: Final = "-"  # stands for a column that a log does not have
_DIGITS: Final = 4  # of the number of a joint, at most
COMMAND = "command"  # positions that were commanded, beside those that were measured
COMMAND_VELOCITY = "command_velocity"  # velocities that were commanded
MEASURED, PLAIN, COMMANDED, DERIVED = 0, 1, 2, 3  # ranks: which of two is the measurement

_SAYS: Final = {
    TIME: "time t timestamp timestamps stamp clock elapsed zeit zeitin",
    POSITION: "q qpos pos position positions angle angles theta jpos",
    VELOCITY: "dq qd qdot qvel vel velocity velocities speed speeds omega jvel dtheta",
    ACCELERATION: "ddq qdd qddot qacc acc accel acceleration accelerations",
    TORQUE: "tau torque torques effort efforts eff trq moment moments mom tq qfrc",
    CURRENT: "current currents cur curr i iq",
    TEMPERATURE: "temp temperature temperatures",
}
_QUANTITY: Final = {word: quantity for quantity, words in _SAYS.items() for word in words.split()}
_RANKS: Final = {
    MEASURED: "measured meas msr actual act fbk feedback real sensed present observation",
    COMMANDED: "cmd command commanded commands target des desired d ref reference setpoint goal "
    "action ipo sp",
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
    "controller control actuator"
)
_USUAL: Final = frozenset(_NO_ROBOT.split())
_BRACKETED: Final = re.compile(r"[\[(]\s*([^\]()\[\d][^\])]*?)\s*[\])]")
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°")
# the letter before the number of an axis, as in `tau_A1`, which is no ampere; `mA_1` is
_AXIS: Final = re.compile(r"(?:(?<![A-Za-z])a|(?<![A-Z])(?<!\bm)(?<!_m)A)(?=[ _.-]?\d)")
_MOTOR: Final = "m"  # is a metre in brackets, and stands for the motor elsewhere, as in `theta_m`
_UNITS: Final = {TIME: SECONDS, CURRENT: CURRENTS, **UNITS}
_SPEED: Final = {"rad": "rad/s", "deg": "deg/s", "mrad": "mrad/s", "turn": "turn/s", "m": "m/s"}


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
    return tuple(word.lower() for word in _WORD.findall(text))


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
    words = words_of(rest)
    joint, words = _joint_in(words, joints)
    if isinstance(joint, int):
        joint, words = _joint_in(words_of(_AXIS.sub(" axis ", rest)), ())
    if not unit:
        unit, words = _unit_at_end(words)
    said = [word for word in words if word in _QUANTITY]
    quantity = _QUANTITY[said[-1]] if said else NOTHING
    if quantity == CURRENT and any(_QUANTITY[word] == TORQUE for word in said):
        quantity = TORQUE  # computed of a current, as `torque_current` is
    if not said and unit and joint is not None:
        quantity = _of_unit(unit)
    if quantity == VELOCITY:
        unit = _SPEED.get(unit, unit)
    if quantity != TIME and any(word in _ELSEWHERE for word in words):
        quantity = NOTHING
    if unit not in _UNITS.get(quantity, ()):
        unit = ""
    ranks = [_RANK[word] for word in words if word in _RANK]
    return Name(column, quantity, max(ranks, default=PLAIN), joint, unit, words)


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
    said = [word for word in name.family if len(word) > 1 and word.isalpha() and word not in known]
    return () if name.joint is None or set(own) & set(said) else tuple(said)


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


def _unit_at_end(words: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Return the unit that the last words write, and the words before it."""
    for many in (2, 1):
        last, before = words[len(words) - many :], words[: len(words) - many]
        if not before or len(last) < many:
            continue
        for written in ("/".join(last), "".join(last)):
            if written in WRITTEN and written != _MOTOR:
                return WRITTEN[written], before
    return "", words


def _of_unit(unit: str) -> str:
    """Return the quantity that a unit alone gives away; a letter alone is no current."""
    return NOTHING if unit in CURRENTS else quantity_of(unit)
