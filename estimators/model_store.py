"""What the model folder of a hybrid holds: its network, how to feed it, and its training."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.features import Feature, Features
from estimators.hybrid import FittedNetwork, HybridModel
from estimators.model_folder import MANIFEST, WEIGHTS, ModelFolder, write_folder
from estimators.neural import NETWORKS
from estimators.scaling import InputScaling, Scaling
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.types import FloatArray

_COLUMNS: Final = "columns"  # which inputs each part of the network sees
_REQUIRED: Final = frozenset(("features", "inputs", "outputs", "rate", "bandwidth"))
_PACKAGES: Final = ("limo", "numpy", "torch", "safetensors", "pin")


def save(model: HybridModel, folder: Path | str) -> None:
    """Write a model folder; it holds all that prediction needs.

    Raises:
        NotFittedError: Nothing was trained.
        ModelStoreError: The folder cannot be written.
    """
    fitted = model.fitted
    entries: dict[str, Any] = {
        "estimator": model.name,
        "network": fitted.network.kind,
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
        "training": dict(fitted.record),
    }
    tensors: dict[str, Any] = {**fitted.network.weights, _COLUMNS: fitted.network.columns}
    write_folder(folder, entries, tensors, model.simulation, _PACKAGES)


def load(folder: Path | str) -> HybridModel:
    """Read a model folder.

    Raises:
        ModelStoreError: A file is missing or does not fit the others; the message names it.
    """
    opened = ModelFolder.open(folder, HybridModel.name, _REQUIRED)
    path, manifest = opened.path, opened.manifest
    if manifest.get("network") not in NETWORKS:
        raise ModelStoreError(
            f"{path / MANIFEST}: network {manifest.get('network')!r} is unknown; known: "
            f"{', '.join(NETWORKS)}"
        )
    model = HybridModel(opened.simulation)
    try:
        model.fitted_ = _fitted(manifest, opened.tensors(), model.simulation.model.n)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelStoreError(f"{path / MANIFEST}: cannot be understood: {error!r}") from None
    return model


def _fitted(manifest: dict[str, Any], tensors: dict[str, Any], n: int) -> FittedNetwork:
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
