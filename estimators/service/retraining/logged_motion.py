"""Read the newest motion of an arm from the logs of its service, without contacts."""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.service.inference.contact import MARGIN
from limo_driver.errors import RecordingError, WireFormatError
from limo_driver.logs.mcap_log import log_files
from limo_driver.logs.ros.joint_state_log import joint_states
from limo_driver.network.messages import JOINT_STATE, LOG, decode_event
from limo_driver.network.streaming import Keys
from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from limo_driver.logs.mcap_file import LoggedMessage
    from limo_driver.types import BoolArray, IntArray

_NANOSECONDS: Final = 1e9
_SLACK: Final = 60.0  # [s] between clocks, and of what is about to be written
_NAME_ENDS: Final = "_%Y%m%dT%H%M%S.%fZ"  # of a log file: when it began
_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_AROUND: Final = 101  # states that say together what the rate is
_BLURRED: Final = 76  # states next to another rate, whose own is not clear
_SILENCE: Final = 1_000_000_000  # [ns], after which states are another stretch
_PER_SECOND: Final = 1e9  # [ns]
_NUMBERS: Final = 2**32  # after which a log's numbers begin anew


@dataclass(frozen=True)
class Span:
    """Span of the logged motion."""

    seconds: float  # of the newest
    rate: float | None = None  # [Hz] of the states; that of the newest ones if not given
    until_ns: int | None = None  # [ns], stamp of the newest state; the newest logged if not given

    def holds(self, stamps: IntArray, folder: Path) -> BoolArray:
        """Return which stamps (T,) [ns], in order, are in it.

        What seems to come from the future was logged before a clock was set back.

        Raises:
            RecordingError: None is.
        """
        until = int(stamps[-1]) if self.until_ns is None else self.until_ns
        present = stamps <= until
        newest = int(stamps[present][-1]) if present.any() else until
        if newest < until - self.seconds * _NANOSECONDS or not present.any():
            raise RecordingError(
                f"the joint states end {(until - newest) / _NANOSECONDS:.0f} s before the newest "
                "one that came: was the log stopped?",
                path=folder,
            )
        return present & (stamps >= newest - self.seconds * _NANOSECONDS)


@dataclass(frozen=True)
class LoggedMotion:
    """Motion outside of contact, and where it came from."""

    recording: Recording
    origin: dict[str, Any]  # logs, times and digest, as JSON values
    contact: float  # [s] that were left out for contact


@dataclass
class Contacts:
    """Stretches of Unix time in which the service saw contact, event by event."""

    key: str  # of the events
    intervals: list[tuple[int, float]] = field(default_factory=list)  # [ns], to inf if it lasts
    _open: dict[int, int] = field(default_factory=dict)  # joint → [ns]

    def take(self, message: LoggedMessage) -> None:
        """Look whether a message of the log begins or ends a contact."""
        if message.schema != LOG or message.topic != self.key:
            return
        try:
            event = decode_event(message.payload)
        except WireFormatError:  # of another program
            return
        match event.kind, event.facts:
            case "serving", _:  # the service began anew, and with it its watchdog
                for joint in tuple(self._open):
                    self._end(joint, event.stamp_ns)
            case "contact", {"joint": int(joint), "state_stamp": int(stamp)}:
                self._open.setdefault(joint, stamp)
            case "contact_end", {"joint": int(joint), "state_stamp": int(stamp)}:
                began = event.facts.get("began_stamp")  # in a log that is not read, perhaps
                self._open.setdefault(joint, began if isinstance(began, int) else 0)
                self._end(joint, stamp)
            case _:
                pass

    def free(self, stamps: IntArray, margin_ns: float) -> BoolArray:
        """Return which stamps (T,) [ns] are farther than a margin from every contact."""
        free = np.ones(stamps.shape, dtype=bool)
        for first, last in [*self.intervals, *((first, np.inf) for first in self._open.values())]:
            free &= (stamps < first - margin_ns) | (stamps > last + margin_ns)
        return free

    def _end(self, joint: int, stamp: int) -> None:
        first = self._open.pop(joint, None)
        if first is not None:
            self.intervals.append((first, stamp))


def newest_motion(
    folder: Path,
    arm: str,
    joints: tuple[str, ...],
    span: Span,
    margin: float = MARGIN,
) -> LoggedMotion:
    """Read the newest motion of an arm from the logs of its service.

    Left out are contacts, states that came at another rate, and the time that two runs share since
    a clock was set back.

    Args:
        folder: Of the logs.
        arm: Its name in keys, with which the names of the logs begin.
        joints: Names, in the order of the columns.
        span: Which of it.
        margin: Left out before and after each contact, beyond the time in which the service
            notices it [s].

    Raises:
        RecordingError: There are no logs, no joint states in them, or none that can be used.
    """
    keys, paths = Keys(arm), _of_span(folder, arm, span)
    contacts, rates = Contacts(keys.event), LoggedRates(keys.joints)

    def also(message: LoggedMessage) -> None:
        contacts.take(message)
        rates.take(message)

    log = joint_states(paths, joints, keys.joints, also)
    columns = log.columns
    stamps = log.start_ns + np.round(columns.time * _NANOSECONDS).astype(np.int64)
    new = span.holds(stamps, folder)
    free = contacts.free(stamps, margin * _NANOSECONDS)
    if not (new & free).any():
        raise RecordingError(f"the last {span.seconds:g} s are all in contact", path=folder)
    rate = span.rate or rates.newest(stamps[new])
    alike = rates.of_rate(stamps, rate) & ~rates.twice(stamps)
    rows = new & free & alike
    if not rows.any():
        raise RecordingError(
            f"no joint states at {rate:.4g} Hz in the last {span.seconds:g} s", path=folder
        )
    recording = Recording.from_arrays(
        columns.time[rows], columns.position[rows], columns.torque[rows]
    )
    # The SHA-256 of what is learned from, which the same logs give again
    digest = sha256()
    for values in (recording.time, recording.position, recording.torque):
        digest.update(np.ascontiguousarray(values).tobytes())
    return LoggedMotion(
        recording,
        {
            "logs": [path.name for path in paths],
            "start_ns": int(stamps[rows][0]),
            "end_ns": int(stamps[rows][-1]),
            "samples": len(recording),
            "rate": rate,
            "other_rate_samples": int((new & free & ~alike).sum()),
            "sha256": digest.hexdigest(),
        },
        contact=float((new & ~free).sum() / rate),
    )


def _of_span(folder: Path, arm: str, span: Span) -> list[Path]:
    """Return the logs that may hold what is asked for, by their names.

    A file says when it began and when it was written last, both by the clock of this machine.
    """
    paths = log_files(folder, arm) if folder.is_dir() else []
    if not paths:
        raise RecordingError(f"holds no logs of {arm}", path=folder)
    written = [path.stat().st_mtime for path in paths]
    until = max(written) if span.until_ns is None else time.time()
    return [
        path
        for path, end in zip(paths, written, strict=True)
        if _began(path, arm) <= until + _SLACK and end >= until - span.seconds - _SLACK
    ]


def _began(path: Path, arm: str) -> float:
    stamp = datetime.strptime(path.stem[len(arm) :], _NAME_ENDS)
    return stamp.replace(tzinfo=UTC).timestamp()


@dataclass
class LoggedRates:
    """Stamps and numbers of one topic's joint states, in the order in which they were logged."""

    topic: str
    _stamps: array[int] = field(default_factory=lambda: array("q"))
    _numbers: array[int] = field(default_factory=lambda: array("q"))

    def take(self, message: LoggedMessage) -> None:
        """Look at a message of the log."""
        if message.schema == JOINT_STATE and message.topic == self.topic:
            self._stamps.append(message.publish_time_ns)
            self._numbers.append(message.sequence)

    def newest(self, stamps: IntArray) -> float:
        """Return the rate of the last states that have one [Hz]; NaN if none has.

        Args:
            stamps: Of the states that count [ns].
        """
        logged, interval = self._intervals
        known = np.flatnonzero(np.isin(logged, stamps) & np.isfinite(interval))
        return float(_PER_SECOND / interval[known[-1]]) if known.size else np.nan

    def of_rate(self, stamps: IntArray, rate: float) -> BoolArray:
        """Return which stamps (T,) [ns] are of states that came at a rate [Hz], beyond doubt."""
        from scipy.ndimage import minimum_filter1d  # slow to import; a service begins without

        logged, interval = self._intervals
        near = np.abs(interval * rate / _PER_SECOND - 1.0) <= RATE_TOLERANCE  # NaN is not
        for first, stop in pairwise(self._bounds):
            near[first:stop] = minimum_filter1d(near[first:stop], 2 * _BLURRED + 1, mode="nearest")
        return np.isin(stamps, logged[near])

    def twice(self, stamps: IntArray) -> BoolArray:
        """Return which stamps (T,) [ns] lie where the clock ran twice, since it was set back."""
        logged, found = np.array(self._stamps, dtype=np.int64), np.zeros(stamps.shape, dtype=bool)
        back = np.flatnonzero(np.diff(logged) < 0) + 1
        runs = [(int(part[0]), int(part[-1])) for part in np.split(logged, back) if part.size]
        reached = -1  # by the runs that began earlier
        for first, last in sorted(runs):
            found |= (stamps >= first) & (stamps <= min(last, reached))
            reached = max(reached, last)
        return found

    @property
    def _bounds(self) -> list[int]:
        """Starts of the segments in which numbers and stamps are contiguous, and the last end."""
        stamps = np.diff(np.array(self._stamps, dtype=np.int64))
        numbers = np.diff(np.array(self._numbers, dtype=np.int64)) % _NUMBERS
        goes_on = (stamps > 0) & (stamps < _SILENCE) & (numbers > 0) & (numbers < _SILENCE)
        ends = np.flatnonzero(~goes_on) + 1
        return [0, *ends.tolist(), len(self._stamps)] if self._stamps else [0]

    @property
    def _intervals(self) -> tuple[IntArray, NDArray[np.float64]]:
        """Return stamps [ns] and the time from one state to the next around each [ns]."""
        from scipy.ndimage import median_filter  # as above

        stamps = np.array(self._stamps, dtype=np.int64)
        numbers = np.array(self._numbers, dtype=np.int64)
        interval = np.full(stamps.shape, np.nan)
        for first, stop in pairwise(self._bounds):
            apart = min(_APART, stop - first - 1)
            if apart < 1:
                continue
            time, count = (
                v[first + apart : stop] - v[first : stop - apart] for v in (stamps, numbers)
            )
            steps = time / np.maximum(count % _NUMBERS, 1)
            steps = median_filter(steps, min(_AROUND, 2 * (steps.size // 2) + 1), mode="nearest")
            before = apart // 2
            interval[first:stop] = np.pad(steps, (before, apart - before), mode="edge")
        return stamps, interval
