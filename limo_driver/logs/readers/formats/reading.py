"""Any file of a log as a table; its ending, or what a folder holds, says what it is."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.arrow import kept_numbers, read_delimited, read_parquet
from limo_driver.logs.readers.formats.lerobot import is_dataset, read_dataset
from limo_driver.logs.readers.table import LogTable
from limo_driver.runtime.given_files import check_file

_POINTER: Final = b"version https://git-lfs"
BAGS: Final = (".mcap", ".db3", ".zstd", ".bag")
_PLAIN: Final = (".csv", ".txt", ".tsv", ".log", ".dat")
_PACKED: Final = ".gz"
TEXTS: Final = (*_PLAIN, *(f"{ending}{_PACKED}" for ending in _PLAIN))
PARQUET: Final = (".parquet", ".pq")
ARRAYS: Final = (".npz",)
_HDF5: Final = (".h5", ".hdf5")
OBJECTS: Final = (".json", ".jsonl", ".ndjson", ".mat", *_HDF5)
_SHEETS: Final = (".xlsx", ".xls", ".xlsm", ".ods")
_EXPECTED: Final = (
    f"expected delimited text ({', '.join(_PLAIN)}, also as .gz), Parquet, NumPy's .npz, JSON "
    "(.json, .jsonl), MATLAB's .mat, HDF5 (.h5, .hdf5), a bag (.mcap, .db3, .bag) or the folder of "
    "a bag or of a LeRobotDataset; what Python reads of it, a DataFrame or arrays by name, "
    "limo.read takes"
)


def ending_of(path: Path) -> str:
    """Return the ending of a file by which its format is known, `.csv.gz` for one."""
    ending = path.suffix.lower()
    return "".join(path.suffixes[-2:]).lower() if ending == _PACKED else ending


def read_table(
    path: Path,
    topic: str | None = None,
    episode: int | None = None,
    joints: Sequence[str] = (),
) -> LogTable:
    """Read what a log holds, without judging it.

    Args:
        path: File or folder.
        topic: Of the joint states of a bag.
        episode: Of a LeRobotDataset.
        joints: Names of the robot's joints, by which one of several topics is found.

    Raises:
        RecordingError: No such file, or it cannot be read as what its ending says.
    """
    if not path.exists():
        raise RecordingError("no such file", path=path)
    check_file(path, RecordingError)
    _refuse_pointer(path)
    if path.is_dir():
        return _read_folder(path, topic, episode, joints)
    ending = ending_of(path)
    if ending in BAGS:
        from limo_driver.logs.readers.formats.bag import read_bags

        return read_bags([path], topic, joints)
    if ending in ARRAYS:
        from limo_driver.logs.readers.formats.arrays import read_npz

        return read_npz(path)
    if ending in OBJECTS:
        return _read_objects(path, ending)

    if ending in TEXTS:
        return read_delimited(path)
    if ending in PARQUET:
        return kept_numbers(read_parquet(path), str(path), "Parquet")
    if ending in _SHEETS:
        raise RecordingError(
            "is a workbook, which is not read: save its sheet as CSV, or give "
            "`limo.read(pandas.read_excel(...), robot)` what pandas reads of it",
            path=path,
        )
    raise RecordingError(f"is of a kind that is not known, {_EXPECTED}", path=path)


def is_log(folder: Path) -> bool:
    """Say whether a folder is one log: a bag as ROS 2 writes it, or a LeRobotDataset."""
    return is_dataset(folder) or (folder / "metadata.yaml").is_file()


def _refuse_pointer(path: Path) -> None:
    """Refuse what Git leaves in the place of a large file.

    Raises:
        RecordingError: It is such a pointer.
    """
    with suppress(OSError), path.open("rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise RecordingError(
                "is a pointer of Git LFS to a file that is not there: `git lfs pull` brings it",
                path=path,
            )


def _read_objects(path: Path, ending: str) -> LogTable:
    if ending == ".mat":
        from limo_driver.logs.readers.formats.arrays import read_mat

        return read_mat(path)
    if ending in _HDF5:
        from limo_driver.logs.readers.formats.arrays import read_hdf5

        return read_hdf5(path)
    from limo_driver.logs.readers.formats.arrays import read_json

    return read_json(path)


def _read_folder(
    path: Path, topic: str | None, episode: int | None, joints: Sequence[str]
) -> LogTable:

    if is_dataset(path):
        return read_dataset(path, episode)
    if any(file.suffix in BAGS for file in path.iterdir()):
        from limo_driver.logs.readers.formats.bag import read_bags

        return read_bags([path], topic, joints)
    raise RecordingError(
        "is a folder that holds neither a bag (.mcap, .db3, .bag) nor a LeRobotDataset "
        "(meta/info.json)",
        path=path,
    )
