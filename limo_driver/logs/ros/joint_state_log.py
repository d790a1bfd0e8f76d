"""Joint states of logs, ours or bags of ROS 2, as columns of a recording, and back."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.logs.mcap_file import CDR, LoggedMessage, McapWriter, read_mcap
from limo_driver.logs.ros.bag_files import read_db3, read_ros1
from limo_driver.logs.ros.message_layout import JSON, PROTOBUF
from limo_driver.network.messages import JOINT_STATE, JointStateCodec, JointStateMessage
from limo_driver.recordings.channels import Columns
from limo_driver.recordings.files.batches import BLOCK
from limo_driver.recordings.gate.doubts import SYSTEMATIC, in_order, runs_backwards
from limo_driver.runtime.display import naturally
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, IntArray

_NANOSECOND = 1e-9  # [s]
_LISTED = 8  # topics that a message names
_DB3 = (".db3", ".zstd")
_ROS1 = ".bag"
_ENDINGS = (".mcap", *_DB3, _ROS1)
_REPORTED = 1024  # messages between two reports of progress


@dataclass(frozen=True)
class JointStateLog:
    """The joint states of one topic, in order of their stamps, and what was odd about them."""

    columns: Columns
    joints: tuple[str, ...]
    topic: str
    start_ns: int  # stamp at time 0
    duplicates: int  # messages with the stamp of another
    reordered: int  # messages that were logged after one with a later stamp
    malformed: int  # messages that could not be decoded, which are not in the columns
    elsewhere: int  # messages of other joints than the robot's, which are not either
    beside: tuple[str, ...] = ()  # joints in the same messages that are none of the robot's


def joint_states(
    paths: Sequence[Path],
    joints: tuple[str, ...],
    topic: str,
    also: Callable[[LoggedMessage], None] | None = None,
) -> JointStateLog:
    """Read the joint states of one topic from logs, of several runs whose clocks may differ.

    Args:
        paths: MCAP or .db3 files, or folders of them.
        joints: Names, in the order of the columns.
        topic: The topic.
        also: Given every message, so that others can be read in the same pass.

    Raises:
        RecordingError: No joint states, or other joints.
    """
    rows, warnings = _Rows(joints, topic), list[str]()
    for message in messages_of(paths, warnings):
        rows.add(message)
        if also is not None:
            also(message)
    return rows.log("", tuple(warnings), one_clock=False)


def joint_state_blocks(
    paths: Sequence[Path],
    joints: tuple[str, ...] | None = None,
    topic: str | None = None,
    robot: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[JointStateLog]:
    """Read the joint states of one topic, of one clock, block by block.

    Each block is in order of the stamps, and follows the one before. Counts are of all messages so
    far, and `start_ns` is that of the first block.

    Args:
        paths: MCAP or .db3 files, or folders of them.
        joints: Names, in the order of the columns; those of the first message if not given.
        topic: The topic; may be left out where there is one with joint states.
        robot: Its name, for the columns.
        progress: Told the files and the messages read, now and then.

    Raises:
        RecordingError: No joint states, several topics of them, other joints, or stamps that run
            backwards again and again.
    """
    rows, warnings = _Rows(joints, topic), list[str]()
    for message in messages_of(paths, warnings, progress):
        rows.add(message)
        if rows.many >= 2 * BLOCK:
            yield rows.log(robot, one_clock=True, most=BLOCK)
    yield rows.log(robot, tuple(warnings), one_clock=True)


def messages_of(
    paths: Sequence[Path],
    notes: list[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[LoggedMessage]:
    """Read the messages of logs, file after file, each in the order in which it was logged.

    Args:
        paths: MCAP, .db3 or .bag files, or folders of them; the ending says which.
        notes: Extended by why files were not read to their ends.
        progress: Told the files and the messages read, now and then.

    Raises:
        RecordingError: A file cannot be read, is something else, or a folder holds none.
        MissingPackageError: Of a bag of ROS 1: rosbags is not installed.
    """
    messages = 0
    for k, path in enumerate(bag_files(paths)):
        why = list[str]()
        for message in _read(path, why.append):
            yield message
            messages += 1
            if progress is not None and messages % _REPORTED == 0:
                progress(k, messages)
        if notes is not None:
            notes += [f"{path} {text}" for text in why]


def bag_files(paths: Sequence[Path]) -> list[Path]:
    """Return the files named and those in the folders named, `part_9` before `part_10`.

    Raises:
        RecordingError: A folder holds none.
    """
    files: list[Path] = []
    for path in paths:
        found = [path]
        if path.is_dir():
            logs = (each for each in path.iterdir() if each.suffix in _ENDINGS)
            found = sorted(logs, key=lambda log: naturally(log.name))
        if not found:
            raise RecordingError("holds no .mcap, .db3 or .bag files", path=path)
        files += found
    return files


def _read(path: Path, tell: Callable[[str], None]) -> Iterator[LoggedMessage]:
    if path.suffix == _ROS1:
        return read_ros1(path, tell)
    if path.suffix in _DB3:
        return read_db3(path, tell)
    return read_mcap(path, tell, (CDR, JSON, PROTOBUF))


def write_joint_states(
    recording: Recording, path: Path, joints: tuple[str, ...], topic: str, start_ns: int = 0
) -> None:
    """Write a recording as joint states in an MCAP file; extras are left behind.

    Args:
        recording: T samples of n joints.
        path: To be made; an older file is replaced.
        joints: Names, n.
        topic: To write to.
        start_ns: Stamp of time 0 [ns].

    Raises:
        RecordingError: A sample was before 1970.
        ConfigError: The file cannot be written.
    """
    codec = JointStateCodec(joints)
    stamps = start_ns + np.round(recording.time / _NANOSECOND).astype(np.int64)
    if stamps[0] < 0:
        raise RecordingError(f"begins at {recording.time[0]:g} s, which no log can hold")
    velocity = np.zeros((len(recording), 0)) if recording.velocity is None else recording.velocity
    rows = zip(stamps.tolist(), recording.position, velocity, recording.torque, strict=True)
    with whole(path) as draft:
        draft.unlink(missing_ok=True)  # of a killed process
        writer = McapWriter(draft)
        try:
            for sequence, (stamp, *values) in enumerate(rows):
                payload = codec.encode(stamp, *values)
                writer.add(LoggedMessage(topic, JOINT_STATE, payload, stamp, stamp, sequence))
            writer.finish()
        finally:
            writer.abandon()  # closed already, if all went well


@dataclass
class _Rows:
    """Rows of one topic as they come; every other topic is only named."""

    joints: tuple[str, ...] | None
    topic: str | None
    topics: dict[str, str] = field(default_factory=dict)  # topic → schema
    malformed: int = 0
    elsewhere: int = 0
    others: tuple[str, ...] = ()  # joints of the first message that was elsewhere
    beside: dict[str, None] = field(default_factory=dict)  # joints that are left out on purpose

    def __post_init__(self) -> None:
        self._wanted = self.topic is None
        self._fixed = self.joints is not None
        self._codec = JointStateCodec(self.joints or ())
        self._stamps = array("q")
        self._values = array("d")  # position, velocity and torque of all joints, row by row
        self._start: int | None = None  # [ns], of the first block
        self._duplicates = self._reordered_before = self._unstamped = 0

    @property
    def many(self) -> int:
        """Rows that were not given out yet."""
        return len(self._stamps)

    def add(self, message: LoggedMessage) -> None:
        self.topics.setdefault(message.topic, message.schema)
        if message.schema != JOINT_STATE or message.encoding != CDR:
            return
        if self.topic is None:
            self.topic = message.topic
        if message.topic != self.topic:
            return
        try:
            state = self._codec.decode(message.payload)
        except WireFormatError:
            self.malformed += 1
            return
        if self.joints is None:
            if not state.names:
                raise RecordingError(f"topic {self.topic} does not name its joints")
            self.joints = state.names
            self._codec = JointStateCodec(state.names, state.frame_id)
        self._append(state, self.joints, message.log_time_ns)

    def _append(self, state: JointStateMessage, joints: tuple[str, ...], received_ns: int) -> None:
        if state.names == joints:
            columns = slice(None)
        elif set(state.names) >= set(joints):
            columns = [state.names.index(name) for name in joints]
            if len(state.names) > len(joints):
                self.beside |= dict.fromkeys(name for name in state.names if name not in joints)
        elif self._fixed:
            self.elsewhere += 1
            self.others = self.others or state.names
            return
        else:
            raise RecordingError(
                f"topic {self.topic} has messages of the joints {', '.join(joints)} and of "
                f"{', '.join(state.names) or 'none'}; say which robot's are meant"
            )
        self._unstamped += state.stamp_ns == 0
        self._stamps.append(state.stamp_ns or received_ns)
        missing = np.full(len(joints), np.nan)
        for values in (state.position, state.velocity, state.torque):
            self._values.frombytes((values[columns] if values.size else missing).tobytes())

    def log(
        self,
        robot: str,
        warnings: tuple[str, ...] = (),
        *,
        one_clock: bool,
        most: int | None = None,
    ) -> JointStateLog:
        """Return rows in order of their stamps: all that wait, or the first so many of them."""
        self._check_topic()
        assert self.joints is not None  # noqa: S101  # there are rows
        assert self.topic is not None  # noqa: S101
        stamps = np.array(self._stamps, dtype=np.int64)
        order, reordered = np.argsort(stamps, kind="stable"), 0
        if one_clock:
            order, reordered = ordered(stamps, self.topic)
        values = np.array(self._values).reshape(stamps.size, 3, -1)[order]
        stamps = stamps[order]
        values, stamps = self._given_out(values, stamps, most)
        start = self._start if self._start is not None else int(stamps[0])
        self._start = start
        self._duplicates += int((np.diff(stamps) == 0).sum())
        self._reordered_before += reordered
        position, velocity, torque = (values[:, k] for k in range(3))
        self._check_measured(position, torque)
        if self._unstamped:
            warnings = (*warnings, about_no_stamps(self._unstamped))
        return JointStateLog(
            Columns(
                (stamps - start).astype(np.float64) * _NANOSECOND,
                position,
                torque,
                None if np.isnan(velocity).all() else velocity,
                warnings=warnings,
                robot=robot,
            ),
            self.joints,
            self.topic,
            start,
            duplicates=self._duplicates,
            reordered=self._reordered_before,
            malformed=self.malformed,
            elsewhere=self.elsewhere,
            beside=tuple(self.beside),
        )

    def _given_out(
        self, values: FloatArray, stamps: IntArray, most: int | None
    ) -> tuple[FloatArray, IntArray]:
        """Return the first rows, and keep the others, in order, for the next block."""
        self._stamps, self._values = array("q"), array("d")
        if most is None:
            return values, stamps
        self._stamps.frombytes(stamps[most:].tobytes())
        self._values.frombytes(values[most:].tobytes())
        return values[:most], stamps[:most]

    def _check_topic(self) -> None:
        found = [topic for topic, schema in self.topics.items() if schema == JOINT_STATE]
        if self._wanted and len(found) > 1:
            raise RecordingError(
                f"joint states of several topics: {', '.join(found)}; say which is meant"
            )
        if not self._stamps:
            named = [f"{topic} ({schema})" for topic, schema in self.topics.items()][:_LISTED]
            asked = "" if self._wanted else f" of topic {self.topic}"
            unread = f"; {self.malformed} are malformed" if self.malformed else ""
            others = ""
            if self.elsewhere:
                listed = ", ".join(self.others[:_LISTED]) or "that have no names"
                more = ", ..." if len(self.others) > _LISTED else ""
                others = f"; {self.elsewhere} are of other joints ({listed}{more})"
            raise RecordingError(
                f"no joint states{asked} in these logs{unread}{others}; they hold "
                f"{', '.join(named) or 'nothing'}"
            )

    def _check_measured(self, position: FloatArray, torque: FloatArray) -> None:
        for name, values in (("position", position), ("effort", torque)):
            if np.isnan(values).all():
                raise RecordingError(
                    f"the joint states of {self.topic} have no {name}; a recording needs "
                    "position and effort"
                )


def ordered(stamps: IntArray, topic: str, source: str | None = None) -> tuple[IntArray, int]:
    """Return the messages of a topic in the order of their stamps, and how many were overtaken.

    Args:
        stamps: In the order in which they were logged, (T,) [ns].
        topic: Which.
        source: Of the messages.

    Raises:
        RecordingError: They run backwards again and again.
    """
    order, overtaken = in_order(stamps)
    if (share := runs_backwards(stamps[order])) > SYSTEMATIC:
        raise RecordingError(
            f"the stamps of {topic} run backwards at {share:.0%} of the messages; are these two "
            "publishers?",
            path=source,
        )
    return order, overtaken


def about_no_stamps(messages: int) -> str:
    """Say what stands for the stamps of messages that have none."""
    return (
        f"{messages} messages have no stamp (0): their times are those at which they were received"
    )
