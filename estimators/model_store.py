"""Model folders: weights as safetensors, a JSON manifest and the simulation; no code, no pickles.

model/
├── manifest.json        inputs in order, units, normalisation, rate, bandwidth, robot, training
├── model.safetensors    weights
└── sim.yaml             gives tau_RBD
"""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from estimators.features import Feature, Features
from estimators.hybrid import FittedNetwork, HybridModel
from estimators.neural import NETWORKS
from estimators.scaling import InputScaling, Scaling
from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
WEIGHTS: Final = "model.safetensors"
SIMULATION: Final = "sim.yaml"
_COLUMNS: Final = "columns"  # which inputs each part of the network sees
_REQUIRED: Final = frozenset(
    ("joints", "features", "inputs", "outputs", "weights", "simulation", "rate", "bandwidth")
)
_PACKAGES: Final = ("limo", "numpy", "torch", "safetensors", "pin")


def save(model: HybridModel, folder: Path | str) -> None:
    """Write a model folder; it holds all that prediction needs.

    Raises:
        NotFittedError: Nothing was trained.
        ModelStoreError: The folder cannot be written.
    """
    fitted, folder = model.fitted, Path(folder)
    tensors: dict[str, Any] = {**fitted.network.weights, _COLUMNS: fitted.network.columns}
    weights = save_tensors({name: np.ascontiguousarray(value) for name, value in tensors.items()})
    manifest: dict[str, Any] = {
        "schema": SCHEMA,
        "estimator": model.name,
        "network": fitted.network.kind,
        "robot": model.simulation.model.name,
        "joints": list(model.simulation.model.joint_names),
        "rate": fitted.rate,
        "bandwidth": fitted.bandwidth,
        "standalone": fitted.standalone,
        "features": _feature_settings(fitted.features),
        "inputs": _described(
            fitted.features.inputs,
            mean=fitted.inputs.mean,
            std=fitted.inputs.std,
            lowest=fitted.inputs.lowest,
            highest=fitted.inputs.highest,
        ),
        "outputs": _described(
            _outputs(fitted.features.n, standalone=fitted.standalone),
            mean=fitted.outputs.mean,
            std=fitted.outputs.std,
            gain=fitted.gain,
        ),
        "weights": {"file": WEIGHTS, "sha256": sha256(weights).hexdigest()},
        "simulation": {"file": SIMULATION},
        "training": dict(fitted.record),
        "packages": {name: version(name) for name in _PACKAGES},
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / WEIGHTS).write_bytes(weights)
        model.simulation.save(folder / SIMULATION)
        manifest["simulation"]["sha256"] = _digest(folder / SIMULATION)
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise ModelStoreError(f"{folder}: cannot be written: {error.strerror}") from None


def load(folder: Path | str) -> HybridModel:
    """Read a model folder.

    Raises:
        ModelStoreError: A file is missing or does not fit the others; the message names it.
    """
    folder = Path(folder)
    manifest = _read_manifest(folder)
    try:
        simulation = Simulation.load(folder / SIMULATION)
    except ConfigError as error:
        raise ModelStoreError(str(error)) from None
    if _digest(folder / SIMULATION) != manifest["simulation"].get("sha256"):
        raise ModelStoreError(
            f"{folder}: {SIMULATION} is not the one of the manifest (sha256 differs); "
            "the network learned what another simulation left over"
        )
    joints = list(simulation.model.joint_names)
    if manifest["joints"] != joints:
        raise ModelStoreError(
            f"{folder}: the manifest is of joints {', '.join(map(str, manifest['joints']))}, but "
            f"{SIMULATION} of {', '.join(joints)}"
        )
    try:
        fitted = _fitted(manifest, (folder / WEIGHTS).read_bytes(), len(joints))
    except OSError as error:
        raise ModelStoreError(f"{folder / WEIGHTS}: cannot be read: {error.strerror}") from None
    except ModelStoreError as error:
        raise ModelStoreError(f"{folder}: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise ModelStoreError(f"{folder / MANIFEST}: cannot be understood: {error!r}") from None
    model = HybridModel(simulation)
    model.fitted_ = fitted
    return model


def check_simulation(model: HybridModel, simulation: Simulation) -> None:
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


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _close(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return all(np.allclose(a[key], b[key], rtol=1e-9, atol=1e-12) for key in a)


def _read_manifest(folder: Path) -> dict[str, Any]:
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
    if manifest.get("network") not in NETWORKS:
        raise ModelStoreError(
            f"{path}: network {manifest.get('network')!r} is unknown; known: {', '.join(NETWORKS)}"
        )
    missing = _REQUIRED - set(manifest)
    if missing:
        raise ModelStoreError(f"{path}: lacks {', '.join(sorted(missing))}")
    if not isinstance(manifest["simulation"], dict):
        raise ModelStoreError(f"{path}: simulation names no file and sha256")
    return manifest


def _fitted(manifest: dict[str, Any], weights: bytes, n: int) -> FittedNetwork:
    if sha256(weights).hexdigest() != manifest["weights"]["sha256"]:
        raise ModelStoreError(f"{WEIGHTS} is not the one of the manifest (sha256 differs)")
    try:
        tensors = load_tensors(weights)
    except SafetensorError as error:
        raise ModelStoreError(f"{WEIGHTS}: {error}") from None
    settings = manifest["features"]
    features = Features(
        n,
        bool(settings["own_joint"]),
        tuple(settings["stop_widths"]),
        tuple(settings["direction_speeds"]),
        float(settings["compliance"]),
        float(settings["reversal"]),
        float(settings["saturation"]),
        tuple(settings["without"]),
    )
    standalone = bool(manifest.get("standalone", False))
    outputs, gain = _output_scaling(manifest["outputs"], _outputs(n, standalone=standalone))
    network = NETWORKS[manifest["network"]](tensors.pop(_COLUMNS), tensors)
    if network.outputs != n or int(network.columns.max()) >= len(features.inputs):
        raise ModelStoreError(f"{WEIGHTS}: {network.outputs} outputs for {n} joints")
    return FittedNetwork(
        features,
        network,
        _input_scaling(manifest["inputs"], features.inputs),
        outputs,
        gain,
        float(manifest["rate"]),
        float(manifest["bandwidth"]),
        manifest.get("training", {}),
        standalone,
    )


def _feature_settings(features: Features) -> dict[str, Any]:
    names = ("own_joint", "stop_widths", "direction_speeds", "compliance")
    names += ("reversal", "saturation", "without")
    return {name: getattr(features, name) for name in names}


def _outputs(n: int, *, standalone: bool) -> tuple[Feature, ...]:
    name = "torque" if standalone else "residual_torque"
    return tuple(Feature(f"{name}_{j + 1}", "N m") for j in range(n))


def _described(features: tuple[Feature, ...], **numbers: FloatArray) -> list[dict[str, Any]]:
    """Return an entry for each feature, with its part of each of the named arrays."""
    return [
        {**asdict(feature), **{name: float(values[i]) for name, values in numbers.items()}}
        for i, feature in enumerate(features)
    ]


def _input_scaling(entries: list[dict[str, Any]], expected: tuple[Feature, ...]) -> InputScaling:
    _check_features(entries, expected, "inputs")
    mean, std = _numbers(entries, "mean", "inputs"), _numbers(entries, "std", "inputs", above=0.0)
    lowest = _numbers(entries, "lowest", "inputs")
    return InputScaling(mean, std, lowest, _numbers(entries, "highest", "inputs"))


def _output_scaling(
    entries: list[dict[str, Any]], expected: tuple[Feature, ...]
) -> tuple[Scaling, FloatArray]:
    """Return normalisation and gain."""
    _check_features(entries, expected, "outputs")
    mean, std = _numbers(entries, "mean", "outputs"), _numbers(entries, "std", "outputs", above=0.0)
    return Scaling(mean, std), _numbers(entries, "gain", "outputs")


def _check_features(
    entries: list[dict[str, Any]], expected: tuple[Feature, ...], what: str
) -> None:
    given = [(entry["name"], entry["unit"]) for entry in entries]
    for i, feature in enumerate(expected):
        if i >= len(given) or given[i] != (feature.name, feature.unit):
            name = given[i] if i < len(given) else "nothing"
            raise ModelStoreError(
                f"{what}: number {i + 1} is {name}, expected {(feature.name, feature.unit)}"
            )
    if len(given) > len(expected):
        raise ModelStoreError(f"{what}: {len(given)} entries, expected {len(expected)}")


def _numbers(
    entries: list[dict[str, Any]], name: str, what: str, *, above: float = -np.inf
) -> FloatArray:
    values: FloatArray = np.array([float(entry[name]) for entry in entries])
    for i, value in enumerate(values):
        if not (np.isfinite(value) and value > above):
            raise ModelStoreError(f"{what}: number {i + 1} has the {name} {value}, which cannot be")
    return values
