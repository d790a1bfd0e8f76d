"""Retraining that is interrupted: by the end of the service, by hand, by a full disk."""

from __future__ import annotations

import errno
import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from served_arm import Arm, served

from estimators.service.retraining import judge
from estimators.service.retraining.judge import (
    GATHERING,
    PROBATION,
    TRAINING,
    RetrainingFile,
    Unfinished,
)
from estimators.service.settings import RetrainingSettings
from limo_driver.errors import LimoError, ModelStoreError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from pathlib import Path
    from typing import TypeAlias

    from served_arm import Served

    from estimators.service.store.served_models import StoreModels
    from estimators.service.store.store import ModelStore
    from limo_driver.physics import Simulation

    Serve: TypeAlias = Callable[..., AbstractContextManager[Served]]

pytestmark = pytest.mark.waits

SETTINGS = RetrainingSettings(
    seconds=2.0, pause=1.0, shadow=50.0, shadow_limit=120.0, probation=60.0
)


class FailingTraining:
    """A training that fails at once."""

    def __init__(self, *_: object) -> None:
        pass

    def result(self) -> None:
        raise LimoError("training ended with status -9")

    def end(self) -> None:
        pass


@pytest.fixture
def training_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimators.service.retraining.retraining.TrainingProcess", FailingTraining)


@pytest.fixture
def serve(store: ModelStore, tmp_path: Path, true_arm: Simulation) -> Serve:
    """Serve the store, and feed the service so many seconds of an arm's states."""

    @contextmanager
    def serve(
        seconds: float, physics: Simulation = true_arm, settings: RetrainingSettings = SETTINGS
    ) -> Iterator[Served]:
        arm = Arm(100.0)
        with served(store, tmp_path, settings, arm, physics) as run:
            run.feed(arm.states(physics, seconds))
            yield run

    return serve


def left(store: ModelStore, what: Unfinished | None = None) -> RetrainingFile:
    file = RetrainingFile(store.home, "arm")
    if what is not None:
        file.write(what)
    return file


class TestProbation:
    @pytest.mark.slow("serves two services")
    def test_goes_on_in_the_next_service_and_sends_back_what_is_worse(
        self, store: ModelStore, tmp_path: Path, true_arm: Simulation, worn_arm: Simulation
    ) -> None:
        store.challenge(2, "left over")
        arm = Arm(300.0)
        with served(store, tmp_path, SETTINGS, arm, worn_arm) as run:
            run.feed(arm.states(worn_arm, 58.0))
            assert run.stage == "probation"
        kept = left(store).read()
        assert kept is not None
        assert (kept.stage, kept.champion, kept.before) == (PROBATION, 2, 1)
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 1.0))
            assert run.stage == "probation"
            run.feed(arm.states(true_arm, 62.0))
        phases = ["waiting", "preparing", "serving"]
        assert run.kinds == [*phases, "probation", "swap", "rollback", "step"]
        assert store.aliases.champion == 1
        assert left(store).read() is None

    def test_is_over_where_somebody_made_another_one_the_champion(
        self, store: ModelStore, serve: Serve
    ) -> None:
        left(store, Unfinished(PROBATION, "drift", 0, champion=2, before=1))
        with serve(2.0) as run:
            assert run.stage == "idle"
        assert "probation of 2 is over: 1 is the champion" in run.event("probation_ended").text
        assert left(store).read() is None

    def test_a_champion_that_cannot_be_loaded_is_sent_back(
        self, store: ModelStore, serve: Serve
    ) -> None:
        store.promote(2, "better")
        left(store, Unfinished(PROBATION, "drift", 0, champion=2, before=1))
        (store.home / "2" / "model.safetensors").write_bytes(b"")
        with serve(2.0) as run:
            pass
        assert "version 2 could not be served" in run.event("rollback").text
        assert store.aliases.champion == 1

    @pytest.mark.slow("streams a minute through two models")
    def test_going_back_is_tried_again_where_it_fails(
        self,
        store: ModelStore,
        tmp_path: Path,
        true_arm: Simulation,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        store.promote(2, "better")
        left(store, Unfinished(PROBATION, "drift", 0, champion=2, before=1))
        (store.home / "2" / "model.safetensors").write_bytes(b"")
        arm, refusals = Arm(100.0), iter([True])
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            models = type(run.server.models)
            rollback = models.rollback

            def refused_once(own: StoreModels, reason: str, instead_of: str | None) -> None:
                if next(refusals, False):
                    raise ModelStoreError("aliases.json: no space left on device")
                rollback(own, reason, instead_of)

            monkeypatch.setattr(models, "rollback", refused_once)
            run.feed(arm.states(true_arm, 3.0))
            assert store.aliases.champion == 2
            run.feed(arm.states(true_arm, 60.0))
        assert store.aliases.champion == 1
        assert run.kinds.count("rollback") == 1


class TestTraining:
    @pytest.mark.usefixtures("training_fails")
    @pytest.mark.parametrize(
        ("stage", "tries", "seconds", "told"),
        [
            (GATHERING, 3, 12.0, "ended with status -9"),  # a drift, which is told but once
            (TRAINING, 1, 3.0, "ended with status -9"),
            (TRAINING, 0, 3.0, "not tried again: drift on joint 1"),
        ],
    )
    def test_is_begun_again_after_it_failed_or_ended_with_the_service_but_not_for_ever(
        self, store: ModelStore, serve: Serve, stage: str, tries: int, seconds: float, told: str
    ) -> None:
        left(store, Unfinished(stage, "drift on joint 1", tries=tries))
        with serve(seconds) as run:
            assert run.stage == "idle"
        assert run.kinds.count("training") == tries
        assert told in run.event("refused").text
        assert left(store).read() is None

    def test_is_noted_before_it_begins(
        self, store: ModelStore, monkeypatch: pytest.MonkeyPatch, serve: Serve
    ) -> None:
        monkeypatch.setattr(
            "estimators.service.retraining.retraining.TrainingProcess", FailingTraining
        )
        monkeypatch.setattr(FailingTraining, "result", lambda _: None)  # goes on for ever
        left(store, Unfinished(GATHERING, "drift on joint 1", tries=3))
        with serve(4.0) as run:
            assert run.stage == "training"
        assert left(store).read() == Unfinished(TRAINING, "drift on joint 1", tries=2)

    @pytest.mark.usefixtures("training_fails")
    def test_is_not_waited_for_by_who_asks_while_motion_is_gathered(
        self, store: ModelStore, tmp_path: Path, true_arm: Simulation
    ) -> None:
        settings = RetrainingSettings(seconds=1000.0, pause=1.0)
        left(store, Unfinished(GATHERING, "drift on joint 1", tries=1))
        arm = Arm(10.0)
        with served(store, tmp_path, settings, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 2.0))
            assert run.stage == "gathering"
            run.server.retrain("now")
            run.feed(arm.states(true_arm, 2.0))
        assert run.kinds.count("training") == 1


class TestByHand:
    @pytest.mark.slow("streams a minute through two models")
    def test_a_challenger_replaces_only_the_champion_that_it_was_judged_against(
        self, store: ModelStore, tmp_path: Path, worn_arm: Simulation
    ) -> None:
        store.add(store.open(1).path, golden=golden(store), parent=1)
        store.challenge(2, "left over")
        arm = Arm(100.0)
        with served(store, tmp_path, SETTINGS, arm, worn_arm) as run:
            run.feed(arm.states(worn_arm, 30.0))
            store.promote(3, "by hand, on the folder")
            run.feed(arm.states(worn_arm, 30.0))
            assert run.server.service is not None
            assert run.server.service.model.version == "1"
        assert "3 is the champion by now, not 1" in run.event("refused").text
        assert (store.aliases.champion, store.aliases.challenger) == (3, None)

    def test_a_challenger_that_was_deleted_is_dropped(
        self, store: ModelStore, serve: Serve
    ) -> None:
        store.challenge(2, "left over")
        shutil.rmtree(store.home / "2")
        with serve(3.0) as run:
            assert run.stage == "idle"
        assert "challenger 2 is dropped" in run.event("refused").text
        assert store.aliases.challenger is None

    def test_asking_is_refused_where_the_champion_does_not_serve(self, serve: Serve) -> None:
        with serve(1.0) as run:
            run.server.load("2")
            with pytest.raises(LimoError, match="2 serves, but the champion is 1"):
                run.server.retrain("to see")


class TestVetting:
    def test_that_refuses_a_challenger_drops_it(
        self,
        store: ModelStore,
        tmp_path: Path,
        true_arm: Simulation,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        def vet(*_: object) -> None:
            raise ModelStoreError("version 2 is refused, crashed: ended with status -11")

        store.challenge(2, "left over")
        arm = Arm(10.0)
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            monkeypatch.setattr(type(run.server.models), "vet", vet)
            run.feed(arm.states(true_arm, 3.0))
            assert run.stage == "idle"
        assert run.event("refused").facts["stage"] == "vetting"
        assert "challenger 2 is dropped: version 2 is refused, crashed" in run.event("refused").text
        assert (store.aliases.champion, store.aliases.challenger) == (1, None)

    def test_waits_for_no_minute_of_states_when_the_service_ends(
        self, store: ModelStore, tmp_path: Path, true_arm: Simulation
    ) -> None:
        store.challenge(2, "left over")
        arm = Arm(30.0)
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 20.0))
            before = run.keeper.status()["judged"]
            run.keeper.close()
            run.feed(arm.states(true_arm, 0.5))
        assert run.keeper.status()["judged"] == before
        assert store.aliases.challenger == 2


class TestFile:
    @pytest.mark.parametrize(
        ("content", "why"),
        [
            ("{", "no JSON"),
            ("[]", "schema"),
            ('{"schema": 1, "stage": "training"}', "reason is missing"),
            (
                '{"schema": 1, "stage": "x", "reason": "", "tries": 1, "champion": null, '
                '"before": null, "foretold": null}',
                "stage is 'x', expected one of gathering",
            ),
        ],
    )
    def test_that_cannot_be_understood_is_told_and_forgotten(
        self, store: ModelStore, content: str, why: str, serve: Serve
    ) -> None:
        path = store.home / "retraining-arm.json"
        path.write_text(content)
        with pytest.raises(ModelStoreError, match=why):
            RetrainingFile(store.home, "arm").read()
        if why != "no JSON":
            return
        with serve(2.0) as run:
            assert run.stage == "idle"
        assert "no JSON" in run.event("refused").text
        assert not path.exists()

    @pytest.mark.usefixtures("training_fails")
    def test_that_a_full_disk_does_not_take_is_told_and_retraining_goes_on(
        self, store: ModelStore, monkeypatch: pytest.MonkeyPatch, serve: Serve
    ) -> None:
        def full(*_: object) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        left(store, Unfinished(GATHERING, "drift on joint 1", tries=1))
        monkeypatch.setattr(judge, "replace", full)
        with serve(4.0) as run:
            assert run.stage == "idle"
        assert "No space left on device" in run.event("failure").text
        assert run.kinds.count("training") == 1

    def test_keeps_a_ratio_that_is_not_known(self, store: ModelStore) -> None:
        what = Unfinished(PROBATION, "drift", 0, 2, 1, [1.5, None])
        assert left(store, what).read() == what


def golden(store: ModelStore) -> Recording:
    kept = store.open(1).golden()
    return Recording.from_arrays(kept.time, kept.position, kept.torque)
