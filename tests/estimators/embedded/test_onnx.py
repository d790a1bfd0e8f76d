"""Networks as ONNX: equal in onnxruntime to limo's own, whatever portions they are given in."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime
import pytest
from lanes import sampled

import limo_driver as limo
from estimators.hybrid import HybridModel
from estimators.hybrid.fitted_network import normalise_inputs
from estimators.hybrid.training.settings import TrainingSettings
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

SINGLE = 2e-6  # of the largest torque


def trained(kind: str, features: str, rigid: Simulation, recording: Recording) -> HybridModel:
    settings = TrainingSettings(
        model=kind, features=features, epochs=1, sequence_length=20, rate=50.0, hidden=6, folds=2
    )
    model = HybridModel(rigid, settings).fit([recording])
    # one epoch carries nothing over to other motion, so that torque would be zero
    model.fitted_ = replace(model.fitted, gain=np.ones(model.fitted.features.n))
    return model


def own(model: HybridModel, features: FloatArray) -> FloatArray:
    fitted = model.fitted
    x = features.copy()
    normalise_inputs(x, fitted.inputs.table, fitted.columns)
    y, _ = fitted.network.advance(fitted.network.init(1), x)
    return fitted.slope * y + fitted.offset


@sampled(
    ("kind", "features"),
    [("mlp7", "drive"), ("lstm-fcl", "own-joint"), ("lstm-2", "all-joints"), ("gru", "drive")],
    "exports each network",
)
def test_it_equals_the_network_in_portions_of_any_size(
    kind: str,
    features: str,
    rigid: Simulation,
    record: Callable[[int, float], Recording],
    tmp_path: Path,
) -> None:
    model = trained(kind, features, rigid, record(0, 30.0))
    session = onnxruntime.InferenceSession(limo.export_onnx(model, tmp_path))
    about = session.get_modelmeta().custom_metadata_map
    assert about["features"] == ", ".join(map(str, model.fitted.features.inputs))
    assert float(about["rate"]) == pytest.approx(model.fitted.rate)
    spread = model.fitted.inputs
    size = (60, spread.mean.size)
    given = spread.mean + 2.0 * spread.std * np.random.default_rng(0).standard_normal(size)
    memory = {
        i.name: np.zeros(i.shape, np.float32) for i in session.get_inputs() if i.name != "features"
    }
    names, torque = [o.name for o in session.get_outputs()], []
    for rows in np.split(given, [1, 20, 50]):
        found = session.run(None, {"features": rows.astype(np.float32), **memory})
        torque.append(found[names.index("torque")])
        memory = {name: found[names.index(f"{name}_after")] for name in memory}
    expected = own(model, given)
    assert np.ptp(expected, axis=0).min() > 0.0
    np.testing.assert_allclose(
        np.concatenate(torque), expected, rtol=0, atol=SINGLE * np.abs(expected).max()
    )


def test_what_has_no_network_is_refused(rigid: Simulation, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no network that ONNX could hold"):
        limo.export_onnx(rigid, tmp_path)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
