"""Versions are vetted once and read once, and a rollback waits for nobody."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from served_arm import Arm, NotVetted, served

from estimators.service.settings import RetrainingSettings
from estimators.service.store import served_models
from estimators.service.store.served_models import StoreModels
from estimators.service.store.vetting import Demand, Vetted
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.service.store.store import ModelStore
    from limo_driver.physics import Simulation

pytestmark = pytest.mark.waits


def test_a_rollback_goes_before_what_is_being_vetted(
    store: ModelStore, true_arm: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, vetting, go = Arm(20.0), threading.Event(), threading.Event()
    with (
        served(store, tmp_path, RetrainingSettings(), arm, true_arm) as own,
        ThreadPoolExecutor(1) as asker,
    ):
        own.feed(arm.states(true_arm, 2.0))
        own.server.promote("2", "as good")
        own.feed(arm.states(true_arm, 1.0))
        assert own.server.index()["serving"] == "2"

        def vet(*_: object) -> None:
            vetting.set()
            assert go.wait(60.0)

        monkeypatch.setattr(NotVetted, "vet", vet)
        asked = asker.submit(own.server.load, "2")
        assert vetting.wait(60.0)
        facts = own.server.rollback("it is worse")
        go.set()
        with pytest.raises(ModelStoreError, match="version 2: there was a rollback meanwhile"):
            asked.result(60.0)
        assert (facts["version"], facts["before"]) == ("1", "2")
        assert own.server.index()["serving"] == "1"
        assert store.aliases.champion == 1
        own.feed(arm.states(true_arm, 1.0))
        steps = [event.facts for event in own.events if event.kind == "step"]
        assert [(step["before"], step["version"]) for step in steps] == [("1", "2"), ("2", "1")]


def test_a_version_is_vetted_once_for_a_demand(
    store: ModelStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    vetted: list[tuple[str, float]] = []

    def vet(_store: ModelStore, version: str, demand: Demand, **_: object) -> Vetted:
        vetted.append((version, demand.rate))
        return Vetted(ok=version != "2", refused="slow", reason="a step takes too long")

    monkeypatch.setattr(served_models, "vet", vet)
    models = StoreModels(store)
    for rate in (100.0, 100.0, 200.0):
        models.vet("1", Demand(rate, 0.1))
    assert vetted == [("1", 100.0), ("1", 200.0)]
    for _ in range(2):
        with pytest.raises(ModelStoreError, match="version 2 is refused, slow"):
            models.vet("2", Demand(100.0, 0.1))
    assert vetted[2:] == [("2", 100.0)] * 2


def test_a_version_is_read_once(store: ModelStore) -> None:
    models = StoreModels(store)
    assert models.load("1") is models.load("1")
    assert models.load("2") is not models.load("1")
    assert models.physics is models.load("1").simulation
    (store.home / "1" / "version.json").unlink()
    with pytest.raises(ModelStoreError):
        models.load("1")
