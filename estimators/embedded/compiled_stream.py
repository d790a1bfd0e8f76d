"""A stream whose estimates are exported C, compiled and loaded into this process.

The library is kept where compiled Python is, under a digest of its source, the compiler and the
processor, and is used once it has given the torque that Python gives. Without a compiler, and of
models that have no form in C, a stream stays what it is.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import pickle
import shlex
import subprocess
import tempfile
import weakref
from collections.abc import Sequence
from ctypes import c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any, Final

import llvmlite.binding
import numpy as np

from estimators.embedded.export import source_of
from estimators.stream import DelayedRows, Stream
from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.recordings.filters.causal_differentiation import LARGEST
from limo_driver.runtime.machine_code import CodePlace
from limo_driver.types import FloatArray

_FLAGS: Final = ("-std=c11", "-O3", "-march=native", "-fPIC", "-shared", "-x", "c", "-", "-lm")
_LONGEST: Final = 120.0  # [s] of compiling
_KEY: Final = "library"
_CLIPPED, _NOT_FINITE = 2, 4  # of what `limo_answer` returns
_FIELDS: Final = 5  # of each joint, that `limo_advance` writes
_SWING: Final = 0.1  # [rad] of the motion on which code and Python are compared
_SECONDS: Final = 0.5  # of it, once the filters are full
_SAME: Final = 1e-6  # of the largest torque; some sums are of single precision
_log = logging.getLogger("limo")


class CompiledStream(Stream):
    """What a stream is, as compiled C; its memory is bytes, which are advanced in place.

    One thread uses it at a time.

    Args:
        stream: In Python.

    Raises:
        ConfigError: Its model has no form in C, the compiler is not there or fails, or the code
            does not give the torque that Python gives.
    """

    def __init__(self, stream: Stream) -> None:
        free, held = _library(source_of(stream))
        for library in (free, held):  # else each model that ever served would stay in memory
            weakref.finalize(self, _close, library._handle).atexit = False
        self._size, self._begin = held.limo_size(), held.limo_init
        self._rows, self._one = free.limo_advance, held.limo_answer
        self._rows.argtypes = [c_void_p, c_size_t, c_int, *[c_void_p] * 3]
        self._rows.restype = c_size_t
        self._one.argtypes = [c_void_p, c_double, *[c_void_p] * 7]
        self._given: dict[int, tuple[FloatArray, c_void_p]] = {}  # the latest arrays, and where
        super().__init__(stream.model, stream.rate, stream.delay)
        # Compare the code with Python on a motion of all joints
        t = np.arange(2 * stream.samples + int(_SECONDS * stream.rate)) / stream.rate
        phase = np.arange(stream.n)
        position = _SWING * np.sin(2.0 * np.pi * (0.5 + 0.1 * phase) * t[:, None] + phase)
        expected, _ = stream.advance(stream.init(), t, position, position)
        found, _ = self.advance(self.init(), t, position, position)
        off = np.abs(found.torque - expected.torque).max() / np.abs(expected.torque).max()
        if not off <= _SAME:
            raise ConfigError(f"compiled C gives torque that differs by {off:.2g} from Python's")

    def init(self) -> Any:  # noqa: ANN401  # what a library remembers
        """Return the memory before the first position."""
        state = ctypes.create_string_buffer(self._size)
        self._begin(state)
        return state

    def copied(self, state: Any) -> Any:  # noqa: ANN401
        """Return memory that stays as it is while another one is advanced."""
        return type(state).from_buffer_copy(state)

    def answer(
        self,
        state: Any,  # noqa: ANN401
        time: float,
        position: FloatArray,
        torque: FloatArray | None,
        places: Sequence[c_void_p],
    ) -> tuple[bool, bool]:
        """Take the next position, and write the estimate where it is to stand.

        It holds the interpreter: whoever waits for that would keep it for longer than this takes.

        Args:
            state: Memory after the position before; advanced in place.
            time: Of the position [s].
            position: (n,) [rad], contiguous.
            torque: Measured with it, (n,) [N m], if it was; likewise.
            places: Addresses of (n,) each: the most that the learned part may add, and to be
                written: torque, its standard deviation, external torque (doubles), outside (bytes).

        Returns:
            Whether every torque is finite, and whether any learned part was beyond its bound.

        Raises:
            RecordingError: The position cannot follow the one before; nothing has changed.
        """
        given = self._place(0, position), None if torque is None else self._place(1, torque)
        if not (found := self._one(state, time, *given, *places)):
            raise _refused(time)
        return not found & _NOT_FINITE, bool(found & _CLIPPED)

    def _place(self, which: int, values: FloatArray) -> c_void_p:
        """Return where values are: mostly where those before were, which spares a search."""
        known, place = self._given.get(which, (None, None))
        if known is not values or place is None:
            place = c_void_p(values.ctypes.data)
            self._given[which] = values, place
        return place

    def _advance_stretch(
        self,
        state: Any,  # noqa: ANN401
        time: FloatArray,
        moved: FloatArray,  # noqa: ARG002
        signals: FloatArray,
    ) -> tuple[DelayedRows, Any]:
        """Advance over T positions, see `Stream`; the interpreter is free meanwhile."""
        time, given = np.ascontiguousarray(time), np.ascontiguousarray(signals)
        measured, rows = given.shape[1] > self.n, np.empty((time.size, 1 + _FIELDS * self.n))
        places = (values.ctypes.data for values in (time, given, rows))
        taken = self._rows(state, time.size, measured, *places)
        if taken < time.size:
            raise _refused(time.item(taken))
        simulation, learned, std, filtered, outside = np.split(rows[:, 1:], _FIELDS, axis=1)
        torques = filtered if measured else None
        return DelayedRows(simulation, learned, std, outside != 0.0, rows[:, 0], torques), state


def fastest(stream: Stream) -> Stream:
    """Return a stream as compiled C where that is possible, else as it is."""
    try:
        return CompiledStream(stream)
    except LimoError as error:
        _log.info("limo: a model runs in Python: %s", error)
        return stream


def _refused(time: float) -> RecordingError:
    return RecordingError(
        f"the sample at {time:.6g} s cannot follow the one before: its time has to increase, time "
        f"and values have to be finite, no value beyond {LARGEST:g}, with torque all or none"
    )


def _library(source: str) -> tuple[ctypes.CDLL, ctypes.PyDLL]:
    """Return a library that frees the interpreter while it runs, and the same that holds it.

    Raises:
        ConfigError: The compiler is not there, or fails.
    """
    compiler = shlex.split(os.environ.get("CC") or "cc")
    processor = llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features()
    made_from = (source, _run([*compiler, "--version"], ""), _FLAGS, *map(str, processor))
    digest = hashlib.blake2b(repr(made_from).encode(), digest_size=16).hexdigest()
    place = CodePlace(__file__, __name__, digest)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "limo.so"
        claim = place.claim(_KEY, lambda: None)
        try:
            if kept := place.read(_KEY):
                path.write_bytes(kept[0])
            else:
                _run([*compiler, *_FLAGS, "-o", str(path)], source)
                place.write(_KEY, lambda: pickle.dumps([path.read_bytes()]))
        finally:
            if claim is not None:
                claim.release()
        try:
            return ctypes.CDLL(str(path)), ctypes.PyDLL(str(path))
        except OSError as error:  # a folder from which nothing may be run
            raise ConfigError(f"{path}: {error}") from None


_close: Final = ctypes.CDLL(None).dlclose
_close.argtypes = [c_void_p]


def _run(command: list[str], given: str) -> str:
    try:
        done = subprocess.run(  # noqa: S603  # the user's own compiler
            command, input=given, capture_output=True, text=True, timeout=_LONGEST, check=True
        )
    except subprocess.CalledProcessError as error:
        raise ConfigError(f"{command[0]}: {error.stderr.strip()}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ConfigError(f"no C compiler {command[0]!r}: {error}") from None
    return done.stdout
