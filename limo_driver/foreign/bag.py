"""The joint states of a ROS 2 bag as a table: one column for each quantity of each joint."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.foreign.dynamic_joint_state import DYNAMIC_JOINT_STATE, decode_dynamic
from limo_driver.foreign.names import words_of
from limo_driver.foreign.table import LogTable
from limo_driver.logs.joint_state_log import bag_files, read_bag
from limo_driver.network.messages import JOINT_STATE, JointStateCodec
from limo_driver.recordings.data_gate import SYSTEMATIC
from limo_driver.recordings.stretches import STRETCH, Stretches

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from limo_driver.logs.mcap_file import LoggedMessage
    from limo_driver.types import FloatArray

_QUANTITIES = ("position", "velocity", "effort")
_LISTED = 8  # topics that a message names


def read_bags(
    paths: Sequence[Path], topic: str | None = None, joints: Sequence[str] = ()
) -> LogTable:
    """Read the joint states of one topic.

    Joints may come in any order, and in several messages (an arm and its gripper): each set of
    names is a table of its own, and the one with the most of the robot's joints is meant.

    Args:
        paths: MCAP or .db3 files, or folders of them.
        topic: The topic; may be left out where one alone has the robot's joints.
        joints: Names of the robot's joints.

    Raises:
        RecordingError: No joint states, several topics that could be meant, or stamps that run
            backwards more than now and then.
    """
    found, notes = _Found(), list[str]()
    for path in bag_files(paths):
        told: list[str] = []
        for message in read_bag(path, told.append):
            found.add(message)
        notes += [f"{path} {text}" for text in told]
    source = ", ".join(map(str, paths))
    kept = found.meant(topic, joints, source)
    columns, more = kept.columns(source)
    others = [str(group) for group in found.groups.values() if group is not kept]
    if others:
        more.append(f"left aside: {'; '.join(others[:_LISTED])}")
    if found.malformed:
        more.append(f"{found.malformed} messages could not be decoded")
    kind = f"ROS 2 bag, topic {kept.topic}"
    spread = kept.stretches.spread
    return LogTable(columns, source, kind, {}, (*notes, *more), spread=spread)


@dataclass(frozen=True)
class _Rows:
    """Messages one after the other."""

    stamps: NDArray[np.int64]  # (T,) [ns]
    values: FloatArray  # (T, 3, n)

    def cut(self, start: int, stop: int) -> _Rows:
        return _Rows(self.stamps[start:stop], self.values[start:stop])


@dataclass
class _Group:
    """The messages of one topic with one set of joints."""

    topic: str
    names: tuple[str, ...]
    stamps: array[int] = field(default_factory=lambda: array("q"))  # since the last stretch
    values: array[float] = field(default_factory=lambda: array("d"))
    stretches: Stretches[_Rows] = field(default_factory=lambda: Stretches(_Rows.cut))

    def __str__(self) -> str:
        """Say what it holds."""
        many = self.stretches.total + len(self.stamps)
        return f"{many} messages of {', '.join(self.names)} on {self.topic}"

    def add(self, stamp: int, values: Iterable[FloatArray]) -> None:
        """Add position, velocity and effort of one message."""
        self.stamps.append(stamp)
        for own in values:
            self.values.frombytes(own.tobytes())
        if len(self.stamps) == STRETCH:
            self._flush()

    def _flush(self) -> None:
        if rows := len(self.stamps):
            values = np.array(self.values).reshape(rows, len(_QUANTITIES), -1)
            self.stretches.add(_Rows(np.array(self.stamps, dtype=np.int64), values), rows)
            self.stamps, self.values = array("q"), array("d")

    def columns(self, source: str) -> tuple[dict[str, NDArray[Any]], list[str]]:
        """Return time and quantities in order of the stamps, and what was odd about these."""
        self._flush()
        pieces = self.stretches.pieces()
        stamps = np.concatenate([piece.stamps for piece in pieces])
        late = np.append(False, stamps[1:] < np.maximum.accumulate(stamps)[:-1])
        if late.mean() > SYSTEMATIC:
            raise RecordingError(
                f"the stamps of {self.topic} run backwards at message {int(late.argmax())}, and "
                f"{late.mean():.0%} of them do; are these two recordings, or two publishers?",
                path=source,
                rows=[int(late.argmax())],
            )
        order = np.argsort(stamps, kind="stable")
        values = np.concatenate([piece.values for piece in pieces])[order]
        columns: dict[str, NDArray[Any]] = {"time": stamps[order]}
        for k, quantity in enumerate(_QUANTITIES):
            if not np.isnan(values[:, k]).all():
                columns |= {
                    f"{quantity}.{joint}": values[:, k, j] for j, joint in enumerate(self.names)
                }
        told = [f"{late.sum()} messages were logged after one with a later stamp"]
        notes = [self.stretches.note()] if self.stretches.spread else []
        return columns, notes + (told if late.any() else [])


@dataclass
class _Found:
    """All joint states of a bag, by topic and joints."""

    groups: dict[tuple[str, tuple[str, ...]], _Group] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)
    malformed: int = 0

    def add(self, message: LoggedMessage) -> None:
        """Add a message, if it is a joint state."""
        self.topics.setdefault(message.topic, message.schema)
        if message.schema not in _DECODERS:
            return
        try:
            state = _DECODERS[message.schema](message.payload)
        except WireFormatError:
            self.malformed += 1
            return
        names = tuple(sorted(state.names))
        group = self.groups.setdefault((message.topic, names), _Group(message.topic, state.names))
        columns = slice(None)
        if group.names != state.names:
            columns = [state.names.index(name) for name in group.names]
        missing = np.full(len(names), np.nan)
        given = (state.position, state.velocity, state.torque)
        group.add(state.stamp_ns, (own[columns] if own.size else missing for own in given))

    def meant(self, topic: str | None, joints: Sequence[str], source: str) -> _Group:
        """Return the group that has the robot's joints."""
        groups = [group for group in self.groups.values() if topic in {None, group.topic}]
        if not groups:
            named = [f"{name} ({kind})" for name, kind in self.topics.items()][:_LISTED]
            unread = f"; {self.malformed} are malformed" if self.malformed else ""
            raise RecordingError(
                f"no joint states{f' of topic {topic}' if topic else ''}{unread}; it holds "
                f"{', '.join(named) or 'nothing'}",
                path=source,
            )
        best = max(_match(group, joints) for group in groups)
        alike = [group for group in groups if _match(group, joints) == best]
        schemas = {self.topics[group.topic] for group in alike}
        first = next(schema for schema in _DECODERS if schema in schemas)
        alike = [group for group in alike if self.topics[group.topic] == first]
        if len(alike) > 1:
            raise RecordingError(
                f"joint states that could be meant are several: {'; '.join(map(str, alike))}; say "
                "which topic is",
                path=source,
            )
        return alike[0]


# by schema; of two that fit alike, the first is meant, as ros2_control publishes both
_DECODERS = {JOINT_STATE: JointStateCodec(()).decode, DYNAMIC_JOINT_STATE: decode_dynamic}


def _match(group: _Group, joints: Sequence[str]) -> int:
    """Return how many of the robot's joints are in the names of a group, as whole words."""
    named = [words_of(name) for name in group.names]
    return sum(any(_holds(name, words_of(joint)) for name in named) for joint in joints)


def _holds(words: tuple[str, ...], part: tuple[str, ...]) -> bool:
    return any(words[k : k + len(part)] == part for k in range(len(words) - len(part) + 1))
