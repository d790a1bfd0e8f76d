"""What training gives: a network, how it is fed, and what of it a model folder holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from estimators.hybrid.features import Feature, Features
from estimators.model_folder import WEIGHTS, ModelFolder
from estimators.neural import NETWORKS, Network
from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.recordings.channels import RATES
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.declarations import ConfigNode, JsonNode
from limo_driver.types import FloatArray, IntArray

_RATE_TOLERANCE: Final = 0.1  # of the network's rate; beyond it, its memory runs at another speed
MEAN, STD, LOWEST, HIGHEST = 0, 1, 2, 3  # rows of the table of an `InputScaling`
_NONE = np.zeros((0, 0), np.int64)  # columns, where nobody asks how far they are beyond


@dataclass(frozen=True)
class FittedNetwork:
    """Result of training: a network, its features and their scaling."""

    features: Features
    network: Network
    inputs: InputScaling
    outputs: Scaling  # of the residual torque, or of the whole if it stands alone [N m]
    gain: FloatArray  # (n,) in [0, 1], how much of its torque carried over to motion held out
    rate: float  # rate of the samples that follow each other in the network's memory [Hz]
    bandwidth: float  # of the filters on motion and torque in training [Hz]
    record: Mapping[str, Any] = field(default_factory=dict)  # settings, data and metrics, as JSON
    standalone: bool = False  # no rigid-body torque goes into it or is added to it

    @cached_property
    def columns(self) -> IntArray:
        """Inputs that the network of each joint may use, (n, f)."""
        return self.features.columns

    @cached_property
    def error(self) -> FloatArray:
        """Root mean square error on motion not trained on, (n,) [N m]; NaN if there was none.

        On stretches left out whole if there were any, else on what was held out: blocks, which
        chose the weights that were kept, and whose neighbours are alike and were trained on.
        """
        rmse = self.record.get("rmse", {})
        known = rmse.get("left_out", rmse.get("held_out", {})).get("hybrid")
        return np.full(self.features.n, np.nan) if known is None else np.array(known)

    @cached_property
    def slope(self) -> FloatArray:
        """Torque by the network's output, (n,) [N m]."""
        return self.gain * self.outputs.std

    @cached_property
    def offset(self) -> FloatArray:
        """Torque where the network's output is zero, (n,) [N m]."""
        return self.gain * self.outputs.mean

    def stride(self, rate: float) -> int:
        """Return how many samples at `rate` [Hz] the network's memory spans at a time.

        Raises:
            ConfigError: The network has a memory, and the rate is no positive number.
            ModelStoreError: The network has a memory and its rate cannot be reached.
        """
        if not self.network.recurrent:
            return 1
        if not 0 < rate < np.inf:
            raise ConfigError(f"rate = {rate:g} Hz has to be above 0 and finite")
        stride = max(1, round(rate / self.rate))
        if abs(rate / stride / self.rate - 1.0) > _RATE_TOLERANCE:
            raise ModelStoreError(
                f"the model remembers at {self.rate:.4g} Hz, which samples at {rate:.4g} Hz cannot "
                f"give; train one at {rate / stride:.4g} Hz, or record at a multiple of its rate"
            )
        return stride


@dataclass(frozen=True)
class Scaling:
    """Normalisation inside the model: x_norm = (x - mean) / std."""

    mean: FloatArray  # (d,)
    std: FloatArray  # (d,), above 0

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> Scaling:
        """Return mean and standard deviation of (T, d); a constant column gets std 1."""
        std = values.std(axis=0, dtype=np.float64)
        return cls(values.mean(axis=0, dtype=np.float64), np.where(std > 0, std, 1.0))

    def normalise(self, values: NDArray[np.floating]) -> FloatArray:
        """Return (T, d) without unit."""
        return (values - self.mean) / self.std

    def restore(self, values: FloatArray) -> FloatArray:
        """Invert `normalise`."""
        return values * self.std + self.mean


@dataclass(frozen=True)
class InputScaling(Scaling):
    """Normalisation of inputs, which first brings them into the range that training saw.

    A network has learned nothing outside: the clip bounds what it adds to the rigid body there.
    """

    lowest: FloatArray  # (d,)
    highest: FloatArray  # (d,)

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> InputScaling:
        """Return mean, standard deviation and range of (T, d)."""
        scaling = Scaling.of(values)
        lowest, highest = (f(values, axis=0).astype(np.float64) for f in (np.min, np.max))
        return cls(scaling.mean, scaling.std, lowest, highest)

    @cached_property
    def table(self) -> FloatArray:
        """All four for compiled code, (4, d)."""
        return np.array([self.mean, self.std, self.lowest, self.highest], dtype=np.float64)

    def normalise(self, values: NDArray[np.floating]) -> FloatArray:
        """Return (T, d), clipped to the range, without unit."""
        inputs = np.array(values, dtype=np.float64)
        normalise_inputs(inputs, self.table, _NONE)
        return inputs


@compiled(reads=("table", "columns"), nogil=True)
def normalise_inputs(inputs: FloatArray, table: FloatArray, columns: IntArray) -> FloatArray:
    """Clip and normalise inputs (T, d), in place, by the table (4, d) of an `InputScaling`.

    Returns:
        How far the farthest of the inputs `columns` (m, f) lay beyond its range, in standard
        deviations, (T, m).
    """
    beyond = np.zeros((inputs.shape[0], columns.shape[0]))
    for t in range(inputs.shape[0]):
        x = inputs[t]
        for j in range(columns.shape[0]):
            for i in columns[j]:
                excess = max(table[LOWEST, i] - x[i], x[i] - table[HIGHEST, i])
                beyond[t, j] = max(beyond[t, j], excess / table[STD, i])
        for i in range(x.size):
            inside = min(max(x[i], table[LOWEST, i]), table[HIGHEST, i])
            x[i] = (inside - table[MEAN, i]) / table[STD, i]
    return beyond


_COLUMNS: Final = "columns"  # which inputs each part of the network sees
_RATES: Final = (0.5, RATES[1])  # [Hz], of a network's memory; slower ones would fill the RAM
PACKAGES: Final = ("limo", "numpy", "torch", "safetensors", "pin")


def entries_of(fitted: FittedNetwork) -> dict[str, Any]:
    """Return what the manifest says of a fitted network: all that prediction needs, but weights."""
    names = ("own_joint", "stop_widths", "direction_speeds", "compliance")
    names += ("reversal", "saturation", "without")
    return {
        "network": fitted.network.kind,
        "rate": fitted.rate,
        "bandwidth": fitted.bandwidth,
        "standalone": fitted.standalone,
        "features": {name: getattr(fitted.features, name) for name in names},
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


def tensors_in(fitted: FittedNetwork) -> dict[str, Any]:
    """Return the weights of a fitted network, and which inputs each of its parts sees."""
    return {**fitted.network.weights, _COLUMNS: fitted.network.columns}


def fitted_in(opened: ModelFolder) -> FittedNetwork:
    """Read a fitted network.

    Raises:
        ModelStoreError: A file does not fit the others; the message names it.
    """
    manifest, n = opened.manifest, opened.simulation.model.n
    features = _features(manifest["features"], n)
    standalone = "standalone" in manifest and manifest.flag("standalone")
    outputs, gain = _output_scaling(manifest, _outputs(n, standalone=standalone))
    entries = _entries_of(manifest, "inputs", features.inputs)
    mean, std = _numbers(entries, "mean"), _numbers(entries, "std", lower=0.0, above=True)
    lowest = _numbers(entries, "lowest")
    highest = [
        entry.number("highest", lower=low) for entry, low in zip(entries, lowest, strict=True)
    ]
    inputs = InputScaling(mean, std, lowest, np.array(highest))
    kind = manifest.text("network", tuple(NETWORKS))
    # What is said of training; the standard deviation follows from its errors
    record = opened.record("held_out", "hybrid")
    if "left_out" in record.get("rmse", {}):
        left_out = opened.manifest["training"]["rmse"]["left_out"]
        left_out.numbers("hybrid", n, lower=0.0)
    return FittedNetwork(
        features,
        _network(kind, opened, features),
        inputs,
        outputs,
        gain,
        manifest.number("rate", lower=_RATES[0], upper=_RATES[1]),
        opened.bandwidth,
        record,
        standalone,
    )


def _network(kind: str, opened: ModelFolder, features: Features) -> Network:
    """Build the network from its tensors; compiled code reads its columns unchecked."""
    tensors = opened.tensors()
    columns: IntArray = tensors.pop(_COLUMNS, np.zeros((0, 0), np.int64))
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


def _features(entries: ConfigNode, n: int) -> Features:
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


def _outputs(n: int, *, standalone: bool) -> tuple[Feature, ...]:
    name = "torque" if standalone else "residual_torque"
    return tuple(Feature(f"{name}_{j + 1}", "N m") for j in range(n))


def _described(features: tuple[Feature, ...], **numbers: FloatArray) -> list[dict[str, Any]]:
    """Return an entry for each feature, with its part of each of the named arrays."""
    return [
        {**asdict(feature), **{name: float(values[i]) for name, values in numbers.items()}}
        for i, feature in enumerate(features)
    ]


def _output_scaling(
    manifest: JsonNode, expected: tuple[Feature, ...]
) -> tuple[Scaling, FloatArray]:
    """Return normalisation and gain."""
    entries = _entries_of(manifest, "outputs", expected)
    gain = np.array([entry.number("gain", lower=0.0, upper=1.0) for entry in entries])
    return Scaling(_numbers(entries, "mean"), _numbers(entries, "std", lower=0.0, above=True)), gain


def _entries_of(
    manifest: JsonNode, what: str, expected: tuple[Feature, ...]
) -> tuple[ConfigNode, ...]:
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


def _numbers(entries: tuple[ConfigNode, ...], name: str, **bounds: Any) -> FloatArray:  # noqa: ANN401  # of a `Parameter`
    return np.array([entry.number(name, **bounds) for entry in entries])
