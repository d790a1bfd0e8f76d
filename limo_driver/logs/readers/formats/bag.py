"""The joint states of a ROS 2 bag as a table: one column for each quantity of each joint."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.logs.mcap_file import CDR, LoggedMessage
from limo_driver.logs.readers.columns import (
    POSITION,
    TORQUE,
    VELOCITY,
    families_of,
    is_commanded,
    read_name,
    words_of,
)
from limo_driver.logs.readers.table import LogTable
from limo_driver.logs.ros.joint_state_log import about_no_stamps, bag_files, messages_of, ordered
from limo_driver.logs.ros.known_layouts import layout_for
from limo_driver.logs.ros.message_layout import DecodedMessage, numbers_of
from limo_driver.network.messages import JOINT_STATE, JointStateCodec, JointStateMessage
from limo_driver.network.messages.cdr import CdrReader
from limo_driver.recordings.files.batches import STRETCH, Stretches
from limo_driver.types import FloatArray, IntArray

DYNAMIC_JOINT_STATE: Final = "control_msgs/msg/DynamicJointState"
_MOST: Final = 1000  # joints
_EVERY: Final = 50  # messages, of which one tells how fast its clock runs
_FEWEST: Final = 10  # of these
_CLOCK: Final = "/clock"  # topic of a simulation's time, which runs as fast as it can


def decode_dynamic(payload: bytes | memoryview) -> JointStateMessage:
    """Return the joint state that a payload holds; NaN where a joint lacks an interface.

    Raises:
        WireFormatError: The payload is malformed; names its offset.
    """
    reader = CdrReader(payload)
    stamp, frame, names = reader.time("stamp"), reader.string("frame_id"), reader.strings("names")
    many = reader.number("I", "interface_values")
    if many != len(names) or many > _MOST:
        raise WireFormatError(
            f"{many} interface_values of {len(names)} joints, expected as many", reader.offset
        )
    values = np.full((len(_QUANTITIES), many), np.nan)
    for j in range(many):
        interfaces, own = reader.strings("interface_names"), reader.doubles("values")
        if own.size != len(interfaces):
            raise WireFormatError(
                f"{own.size} values of {len(interfaces)} interfaces", reader.offset
            )
        for interface, value in zip(interfaces, own.tolist(), strict=True):
            if interface in _QUANTITIES:
                values[_QUANTITIES.index(interface), j] = value
    reader.end()
    position, velocity, effort = values
    return JointStateMessage(stamp, frame, names, position, velocity, effort)


_LATEST: Final = (1 << 63) - 1  # [ns]
_LISTED = 8  # topics that a message names
_PEEKED = 5000  # messages that show which topic has which joints
_QUANTITIES: Final = ("position", "velocity", "effort")
# Types that hold states of joints, read by the definition in the bag; others are if asked for.
_STATES: Final = (
    "control_msgs/msg/JointTrajectoryControllerState",
    "franka_msgs/msg/FrankaRobotState",
    "franka_msgs/msg/FrankaState",
    "iiwa_msgs/msg/JointPosition",
    "iiwa_msgs/msg/JointTorque",
    "iiwa_msgs/msg/JointVelocity",
)
# by schema; of two that fit alike, the first is meant, as ros2_control publishes both
_DECODERS: Final = {JOINT_STATE: JointStateCodec(()).decode, DYNAMIC_JOINT_STATE: decode_dynamic}
_ORDER: Final = (*_DECODERS, *_STATES)


def read_bags(
    paths: Sequence[Path], topic: str | None = None, joints: Sequence[str] = ()
) -> LogTable:
    """Read the joint states of one topic.

    Joints may come in any order, and in several messages (an arm and its gripper): each set of
    names is a table of its own, and the one with the most of the robot's joints is meant. Where
    that has no torque and another topic has nothing else, as those of iiwa_stack do, the torque of
    the nearest stamp stands beside each position.

    Args:
        paths: MCAP or .db3 files, or folders of them.
        topic: The topic; may be left out where one alone has the robot's joints. Messages of any
            type that the bag defines are read of it.
        joints: Names of the robot's joints.

    Raises:
        RecordingError: No joint states, several topics that could be meant, or stamps that run
            backwards again and again.
    """
    found, notes = _Found(topic), list[str]()
    for message in messages_of(paths, notes):
        found.add(message)
    source = ", ".join(map(str, paths))
    kept = found.meant(joints, source, notes)
    columns, more = kept.columns(source)
    beside = found.beside(kept, joints)
    if beside is not None:
        columns, said = _joined(columns, beside.columns(source)[0], beside)
        more.append(said)
    others = [str(group) for group in found.groups.values() if group not in (kept, beside)]
    if others:
        more.append(f"left aside: {'; '.join(others[:_LISTED])}")
    if found.malformed:
        more.append(f"{found.malformed} messages could not be decoded")
    version = 1 if all(path.suffix == ".bag" for path in bag_files(paths)) else 2
    kind = f"ROS {version} bag" if kept.encoding == CDR else f"MCAP file in {kept.encoding}"
    kind, is_si = f"{kind}, topic {kept.topic}", kept.encoding == CDR or kept.schema in _ORDER
    spread = kept.stretches.spread
    every = (*notes, *more)
    table = LogTable(columns, source, kind, kept.empty, every, spread=spread, is_si=is_si)
    received = 0.0 if _CLOCK in found.topics else kept.seconds_received
    return replace(table, clock="ns", received=received)


def topic_with(
    paths: Sequence[Path], joints: Sequence[str], topic: str | None = None
) -> str | None:
    """Return the topic whose joint states name all joints, letter by letter; None if none does.

    Args:
        paths: MCAP or .db3 files, or folders of them, whose first messages are looked at.
        joints: Names of the robot's joints.
        topic: That is asked for.

    Raises:
        RecordingError: Several topics do.
    """
    found = _Found(topic)
    of_joints = (x for x in messages_of(paths) if (x.schema, x.encoding) == (JOINT_STATE, CDR))
    for message in islice(of_joints, _PEEKED):
        found.add(message)
    groups = [g for g in found.groups.values() if set(joints) <= set(g.names)]
    topics = list(dict.fromkeys(g.topic for g in groups if topic in {None, g.topic}))
    if len(topics) > 1:
        raise RecordingError(
            f"joint states of several topics: {', '.join(topics)}; say which is meant"
        )
    return topics[0] if topics else None


@dataclass(frozen=True)
class _Rows:
    """Messages one after the other."""

    stamps: IntArray  # (T,) [ns]
    values: FloatArray  # (T, k)

    def cut(self, start: int, stop: int) -> _Rows:
        return _Rows(self.stamps[start:stop], self.values[start:stop])


@dataclass(eq=False)
class _Group:
    """The messages of one topic with one set of joints."""

    topic: str
    schema: str
    names: tuple[str, ...]  # of the joints, or of the columns where no joints are named
    held: tuple[str, ...]  # columns
    encoding: str = CDR
    stamps: array[int] = field(default_factory=lambda: array("q"))  # since the last stretch
    values: array[float] = field(default_factory=lambda: array("d"))
    empty: dict[str, str] = field(default_factory=dict)  # quantities, and what they hold
    received: array[int] = field(default_factory=lambda: array("q"))  # [ns], a message now and then
    unstamped: int = 0  # messages that have no stamp, whose time is that of their receipt
    stretches: Stretches[_Rows] = field(default_factory=lambda: Stretches(_Rows.cut))

    def __str__(self) -> str:
        """Say what it holds."""
        return f"{self.many} messages of {', '.join(self.names)} on {self.topic}"

    @property
    def many(self) -> int:
        """Number of messages."""
        return self.stretches.total + len(self.stamps)

    def add(self, message: LoggedMessage, stamp: int | None, values: FloatArray) -> None:
        """Add the values of one message, (k,); of a stamp that was never set it is 0."""
        self.unstamped += stamp == 0
        if self.many % _EVERY == 0 and stamp:
            self.received.extend((stamp, message.log_time_ns))
        self.stamps.append(stamp or message.log_time_ns)
        self.values.frombytes(values.tobytes())
        if len(self.stamps) == STRETCH:
            self._flush()

    def _flush(self) -> None:
        if rows := len(self.stamps):
            values = np.array(self.values).reshape(rows, len(self.held))
            self.stretches.add(_Rows(np.array(self.stamps, dtype=np.int64), values), rows)
            self.stamps, self.values = array("q"), array("d")

    def joints_of(self, quantity: str, joints: Sequence[str]) -> tuple[int, int]:
        """Return how many of the robot's joints have a quantity by name, and by name or number."""
        families = [f for f in families_of(self.held, joints) if f.quantity == quantity]
        counts = [
            (len(f.names) * any(isinstance(name.joint, str) for name in f.names), len(f.names))
            for f in families
            if joints and not (f.by_order and len(f.names) != len(joints))
        ]
        return max(counts, default=(0, 0))

    @property
    def seconds_received(self) -> float:
        """Seconds of receipt that pass in one of the stamps; 0 where that is not known."""
        both = np.array(self.received, dtype=np.int64).reshape(-1, 2)
        steps = np.diff(both, axis=0)
        forward = steps[steps[:, 0] > 0]
        return float(np.median(forward[:, 1] / forward[:, 0])) if len(forward) >= _FEWEST else 0.0

    def columns(self, source: str) -> tuple[dict[str, NDArray[Any]], list[str]]:
        """Return time and quantities in order of the stamps, and what was odd about these."""
        self._flush()
        pieces = self.stretches.pieces()
        stamps = np.concatenate([piece.stamps for piece in pieces])
        order, overtaken = ordered(stamps, self.topic, source)
        values = np.concatenate([piece.values for piece in pieces])[order]
        columns: dict[str, NDArray[Any]] = {"time": stamps[order]}
        for quantity in dict.fromkeys(name.partition(".")[0] for name in self.held):
            own = [k for k, name in enumerate(self.held) if name.partition(".")[0] == quantity]
            if not np.isnan(values[:, own]).all():
                columns |= {self.held[k]: values[:, k] for k in own}
            else:
                self.empty[quantity] = "no number in any message"
        notes = [self.stretches.note()] if self.stretches.spread else []
        if overtaken:
            notes.append(f"{overtaken} messages were logged after one with a later stamp")
        if self.unstamped:
            notes.append(about_no_stamps(self.unstamped))
        return columns, notes


@dataclass
class _Found:
    """All joint states of a bag, by topic and joints."""

    topic: str | None = None  # that is asked for
    groups: dict[tuple[str, tuple[str, ...]], _Group] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)  # topic → why its type cannot be read
    others: set[str] = field(default_factory=set)  # topics of something else than joints
    malformed: int = 0

    def add(self, message: LoggedMessage) -> None:
        """Add a message, if it is a joint state."""
        self.topics.setdefault(message.topic, message.schema or message.encoding)
        try:
            if message.encoding != CDR:
                if message.topic not in self.others:
                    self._add_numbers(message, numbers_of(message))
            elif message.schema in _DECODERS:
                self._add_state(message, _DECODERS[message.schema](message.payload))
            elif message.schema in _STATES or message.topic == self.topic:
                self._add_any(message)
        except WireFormatError:
            self.malformed += 1

    def _add_state(self, message: LoggedMessage, state: JointStateMessage) -> None:
        key = (message.topic, tuple(sorted(state.names)))
        group = self.groups.get(key)
        if group is None:
            held = tuple(f"{quantity}.{name}" for quantity in _QUANTITIES for name in state.names)
            group = self.groups[key] = _Group(message.topic, message.schema, state.names, held)
        n, columns = len(state.names), slice(None)
        if group.names != state.names:
            columns = [state.names.index(name) for name in group.names]
        values = np.full(3 * n, np.nan)
        for k, own in enumerate((state.position, state.velocity, state.torque)):
            if own.size:
                values[k * n : (k + 1) * n] = own[columns]
        group.add(message, state.stamp_ns, values)

    def _add_any(self, message: LoggedMessage) -> None:
        """Add what a message of another type says of joints, by its definition."""
        layout = layout_for(message.schema, message.definition)
        if isinstance(layout, str):
            self.unread[message.topic] = layout
            return
        self._add_numbers(message, layout.decode(message.payload))

    def _add_numbers(self, message: LoggedMessage, found: DecodedMessage) -> None:
        key = (message.topic, tuple(sorted(found.values)))
        group = self.groups.get(key)
        if group is None:
            held = tuple(name for name in found.values if self._is_kept(name, message))
            if not held:
                self.others.add(message.topic)
                return
            names = found.labels or held
            group = self.groups[key] = _Group(message.topic, message.schema, names, held)
            group.encoding = message.encoding
        if abs(found.stamp_ns or message.log_time_ns) > _LATEST:
            raise WireFormatError(f"a stamp of {found.stamp_ns} ns", 0)
        group.add(message, found.stamp_ns, np.array([found.values[name] for name in group.held]))

    def _is_kept(self, column: str, message: LoggedMessage) -> bool:
        """Say whether a number may be motion or torque of a joint, behind its gear.

        Of a topic that is asked for, and of which no type says what it holds, all may be.
        """
        if message.topic == self.topic and message.schema not in _ORDER:
            return True
        is_before_gear = message.schema.startswith(_FRANKA) and not _OF_MOTOR.isdisjoint(
            words_of(column)
        )
        return read_name(column).quantity in _MEASURED and not is_before_gear

    def meant(self, joints: Sequence[str], source: str, notes: Sequence[str] = ()) -> _Group:
        """Return the group that has the robot's joints; notes say what was wrong with the files."""
        groups = [g for g in self.groups.values() if self.topic in {None, g.topic}]
        if not groups:
            raise RecordingError("; ".join((self._nothing(), *notes)), path=source)
        counts = {id(group): group.joints_of(POSITION, joints) for group in groups}
        best = max(counts.values())
        alike = [group for group in groups if counts[id(group)] == best]
        if joints and not best[1]:  # whoever reads on says what the joints are
            return max(groups, key=lambda group: group.many)
        known = [group for group in alike if group.schema in _ORDER]
        if known:
            first = min(_ORDER.index(group.schema) for group in known)
            alike = [group for group in known if _ORDER.index(group.schema) == first]
        alike = [group for group in alike if not is_commanded(words_of(group.topic))] or alike
        by_topic: dict[str, _Group] = {}  # of one topic with fields that come and go, the longest
        for group in alike:
            if group.schema not in _DECODERS:
                other = by_topic.setdefault(group.topic, group)
                by_topic[group.topic] = max(other, group, key=lambda item: item.many)
        alike = list(by_topic.values()) or alike
        if len(alike) > 1:
            raise RecordingError(
                f"joint states of several topics could be meant: {'; '.join(map(str, alike))}; "
                "choose one by `topic` where it is inspected or converted",
                path=source,
            )
        return alike[0]

    def beside(self, kept: _Group, joints: Sequence[str]) -> _Group | None:
        """Return the group that has the torques of a topic that has none, if there is one alone."""
        if kept.schema in _DECODERS or kept.joints_of(TORQUE, joints)[1]:
            return None
        found = [
            group
            for group in self.groups.values()
            if group.joints_of(TORQUE, joints)[1] == len(joints)
            and not group.joints_of(POSITION, joints)[1]
            and not is_commanded(words_of(group.topic))
        ]
        return found[0] if len(found) == 1 else None

    def _nothing(self) -> str:
        named = [f"{name} ({kind})" for name, kind in self.topics.items()][:_LISTED]
        unread = f"; {self.malformed} are malformed" if self.malformed else ""
        why = "".join(f"; {topic} cannot be read: {text}" for topic, text in self.unread.items())
        return (
            f"no joint states{f' of topic {self.topic}' if self.topic else ''}{unread}; it holds "
            f"{', '.join(named) or 'nothing'}{why}{_ANY_TYPE if named and not self.topic else ''}"
        )


_ANY_TYPE: Final = "; of one that `topic` names, the numbers are read"
_MEASURED: Final = (POSITION, VELOCITY, TORQUE)
_FRANKA: Final = "franka_msgs/"
_OF_MOTOR: Final = frozenset({"motor", "theta", "dtheta"})  # before the gear, in these messages


def _joined(
    columns: dict[str, NDArray[Any]], more: dict[str, NDArray[Any]], group: _Group
) -> tuple[dict[str, NDArray[Any]], str]:
    """Return columns with those of another topic at the nearest stamp, and what that left.

    Rows without one within half a period have NaN there, which is no measurement.
    """
    stamps, others = columns["time"], more["time"]
    period = int(np.median(np.diff(stamps))) if stamps.size > 1 else 0
    after = np.searchsorted(others, stamps).clip(1, max(others.size - 1, 1))
    before = after - 1
    after = np.minimum(after, others.size - 1)
    nearest = np.where(stamps - others[before] <= others[after] - stamps, before, after)
    missing = np.abs(others[nearest] - stamps) > period / 2
    found = dict(columns)
    for name, values in more.items():
        if name != "time":
            found[name] = np.where(missing, np.nan, values[nearest])
    said = f"torques are those of {group.topic} at the nearest stamp"
    if missing.any():
        said += f"; {missing.sum()} rows have none within half a period"
    return found, said
