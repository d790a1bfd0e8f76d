"""A challenger from logs: what it learns from, what is said of it, and what a crash leaves."""

from __future__ import annotations

import errno
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.service.retraining.logged_motion import Span, newest_motion
from estimators.service.retraining.trainer import TrainingProcess, learned, train
from estimators.service.settings import RetrainingSettings
from estimators.service.store import store as store_module
from estimators.service.store.aliases import check_signing
from estimators.service.store.store import ModelStore
from limo_driver.errors import ConfigError, LimoError, ModelStoreError, RecordingError
from limo_driver.logs.mcap_log import LogLimits, McapLog
from limo_driver.network.messages import JOINT_STATE, LOG, Event, JointStateCodec, Level

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

pytestmark = pytest.mark.waits

NAMES = ("shoulder", "elbow")
START = 1_700_000_000_000_000_000  # [ns]
SETTINGS = RetrainingSettings(seconds=60.0)


def at(seconds: float) -> int:
    return START + round(1e9 * seconds)


def write_log(folder: Path, recording: Recording, *events: tuple[str, float]) -> None:
    """Write joint states, and events at times [s] of them."""
    codec = JointStateCodec(NAMES, "arm")
    with McapLog(folder, "arm", LogLimits(queue=1_000_000)) as log:
        for k, time_ in enumerate(recording.time):
            payload = codec.encode(
                at(time_), recording.position[k], 0 * recording.position[k], recording.torque[k]
            )
            log.write("limo/arm/state/joints", JOINT_STATE, payload, at(time_), at(time_), k)
        for kind, seconds in events:
            facts = {"joint": 2, "state_stamp": at(seconds)}
            event = Event(at(seconds), Level.WARN, kind, "", facts)
            log.write("limo/arm/event", LOG, event.encode(), at(seconds), at(seconds))


@pytest.fixture
def store(rigid: Simulation, training_recording: Recording, tmp_path: Path) -> ModelStore:
    store = ModelStore(tmp_path / "models")
    JointPhysics(rigid).fit([training_recording[:1000]]).save(tmp_path / "model")
    store.add(tmp_path / "model", golden=training_recording)
    store.promote(1, "the first")
    return store


class TestMotion:
    def test_is_the_newest(self, test_recording, tmp_path) -> None:
        write_log(tmp_path, test_recording)
        motion = newest_motion(tmp_path, "arm", NAMES, Span(10.0))
        assert motion.recording.duration == pytest.approx(10.0, abs=0.02)
        np.testing.assert_array_equal(motion.recording.torque[-1], test_recording.torque[-1])
        assert motion.origin["end_ns"] == at(test_recording.time[-1])

    def test_is_without_what_was_in_contact(self, test_recording, tmp_path) -> None:
        events = [("contact", 5.0), ("contact_end", 7.0), ("contact", 25.0)]
        write_log(tmp_path, test_recording, *events)
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0), margin=1.0)
        stamps = np.round(motion.recording.time, 3)
        left_out = set(np.round(test_recording.time, 3)) - set(stamps)
        assert min(left_out) == 4.0
        assert not left_out & set(np.round(np.arange(8.01, 23.99, 0.01), 2))
        assert max(stamps) == 23.99  # the last contact has not ended
        assert motion.contact == pytest.approx(4.0 + 6.0, abs=0.1)

    def test_a_contact_that_began_before_the_log_is_left_out(
        self, test_recording, tmp_path
    ) -> None:
        write_log(tmp_path, test_recording, ("contact_end", 9.0))
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0), margin=1.0)
        assert motion.recording.time[0] == pytest.approx(10.01)

    def test_a_service_that_began_anew_ended_the_contacts(self, test_recording, tmp_path) -> None:
        write_log(tmp_path, test_recording, ("contact", 5.0), ("serving", 9.0))
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0), margin=1.0)
        assert motion.contact == pytest.approx(6.0, abs=0.1)
        assert motion.recording.time[-1] == pytest.approx(test_recording.time[-1])

    @pytest.mark.slow("writes and reads logs for seconds")
    def test_says_what_is_missing(self, test_recording, tmp_path) -> None:
        with pytest.raises(RecordingError, match="holds no logs of arm"):
            newest_motion(tmp_path / "nothing", "arm", NAMES, Span(10.0))
        write_log(tmp_path, test_recording, ("contact", 0.0))
        with pytest.raises(RecordingError, match="all in contact"):
            newest_motion(tmp_path, "arm", NAMES, Span(10.0))
        with pytest.raises(RecordingError, match="of other joints"):
            newest_motion(tmp_path, "arm", ("a", "b"), Span(10.0))


class TestTraining:
    def test_adds_a_version_that_says_where_it_came_from(
        self, store, training_recording, tmp_path
    ) -> None:
        write_log(tmp_path / "logs", training_recording)
        found = train(store, newest_motion(tmp_path / "logs", "arm", NAMES, Span(60.0)), 0.1)
        version = store.open(2)
        assert (found["version"], version.record["parent"]) == (2, 1)
        against = version.record["record"]["metrics"]["against_champion"]
        assert len(against["rmse_challenger"]) == 2
        assert version.record["record"]["data"]["samples"] == 6000
        assert store.verify(2) <= 1e-6
        assert store.aliases.champion == 1

    @pytest.mark.slow("learns a model first")
    def test_of_little_motion_is_refused(self, store, training_recording, tmp_path) -> None:
        write_log(tmp_path / "logs", training_recording[:1500])
        motion = newest_motion(tmp_path / "logs", "arm", NAMES, Span(60.0))
        with pytest.raises(RecordingError, match="only 15 s of motion"):
            train(store, motion, 0.1)


class TestKinds:
    @pytest.fixture
    def hybrid(
        self, rigid: Simulation, training_recording: Recording, tmp_path: Path
    ) -> ModelStore:
        settings = TrainingSettings(
            model="mlp7", features="drive", epochs=1, hidden=4, folds=1, rate=50.0, batch=200
        )
        store = ModelStore(tmp_path / "hybrids")
        HybridModel(rigid, settings).fit([training_recording]).save(tmp_path / "hybrid")
        store.add(tmp_path / "hybrid", golden=training_recording)
        store.promote(1, "the first")
        return store

    @pytest.mark.slow("trains a model")
    def test_a_challenger_is_of_the_kind_of_the_champion(
        self, hybrid, training_recording, tmp_path
    ) -> None:
        write_log(tmp_path / "logs", training_recording)
        motion = newest_motion(tmp_path / "logs", "arm", NAMES, Span(60.0))
        train(hybrid, motion, 0.1)
        first, second = (hybrid.open(number).load() for number in (1, 2))
        assert second.name == "hybrid"
        settings = [model.fitted.record["settings"] for model in (first, second)]
        assert settings[0] | {"device": "cpu"} == settings[1]

    @pytest.mark.slow("trains a model")
    def test_or_of_another_one_if_that_is_wanted(
        self, hybrid, training_recording, tmp_path
    ) -> None:
        write_log(tmp_path / "logs", training_recording)
        motion = newest_motion(tmp_path / "logs", "arm", NAMES, Span(60.0))
        train(hybrid, motion, 0.1, "joint-physics")
        assert hybrid.open(2).estimator == "joint-physics"
        with pytest.raises(ConfigError, match=r"no kind of challenger is 'x'; known: same, joint"):
            train(hybrid, motion, 0.1, "x")

    def test_a_champion_that_does_not_say_how_it_was_trained(
        self, rigid, training_recording
    ) -> None:
        model = HybridModel(rigid)
        model.fitted_ = SimpleNamespace(record={}, bandwidth=10.0)
        with pytest.raises(ModelStoreError, match="does not say how it was trained"):
            learned("same", model, training_recording)


class TestSigning:
    @pytest.fixture
    def keys(self, tmp_path: Path) -> tuple[Path, Path]:
        return write_keys(tmp_path, "own")

    @pytest.mark.slow("trains in a process of its own")
    def test_a_challenger_is_signed_before_it_appears(
        self, store, training_recording, tmp_path, keys
    ) -> None:
        private, public = keys
        store.sign(1, private)
        signing = ModelStore(store.root, None, [public], private)
        write_log(tmp_path / "logs", training_recording)
        settings = replace(SETTINGS, training_limit=300.0)
        process = TrainingProcess(signing, tmp_path / "logs", "arm", settings, Span(60.0), 0.1, 1.0)
        TestProcess.wait(process)
        assert signing.open(2).number == 2
        with pytest.raises(ModelStoreError, match="none of the trusted keys"):
            ModelStore(store.root, None, [write_keys(tmp_path, "other")[1]]).open(2)

    def test_with_a_key_that_nobody_trusts_is_refused(self, tmp_path, keys) -> None:
        check_signing(keys[0])
        check_signing(keys[0], [keys[1]])
        with pytest.raises(ModelStoreError, match="trusted by none of the trusted keys"):
            check_signing(keys[0], [write_keys(tmp_path, "other")[1]])
        with pytest.raises(ModelStoreError, match="cannot be read"):
            check_signing(tmp_path / "nothing.pem")


def write_keys(folder: Path, name: str) -> tuple[Path, Path]:
    """Write a private and a public key."""
    key = Ed25519PrivateKey.generate()
    private, public = folder / f"{name}.pem", folder / f"{name}.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(
        key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    )
    return private, public


@pytest.mark.slow("trains in processes of their own")
class TestProcess:
    def start(self, store: ModelStore, tmp_path: Path, limit: float) -> TrainingProcess:
        settings = replace(SETTINGS, training_limit=limit)
        return TrainingProcess(store, tmp_path / "logs", "arm", settings, Span(60.0), 0.1, 1.0)

    @pytest.mark.slow("trains in a process of its own")
    def test_that_is_killed_leaves_the_store_as_it_was(
        self, store, training_recording, tmp_path
    ) -> None:
        write_log(tmp_path / "logs", training_recording)
        process = self.start(store, tmp_path, 300.0)
        ends = time.monotonic() + 200.0
        while not list(store.home.glob(".adding-*")) and time.monotonic() < ends:
            time.sleep(0.002)
        process.end()
        assert store.numbers() in {(1,), (1, 2)}
        for number in store.numbers():
            store.verify(number)
        added = store.add(tmp_path / "model", golden=training_recording)
        assert not list(store.home.glob(".adding-*"))
        assert store.verify(added.number) <= 1e-6

    def test_that_takes_too_long_is_ended(self, store, training_recording, tmp_path) -> None:
        write_log(tmp_path / "logs", training_recording)
        process = self.start(store, tmp_path, 0.01)
        with pytest.raises(LimoError, match=r"took longer than 0\.01 s"):
            self.wait(process)

    def test_that_fails_says_why(self, store, tmp_path) -> None:
        with pytest.raises(LimoError, match=r"training failed: .*holds no logs of arm"):
            self.wait(self.start(store, tmp_path, 300.0))

    def test_ends_with_whoever_started_it(self, store, training_recording, tmp_path) -> None:
        write_log(tmp_path / "logs", training_recording)
        process = self.start(store, tmp_path, 300.0)
        process._let_go()  # as the end of the process that holds it does
        with pytest.raises(LimoError, match="training ended with status 3"):
            self.wait(process)
        assert store.numbers() == (1,)

    def test_that_finds_the_disk_full_says_so(
        self, store, training_recording, tmp_path, monkeypatch
    ) -> None:
        def full(*_: object) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        write_log(tmp_path / "logs", training_recording)
        motion = newest_motion(tmp_path / "logs", "arm", NAMES, Span(60.0))
        monkeypatch.setattr(store_module, "write", full)
        with pytest.raises(ModelStoreError, match="No space left on device"):
            train(store, motion, 0.1)
        assert store.numbers() == (1,)
        assert not list(store.home.glob(".adding-*"))

    @staticmethod
    def wait(process: TrainingProcess) -> None:
        ends = time.monotonic() + 200.0
        while process.result() is None and time.monotonic() < ends:
            time.sleep(0.02)
