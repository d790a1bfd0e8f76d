from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import sampled

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.model_folder import as_manifest, check_simulation, read_manifest
from estimators.neural import NETWORKS
from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.physics import CoulombFriction, Simulation

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.recordings.recording import Recording

SETTINGS = TrainingSettings(
    model="lstm-fcl", features="drive", epochs=1, sequence_length=20, hidden=4
)


@pytest.fixture(scope="module")
def model(rigid: Simulation, training_recording: Recording) -> HybridModel:
    return HybridModel(rigid, SETTINGS).fit([training_recording])


@pytest.fixture
def folder(model: HybridModel, tmp_path: Path) -> Path:
    model.save(tmp_path / "model")
    return tmp_path / "model"


def test_a_loaded_model_predicts_the_same(
    model: HybridModel, folder: Path, test_recording: Recording
) -> None:
    loaded = HybridModel.load(folder)
    np.testing.assert_array_equal(loaded.predict(test_recording), model.predict(test_recording))


@sampled(
    ("kind", "layers"),
    [("lstm-fcl", 2), *((kind, 1) for kind in NETWORKS), ("transformer", 2)],
    "trains a network each",
    first=len(NETWORKS),
)
def test_every_network_is_stored_and_streams(
    rigid: Simulation, test_recording: Recording, tmp_path: Path, kind: str, layers: int
) -> None:
    settings = replace(SETTINGS, model=kind, layers=layers, folds=1)
    recording = test_recording[:1000]
    model = HybridModel(rigid, settings).fit([recording])
    model.save(tmp_path / "model")
    loaded = HybridModel.load(tmp_path / "model")
    assert type(loaded.fitted.network) is NETWORKS[kind]
    predicted = loaded.predict(recording)
    np.testing.assert_array_equal(predicted, model.predict(recording))
    state, motion = loaded.init(100.0), recording.motion(10.0)
    for t in range(50):  # more than two blocks of a transformer
        torque, state = loaded.step(state, motion.sample(t))
        np.testing.assert_allclose(torque, predicted[t], atol=1e-9)


def test_hybrid_is_the_sum_of_its_parts(model: HybridModel, test_recording: Recording) -> None:
    found = model.estimate(test_recording)
    np.testing.assert_allclose(
        found.simulation, model.simulation.predict(test_recording.motion(10.0)), atol=1e-12
    )
    np.testing.assert_allclose(model.predict(test_recording), found.simulation + found.learned)


def test_a_manifest_says_what_the_network_sees(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["inputs"][0]["name"] == "velocity_1"
    assert manifest["inputs"][0]["unit"] == "rad/s"
    assert {"mean", "std", "lowest", "highest"} <= set(manifest["inputs"][0])
    assert all(0.0 <= output["gain"] <= 1.0 for output in manifest["outputs"])
    assert manifest["joints"] == ["shoulder", "elbow"]
    assert (round(manifest["rate"]), manifest["bandwidth"]) == (100, 10.0)
    assert manifest["training"]["recordings"][0]["samples"] == 6000
    assert "torch" in manifest["packages"]
    assert {item.name for item in folder.iterdir()} == {
        "manifest.json",
        "model.safetensors",
        "sim.yaml",
    }


def test_outside_the_training_range_the_network_adds_what_it_adds_at_the_border(
    model: HybridModel,
) -> None:
    inputs = model.fitted.inputs
    far = np.stack([inputs.highest + 100 * inputs.std, inputs.lowest - 100 * inputs.std])
    border = np.stack([inputs.highest, inputs.lowest])
    np.testing.assert_array_equal(inputs.normalise(far), inputs.normalise(border))
    inside = (inputs.lowest + inputs.highest)[None] / 2
    np.testing.assert_allclose(inputs.restore(inputs.normalise(inside)), inside, atol=1e-12)


@pytest.mark.parametrize("times", [0.5, 4.0])
def test_how_sure_it_is_follows_from_how_far_it_is_from_all_of_training(
    model: HybridModel, test_recording: Recording, times: float
) -> None:
    """variance = e² + (d s)², d the farthest input beyond its range, in its deviations."""
    fitted, inputs, position = model.fitted, model.fitted.inputs, test_recording.position
    middle = position.mean(axis=0)
    wider = replace(test_recording, position=middle + times * (position - middle))
    found = model.estimate(wider)
    seen, _ = fitted.features.advance(
        fitted.features.init(), wider.motion(10.0), found.simulation, model.simulation.body
    )
    excess = np.maximum(inputs.lowest - seen, seen - inputs.highest).clip(0.0) / inputs.std
    d = np.stack([excess[:, own].max(axis=1) for own in fitted.columns], axis=1)
    assert (d.max() > 1.0) == (times > 1.0)
    np.testing.assert_allclose(found.std, np.hypot(fitted.error, d * fitted.outputs.std))
    np.testing.assert_array_equal(found.outside, d > 0.1)


def test_the_gain_scales_the_network_of_its_joint(
    model: HybridModel, test_recording: Recording
) -> None:
    scaled = HybridModel(model.simulation)
    scaled.fitted_ = replace(model.fitted, gain=model.fitted.gain * [0.5, 0.0])
    np.testing.assert_allclose(
        scaled.estimate(test_recording).learned,
        model.estimate(test_recording).learned * [0.5, 0.0],
    )


@pytest.mark.slow("starts a process that loads and predicts")
def test_predicting_needs_no_torch(folder: Path) -> None:
    code = (
        "import sys; from estimators.hybrid.model import HybridModel; import numpy as np\n"
        "from limo_driver.types import JointSample\n"
        f"model = HybridModel.load({str(folder)!r}); z = np.zeros(2)\n"
        "model.step(model.init(), JointSample(0.0, z, z, z)); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def edit(folder: Path, **changes: object) -> None:
    entries = dict(read_manifest(folder).content) | changes
    (folder / "manifest.json").write_text(as_manifest(entries))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 2}, "schema is not 1"),
        (
            {"network": "gpt"},
            "network is 'gpt', expected one of mlp7, lstm-2, lstm-fcl, gru, lru, transformer",
        ),
        ({"joints": ["a", "b"]}, "joints a, b, but sim.yaml of shoulder, elbow"),
        ({"inputs": []}, "inputs: number 1 is nothing"),
        ({"outputs": [{"name": "x", "unit": "N m", "mean": 0, "std": 1}]}, "number 1 is"),
        ({"weights": {"sha256": "0"}}, "sha256 differs"),
        ({"simulation": "sim.yaml"}, "simulation is 'sim.yaml', expected an object"),
        ({"features": {}}, "features: lacks own_joint"),
        ({"rate": None}, "rate is None, expected a number from 0.5 to 5500"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(
    folder: Path, changes: dict[str, object], message: str
) -> None:
    edit(folder, **changes)
    with pytest.raises(ModelStoreError, match=message):
        HybridModel.load(folder)


@pytest.mark.parametrize("name", ["manifest.json", "model.safetensors", "sim.yaml"])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(ModelStoreError, match=name):
        HybridModel.load(folder)


def test_a_changed_simulation_is_refused(folder: Path) -> None:
    path = folder / "sim.yaml"
    path.write_text(path.read_text() + "# changed\n")
    with pytest.raises(ModelStoreError, match=r"sim.yaml is not the one of the manifest"):
        HybridModel.load(folder)


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ModelStoreError, match="no such model folder"):
        HybridModel.load(tmp_path / "nothing")


def test_another_sampling_rate(model: HybridModel, test_recording: Recording) -> None:
    assert model.fitted.stride(1000.0) == 10
    with pytest.raises(ModelStoreError, match="remembers at 100 Hz, which samples at 50 Hz"):
        model.predict(test_recording[::2])


@pytest.mark.parametrize("rate", [0.0, -100.0, float("nan"), float("inf")])
def test_a_rate_that_cannot_be(model: HybridModel, rate: float) -> None:
    with pytest.raises(ConfigError, match="has to be above 0 and finite"):
        model.init(rate)


def test_another_simulation_is_named(
    model: HybridModel, rigid: Simulation, arm: Path, tmp_path: Path
) -> None:
    check_simulation(model, rigid)
    heavier = CoulombFriction(joint=2, tau_c=2.0)
    with pytest.raises(
        ModelStoreError, match=r"another simulation \(coulomb_friction of joint 2\)"
    ):
        check_simulation(model, replace(rigid, effects=(rigid.effects[0], heavier)))
    with pytest.raises(ModelStoreError, match="1 effects instead of 2"):
        check_simulation(model, replace(rigid, effects=rigid.effects[:1]))
    with pytest.raises(ModelStoreError, match="of iiwa14"):
        check_simulation(model, Simulation("iiwa14"))
    longer = tmp_path / "two_joints.urdf"
    longer.write_text(arm.read_text().replace('xyz="0.3 0 0"', 'xyz="0.4 0 0"'))
    with pytest.raises(ModelStoreError, match="where its joints are"):
        check_simulation(model, replace(rigid, robot=str(longer)))


def test_a_simulation_read_back_from_its_file_is_the_same(model: HybridModel, folder: Path) -> None:
    check_simulation(model, Simulation.load(folder / "sim.yaml"))
