"""LeRobotDatasets: read as tables, and written as commands for servos.

Commands written as a LeRobotDataset v3.0, whose episodes `lerobot-replay` plays.

An action is what LeRobot sends to a robot of motors: one goal position each, in degrees
(`use_degrees`), but of a motor named `gripper` in percent of its range, named `<motor>.pos`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.formats.arrow import numbers_of, read_parquet
from limo_driver.logs.readers.table import LogTable
from limo_driver.runtime.given_files import check_file, read_json_file
from limo_driver.types import FloatArray

# pyarrow ships no type stubs, so its tables are unknown to the checker.
# pyright: reportUnknownParameterType=false
KIND = "LeRobotDataset"
_INFO = "meta/info.json"
_BETWEEN = 1.0  # [s] from the end of one episode to the start of the next: a gap, as it was
_KNOWN = ("v2.0", "v2.1", "v3.0")
GRIPPER = "gripper"  # the motor that LeRobot counts in percent of its range
_VERSION = "v3.0"
_TASK = "Excite the drives of all joints."
_FILE = "chunk-000/file-000.parquet"
_INDICES = ("frame_index", "episode_index", "index", "task_index")
_CHUNK = 1000  # files in a folder
_DATA_MB, _VIDEO_MB = 100, 200  # of a file, as LeRobot has it


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
    found = LogTable(columns, read.source, read.kind, read.unread, notes, str(robot or ""))
    fps = info.get("fps")
    return replace(found, rate=float(fps)) if isinstance(fps, (int, float)) else found


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


def write_actions(
    folder: Path,
    command: FloatArray,
    episodes: Sequence[slice],
    names: Sequence[str],
    fps: float,
    robot: str = "",
    ranges: Sequence[tuple[float, float]] = (),
) -> None:
    """Write commands as episodes of actions.

    Args:
        folder: To be made; it must not hold a dataset yet.
        command: (T, n) [rad].
        episodes: Rows of each, one after the other.
        names: Of the motors, as LeRobot knows them.
        fps: Commands in a second, a whole number.
        robot: Its type, as LeRobot knows it.
        ranges: Ends of each joint [rad]; a gripper needs them.

    Raises:
        ConfigError: The folder holds something, the rate is no whole number, or a gripper has no
            range.
    """
    if fps != int(fps):
        raise ConfigError(f"LeRobot plays whole numbers of commands in a second, {fps:g} given")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(
            "holds something; a LeRobotDataset needs a folder of its own", path=folder
        )
    lengths = [rows.stop - rows.start for rows in episodes]
    total = sum(lengths)
    frame = np.concatenate([np.arange(length) for length in lengths])
    goals = np.concatenate([command[rows] for rows in episodes])
    action = _counted(goals, names, ranges).astype(np.float32)
    n = action.shape[1]
    indices = {
        "frame_index": frame,
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "index": np.arange(total),
        "task_index": np.zeros(total, dtype=np.int64),
    }
    timestamp = (frame / fps).astype(np.float32)
    table = {
        "action": pa.FixedSizeListArray.from_arrays(pa.array(action.ravel()), n),
        "timestamp": timestamp,
        **indices,
    }
    scalar: dict[str, Any] = {"shape": [1], "names": None}
    features = {
        "action": {"dtype": "float32", "shape": [n], "names": [f"{name}.pos" for name in names]},
        "timestamp": {"dtype": "float32", **scalar},
        **{name: {"dtype": "int64", **scalar} for name in _INDICES},
    }
    info = {
        "codebase_version": _VERSION,
        "robot_type": robot or None,
        "total_episodes": len(lengths),
        "total_frames": total,
        "total_tasks": 1,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": int(fps),
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    statistics = {"action": action, "timestamp": timestamp, **indices}
    meta = folder / "meta"
    (folder / "data" / _FILE).parent.mkdir(parents=True)
    (meta / "episodes" / _FILE).parent.mkdir(parents=True)
    pq.write_table(pa.table(table), folder / "data" / _FILE)
    pq.write_table(_episodes(lengths), meta / "episodes" / _FILE)
    pq.write_table(_tasks(), meta / "tasks.parquet")
    (meta / "info.json").write_text(json.dumps(info, indent=4), encoding="utf-8")
    stats = {name: _statistics(values) for name, values in statistics.items()}
    (meta / "stats.json").write_text(json.dumps(stats, indent=4), encoding="utf-8")


def _counted(
    goals: FloatArray, names: Sequence[str], ranges: Sequence[tuple[float, float]]
) -> FloatArray:
    """Return goals (T, n) [rad] as LeRobot counts them."""
    action = np.rad2deg(goals)
    for j in (j for j, name in enumerate(names) if name == GRIPPER):
        low, high = ranges[j] if j < len(ranges) else (-np.inf, np.inf)
        if not np.isfinite(high - low):
            raise ConfigError(
                f"motor {GRIPPER} has no range in the description of the robot; LeRobot counts it "
                "in percent of that"
            )
        action[:, j] = 100.0 * (goals[:, j] - low) / (high - low)
    return action


def _episodes(lengths: Sequence[int]) -> pa.Table:
    many = len(lengths)
    ends = np.cumsum(lengths)
    nowhere = np.zeros(many, dtype=np.int64)
    return pa.table(
        {
            "episode_index": np.arange(many),
            "tasks": [[_TASK]] * many,
            "length": np.array(lengths, dtype=np.int64),
            "data/chunk_index": nowhere,
            "data/file_index": nowhere,
            "dataset_from_index": ends - lengths,
            "dataset_to_index": ends,
            "meta/episodes/chunk_index": nowhere,
            "meta/episodes/file_index": nowhere,
        }
    )


def _tasks() -> pa.Table:
    """Return the table of tasks, whose index is their text: LeRobot reads it by pandas."""
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [_TASK]})
    column = {"field_name": "task_index", "name": "task_index", "pandas_type": "int64",
              "numpy_type": "int64", "metadata": None}  # fmt: skip
    index = {"field_name": "task", "name": "task", "pandas_type": "unicode",
             "numpy_type": "object", "metadata": None}  # fmt: skip
    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column, index],
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }
