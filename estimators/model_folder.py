"""Model folders: tensors, a JSON manifest and the simulation; no code, no pickles.

model/
├── manifest.json        which estimator, robot and data; what the tensors are
├── model.safetensors    tensors
└── sim.yaml             the simulation whose residual was learned

What each estimator keeps in them stands in `model_store` (hybrid) and `joint_physics.store`.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from estimators.hybrid import HybridModel
    from estimators.joint_physics import JointPhysics
    from limo_driver.recording import Recording

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
WEIGHTS: Final = "model.safetensors"
SIMULATION: Final = "sim.yaml"


@dataclass(frozen=True)
class ModelFolder:
    """What a folder holds, checked to fit together."""

    path: Path
    manifest: dict[str, Any]
    simulation: Simulation

    @classmethod
    def open(cls, folder: Path | str, estimator: str, required: frozenset[str]) -> ModelFolder:
        """Read manifest and simulation.

        Args:
            folder: The model folder.
            estimator: Name of the estimator it has to be of.
            required: Entries that its manifest has to have.

        Raises:
            ModelStoreError: A file is missing or does not fit the others; the message names it.
        """
        path = Path(folder)
        manifest = read_manifest(path)
        if manifest.get("estimator") != estimator:
            raise ModelStoreError(
                f"{path / MANIFEST}: is of {manifest.get('estimator')!r}, expected {estimator!r}"
            )
        missing = (required | {"joints", "weights", "simulation"}) - set(manifest)
        if missing:
            raise ModelStoreError(f"{path / MANIFEST}: lacks {', '.join(sorted(missing))}")
        if not isinstance(manifest["simulation"], dict):
            raise ModelStoreError(f"{path / MANIFEST}: simulation names no file and sha256")
        return cls(path, manifest, _read_simulation(path, manifest))

    def tensors(self) -> dict[str, Any]:
        """Read the tensors.

        Raises:
            ModelStoreError: The file is missing, or not the one of the manifest.
        """
        try:
            data = (self.path / WEIGHTS).read_bytes()
        except OSError as error:
            raise ModelStoreError(
                f"{self.path / WEIGHTS}: cannot be read: {error.strerror}"
            ) from None
        if sha256(data).hexdigest() != self.manifest["weights"]["sha256"]:
            raise ModelStoreError(
                f"{self.path}: {WEIGHTS} is not the one of the manifest (sha256 differs)"
            )
        try:
            return load_tensors(data)
        except SafetensorError as error:
            raise ModelStoreError(f"{self.path}: {WEIGHTS}: {error}") from None


def write_folder(
    folder: Path | str,
    entries: Mapping[str, Any],
    tensors: Mapping[str, Any],
    simulation: Simulation,
    packages: tuple[str, ...],
) -> None:
    """Write a model folder.

    Args:
        folder: Where to.
        entries: Of the manifest; robot, joints and digests are added.
        tensors: Arrays by name.
        simulation: Whose residual was learned.
        packages: Whose versions the manifest states.

    Raises:
        ModelStoreError: The folder cannot be written.
    """
    path = Path(folder)
    weights = save_tensors({name: np.ascontiguousarray(value) for name, value in tensors.items()})
    manifest: dict[str, Any] = {
        "schema": SCHEMA,
        "robot": simulation.model.name,
        "joints": list(simulation.model.joint_names),
        **entries,
        "weights": {"file": WEIGHTS, "sha256": sha256(weights).hexdigest()},
        "packages": {name: version(name) for name in packages},
    }
    try:
        path.mkdir(parents=True, exist_ok=True)
        (path / WEIGHTS).write_bytes(weights)
        simulation.save(path / SIMULATION)
        manifest["simulation"] = {"file": SIMULATION, "sha256": _digest(path / SIMULATION)}
        (path / MANIFEST).write_text(json.dumps(manifest, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise ModelStoreError(f"{path}: cannot be written: {error.strerror}") from None


def load_model(folder: Path | str) -> HybridModel | JointPhysics:
    """Read a model folder of any estimator; runs no code from it.

    Raises:
        ModelStoreError: The folder is incomplete or does not fit together, by name.
    """
    name = read_manifest(Path(folder)).get("estimator")
    if name not in _LOADERS:
        raise ModelStoreError(
            f"{Path(folder) / MANIFEST}: estimator {name!r} is unknown; known: "
            f"{', '.join(_LOADERS)}"
        )
    return _LOADERS[name](folder)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a folder.

    Raises:
        ModelStoreError: There is none that can be read.
    """
    path = folder / MANIFEST
    if not folder.is_dir():
        raise ModelStoreError(f"{folder}: no such model folder")
    try:
        manifest = json.loads(path.read_text())
    except OSError as error:
        raise ModelStoreError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ModelStoreError(f"{path}: no JSON: {error}") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise ModelStoreError(f"{path}: its schema is not {SCHEMA}")
    return manifest


def check_simulation(model: HybridModel | JointPhysics, simulation: Simulation) -> None:
    """Check that a simulation is the one whose residual the model learned.

    Raises:
        ModelStoreError: Names what differs.
    """
    own = model.simulation
    if own.model.joint_names != simulation.model.joint_names:
        raise ModelStoreError(
            f"the model is of robot {own.model.name}, the simulation of {simulation.model.name}"
        )
    differing = [
        mine.name + "".join(f" of joint {joint}" for joint in mine.joints[:1])
        for mine, theirs in zip(own.effects, simulation.effects, strict=False)
        if mine != theirs
    ]
    differing += [
        f"inertia of {link}"
        for link, inertial in own.model.inertials.items()
        if not _close(asdict(inertial), asdict(simulation.model.inertials[link]))
    ]
    if len(own.effects) != len(simulation.effects):
        differing.append(f"{len(simulation.effects)} effects instead of {len(own.effects)}")
    if differing:
        raise ModelStoreError(
            f"the model learned the residual of another simulation ({differing[0]}"
            f"{f' and {len(differing) - 1} more' if len(differing) > 1 else ''}); "
            "train it again on this one, or use the sim.yaml of the model folder"
        )


def provenance(recording: Recording) -> dict[str, Any]:
    """Return as JSON values which data a model learned from."""
    path = Path(recording.source)
    readable = bool(recording.source) and path.is_file()
    return {
        "file": path.name,
        "sha256": _digest(path) if readable else None,
        "samples": len(recording),
        "left_out": sum(len(item.rows) for item in recording.left_out),
    }


def _hybrid(folder: Path | str) -> HybridModel:
    from estimators.hybrid import HybridModel

    return HybridModel.load(folder)


def _joint_physics(folder: Path | str) -> JointPhysics:
    from estimators.joint_physics import JointPhysics

    return JointPhysics.load(folder)


_LOADERS: Final[dict[str, Callable[[Path | str], HybridModel | JointPhysics]]] = {
    "hybrid": _hybrid,
    "joint-physics": _joint_physics,
}


def _read_simulation(folder: Path, manifest: dict[str, Any]) -> Simulation:
    try:
        simulation = Simulation.load(folder / SIMULATION)
    except ConfigError as error:
        raise ModelStoreError(str(error)) from None
    if _digest(folder / SIMULATION) != manifest["simulation"].get("sha256"):
        raise ModelStoreError(
            f"{folder}: {SIMULATION} is not the one of the manifest (sha256 differs); "
            "the model learned what another simulation left over"
        )
    joints = list(simulation.model.joint_names)
    if manifest["joints"] != joints:
        raise ModelStoreError(
            f"{folder}: the manifest is of joints {', '.join(map(str, manifest['joints']))}, but "
            f"{SIMULATION} of {', '.join(joints)}"
        )
    return simulation


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _close(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return all(np.allclose(a[key], b[key], rtol=1e-9, atol=1e-12) for key in a)
