"""Save and load the model folder of a hybrid: network, features, scaling, training."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.hybrid.features import Feature, Features
from estimators.hybrid.fitted_network import FittedNetwork, InputScaling, Scaling
from estimators.hybrid.model import HybridModel
from estimators.model_folder import WEIGHTS, ModelFolder, write_folder
from estimators.neural import NETWORKS
from limo_driver.errors import ModelStoreError
from limo_driver.recordings.channels import RATES

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from estimators.neural import Network
    from limo_driver.runtime.declarations import Given, JsonGiven
    from limo_driver.types import FloatArray

_COLUMNS: Final = "columns"  # which inputs each part of the network sees
_RATES: Final = (0.5, RATES[1])  # [Hz], of a network's memory; slower ones would fill the RAM
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
    opened = ModelFolder.open(folder, HybridModel.name)
    model = HybridModel(opened.simulation)
    model.fitted_ = _fitted(opened, model.n)
    return model


def _fitted(opened: ModelFolder, n: int) -> FittedNetwork:
    manifest = opened.manifest
    features = _features(manifest["features"], n)
    standalone = "standalone" in manifest and manifest.flag("standalone")
    outputs, gain = _output_scaling(manifest, _outputs(n, standalone=standalone))
    inputs = _input_scaling(manifest, features.inputs)
    kind = manifest.text("network", tuple(NETWORKS))
    return FittedNetwork(
        features,
        _network(kind, opened, features),
        inputs,
        outputs,
        gain,
        manifest.number("rate", lower=_RATES[0], upper=_RATES[1]),
        opened.bandwidth,
        _record(opened, n),
        standalone,
    )


def _record(opened: ModelFolder, n: int) -> dict[str, Any]:
    """Return what is said of training; the standard deviation follows from its errors."""
    record = opened.record("held_out", "hybrid")
    if "left_out" in record.get("rmse", {}):
        left_out = opened.manifest["training"]["rmse"]["left_out"]
        left_out.numbers("hybrid", n, lower=0.0)
    return record


def _network(kind: str, opened: ModelFolder, features: Features) -> Network:
    """Build the network from its tensors; compiled code reads its columns unchecked."""
    tensors = opened.tensors()
    columns: NDArray[np.int64] = tensors.pop(_COLUMNS, np.zeros((0, 0), np.int64))
    try:
        network = NETWORKS[kind](columns, tensors)
    except ModelStoreError as error:
        raise ModelStoreError(f"{opened.path / WEIGHTS}: {error}") from None
    if int(network.columns.max()) >= len(features.inputs):
        raise ModelStoreError(
            f"{opened.path / WEIGHTS}: columns go up to {int(network.columns.max())}, expected "
            f"less than {len(features.inputs)}, the number of inputs"
        )
    if network.outputs != features.n:
        raise ModelStoreError(
            f"{opened.path / WEIGHTS}: {network.outputs} outputs for {features.n} joints"
        )
    return network


def _features(entries: Given, n: int) -> Features:
    return Features(
        n,
        entries.flag("own_joint"),
        entries.numbers("stop_widths", lower=0.0, above=True),
        entries.numbers("direction_speeds", lower=0.0, above=True),
        entries.number("compliance", lower=0.0),
        entries.number("reversal", lower=0.0, above=True),
        entries.number("saturation", lower=0.0, above=True),
        entries.texts("without"),
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


def _input_scaling(manifest: JsonGiven, expected: tuple[Feature, ...]) -> InputScaling:
    entries = _entries_of(manifest, "inputs", expected)
    mean, std = _numbers(entries, "mean"), _numbers(entries, "std", lower=0.0, above=True)
    lowest = _numbers(entries, "lowest")
    highest = [
        entry.number("highest", lower=low) for entry, low in zip(entries, lowest, strict=True)
    ]
    return InputScaling(mean, std, lowest, np.array(highest))


def _output_scaling(
    manifest: JsonGiven, expected: tuple[Feature, ...]
) -> tuple[Scaling, FloatArray]:
    """Return normalisation and gain."""
    entries = _entries_of(manifest, "outputs", expected)
    gain = np.array([entry.number("gain", lower=0.0, upper=1.0) for entry in entries])
    return Scaling(_numbers(entries, "mean"), _numbers(entries, "std", lower=0.0, above=True)), gain


def _entries_of(manifest: JsonGiven, what: str, expected: tuple[Feature, ...]) -> tuple[Given, ...]:
    """Return the entries of `what`, which have to be those expected, in order."""
    entries = manifest[what].sections()
    given = [(entry.text("name"), entry.text("unit")) for entry in entries]
    for i, feature in enumerate(expected):
        if i >= len(given) or given[i] != (feature.name, feature.unit):
            name = given[i] if i < len(given) else "nothing"
            manifest[what].fail(
                f"number {i + 1} is {name}, expected {(feature.name, feature.unit)}"
            )
    if len(given) > len(expected):
        manifest[what].fail(f"{len(given)} entries, expected {len(expected)}")
    return entries


def _numbers(entries: tuple[Given, ...], name: str, **bounds: Any) -> FloatArray:  # noqa: ANN401  # of a `Parameter`
    return np.array([entry.number(name, **bounds) for entry in entries])
