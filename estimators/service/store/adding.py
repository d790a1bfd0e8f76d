"""Gather the files of a new version of a model, and write its version.json."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path, PurePath
from shutil import copyfile
from typing import TYPE_CHECKING, Any, Final

from estimators.model_folder import (
    MANIFEST,
    SIMULATION,
    WEIGHTS,
    as_manifest,
    load_model,
    read_manifest,
)
from estimators.service.store.aliases import write
from estimators.service.store.version import SCHEMA, Golden, StreamReplay, described, digest
from limo_driver.errors import ModelStoreError
from limo_driver.model import BUILT_IN
from limo_driver.runtime.outputs import sync

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.residual_model import ResidualModel

_NAME: Final = re.compile(r"\w[\w.+-]*")


def robot_of(folder: Path) -> str:
    """Return the name of the robot that a model folder is of: built in, or that of its URDF.

    Raises:
        ModelStoreError: It names none, or one that cannot name a folder.
    """
    name = PurePath(read_manifest(folder).text("robot")).stem
    if not _NAME.fullmatch(name):
        raise ModelStoreError(
            f"{folder / MANIFEST}: robot {name!r} cannot name a folder, expected letters, digits, "
            "_, +, - and dots"
        )
    return name


def gather(folder: Path, into: Path, robot: str) -> ResidualModel[Any]:
    """Copy a model folder, with the URDF of a robot that is not built in, and load the copy.

    Raises:
        ModelStoreError: A file is missing or does not fit the others, by name.
    """
    for name in (MANIFEST, WEIGHTS, SIMULATION):
        if not (folder / name).is_file():
            raise ModelStoreError(f"{folder / name}: is missing, or no regular file")
    model = load_model(folder)
    for name in (MANIFEST, WEIGHTS, SIMULATION):
        copyfile(folder / name, into / name)
    if robot not in BUILT_IN:
        # Copy the URDF, and let simulation and manifest refer to the copy
        urdf = into / f"{robot}.urdf"
        described = model.simulation.model.description
        if described.kind == "URDF" and not model.simulation.model.chosen:
            copyfile(model.simulation.model.urdf, urdf)
        else:  # with the meshes and joints that it is meant with
            urdf.write_text(described.text, encoding="utf-8")
        replace(model.simulation, robot=str(urdf)).save(into / SIMULATION)
        given = read_manifest(into)
        own = {**given["simulation"].content, "sha256": digest(into / SIMULATION)}
        manifest = as_manifest({**given.content, "robot": robot, "simulation": own})
        write(into / MANIFEST, manifest.encode())
    for path in into.iterdir():
        sync(path)
    return load_model(into)


def recorded(
    path: Path,
    model: ResidualModel[Any],
    golden: Golden,
    replay: StreamReplay,
    record: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what version.json says, but for the number and the parent."""
    manifest = read_manifest(path).content  # those of a model that was loaded
    training = manifest.get("training") or {}
    return {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "code": version("limo"),
        "robot": path.parent.name,
        "joints": list(model.simulation.model.joint_names),
        "estimator": model.name,
        "input": {
            "quantity": "position",
            "unit": "rad",
            "bandwidth": model.bandwidth,
            "rate": manifest.get("rate"),  # that of a network's memory
            "features": [item["name"] for item in manifest.get("inputs", [])],
        },
        "golden": golden.as_values(),
        "latency": replay.latency(),
        "data": list(training.get("recordings", [])),
        "rmse": training.get("rmse"),
        "record": dict(record),
        "files": {item.name: described(item) for item in sorted(path.iterdir())},
    }


def as_json(content: Mapping[str, Any]) -> bytes:
    """Return the content of a version.json.

    Raises:
        ModelStoreError: A value is no JSON, or no finite number.
    """
    try:
        return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
    except (TypeError, ValueError) as error:
        raise ModelStoreError(f"the record of the version is no JSON: {error}") from None
