"""Logs that are named arrays, or trees of them: .npz, JSON, .mat and HDF5, as tables."""

from __future__ import annotations

import json
import math
import sys
import zipfile
import zlib
from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, Final, cast

import numpy as np
import pyarrow as pa
from numpy.lib import format as npy
from numpy.typing import NDArray

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.arrow import numbers_of
from limo_driver.logs.readers.table import LogTable, said_of_shape, table_of
from limo_driver.recordings.files.batches import BLOCK, STRETCH, Stretches, most_rows
from limo_driver.runtime.given_files import Spent, apart, json_of, read_text

_KIND: Final = "NumPy arrays"
_MATRIX: Final = 2  # axes
_MOST_JOINTS: Final = 64  # and numbers of one sample
_LISTED: Final = 100  # structures in a list
_WIDEST: Final = 1 << 15  # bytes of a row: 4096 numbers, as images have and no joints
_DAMAGE: Final = (
    OSError,
    ValueError,
    zipfile.BadZipFile,
    EOFError,
    TokenError,  # of a header that goes on
    SyntaxError,
    RecursionError,
    RuntimeError,  # packed with a password
    NotImplementedError,  # packed as few programs do
    TypeError,  # a type of numbers that is none
    zlib.error,
)
_DEEPEST: Final = 8  # objects one in the other
# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false
_JSON: Final = "JSON"
_LARGEST: Final = 1 << 28  # bytes; what Python makes of one has ten times its size
_DEEPEST_RECORDS: Final = 4  # objects one in the other, in which records are looked for
_MATLAB: Final = "MATLAB variables"


def read_npz(path: Path) -> LogTable:
    """Read the arrays of a file, or stretches of those that are long.

    Raises:
        RecordingError: It is none, or damaged.
    """
    with _opened(path) as members:
        rows = _usual_rows(members)
        most = most_rows(sum(member.width for member in members if member.rows == rows))
        if rows <= most:
            arrays = {member.name: member.read(rows) for member in members if member.rows == rows}
            labels = {member.name: member.labels() for member in members if member.is_labels}
            aside = {
                member.name: member.said(rows) if member.shape else ""
                for member in members
                if member.rows != rows and not member.is_labels
            }
            table = table_of({**arrays, **labels} if rows else {}, str(path), _KIND)
            single = [x.single() for x in members if x.is_single and x.rows != rows]
            unread = {**table.unread, **{k: v for k, v in aside.items() if v}}
            return replace(table, unread=unread, words=tuple(single))
    stretches = Stretches[LogTable](LogTable.cut, most, min(STRETCH, most))
    first: LogTable | None = None
    for block in npz_blocks(path):
        first = first or block
        stretches.add(block, block.rows)
    assert first is not None  # noqa: S101  # it has more rows than none
    pieces = stretches.pieces()
    columns = {
        name: np.concatenate([piece.columns[name] for piece in pieces]) for name in first.columns
    }
    return replace(first, columns=columns, spread=stretches.spread, notes=(stretches.note(),))


def rows_of_npz(path: Path) -> int:
    """Return how many rows most of the arrays have.

    Raises:
        RecordingError: It is none, or damaged.
    """
    with _opened(path) as members:
        return _usual_rows(members)


def npz_blocks(path: Path) -> Iterator[LogTable]:
    """Yield the arrays of a file, block by block of their rows.

    Raises:
        RecordingError: It is damaged.
    """
    with _opened(path) as members:
        rows = _usual_rows(members)
        alike = [member for member in members if member.rows == rows]
        labels = {member.name: member.labels() for member in members if member.is_labels}
        for start in range(0, rows, BLOCK):
            many = min(BLOCK, rows - start)
            arrays = {member.name: member.read(many) for member in alike}
            yield replace(table_of({**arrays, **labels}, str(path), _KIND), first_row=start)


@contextmanager
def _opened(path: Path) -> Generator[list[_Member]]:
    """Open the arrays of a file; of each, its header is read.

    Raises:
        RecordingError: It is none, damaged, or unpacks to far more than a log does.
    """
    try:
        with zipfile.ZipFile(path) as archive, ExitStack() as opened:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            Spent(path, RecordingError).take(unpacked=unpacked)
            yield [_Member(archive, name, opened) for name in archive.namelist()]
    except RecordingError:  # which is a ValueError, too
        raise
    except _DAMAGE as error:
        raise RecordingError(f"cannot be read as .npz: {error}", path=path) from None


class _Member:
    """One array of an archive, read from its first row on."""

    def __init__(self, archive: zipfile.ZipFile, name: str, opened: ExitStack) -> None:
        self.name = name.removesuffix(".npy")
        self._file: IO[bytes] = opened.enter_context(archive.open(name))
        version = npy.read_magic(self._file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        self.shape, by_columns, self._kind = read(self._file)
        usable = len(self.shape) in {1, _MATRIX} and not self._kind.hasobject
        few = len(self.shape) == 1 and self._size(self.shape[0]) <= _WIDEST
        self.is_labels = few and self._kind.kind in "US"  # which may name columns, and are none
        usable = usable and self._kind.kind not in "US"
        self.width = self._size(1)  # of a row [bytes]
        self.rows = self.shape[0] if usable and 0 < self.width <= _WIDEST else 0
        self._whole = None
        self._by_columns = by_columns and len(self.shape) == _MATRIX
        self._next = 0

    @property
    def is_single(self) -> bool:
        """Whether it is one number."""
        return math.prod(self.shape) == 1 and self._kind.kind in "iuf" and self.rows < _MATRIX

    def single(self) -> str:
        """Return the one number with its name."""
        data = self._file.read(self._kind.itemsize)
        return f"{self.name} = {np.frombuffer(data, self._kind)[0]:.10g}"

    def said(self, rows: int) -> str:
        """Say what it is instead of rows of numbers, as many as most have."""
        if self._kind.hasobject:
            return "objects of Python"
        if self._kind.kind in "US":
            return "texts"
        return said_of_shape(self.shape, rows)

    def labels(self) -> NDArray[Any]:
        texts = self._from_bytes(self.shape[0])
        code_points = np.dtype(np.uint32).newbyteorder(self._kind.byteorder)
        if self._kind.kind == "U" and (texts.view(code_points) > sys.maxunicode).any():
            raise ValueError(f"{self.name} holds texts of characters that there are not")
        return texts

    def read(self, rows: int) -> NDArray[Any]:
        if self._by_columns:  # no row of it is there before all of it is
            if self._whole is None:
                data = self._file.read()
                self._whole = np.frombuffer(data, self._kind).reshape(self.shape, order="F")
            self._next += rows
            return self._whole[self._next - rows : self._next]
        return self._from_bytes(rows)

    def _from_bytes(self, rows: int) -> NDArray[Any]:
        size = self._size(rows)
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError(f"{self.name} ends before its last row")
        return np.frombuffer(data, self._kind).reshape(rows, *self.shape[1:])

    def _size(self, rows: int) -> int:
        return rows * math.prod(self.shape[1:]) * self._kind.itemsize


def _usual_rows(members: list[_Member]) -> int:
    lengths = [member.rows for member in members if member.rows]
    return max(lengths, key=lengths.count, default=0)


def table_of_tree(tree: Mapping[str, Any], source: str, kind: str) -> LogTable:
    """Make a table of arrays by name: `state.q` is the array `q` of the object `state`.

    A sample is a row: an array that has the samples as its columns is turned. Objects that hold all
    of the log, as a run of several does, are in no name.

    Args:
        tree: Numbers, lists and arrays of them, texts, or objects that hold such, by name.
        source: Where they are from, for messages.
        kind: What that is, in words.
    """
    every = dict(_leaves("", tree))
    arrays = {name: values for name, values in every.items() if values.ndim}
    single = {name: x for name, x in every.items() if x.ndim == 0 and x.dtype.kind in "iuf"}
    words = tuple(f"{name.split('.')[-1]} = {value:.10g}" for name, value in single.items())
    rows = _samples(arrays)
    holders = [name.split(".")[:-1] for name, x in arrays.items() if rows in x.shape]
    shared = takewhile(lambda at: len(set(at)) == 1, zip(*holders, strict=False))
    around = "".join(f"{names[0]}." for names in shared)
    turned = {name.removeprefix(around): x.T if _lies(x, rows) else x for name, x in arrays.items()}
    return replace(table_of(turned, source, kind, rows), words=words)


def _lies(values: NDArray[Any], rows: int) -> bool:
    """Say whether samples are columns."""
    return values.ndim == _MATRIX and values.shape[1] == rows != values.shape[0]


def _leaves(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        inside = cast("Mapping[str, object]", value) if depth < _DEEPEST else {}
        for key, each in inside.items():
            yield from _leaves(f"{name}.{key}" if name else key, each, depth + 1)
        return
    if structures := _structures(value):  # as Simulink logs signals
        yield from _leaves(name, structures, depth)
        return
    try:
        values = np.asarray(value)
    except ValueError:  # lists of different lengths
        values = np.asarray(value, dtype=object)
    if values.ndim > 1 and 1 in values.shape:  # MATLAB has no vectors
        values = values.squeeze()
    yield name, values


def _structures(value: object) -> dict[str, object]:
    """Return the structures of a short list by their label or number; nothing of other lists."""
    if isinstance(value, np.ndarray):
        value = value.ravel().tolist() if value.dtype == object else []
    every = cast("list[object]", value) if isinstance(value, list) else []
    if not 0 < len(every) <= _LISTED:
        return {}
    known = [cast("Mapping[str, object]", each) for each in every if isinstance(each, Mapping)]
    labels = [str(each.get("label", "")) or str(k) for k, each in enumerate(known)]
    is_named = len(known) == len(every) == len(set(labels))
    return dict(zip(labels, known, strict=True)) if is_named else {}


def _samples(arrays: Mapping[str, NDArray[Any]]) -> int:
    """Return how many samples a log has: the length that most arrays have along an axis.

    Matrices of an arm, six by six, may be more; a log is longer than that.
    """
    lengths = [
        length
        for values in arrays.values()
        if values.dtype.kind in "fiu" and values.ndim <= _MATRIX
        for length in {max(values.shape)}
    ]
    long = [length for length in lengths if length > _MOST_JOINTS] or lengths
    return max(long, key=lambda length: (long.count(length), length), default=0)


def read_json(path: Path) -> LogTable:
    """Read the longest list of records that a file holds, else its arrays.

    A record is an object that has a number or a list of numbers by name.

    Raises:
        RecordingError: It is no JSON, holds neither, or is larger than is read at once.
    """
    whole = json_of(read_text(path, RecordingError, _LARGEST), path, RecordingError, _parsed)
    found = max(_records_in("", whole), key=lambda each: len(each[1]), default=("", []))
    if len(found[1]) > 1:
        around = cast("dict[str, Any]", whole) if isinstance(whole, dict) else {}
        words = (f"{k} = {x}" for k, x in around.items() if isinstance(x, (int, float, str)))
        return replace(_of_records(*found, path), words=tuple(words))
    if not isinstance(whole, dict):
        raise RecordingError(
            "holds no records, expected a list of objects, an object a line, or arrays by name",
            path=path,
        )
    return table_of_tree(cast("Mapping[str, Any]", whole), str(path), _JSON)


def _parsed(text: str) -> object:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise
        return list(_lines(text))


def _lines(text: str) -> Iterator[object]:
    """Yield what each line holds that is not empty; an error tells the line of the file."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            try:
                yield json.loads(line)
            except json.JSONDecodeError as error:
                error.lineno = number
                raise


def _records_in(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, list[Any]]]:
    """Yield every list of objects, with the name of what holds it."""
    if isinstance(value, list):
        listed = cast("list[object]", value)
        if listed and all(isinstance(each, dict) for each in listed):
            yield name, listed
    elif isinstance(value, dict) and depth < _DEEPEST_RECORDS:
        for key, each in cast("dict[str, object]", value).items():
            yield from _records_in(key, each, depth + 1)


def _of_records(name: str, records: list[Any], path: Path) -> LogTable:
    try:
        batch = pa.RecordBatch.from_struct_array(pa.array(records))
    except (pa.ArrowException, OverflowError) as error:
        raise RecordingError(
            f"its {len(records)} records are not alike: {str(error).splitlines()[0]}", path=path
        ) from None
    kind = f"{_JSON}, the records of {name}" if name else f"{_JSON} records"
    return numbers_of(pa.Table.from_batches([batch]), str(path), kind)


def read_mat(path: Path) -> LogTable:
    """Read the arrays of a file, those of its structures included.

    Raises:
        RecordingError: It is none, damaged, or unpacks to more than a log does; or it is of version
            7.3, and h5py is not installed.
    """
    return table_of_tree(apart(variables_of, path, RecordingError), str(path), _MATLAB)


def read_hdf5(path: Path) -> LogTable:
    """Read the arrays of a file with one or two axes, those of its groups included.

    Raises:
        RecordingError: It is none, damaged, or unpacks to more than a log does; or h5py is not
            installed.
    """
    from limo_driver.logs.readers.formats.hdf5 import tree_of

    return table_of_tree(apart(tree_of, path, RecordingError), str(path), "HDF5")


def variables_of(path: Path) -> dict[str, Any]:
    """Return the variables of a file by name, in this process, whatever they unpack to.

    Raises:
        RecordingError: It is none, or damaged.
        MissingPackageError: It is of version 7.3, and h5py is not installed.
    """
    from scipy.io import loadmat  # slow to import
    from scipy.io.matlab import MatReadError

    try:
        found: dict[str, Any] = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        from limo_driver.logs.readers.formats.hdf5 import tree_of

        return tree_of(path)
    except (MatReadError, OSError, ValueError, TypeError, KeyError, EOFError) as error:
        raise RecordingError(f"cannot be read as .mat: {error}", path=path) from None
    return {name: values for name, values in found.items() if not name.startswith("__")}
