"""LeRobotDataset folders, v2.1 and v3.0: the episodes' joint states as one table."""

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.arrow import numbers_of, read_parquet
from limo_driver.logs.readers.table import LogTable
from limo_driver.runtime.given_files import check_file, read_json_file

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

KIND = "LeRobotDataset"
_INFO = "meta/info.json"
_BETWEEN = 1.0  # [s] from the end of one episode to the start of the next: a gap, as it was
_KNOWN = ("v2.0", "v2.1", "v3.0")


def is_dataset(folder: Path) -> bool:
    """Say whether a folder is a LeRobotDataset."""
    return (folder / _INFO).is_file()


def read_dataset(folder: Path, episode: int | None = None) -> LogTable:
    """Read a LeRobotDataset without its images.

    Args:
        folder: With `meta/` and `data/` in it.
        episode: Which one; all of them, one after the other with a gap between, if not given.

    Raises:
        RecordingError: It is damaged, of a version that is not known, or has no such episode.
    """
    info = _read_info(folder)
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise RecordingError("holds no data/**/*.parquet", path=folder)
    for file in files:
        check_file(file, RecordingError)
    parts = [_without_images(read_parquet(file).table) for file in files]
    try:
        table = pa.concat_tables(parts, promote_options="permissive")
    except pa.ArrowException as error:
        raise RecordingError(f"its files do not fit together: {error}", path=folder) from None
    if table.num_rows == 0:
        raise RecordingError("holds no rows", path=folder)
    read = numbers_of(table, str(folder), _kind(info), _names(info))
    for name in ("episode_index", "timestamp"):
        if not np.isfinite(read.column(name).astype(np.float64)).all():
            raise RecordingError(f"column {name} has empty cells, expected numbers", path=folder)
    columns, notes = _in_order(dict(read.columns), episode, folder)
    notes = (*notes, *_lacking(read.columns["episode_index"], info))
    robot = info.get("robot_type")
    return LogTable(columns, read.source, read.kind, read.unread, notes, str(robot or ""))


def _in_order(
    columns: dict[str, Any], episode: int | None, folder: Path
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the rows by episode with a time that goes on, and what has to be said."""
    index = columns["episode_index"].astype(np.int64)
    known = np.unique(index)
    if episode is not None and episode not in known:
        raise RecordingError(
            f"has no episode {episode}; it has {known.size}, from {known[0]} to {known[-1]}",
            path=folder,
        )
    rows = np.flatnonzero(index == episode) if episode is not None else np.arange(index.size)
    order = rows[np.argsort(index[rows], kind="stable")]
    columns = {name: values[order] for name, values in columns.items()}
    time, index = columns["timestamp"].astype(np.float64), index[order]
    starts = np.append(0, np.flatnonzero(np.diff(index)) + 1)
    since = np.zeros(time.size)
    for k, start in enumerate(starts[1:], start=1):
        before = starts[k - 1]
        since[start:] += time[start - 1] - time[before] + _BETWEEN + time[before] - time[start]
    columns["timestamp"] = time + since
    told = f"{starts.size} episodes, one after the other with a gap of {_BETWEEN:g} s between"
    return columns, (told,) if starts.size > 1 else ()


def _lacking(episodes: NDArray[Any], info: dict[str, Any]) -> tuple[str, ...]:
    """Say that files of episodes are missing, as after an unfinished download."""
    there, stated = np.unique(episodes).size, info.get("total_episodes")
    if not isinstance(stated, int) or there >= stated:
        return ()
    return (f"{_INFO} says that there are {stated} episodes; the files here hold {there}",)


def _read_info(folder: Path) -> dict[str, Any]:
    path = folder / _INFO
    info = read_json_file(path, RecordingError)
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if version not in _KNOWN:
        raise RecordingError(
            f"is of version {version!r} of LeRobotDataset, expected one of {', '.join(_KNOWN)}",
            path=path,
        )
    return info


def _kind(info: dict[str, Any]) -> str:
    return f"{KIND} {info['codebase_version']}"


def _names(info: dict[str, Any]) -> dict[str, list[str]]:
    """Return the names of the entries of each feature that states them."""
    features = info.get("features")
    found: dict[str, list[str]] = {}
    for feature, about in features.items() if isinstance(features, dict) else ():
        names = about.get("names") if isinstance(about, dict) else None
        if isinstance(names, dict) and len(names) == 1:  # {"motors": [...]}
            names = next(iter(names.values()))
        if isinstance(names, list) and all(isinstance(name, str) for name in names):
            found[feature] = names if len(set(names)) == len(names) else []
    return found


def _without_images(table: pa.Table) -> pa.Table:
    kept = [name for name in table.column_names if not pa.types.is_struct(table[name].type)]
    return table.select(kept)
