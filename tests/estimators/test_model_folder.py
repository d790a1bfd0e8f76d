"""Model folders that were edited, damaged or half written: refused by name, never a traceback."""

from __future__ import annotations

import shutil
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.model_folder import as_manifest, load_model, read_manifest
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

NAN = float("nan")
NETWORK = TrainingSettings(
    model="lstm-fcl", features="drive", epochs=1, sequence_length=20, hidden=4, folds=1
)


@pytest.fixture(scope="module")
def folders(
    rigid: Simulation, training_recording: Recording, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("models")
    HybridModel(rigid, NETWORK).fit([training_recording[:1500]]).save(path / "network")
    JointPhysics(rigid).fit([training_recording]).save(path / "physics")
    return path


@pytest.fixture
def network(folders: Path, tmp_path: Path) -> Path:
    return shutil.copytree(folders / "network", tmp_path / "network")


@pytest.fixture
def physics(folders: Path, tmp_path: Path) -> Path:
    return shutil.copytree(folders / "physics", tmp_path / "physics")


def seal(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Edit a manifest as somebody does who knows how it is sealed."""
    values = dict(read_manifest(folder).content)
    change(values)
    (folder / "manifest.json").write_text(as_manifest(values))


def put(folder: Path, **tensors: Any) -> None:
    """Exchange tensors, and let the manifest say so."""
    path = folder / "model.safetensors"
    save_file(load_file(path) | tensors, path)
    digest = sha256(path.read_bytes()).hexdigest()
    seal(folder, lambda m: m["weights"].update(sha256=digest))


COMMON = [
    *[("weights", value, "weights is .*, expected an object") for value in (None, [], 3)],
    ("weights", {}, "weights: lacks sha256"),
    *[("joints", value, "joints is .*, expected a list of texts") for value in (7, None)],
    ("joints", [1, 2], "joints: number 1 is 1, expected a text"),
    *[
        ("estimator", value, "estimator is .*, expected one of hybrid, ")
        for value in ([], None, {})
    ],
    ("simulation", {}, "simulation: lacks sha256"),
    ("robot", "panda", r"of robot panda, but sim\.yaml of .*two_joints"),
    ("robot", None, "robot is None, expected a text"),
    *[("bandwidth", v, "bandwidth is .*, expected a number above 0") for v in (-1, 0, "x", True)],
    *[("training", value, "training is .*, expected an object") for value in (5, None, [])],
    ("training", {"recordings": 3}, "training: recordings is 3, expected a list of objects"),
    ("training", {"rmse": {"held_out": "x"}}, "held_out is 'x', expected"),
]


@pytest.mark.parametrize("kind", ["network", "physics"])
@pytest.mark.parametrize(("name", "value", "message"), COMMON)
def test_an_entry_that_cannot_be_is_named(
    request: pytest.FixtureRequest, kind: str, name: str, value: object, message: str
) -> None:
    folder = request.getfixturevalue(kind)
    seal(folder, lambda m: m.update({name: value}))
    with pytest.raises(ModelStoreError, match=message) as refused:
        load_model(folder)
    assert str(folder) in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *[
            (lambda m, v=v: m.update(rate=v), r"rate is .*, expected a number from 0\.5 to 5500")
            for v in (-200, 0, 10**400, "200")
        ],
        (lambda m: m.update(network=[]), r"network is \[\], expected one of mlp7, "),
        (lambda m: m.update(standalone="no"), "standalone is 'no', expected true or false"),
        (lambda m: m["outputs"][0].update(gain=1e9), "outputs: number 1: gain is 1.*from 0 to 1"),
        (lambda m: m["inputs"][1].update(highest=-1e6), "inputs: number 2: highest is -1000000"),
        (lambda m: m["inputs"][0].update(std=0), "inputs: number 1: std is 0, expected .* above 0"),
        (lambda m: m.update(inputs={}), "inputs is {}, expected a list of objects"),
        (
            lambda m: m["features"].update(stop_widths=[-1]),
            "stop_widths: number 1 is -1, expected a number above 0",
        ),
        (lambda m: m["features"].update(saturation=0), "saturation is 0, expected .* above 0"),
        (
            lambda m: m["training"]["rmse"]["held_out"].update(hybrid=[1, 2, 3]),
            r"hybrid is \[1, 2, 3\], expected a list of 2 numbers",
        ),
        *[
            (
                lambda m, v=v: m["training"]["rmse"].update(left_out={"hybrid": v}),
                f"left_out: hybrid{at} is .*, expected {what} of 0 or more",
            )
            for v, at, what in [
                *[(v, "", "a list of 2 numbers") for v in ("x", [0.1])],
                *[([0.1, v], ": number 2", "a number") for v in (-0.1, None)],
            ]
        ],
        (lambda m: m["training"]["rmse"].update(left_out=None), "left_out is None, expected"),
        (lambda m: m["training"]["rmse"].update(left_out={}), "left_out: lacks hybrid"),
    ],
)
def test_what_a_network_cannot_be_fed_is_named(network: Path, change, message: str) -> None:
    seal(network, change)
    with pytest.raises(ModelStoreError, match=message):
        load_model(network)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c - 100, "columns go down to -100, expected 0 or more"),
        (lambda c: c + 1000, "columns go up to 10.*, expected less than 34"),
        (lambda c: c.astype(np.float32), "columns are float32 of shape"),
        (lambda c: c.ravel(), r"columns are int64 of shape \(34,\), expected integers of shape"),
        (lambda _: np.zeros((0, 0), np.int64), r"columns are int64 of shape \(0, 0\)"),
    ],
)
def test_columns_that_compiled_code_cannot_be_given_are_refused(
    network: Path, change, message: str
) -> None:
    put(network, columns=change(load_file(network / "model.safetensors")["columns"]))
    with pytest.raises(ModelStoreError, match=rf"model\.safetensors: .*{message}"):
        load_model(network)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("noise", lambda a: -a, "noise goes down to -.*, expected at least 1e-100"),
        ("factor", lambda a: 0 * a, "factor goes down to 0, expected at least 1e-100"),
        ("weights", lambda a: a * np.nan, "weights is not finite"),
        ("weights", lambda a: a.astype(np.int32), "weights is int32 of shape .*expected float64"),
        ("root", lambda a: a[0], r"root is float64 of shape \(154, 154\), expected"),
    ],
)
def test_weights_that_cannot_be_are_named(physics: Path, name: str, change, message: str) -> None:
    put(physics, **{name: change(load_file(physics / "model.safetensors")[name])})
    with pytest.raises(ModelStoreError, match=message):
        load_model(physics)


@pytest.mark.parametrize(
    ("old", "new"),
    [('"rate": ', '"rate": 1'), ('"bandwidth": 10.0', '"bandwidth": NaN'), ('"gain"', '"g"')],
)
def test_a_manifest_edited_by_hand_is_refused(network: Path, old: str, new: str) -> None:
    path = network / "manifest.json"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ModelStoreError, match=r"manifest\.json: was changed since it was written"):
        load_model(network)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"[" * 100_000, b"{", b""])
def test_what_is_no_json_is_refused(network: Path, content: bytes) -> None:
    (network / "manifest.json").write_bytes(content)
    with pytest.raises(ModelStoreError, match=r"manifest\.json: is no (JSON|text)"):
        load_model(network)


def test_a_save_that_fails_leaves_the_model_that_was_there(
    folders: Path, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path.name: path.read_bytes() for path in network.iterdir()}
    other = HybridModel.load(folders / "network")
    fitted = other.fitted
    object.__setattr__(fitted, "record", {"loss": NAN})
    with pytest.raises(ModelStoreError, match="the manifest of the model is no JSON"):
        other.save(network)
    object.__setattr__(fitted, "record", {})

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as interrupted:
        interrupted.setattr("pathlib.Path.write_bytes", interrupt)
        with pytest.raises(KeyboardInterrupt):
            other.save(network)
    assert {path.name: path.read_bytes() for path in network.iterdir()} == before
    other.save(network)
    assert load_model(network).fitted.record == {}
    assert sorted(path.name for path in network.iterdir()) == sorted(before)
