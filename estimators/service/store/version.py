"""One version of a model: a folder with its own record, which never changes.

<robot>/<n>/
├── manifest.json, model.safetensors, sim.yaml   the model folder, as `limo train` writes it
├── <robot>.urdf                                 of a robot that is not built in
├── golden.safetensors                           a motion, and what the model answers to it live
├── version.json                                 digests of all these, and where they came from
└── signature.json                               of version.json, if it was signed
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from estimators.model_folder import load_model
from estimators.service.store.golden_motion import Golden
from estimators.service.store.signature import check_signature
from limo_driver.errors import ModelStoreError
from limo_driver.runtime.declarations import read_json
from limo_driver.runtime.given_files import read_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.residual_model import ResidualModel

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
