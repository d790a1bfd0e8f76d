"""A version of a model: its files by their hashes, and a motion whose torque it has to give.

One version of a model: a folder with its own record, which never changes.

<robot>/<n>/
├── manifest.json, model.safetensors, sim.yaml   the model folder, as `limo train` writes it
├── <robot>.urdf                                 of a robot that is not built in
├── golden.safetensors                           a motion, and what the model answers to it live
├── version.json                                 digests of all these, and where they came from
└── signature.json                               of version.json, if it was signed
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import file_digest, sha256
from pathlib import Path
from time import thread_time_ns
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from safetensors.numpy import save as save_tensors

from estimators.model_folder import LARGEST_FILE, load_model, tensors_of
from estimators.service.store.aliases import check_signature
from estimators.stream import Stream
from limo_driver.errors import ModelStoreError
from limo_driver.runtime.declarations import read_json
from limo_driver.runtime.given_files import read_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.base import LiveEstimator
    from estimators.residual_model import ResidualModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

SCHEMA: Final = 1
RECORD: Final = "version.json"
GOLDEN: Final = "golden.safetensors"
_ENTRIES: Final[dict[str, type | tuple[type, ...]]] = {
    "version": int,
    "parent": (int, type(None)),
    "created": str,
    "robot": str,
    "joints": list,
    "estimator": str,
    "input": dict,
    "golden": dict,
    "latency": dict,
    "data": list,
    "code": str,
    "record": dict,
    "files": dict,
}
SECONDS: Final = 4.0  # of motion that are kept
RELATIVE: Final = 1e-9  # by which a replay may differ, of the torque
ABSOLUTE: Final = 1e-6  # [N m]
_WARM_UP: Final = 50  # steps that are not timed, since the first ones compile
_FEWEST: Final = 10  # timed steps, to say anything of their percentiles
_DIMENSIONS: Final = {"time": 1, "position": 2, "torque": 2, "rate": 0, "delay": 0}


@dataclass(frozen=True)
class Version:
    """A version as its version.json describes it; `load` gives the model."""

    path: Path
    record: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path, trusted_keys: Sequence[Path] = ()) -> Version:
        """Read the version.json of a folder.

        Args:
            path: The version's folder, named by its number.
            trusted_keys: Public keys, one of which has to have signed it; none: any version goes.

        Raises:
            ModelStoreError: It cannot be understood, is of another version, or no trusted key
                signed it.
        """
        file = path / RECORD
        data = read_bytes(file, ModelStoreError)
        record = read_json(file, ModelStoreError, SCHEMA, data).content
        if trusted_keys:
            check_signature(data, path, trusted_keys)
        check_record(file, record)
        return cls(path, record)

    @property
    def number(self) -> int:
        """Its number, from 1."""
        return self.record["version"]

    @property
    def robot(self) -> str:
        """Name of the robot that the model is of."""
        return self.record["robot"]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(self.record["joints"])

    @property
    def estimator(self) -> str:
        """Name of the kind of estimator."""
        return self.record["estimator"]

    def check_files(self) -> None:
        """Check that every file is the one that was added.

        Raises:
            ModelStoreError: Names the one that is missing or differs.
        """
        for name, expected in self.record["files"].items():
            path = self.path / name
            if not path.is_file():
                raise ModelStoreError(f"{path}: is missing, or no regular file")
            if path.stat().st_size != expected["bytes"]:
                raise ModelStoreError(
                    f"{path}: has {path.stat().st_size} bytes, expected {expected['bytes']}"
                )
            if digest(path) != expected["sha256"]:
                raise ModelStoreError(f"{path}: is not the one that was added (sha256 differs)")

    def load(self) -> ResidualModel[Any]:
        """Check the files and read the model; runs no code from them.

        Raises:
            ModelStoreError: A file differs from what was added, or does not fit the others.
        """
        self.check_files()
        model = load_model(self.path)
        joints = model.simulation.model.joint_names
        if joints != self.joints:
            raise ModelStoreError(
                f"{self.path}: the model is of joints {', '.join(joints)}, {RECORD} of "
                f"{', '.join(self.joints)}"
            )
        return model

    def golden(self) -> Golden:
        """Read the golden motion.

        Raises:
            ModelStoreError: The file is missing or cannot be understood.
        """
        return Golden.load(self.path / GOLDEN)

    def verify(self) -> float:
        """Check the files, load the model, and replay the golden motion.

        Returns:
            By how much the torque differs from that of the day it was added, at most [N m].

        Raises:
            ModelStoreError: Anything of it fails, by name.
        """
        model = self.load()
        return self.golden().deviation(model)


def described(path: Path) -> dict[str, Any]:
    """Return size and SHA-256 of a file as JSON values."""
    return {"bytes": path.stat().st_size, "sha256": digest(path)}


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def check_record(file: Path, record: object) -> None:
    """Check the content of a version.json before any of it is used.

    Raises:
        ModelStoreError: It is not what one holds, or is of another folder's version.
    """
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise ModelStoreError(f"{file}: its schema is not {SCHEMA}")
    for name, kind in _ENTRIES.items():
        if not isinstance(record.get(name, ...), kind):
            raise ModelStoreError(f"{file}: {name} is missing or of the wrong type")
    if str(record["version"]) != file.parent.name:
        raise ModelStoreError(
            f"{file}: is of version {record['version']}, but lies in folder {file.parent.name}"
        )
    for name, entry in record["files"].items():
        if (
            Path(name).name != name
            or not isinstance(entry, dict)
            or set(entry) != {"bytes", "sha256"}
        ):
            raise ModelStoreError(f"{file}: files: {name!r} is no file name with bytes and sha256")


@dataclass(frozen=True)
class StreamReplay:
    """Answers of a stream, step by step, and the time that each step took."""

    torque: FloatArray  # (T, n) [N m]
    cost: FloatArray  # (T,) [s] of CPU, which the load of other processes does not add to

    def latency(self) -> dict[str, float | int]:
        """Return percentiles of the cost of a step, warmed up [s].

        Raises:
            ModelStoreError: There are too few steps to say.
        """
        timed = self.cost[_WARM_UP:]
        if timed.size < _FEWEST:
            raise ModelStoreError(
                f"{self.cost.size} steps are too few to time; at least {_WARM_UP + _FEWEST}"
            )
        p50, p99 = np.percentile(timed, [50, 99])
        return {"p50": float(p50), "p99": float(p99), "steps": int(timed.size)}


def replay(stream: Stream, time: FloatArray, position: FloatArray) -> StreamReplay:
    """Step a stream through T positions.

    Args:
        stream: Of the model.
        time: (T,) [s].
        position: (T, n) [rad].
    """
    state = stream.init()
    torque, cost = np.empty(position.shape), np.empty(time.size)
    measured = np.zeros(position.shape[1])  # a step costs what it does with a measured torque
    for t in range(time.size):
        start = thread_time_ns()
        estimate, state = stream.step(state, float(time[t]), position[t], measured)
        cost[t] = 1e-9 * (thread_time_ns() - start)
        torque[t] = estimate.torque
    return StreamReplay(torque, cost)


@dataclass(frozen=True)
class Golden:
    """Positions of n joints at T instants, and the torque that a model gave for them."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray  # (T, n) [N m]
    rate: float  # of the stream [Hz]
    delay: float  # of the stream [s]

    @classmethod
    def of(
        cls, model: LiveEstimator, recording: Recording, delay: float
    ) -> tuple[Golden, StreamReplay]:
        """Replay the liveliest seconds of a recording.

        Raises:
            ConfigError, ModelStoreError: The model cannot be streamed at that rate and delay, or
                gives no finite torque.
        """
        stream = Stream(model, recording.rate, delay)
        # The rows of `SECONDS` without a gap in which the joints travel farthest
        rows = max(recording.segments, key=lambda part: part.stop - part.start)
        length = min(int(SECONDS * recording.rate), rows.stop - rows.start)
        steps = np.abs(np.diff(recording.position[rows], axis=0)).sum(axis=1)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        start = rows.start + int(
            (travelled[length - 1 :] - travelled[: travelled.size - length + 1]).argmax()
        )
        part = recording[slice(start, start + length)]
        found = replay(stream, part.time, part.position)
        if not np.isfinite(found.torque).all():
            raise ModelStoreError("the torque of the golden motion is not finite")
        golden = cls(part.time, part.position, found.torque, recording.rate, delay)
        return golden, found

    @classmethod
    def load(cls, path: Path) -> Golden:
        """Read what `as_bytes` gives.

        Raises:
            ModelStoreError: The file is missing or holds something else.
        """
        tensors = tensors_of(read_bytes(path, ModelStoreError, LARGEST_FILE), path)
        for name, dimensions in _DIMENSIONS.items():
            found = tensors.get(name)
            if found is None or found.ndim != dimensions or not np.isfinite(found).all():
                raise ModelStoreError(
                    f"{path}: {name} is not there in {dimensions} dimensions of finite numbers"
                )
        time, position, torque = (tensors[name] for name in ("time", "position", "torque"))
        if torque.shape != position.shape or time.size != len(position):
            raise ModelStoreError(
                f"{path}: time {time.shape}, position {position.shape} and torque {torque.shape} "
                "do not fit together, expected (T,), (T, n) and (T, n)"
            )
        return cls(time, position, torque, float(tensors["rate"]), float(tensors["delay"]))

    def as_bytes(self) -> bytes:
        """Return the content of the file."""
        arrays = {name: np.array(getattr(self, name), np.float64) for name in _DIMENSIONS}
        return save_tensors(arrays)

    def deviation(self, model: LiveEstimator) -> float:
        """Replay the motion and return by how much the torque differs at most [N m].

        Raises:
            ModelStoreError: By more than is allowed.
        """
        torque = replay(Stream(model, self.rate, self.delay), self.time, self.position).torque
        error = np.abs(torque - self.torque)
        allowed = ABSOLUTE + RELATIVE * np.abs(self.torque)
        if not (error <= allowed).all():  # also where it is not a number
            t, j = np.argwhere(~(error <= allowed))[0]
            raise ModelStoreError(
                f"joint {j + 1} gives {torque[t, j]:.9g} N m at {self.time[t]:.4g} s of the golden "
                f"motion, expected {self.torque[t, j]:.9g} N m"
            )
        return float(error.max())

    def at(self, rate: float) -> tuple[FloatArray, FloatArray]:
        """Return time (T,) [s] and position (T, n) [rad], linear between the samples."""
        time = np.arange(self.time[0], self.time[-1], 1.0 / rate)
        columns = [np.interp(time, self.time, q) for q in self.position.T]
        return time, np.stack(columns, axis=1)

    def as_values(self) -> dict[str, Any]:
        """Return rate, delay and extent as JSON values."""
        return {
            "rate": self.rate,
            "delay": self.delay,
            "samples": self.time.size,
            "position_sha256": sha256(self.position.tobytes()).hexdigest(),
        }
