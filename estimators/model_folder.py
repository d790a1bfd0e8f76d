"""Model folders: tensors, a JSON manifest and the simulation; no code, no pickles.

model/
├── manifest.json        which estimator, robot and data; what the tensors are
├── model.safetensors    tensors
└── sim.yaml             the simulation whose residual was learned

What each estimator keeps in them is its own: it is found by its name, see `estimator_called`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from estimators.residual_model import ResidualModel, estimator_called, known_estimators
from limo_driver.errors import ConfigError, ModelStoreError, PlugInError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.declarations import JsonNode, read_json
from limo_driver.runtime.given_files import read_bytes
from limo_driver.runtime.outputs import replacing
from limo_driver.types import same_robot

WEIGHTS: Final = "model.safetensors"
SIMULATION: Final = "sim.yaml"
LARGEST_FILE: Final = 1 << 30  # bytes of tensors
_POSES: Final = 4  # at which two bodies are compared; one could hide a difference by chance
SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
_DIGEST: Final = "sha256"  # of all the other entries


@dataclass(frozen=True)
class ModelFolder:
    """Content of a model folder, checked to fit together."""

    path: Path
    manifest: JsonNode
    simulation: Simulation

    @classmethod
    def open(cls, folder: Path | str, estimator: str) -> ModelFolder:
        """Read manifest and simulation.

        Args:
            folder: The model folder.
            estimator: Name of the estimator it has to be of.

        Raises:
            ModelStoreError: A file is missing or does not fit the others; the message names it.
        """
        path = Path(folder)
        manifest = read_manifest(path)
        given = manifest.text("estimator")
        if given != estimator:
            manifest.fail(f"is of {given!r}, expected {estimator!r}")
        expected = manifest["simulation"].text("sha256")
        try:
            simulation = Simulation.load(path / SIMULATION)
            found = _digest(path / SIMULATION)
        except ConfigError as error:
            raise ModelStoreError(str(error)) from None
        if found != expected:
            raise ModelStoreError(
                f"{path}: {SIMULATION} is not the one of the manifest (sha256 differs); "
                "the model learned what another simulation left over"
            )
        model, joints, robot = simulation.model, manifest.texts("joints"), manifest.text("robot")
        if joints != model.joint_names:
            raise ModelStoreError(
                f"{path}: the manifest is of joints {', '.join(joints)}, but {SIMULATION} of "
                f"{', '.join(model.joint_names)}"
            )
        if not same_robot(robot, model.name):
            raise ModelStoreError(
                f"{path}: the manifest is of robot {robot}, but {SIMULATION} of {model.name}"
            )
        return cls(path, manifest, simulation)

    @property
    def bandwidth(self) -> float:
        """Of the filters on motion and torque that the model was fitted behind [Hz]."""
        return self.manifest.number("bandwidth", lower=0.0, above=True)

    def record(self, *error: str) -> dict[str, Any]:
        """Return which data the model was fitted to and how; empty where nothing is said.

        Args:
            error: Where in it the errors on motion held out stand, which have to be of each joint.
        """
        if "training" not in self.manifest:
            return {}
        training = self.manifest["training"]
        if "recordings" in training:
            training["recordings"].sections()
        if "rmse" in training:
            found = training["rmse"]
            for name in error[:-1]:
                found = found[name]
            found.numbers(error[-1], self.simulation.model.n, lower=0.0)
        return dict(training.content)

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Read the tensors.

        Raises:
            ModelStoreError: The file is missing, or not the one of the manifest.
        """
        data = read_bytes(self.path / WEIGHTS, ModelStoreError, LARGEST_FILE)
        if sha256(data).hexdigest() != self.manifest["weights"].text("sha256"):
            raise ModelStoreError(
                f"{self.path}: {WEIGHTS} is not the one of the manifest (sha256 differs)"
            )
        return tensors_of(data, self.path / WEIGHTS)


def tensors_of(data: bytes, path: Path) -> dict[str, NDArray[Any]]:
    """Return the tensors in the bytes of a file.

    Raises:
        ModelStoreError: It is no safetensors, or of a type that no model has.
    """
    try:
        return load_tensors(data)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ModelStoreError(str(error), path=path) from None


def write_folder(
    folder: Path | str,
    entries: Mapping[str, Any],
    tensors: Mapping[str, Any],
    simulation: Simulation,
    packages: tuple[str, ...],
) -> None:
    """Write a model folder; a model that is there is replaced only when all of it can be written.

    Args:
        folder: Where to.
        entries: Of the manifest; robot, joints and digests are added.
        tensors: Arrays by name.
        simulation: Whose residual was learned.
        packages: Whose versions the manifest states.

    Raises:
        ModelStoreError: The folder cannot be written, or an entry is no JSON.
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
        # Each takes its place once all are written, the weights first and the manifest last.
        with (
            replacing(path / MANIFEST) as described,
            replacing(path / SIMULATION) as simulated,
            replacing(path / WEIGHTS) as learned,
        ):
            simulation.save(simulated)
            manifest["simulation"] = {"file": SIMULATION, "sha256": _digest(simulated)}
            described.write_text(as_manifest(manifest), encoding="utf-8")
            learned.write_bytes(weights)
    except OSError as error:
        raise ModelStoreError(f"{path}: cannot be written: {error.strerror}") from None
    except ConfigError as error:
        raise ModelStoreError(str(error)) from None


def load_model(folder: Path | str) -> ResidualModel[Any]:
    """Read a model folder of any estimator; runs no code from it.

    Raises:
        ModelStoreError: The folder is incomplete or does not fit together, by name.
    """
    manifest = read_manifest(Path(folder))
    name = manifest.text("estimator", known_estimators())
    try:
        estimator = estimator_called(name)
    except (ConfigError, PlugInError) as error:
        manifest.fail(str(error))
    return estimator.load(folder)


def check_simulation(model: ResidualModel[Any], simulation: Simulation) -> None:
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
    if not differing and not _same_torque(own.body, simulation.body):
        differing.append("where its joints are, or which way is down")
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
        "time": [float(recording.time[0]), float(recording.time[-1])],
        "left_out": sum(len(item.rows) for item in recording.left_out),
    }


def _same_torque(first: RobotModel, second: RobotModel) -> bool:
    """Say whether two bodies need the same torque for the same motion of all joints."""
    motion = np.random.default_rng(0).uniform(-1.0, 1.0, (3, _POSES, first.n))
    torque = first.inverse_dynamics(*motion)
    return np.allclose(second.inverse_dynamics(*motion), torque, rtol=1e-6, atol=1e-9)


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _close(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return all(np.allclose(a[key], b[key], rtol=1e-9, atol=1e-12) for key in a)


def read_manifest(folder: Path) -> JsonNode:
    """Read the manifest of a folder.

    Raises:
        ModelStoreError: There is none that can be read, or it was changed since it was written.
    """
    path = folder / MANIFEST
    if not folder.is_dir():
        raise ModelStoreError(f"{folder}: no such model folder")
    given = read_json(path, ModelStoreError, SCHEMA)
    own = given.content.pop(_DIGEST, None)
    if own is not None and own != _digest_of_entries(given.content):  # the first manifests had none
        given.fail("was changed since it was written (sha256 differs); train the model again")
    return given


def as_manifest(values: Mapping[str, Any]) -> str:
    """Return the text of a manifest with these entries, and the digest by which changes show.

    Raises:
        ModelStoreError: A value is no JSON, or no finite number.
    """
    try:
        sealed = {"schema": SCHEMA, **values}
        sealed[_DIGEST] = _digest_of_entries({k: v for k, v in sealed.items() if k != _DIGEST})
        return json.dumps(sealed, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise ModelStoreError(f"the manifest of the model is no JSON: {error}") from None


def _digest_of_entries(values: Mapping[str, Any]) -> str:
    """Return the sha256 of entries, however they are spaced and ordered."""
    return sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
