"""What the model folder of a hybrid holds: its network, how to feed it, and its training."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.hybrid.features import Feature, Features
from estimators.hybrid.fitted_network import FittedNetwork
from estimators.hybrid.model import HybridModel
from estimators.hybrid.scaling import InputScaling, Scaling
from estimators.model_folder import WEIGHTS, ModelFolder, write_folder
from estimators.neural import NETWORKS
from limo_driver.errors import ModelStoreError
from limo_driver.recordings.recorded_time import RATES

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from estimators.manifest import Entries
    from estimators.neural import Network
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
    features = _features(manifest.entries("features"), n)
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
        manifest.number("rate", least=_RATES[0], most=_RATES[1]),
        opened.bandwidth,
        _record(opened, n),
        standalone,
    )


def _record(opened: ModelFolder, n: int) -> dict[str, Any]:
    """Return what is said of training; the standard deviation follows from its errors."""
    record = opened.record("held_out", "hybrid")
    if "left_out" in record.get("rmse", {}):
        left_out = opened.manifest.entries("training").entries("rmse").entries("left_out")
        left_out.numbers("hybrid", n, least=0.0)
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


def _features(entries: Entries, n: int) -> Features:
    return Features(
        n,
        entries.flag("own_joint"),
        entries.numbers("stop_widths", above=0.0),
        entries.numbers("direction_speeds", above=0.0),
        entries.number("compliance", least=0.0),
        entries.number("reversal", above=0.0),
        entries.number("saturation", above=0.0),
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


def _input_scaling(manifest: Entries, expected: tuple[Feature, ...]) -> InputScaling:
    entries = _entries_of(manifest, "inputs", expected)
    mean, std = _numbers(entries, "mean"), _numbers(entries, "std", above=0.0)
    lowest = _numbers(entries, "lowest")
    highest = [
        entry.number("highest", least=low) for entry, low in zip(entries, lowest, strict=True)
    ]
    return InputScaling(mean, std, lowest, np.array(highest))


def _output_scaling(manifest: Entries, expected: tuple[Feature, ...]) -> tuple[Scaling, FloatArray]:
    """Return normalisation and gain."""
    entries = _entries_of(manifest, "outputs", expected)
    gain = np.array([entry.number("gain", least=0.0, most=1.0) for entry in entries])
    return Scaling(_numbers(entries, "mean"), _numbers(entries, "std", above=0.0)), gain


def _entries_of(manifest: Entries, what: str, expected: tuple[Feature, ...]) -> tuple[Entries, ...]:
    """Return the entries of `what`, which have to be those expected, in order."""
    entries = manifest.list(what)
    given = [(entry.text("name"), entry.text("unit")) for entry in entries]
    for i, feature in enumerate(expected):
        if i >= len(given) or given[i] != (feature.name, feature.unit):
            name = given[i] if i < len(given) else "nothing"
            raise ModelStoreError(
                f"{manifest.place}: {what}: number {i + 1} is {name}, expected "
                f"{(feature.name, feature.unit)}"
            )
    if len(given) > len(expected):
        raise ModelStoreError(
            f"{manifest.place}: {what}: {len(given)} entries, expected {len(expected)}"
        )
    return entries


def _numbers(entries: tuple[Entries, ...], name: str, *, above: float = -np.inf) -> FloatArray:
    return np.array([entry.number(name, above=above) for entry in entries])
