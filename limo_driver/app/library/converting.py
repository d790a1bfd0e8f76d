"""Convert logs of any format and length to a recording's file, with every row of them.

A long log block by block: what is written of it anew has all of its rows, and none too many.
"""

# pyright: reportUnknownParameterType=false
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.app.library.reading import columns_of, mapping_of, proposed, said
from limo_driver.errors import LimoError, RecordingError
from limo_driver.logs.readers.columns import WRITTEN
from limo_driver.logs.readers.formats.arrays import npz_blocks, rows_of_npz
from limo_driver.logs.readers.formats.arrow import numbers_of
from limo_driver.logs.readers.formats.bag import read_bags, topic_with
from limo_driver.logs.readers.formats.reading import ARRAYS, PARQUET, TEXTS, ending_of
from limo_driver.logs.readers.mapping import LogMapping
from limo_driver.logs.readers.proposals.gravity import other_unit_from
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.proposals.recorded_joints import mapped_part
from limo_driver.logs.readers.proposals.times import refuse_two_units
from limo_driver.logs.readers.table import LogTable
from limo_driver.logs.ros.joint_state_log import joint_state_blocks
from limo_driver.model import RobotModel
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.channels import Columns
from limo_driver.recordings.files.batches import LONG_TEXT, MOST, blocks_of, is_packed
from limo_driver.recordings.files.delimited import DelimitedText
from limo_driver.recordings.files.parquet import parquet_rows, reading_parquet
from limo_driver.recordings.files.recording_file import columns_writer
from limo_driver.recordings.gate.doubts import LeftOut, OneClock, without_silent_torques
from limo_driver.recordings.gate.rows import inspect
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Converted:
    """What was written, and what was odd about it."""

    joints: tuple[str, ...]
    samples: int
    usable: int
    duration: float  # [s]
    notes: tuple[str, ...]


def convert_log(
    log: Path,
    out: Path,
    model: RobotModel | None = None,
    mapping: LogMapping | Path | str | None = None,
    topic: str | None = None,
    episode: int | None = None,
) -> Converted:
    """Write the rows of one log as its mapping, or the one proposed for it, says.

    A long log goes through memory block by block, and each block is judged by itself.

    Args:
        log: File or folder.
        out: To be written, Parquet.
        model: The robot.
        mapping: Which columns are what, or the file that says so.
        topic: Of the joint states of a bag, where there are several.
        episode: Of a LeRobotDataset; all if not given.

    Raises:
        ConfigError: There is neither robot nor mapping, or a question is open.
        RecordingError: The log cannot be read, or lacks what a recording has.
    """
    blocks = long_log(log)
    if blocks is None:
        columns, used, model = columns_of(log, model, mapping, topic, episode)
        pieces = iter([columns])
    else:
        used, pieces, model = _mapped(blocks, model, mapping_of(mapping), log)
    judged = _Judged(log, model, is_whole=blocks is None)
    return _write(pieces, out, judged, used.joints, logs=[log.name])


def _write(
    pieces: Iterable[Columns],
    out: Path,
    judged: _Judged,
    joints: tuple[str, ...],
    **provenance: object,
) -> Converted:
    """Write rows as they are judged, and where they are from."""
    about = {"joints": joints, "provenance": {**provenance, "limo": version("limo")}}
    with columns_writer(out, about) as write:
        for columns in pieces:
            write(judged.taken(columns))
    return judged.converted(joints)


@dataclass(frozen=True)
class ConvertedBags:
    """What was written of the joint states of bags, and what was odd about them."""

    whole: Converted
    topic: str
    duplicates: int = 0  # messages with the stamp of another
    reordered: int = 0  # messages that were logged after one with a later stamp
    malformed: int = 0  # messages that could not be decoded
    elsewhere: int = 0  # messages of other joints than the robot's


def convert_bags(
    bags: Sequence[Path],
    out: Path,
    model: RobotModel | None = None,
    topic: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ConvertedBags:
    """Write the joint states of one topic, in order of their stamps, block by block.

    Joints that are not named as the robot's are found as `limo.inspect` finds them.

    Args:
        bags: MCAP or .db3 files, or folders of them.
        out: To be written, Parquet.
        model: The robot, whose joints are meant, in their order.
        topic: The topic; may be left out where there is one with joint states.
        progress: Told the files and the messages read, now and then.

    Raises:
        ConfigError: Which joints are meant is to be decided first.
        RecordingError: There are no joint states, several topics of them, or they cannot be used.
    """
    if model is None:
        return _streamed(bags, out, None, None, topic, progress)
    if (exact := topic_with(bags, model.joint_names, topic)) is not None:
        return _streamed(bags, out, model, model.joint_names, exact, progress)
    table = read_bags(bags, topic, model.joint_names)
    proposal = propose(table, model)
    model = proposal.model
    columns = proposal.mapping.columns(table, model)
    names = [name.partition(".")[2] for name in proposal.mapping.position.columns]
    own = table.kind.rpartition(" ")[2]
    if table.spread and _is_plain(proposal.mapping, names):  # of which the table has not every row
        return _streamed(bags, out, model, tuple(names), own, progress, (said(proposal),))
    columns = replace(columns, warnings=(said(proposal), *columns.warnings))
    judged, start_ns = _Judged(bags[0], model, is_whole=True), int(table.columns["time"][0])
    logs = [path.name for path in bags]
    whole = _write(
        [columns], out, judged, model.joint_names, logs=logs, topic=own, start_ns=start_ns
    )
    return ConvertedBags(whole, own)


def _is_plain(mapping: LogMapping, names: Sequence[str]) -> bool:
    """Say whether a mapping takes position and effort of joint states as they are."""
    torque = mapping.torque
    return (
        torque is not None
        and mapping.position.columns == tuple(f"position.{name}" for name in names)
        and torque.columns == tuple(f"effort.{name}" for name in names)
        and set(mapping.position.unit) <= {"rad", "m"}
        and set(torque.unit) <= {"N m", "N"}
    )


def _streamed(
    bags: Sequence[Path],
    out: Path,
    model: RobotModel | None,
    joints: tuple[str, ...] | None,
    topic: str | None,
    progress: Callable[[int, int], None] | None,
    told: tuple[str, ...] = (),
) -> ConvertedBags:
    """Write joint states of these names as they come."""
    blocks = joint_state_blocks(bags, joints, topic, "" if model is None else model.name, progress)
    first, second = next(blocks), next(blocks, None)
    named = first.joints if model is None else model.joint_names
    judged, last = _Judged(bags[0], model, is_whole=second is None), first

    def pieces() -> Iterator[Columns]:
        nonlocal last
        for last in chain([first], [] if second is None else [second], blocks):
            yield last.columns

    source = {"topic": first.topic, "start_ns": first.start_ns}
    whole = _write(pieces(), out, judged, named, logs=[path.name for path in bags], **source)
    beside = (f"left out: {', '.join(last.beside)}",) if last.beside else ()
    whole = replace(whole, notes=(*told, *beside, *whole.notes))
    counts = (last.duplicates, last.reordered, last.malformed, last.elsewhere)
    return ConvertedBags(whole, first.topic, *counts)


def _mapped(
    blocks: Iterator[LogTable], model: RobotModel | None, mapping: LogMapping | None, log: Path
) -> tuple[LogMapping, Iterator[Columns], RobotModel | None]:
    """Return the mapping of a long log, its rows in SI units, block by block, and its robot."""
    first = next(blocks, None)
    if first is None:
        raise RecordingError("holds no rows", path=log)
    told: tuple[str, ...] = ()
    if mapping is None:
        proposal = proposed(first, model)
        mapping, told, model = proposal.mapping, (said(proposal),), proposal.model
    elif model is not None:
        model = mapped_part(mapping, model)
    used, part, origin = mapping, model, mapping.time.origin(first)

    def pieces() -> Iterator[Columns]:
        before: LogTable | None = None
        for table in chain([first], blocks):
            check_units(table, before, used)
            columns = used.columns(table, part, origin)
            yield replace(columns, warnings=(*told, *columns.warnings))
            before = table

    return used, pieces(), part


class _Judged:
    """The findings about all rows, as they come."""

    def __init__(self, log: Path, model: RobotModel | None, *, is_whole: bool) -> None:
        self._log, self._model, self._is_whole = log, model, is_whole
        self._head: Columns | None = None  # the first block
        self._clock = OneClock()
        self._rows = self._usable = self._blocks = 0
        self._first = self._last = 0.0
        self._left_out: dict[str, list[int]] = defaultdict(list)
        self._warnings = dict[str, None]()

    def taken(self, columns: Columns) -> Columns:
        """Judge what comes next, and return it with a time that goes on.

        Raises:
            RecordingError: It cannot be used, or is of an earlier time.
        """
        columns = self._clock.taken(columns)
        try:
            judged = without_silent_torques(columns)
            findings = inspect(judged)
        except RecordingError as error:
            raise self._placed(error, columns.time.size) from None
        self._head = self._head or columns
        time = columns.time[findings.rows]
        if self._blocks and time[0] <= self._last:
            raise RecordingError(
                f"the time runs backwards about row {self._rows}, from {self._last:.6g} s to "
                f"{time[0]:.6g} s; are these two recordings in one file?",
                path=self._log,
                rows=[self._rows],
            )
        for item in findings.left_out:
            self._left_out[item.reason] += [self._rows + row for row in item.rows]
        own = findings.warnings if self._is_whole else ()  # of one block they say little
        self._warnings |= dict.fromkeys((*judged.warnings, *own))
        self._first = self._first if self._blocks else float(columns.time[0])
        self._last, self._blocks = float(time[-1]), self._blocks + 1
        self._rows, self._usable = self._rows + columns.time.size, self._usable + time.size
        return columns

    def converted(self, joints: tuple[str, ...]) -> Converted:
        """Return what is to be told."""
        left = [str(LeftOut(reason, tuple(rows))) for reason, rows in self._left_out.items()]
        notes = (*self._warnings, *left)
        if not self._is_whole:
            notes = (
                *notes,
                f"written in {self._blocks} blocks, each judged by itself",
            )
        if self._head is not None and self._model is not None:
            notes = (*notes, *_doubts(self._head, self._model))
        return Converted(joints, self._rows, self._usable, self._last - self._first, notes)

    def _placed(self, error: RecordingError, rows: int) -> RecordingError:
        if self._is_whole:
            return RecordingError(str(error), path=self._log, rows=error.rows)
        last = self._rows + rows - 1
        return RecordingError(
            f"rows {self._rows} to {last}, counted from the first of them: {error}",
            path=self._log,
            rows=[self._rows + row for row in error.rows],
        )


def _doubts(columns: Columns, model: RobotModel) -> tuple[str, ...]:
    """Return what makes one doubt rows that are written all the same: they may be mended later."""
    from estimators.diagnosis.from_motion.checks.commands import check_commands
    from estimators.diagnosis.from_torque.residuals.plausibility import doubts_about

    try:
        recording = Recording.from_columns(columns)
        if not recording.has_torque:
            return check_commands([recording], model.sliding)
        return doubts_about(model, [recording], bandwidth_for([recording]))
    except LimoError as error:
        return (f"identification and diagnosis will refuse it: {error}",)


# pyarrow ships no type stubs, so its tables are unknown to the checker.


def long_log(path: Path) -> Iterator[LogTable] | None:
    """Return the rows of a long log, block by block; None if it can as well be read at once.

    Args:
        path: Delimited text, Parquet or .npz; of anything else nothing is known here.

    Raises:
        RecordingError: It cannot be read, at once or while the rows come.
    """
    ending = ending_of(path)
    if ending in TEXTS and path.is_file() and (is_packed(path) or path.stat().st_size > LONG_TEXT):
        return _numbers(DelimitedText(path, WRITTEN).blocks(), path, "delimited text")
    if ending in PARQUET and _rows_of_parquet(path) > MOST:
        return _numbers(_parquet_tables(path), path, "Parquet")
    if ending in ARRAYS and rows_of_npz(path) > MOST:
        return npz_blocks(path)
    return None


def check_units(table: LogTable, before: LogTable | None, mapping: LogMapping) -> None:
    """Check that time and positions go on in the units in which they began.

    Args:
        table: A block.
        before: The one before it, if there is one.
        mapping: How they are read.

    Raises:
        RecordingError: They do not.
    """
    for name in mapping.time.columns:
        refuse_two_units(table, name)
    names = mapping.position.columns
    own = np.stack([table.column(name) for name in names], axis=1).astype(np.float64)
    if before is not None:
        last = [float(before.column(name)[-1]) for name in names]
        own = np.vstack([last, own])
    if (row := other_unit_from(own)) is not None:
        raise RecordingError(
            f"the positions {shortened(list(names))} jump by a factor of 57.3 at row "
            f"{table.first_row + row - (before is not None)}: degrees and radians in one column; "
            "expected one unit",
            path=table.source or None,
        )


def _numbers(tables: Iterable[pa.Table], path: Path, kind: str) -> Iterator[LogTable]:
    start = 0
    for table in tables:
        found = numbers_of(table, str(path), kind)
        yield replace(found, first_row=start)
        start += found.rows


def _rows_of_parquet(path: Path) -> int:
    import pyarrow.parquet as pq

    with reading_parquet(path):
        return pq.read_metadata(path).num_rows


def _parquet_tables(path: Path) -> Iterator[pa.Table]:
    with reading_parquet(path):
        rows = parquet_rows(path)
        yield from blocks_of(rows.batches, rows.schema)
