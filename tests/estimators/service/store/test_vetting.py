"""Vetting: what must not serve is refused by name, and whoever asks goes on."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from estimators.hybrid import HybridModel
from estimators.hybrid.fitted_network import Scaling
from estimators.hybrid.training.settings import TrainingSettings
from estimators.service.store import vetting
from estimators.service.store.adding import as_json
from estimators.service.store.store import ModelStore
from estimators.service.store.version import described
from estimators.service.store.vetting import Demand, check, vet
from limo_driver.errors import ModelStoreError
from limo_driver.runtime.processes import processor_time

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

pytestmark = pytest.mark.waits

LATE = Demand(rate=100.0, delay=0.1, limit=1.0)
SETTINGS = TrainingSettings(
    model="lstm-fcl", features="drive", epochs=1, sequence_length=20, hidden=4, folds=1
)


@pytest.fixture(scope="module")
def filled(
    rigid: Simulation,
    training_recording: Recording,
    test_recording: Recording,
    tmp_path_factory: pytest.TempPathFactory,
) -> ModelStore:
    """A store of a good version and one that diverges."""
    model = HybridModel(rigid, SETTINGS).fit([training_recording[:1500]])
    store, folder = ModelStore(tmp_path_factory.mktemp("models")), tmp_path_factory.mktemp("model")
    model.save(folder)
    store.add(folder, golden=test_recording)
    wild = HybridModel(rigid)
    outputs = model.fitted.outputs
    wild.fitted_ = replace(model.fitted, outputs=Scaling(outputs.mean, outputs.std * 1e9))
    wild.save(folder)
    store.add(folder, golden=test_recording)
    return store


@pytest.fixture
def store(filled: ModelStore, tmp_path: Path) -> ModelStore:
    shutil.copytree(filled.root, tmp_path / "models")
    return ModelStore(tmp_path / "models")


@pytest.mark.slow("starts a process that loads a model")
def test_a_good_version_passes_in_a_process_of_its_own(filled: ModelStore) -> None:
    vetted = vet(filled, 1, LATE)
    assert (vetted.ok, vetted.refused, vetted.reason) == (True, None, "")
    assert 0 < vetted.figures["p50"] <= vetted.figures["p99"] < 1.0
    assert vetted.figures["deviation"] <= 1e-6


@pytest.mark.slow("starts a process that loads a model")
def test_its_command_prints_json(filled: ModelStore) -> None:
    command = [sys.executable, "-m", "estimators.service.store.vetting", str(filled.root), "2"]
    found = subprocess.run(
        [*command, "--rate", "100", "--delay", "0.1"], capture_output=True, text=True, check=True
    )
    values = json.loads(found.stdout)
    assert values["ok"] is False
    assert values["refused"] == "diverging"


def test_a_diverging_version_is_refused(filled: ModelStore) -> None:
    vetted = check(filled, 2, LATE)
    assert vetted.refused == "diverging"
    assert "expected at most the 100 N m of its limit" in vetted.reason


@pytest.mark.parametrize("name", ["model.safetensors", "golden.safetensors", "version.json"])
def test_a_corrupt_version_is_refused(store: ModelStore, name: str) -> None:
    path = store.home / "1" / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    vetted = check(store, 1, LATE)
    assert vetted.refused == "corrupt"
    assert name in vetted.reason


def test_a_version_that_answers_otherwise_is_refused(store: ModelStore) -> None:
    """As when the code that computes the torque is not that of the day it was added."""
    version = store.open(1)
    golden, path = version.golden(), version.path / "golden.safetensors"
    path.write_bytes(replace(golden, torque=golden.torque + 1e-3).as_bytes())
    record = {**version.record, "files": {**version.record["files"], path.name: described(path)}}
    (version.path / "version.json").write_bytes(as_json(record))
    vetted = check(store, 1, LATE)
    assert vetted.refused == "changed"
    assert "of the golden motion, expected" in vetted.reason


@pytest.mark.parametrize(
    ("demand", "reason"),
    [
        (replace(LATE, rate=130.0), "remembers at"),
        (replace(LATE, rate=15.0, delay=1.0), "10 Hz is too high for positions at 15 Hz"),
        (replace(LATE, joints=("elbow", "shoulder")), "expected elbow, shoulder, in this order"),
    ],
)
def test_an_incompatible_version_is_refused(
    filled: ModelStore, demand: Demand, reason: str
) -> None:
    vetted = check(filled, 1, demand)
    assert vetted.refused == "incompatible"
    assert reason in vetted.reason


def test_a_slow_version_is_refused_with_its_figures(filled: ModelStore) -> None:
    vetted = check(filled, 1, replace(LATE, limit=1e-7))
    assert vetted.refused == "slow"
    assert "expected at most 0 µs at 100 Hz" in vetted.reason
    assert vetted.figures["p50"] > 1e-7
    assert Demand(1000.0, 0.1).slowest == pytest.approx(1e-3)


@pytest.mark.slow("waits until a process has hung for 5 s")
def test_a_hanging_version_is_ended(
    filled: ModelStore, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = tmp_path / "pid"
    hang = f"echo $$ > {own}; exec sleep 600"  # a shell is up long before it has hung
    monkeypatch.setattr(vetting, "_COMMAND", ("sh", "-c", hang))
    vetted = vet(filled, 1, LATE, timeout=5.0)
    assert vetted.refused == "hanging"
    assert vetted.reason == "gave no answer within 5 s of a processor"
    with pytest.raises(ProcessLookupError):
        os.kill(int(own.read_text()), 0)


def test_processor_time_is_that_of_a_process_and_its_children() -> None:
    # as of a compiler: the shell waits, and its child computes
    loop = f"{sys.executable} -c 'while True: pass' & wait"
    with subprocess.Popen(["sh", "-c", loop], start_new_session=True) as process:
        try:
            while processor_time(process.pid) < 0.2:
                assert process.poll() is None
                time.sleep(0.01)
        finally:
            os.killpg(process.pid, signal.SIGKILL)
    assert processor_time(process.pid) == 0.0


@pytest.mark.slow("computes for two seconds of a processor")
def test_a_version_that_computes_for_ever_is_ended(
    filled: ModelStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vetting, "_COMMAND", (sys.executable, "-c", "while True: pass"))
    vetted = vet(filled, 1, LATE, timeout=2.0)
    assert vetted.reason == "gave no answer within 2 s of a processor"


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os; os.kill(os.getpid(), 9)", "ended with status -9"),
        ("raise MemoryError('all gone')", "ended with status 1: MemoryError: all gone"),
        ("print('no JSON')", "ended with status 0"),
    ],
)
def test_a_crashing_version_is_refused(
    filled: ModelStore, monkeypatch: pytest.MonkeyPatch, code: str, reason: str
) -> None:
    monkeypatch.setattr(vetting, "_COMMAND", (sys.executable, "-c", code))
    vetted = vet(filled, 1, LATE)
    assert (vetted.refused, vetted.reason) == ("crashed", reason)


def test_a_version_that_is_not_there_is_an_error(filled: ModelStore) -> None:
    with pytest.raises(ModelStoreError, match="has no version 9"):
        vet(filled, 9, LATE)
