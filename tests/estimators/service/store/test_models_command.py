"""`limo models`: what a user sees of a store."""

from __future__ import annotations

import json
import re
import shutil
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.service.store.store import ModelStore
from limo_driver.app.cli.models import command
from limo_driver.errors import ModelStoreError, RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording


@pytest.fixture(scope="module")
def place(
    rigid: Simulation,
    training_recording: Recording,
    test_recording: Recording,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """Folder of two models, one of them good, two recordings, and a store of both."""
    path = tmp_path_factory.mktemp("place")
    settings = TrainingSettings(model="mlp7", features="drive", epochs=1, hidden=4, folds=1)
    HybridModel(rigid, settings).fit([training_recording[:800]]).save(path / "poor")
    JointPhysics(rigid).fit([training_recording]).save(path / "good")
    training_recording.save(path / "train.parquet")
    training_recording[:3000].save(path / "short.parquet")
    test_recording.save(path / "test.parquet")
    return path


@pytest.fixture(scope="module")
def store(place: Path) -> Path:
    for name in ("poor", "good"):
        given = [str(place / name), "--golden", str(place / "train.parquet")]
        given += ["--test", str(place / "train.parquet")] if name == "good" else []
        found = run("add", *given, "--store", place / "models")
        assert found.exit_code == 0, found.exception
        assert re.fullmatch(r".*models/two_joints/[12]: version [12]\n", found.stdout)
    return place / "models"


def run(*arguments: object):
    environment = {"COLUMNS": "160", "TERM": "dumb"}
    return CliRunner().invoke(command, [str(a) for a in arguments], env=environment)


def test_a_stray_folder_with_a_number_for_a_name_is_named_and_left_out(
    store: Path, tmp_path: Path, limo
) -> None:
    copy = tmp_path / "models"
    shutil.copytree(store, copy)
    (copy / "two_joints" / "77").mkdir()
    listed = limo("models", "list", "--store", copy, "--json")
    assert listed.returncode == 0
    assert [version["version"] for version in json.loads(listed.stdout)] == [1, 2]
    assert "77" in listed.stderr
    assert "Traceback" not in listed.stderr


def test_promotion_is_seen_in_the_list_and_undone(store: Path) -> None:
    assert run("promote", "1", "--store", store).stdout == "champion: version 1\n"
    found = run("promote", "2", "--reason", "far better", "--store", store)
    assert found.stdout == "champion: version 2 instead of 1\n"
    listed = run("list", "--store", store).stdout
    assert re.search(r"2 +joint-physics .* champion", listed)
    assert re.search(r"1 +hybrid", listed)
    values = json.loads(run("list", "--store", store, "--json").stdout)
    assert [(v["version"], v["aliases"]) for v in values] == [(1, []), (2, ["champion"])]
    shown = run("show", "--store", store).stdout
    assert "promote 1 → 2: far better" in shown
    assert re.search(r"RMSE of elbow +0\.0\d+ N m \(0\.0\d+ to 0\.0\d+\)", shown)
    assert run("rollback", "--store", store).stdout == "champion: version 1 instead of 2\n"
    history = json.loads(run("show", "1", "--store", store, "--json").stdout)["history"]
    assert [change["action"] for change in history] == ["promote", "promote", "rollback"]


def test_a_better_version_is_seen_in_a_comparison(store: Path, place: Path, tmp_path: Path) -> None:
    given = ["--data", place / "train.parquet", "--store", store]
    found = run("compare", 1, 2, *given, "--out", tmp_path / "difference.png", "--block", 2)
    assert found.exit_code == 0, found.exception
    assert "promote: better on average and worse on no joint" in " ".join(found.stdout.split())
    assert (tmp_path / "difference.png").read_bytes().startswith(b"\x89PNG")
    values = json.loads(run("compare", 2, 1, *given, "--block", 2, "--json").stdout)
    assert not values["promote"]
    assert values["reason"].startswith("worse on joint 1, 2")
    assert all(low > 0 for low in values["difference"]["low"])


def test_too_little_data_is_said(store: Path, place: Path) -> None:
    given = ["--store", store, "--data"]
    found = run("compare", 1, 2, *given, place / "short.parquet", "--json")
    assert json.loads(found.stdout)["reason"] == "only 5 blocks, at least 10 are needed"
    refused = run("compare", 1, 2, *given, place / "short.parquet", "--block", 40)
    assert isinstance(refused.exception, RecordingError)
    assert "at least a block of 40 s" in str(refused.exception)


def test_verify_and_sign(store: Path, tmp_path: Path) -> None:
    ed25519 = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ed25519")
    from cryptography.hazmat.primitives import serialization as s

    key = ed25519.Ed25519PrivateKey.generate()
    private, public = tmp_path / "key.pem", tmp_path / "key.pub"
    private.write_bytes(key.private_bytes(s.Encoding.PEM, s.PrivateFormat.PKCS8, s.NoEncryption()))
    public.write_bytes(
        key.public_key().public_bytes(s.Encoding.PEM, s.PublicFormat.SubjectPublicKeyInfo)
    )
    refused = run("verify", 2, "--store", store, "--trust", public)
    assert isinstance(refused.exception, ModelStoreError)
    assert run("sign", private, 2, "--store", store).exit_code == 0
    found = run("verify", 2, "--store", store, "--trust", public)
    assert found.stdout.startswith("version 2: all files as added; its torque differs by ")
    values = json.loads(run("verify", 2, "--store", store, "--json").stdout)
    assert values["deviation"] <= 1e-6
    assert ModelStore(store).open(2).path.joinpath("signature.json").is_file()


def test_an_empty_store_says_what_to_do(tmp_path: Path) -> None:
    found = run("list", "--store", tmp_path / "models")
    assert isinstance(found.exception, ModelStoreError)
    assert "holds no versions; add one first" in str(found.exception)
