"""Recorder: stream measurements to disk, so that a killed process keeps its data.

Samples go to `NAME.partial`, an Arrow stream that is complete up to its last batch at any moment;
`close` turns it into the Parquet file NAME, replacing an older one only then. A `NAME.partial` that
is there already is what a killed run left, so nothing is recorded over it. A thread writes, so that
a slow disk does not hold up the control loop; what a full one does not take waits for it.
"""

# pyright: reportUnknownParameterType=false
# pyarrow ships no stubs.

from __future__ import annotations

import io
import json
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from limo_driver.errors import RecordingError
from limo_driver.recordings.files.batches import blocks_of
from limo_driver.recordings.files.parquet import DAMAGE, LogStream, StoredLog, whole_table
from limo_driver.runtime import written_by
from limo_driver.runtime.outputs import reason, replacing, require_parquet
from limo_driver.runtime.processes import Closing
from limo_driver.types import FloatArray, JointState

METADATA_KEY = b"limo.recording"
FLUSH_PERIOD = 0.25  # [s]; a killed process loses about this much
AGAIN = 5.0  # [s] until what could not be written is tried again
MOST_WAITING = 200e6  # bytes of rows that wait for a full disk; a quarter of an hour at 1 kHz
_PARQUET_MAGIC = b"PAR1"
_ROWS_OF_GROUP = 65536
_QUANTITIES = ("position", "velocity", "torque", "target_position")


class Recorder(Closing):
    """Writes one row for each state: time, position_j, velocity_j, torque_j, target_position_j.

    Joints are 1-based; SI units, and °C in temperature_j, which is there where it is measured.
    Stale states are not recorded: they hold nothing new.

    Args:
        path: Parquet file to write; it appears when the recording is closed.
        n: Number of joints.
        header: What a reader should know, as JSON: robot, segments, provenance.
        temperature: Whether states have temperatures to record.

    Raises:
        ConfigError: The ending of its name is that of another format.
        RecordingError: The file cannot be written, or an unfinished log of that name exists.
    """

    def __init__(
        self, path: Path | str, n: int, header: Mapping[str, Any], *, temperature: bool = False
    ) -> None:
        self.path = Path(path)
        require_parquet(self.path)
        if self.path.is_dir():
            raise RecordingError("cannot be written: it is a folder", path=self.path)
        self.partial = partial_path(self.path)
        self.samples = 0
        self._quantities = (*_QUANTITIES, "temperature") if temperature else _QUANTITIES
        self._schema = _schema(self._quantities, n, header)
        self._n = n
        self._rows: list[FloatArray] = []
        self._lock = threading.Lock()
        self._failure: Exception | None = None  # why nothing is recorded any more
        self._waiting, self._written = io.BytesIO(), 0  # bytes for the file, and those in it
        try:
            self._file = self.partial.open("xb", buffering=0)
        except FileExistsError:
            raise RecordingError(
                f"{self.partial.name} beside it is the log of a run that is under way or was cut "
                f"off; rename it to keep it (limo reads NAME.partial), or delete it",
                path=self.path,
            ) from None
        except OSError as error:
            raise RecordingError(f"cannot be written: {error.strerror}", path=self.path) from None
        try:
            self._stream = LogStream(self._waiting, self._schema)
            self._sync(durably=False)  # an arm that is commanded by now waits for no disk
        except OSError as error:  # nothing is in it that another run should not write over
            self._abandon()
            self.partial.unlink(missing_ok=True)
            raise RecordingError(f"cannot be written: {reason(error)}", path=self.path) from None
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._write_on, name="limo-recorder", daemon=True)
        self._thread.start()

    def append(self, state: JointState, target: FloatArray | None = None) -> None:
        """Record a state and the position commanded in answer to it, if any.

        Nothing that goes wrong here may stop who controls an arm: what cannot be written any more
        is dropped, and `close` says so.
        """
        if self._failure is not None or state.stale:
            return
        row = np.full(1 + len(self._quantities) * self._n, np.nan)
        row[0] = state.time
        known = (state.position, state.velocity, state.torque, target, state.temperature)
        for k, values in enumerate(known[: len(self._quantities)]):
            if values is not None:
                row[1 + k * self._n : 1 + (k + 1) * self._n] = values
        with self._lock:
            self._rows.append(row)
        self.samples += 1

    def append_all(
        self,
        time: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        torque: FloatArray,
        target: FloatArray,
    ) -> None:
        """Record T states in a row without temperatures, as `append` does.

        Args:
            time: (T,) [s].
            position: (T, n) [rad].
            velocity: (T, n) [rad/s].
            torque: (T, n) [N m].
            target: Positions commanded in answer, (T, n) [rad].
        """
        if self._failure is not None:
            return
        rows = np.full((time.size, 1 + len(self._quantities) * self._n), np.nan)
        known = np.column_stack([time, position, velocity, torque, target])
        rows[:, : known.shape[1]] = known
        with self._lock:
            self._rows.extend(rows)
        self.samples += time.size

    def close(self) -> None:
        """Write the Parquet file and remove the partial one; a second call does nothing.

        Raises:
            RecordingError: It cannot be written; the partial file stays.
        """
        if self._done.is_set():
            return
        self._done.set()
        self._thread.join()
        try:
            if self._failure is not None:
                raise self._failure
            self._flush()
            self._stream.close()
            self._sync()
            self._file.close()
            # Turn the stream into Parquet, batch by batch, so that it is whole or absent
            log = StoredLog(self.partial)
            with replacing(self.path) as draft:
                with pq.ParquetWriter(draft, log.schema, use_dictionary=False) as writer:
                    for table in blocks_of(log.batches(), log.schema, _ROWS_OF_GROUP):
                        writer.write_table(table)
                if losses := log.describe_losses():
                    raise pa.ArrowInvalid(f"its log {losses}")
            self.partial.unlink()
        except (OSError, MemoryError, pa.ArrowException) as error:
            self._abandon()
            raise self._lost(error) from None

    def _abandon(self) -> None:
        """Close the log as it is, after it could not be written."""
        with suppress(OSError):
            self._file.close()

    def _write_on(self) -> None:
        pause = FLUSH_PERIOD
        while not self._done.wait(pause):
            try:
                self._flush()
                pause = FLUSH_PERIOD
            except (OSError, MemoryError, pa.ArrowException) as error:
                pause = AGAIN
                if isinstance(error, OSError) and self._waiting.tell() < MOST_WAITING:
                    continue  # the disk may have room again
                self._failure = error
                self._rows.clear()
                return

    def _flush(self) -> None:
        with self._lock:
            rows, self._rows = self._rows, []
        if rows:
            self._stream.write(np.ascontiguousarray(np.array(rows).T))
        if self._waiting.tell():
            self._sync()

    def _sync(self, *, durably: bool = True) -> None:
        """Bring what waits to the disk, or only on its way there, all of it or nothing."""
        left = self._waiting.getvalue()
        try:
            while left:
                left = left[self._file.write(left) :]
            if durably:
                os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self._written)
            self._file.seek(self._written)
            raise
        self._written = self._file.tell()
        self._waiting.seek(0)
        self._waiting.truncate()

    def _lost(self, error: Exception) -> RecordingError:
        why = reason(error) if isinstance(error, OSError) else str(error)
        return RecordingError(
            f"cannot be written: {why}; what was written is in {self.partial}",
            path=self.path,
        )


def partial_path(path: Path) -> Path:
    """Return where a recording is kept while it is being made."""
    return path.with_name(path.name + ".partial")


def read_log(path: Path | str, tell: Callable[[str], None] | None = None) -> pa.Table:
    """Read a recording of limo's own, finished (Parquet) or cut off (`.partial`).

    A cut-off log ends with its last complete batch, and batches that are damaged are left out. Its
    schema metadata hold the header, as JSON under `limo.recording`.

    Args:
        path: The file.
        tell: Told, once, if it has no end or is damaged.

    Raises:
        RecordingError: Neither, or it ends before its header.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            finished = file.read(len(_PARQUET_MAGIC)) == _PARQUET_MAGIC
        if finished:
            return whole_table(path, RecordingError)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", path=path) from None
    except DAMAGE as error:
        raise RecordingError(f"is no log of limo's: {error}", path=path) from None
    log = StoredLog(path)
    table = pa.Table.from_batches(log.batches(), log.schema)
    if tell is not None and (losses := log.describe_losses()):
        tell(losses)
    return table


def read_header(table: pa.Table) -> dict[str, Any]:
    """Return the metadata of a recording; empty for tables from elsewhere.

    Raises:
        RecordingError: There is a header, but it is no JSON object.
    """
    return header_of(table.schema)


def header_of(schema: pa.Schema) -> dict[str, Any]:
    """Return the metadata of a recording by its schema, as `read_header` does of its table."""
    text = (schema.metadata or {}).get(METADATA_KEY, b"{}")
    try:
        header: object = json.loads(text)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict):
        raise RecordingError(f"its header {METADATA_KEY.decode()} is no JSON object; not read")
    return cast("dict[str, Any]", header)


def _schema(quantities: tuple[str, ...], n: int, header: Mapping[str, Any]) -> pa.Schema:
    names = ["time", *(f"{q}_{j + 1}" for q in quantities for j in range(n))]
    return pa.schema(
        [(name, pa.float64()) for name in names],
        metadata={
            METADATA_KEY: json.dumps({written_by.KEY: written_by.installed(), **header}).encode()
        },
    )
