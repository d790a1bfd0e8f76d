"""From drift to a better champion, and back where it is none."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from served_arm import Arm, Served, served

from estimators.service.settings import RetrainingSettings
from limo_driver.errors import ConfigError, LimoError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.service.store.store import ModelStore
    from limo_driver.physics import Simulation

pytestmark = pytest.mark.waits

SETTINGS = RetrainingSettings(
    seconds=40.0, pause=1.0, shadow=50.0, shadow_limit=120.0, probation=60.0
)


def rms(seconds: list[list[float]]) -> np.ndarray:
    return np.sqrt(np.mean(np.square(seconds), axis=0))


@pytest.mark.slow("trains in a process of its own, and feeds 400 s of motion")
def test_friction_that_changed_is_learned_and_the_residual_falls(
    store: ModelStore, tmp_path: Path, true_arm: Simulation, worn_arm: Simulation
) -> None:
    arm = Arm(600.0)
    with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
        run.feed(arm.states(true_arm, 150.0))
        healthy = rms(run.residual[-60:])
        assert run.stage == "idle"
        assert "drift" not in run.kinds

        run.feed(arm.states(worn_arm, 60.0))
        assert run.event("drift").facts["joints"]
        worn = rms(run.residual[-20:])
        assert (worn > 2 * healthy).all()

        run.feed(arm.states(worn_arm, 41.0))
        assert run.stage == "training"
        run.sync()
        run.wait_while("training")
        assert run.stage in {"vetting", "shadow"}
        status = run.feed(arm.states(worn_arm, 60.0))
        assert status["retraining"]["stage"] in {"shadow", "probation"}
        assert status["retraining"].get("challenger", "3") == "3"
        run.feed(arm.states(worn_arm, 80.0))
        assert run.kinds[-1] == "probation_passed"

    assert "changed" in run.kinds  # each joint whose friction did
    assert " ".join(kind for kind in run.kinds if kind != "changed") == (
        "waiting preparing serving drift training trained shadow shadow swap promoted "
        "step probation_passed"
    )
    assert (rms(run.residual[-40:]) < 0.5 * worn).all()
    record = store.open("champion").record
    assert (record["version"], record["parent"]) == (3, 1)
    assert store.aliases.challenger is None
    metrics, data = record["record"]["metrics"], record["record"]["data"]
    assert metrics["against_champion"]["mean_ratio"]["value"] < 1.0
    assert data["end_ns"] - data["start_ns"] == pytest.approx(40e9, rel=0.1)
    assert data["logs"][0].startswith("arm_")


class TestJudgement:
    """A challenger that the service before left is judged, which spares a training."""

    def judged(
        self, store: ModelStore, tmp_path: Path, arm: Arm, *parts: tuple[Simulation, float]
    ) -> Served:
        with served(store, tmp_path, SETTINGS, arm, parts[0][0]) as run:
            for physics, seconds in parts:
                run.feed(arm.states(physics, seconds))
        return run

    @pytest.mark.slow("streams minutes through two models")
    def test_a_worse_challenger_is_dropped(self, store, tmp_path, true_arm) -> None:
        store.challenge(2, "left over")
        run = self.judged(store, tmp_path, Arm(200.0), (true_arm, 60.0))
        assert run.server.service.model.version == "1"
        assert "promoted" not in run.kinds
        assert run.event("refused").facts["version"] == "2"
        assert "worse" in run.event("refused").text
        assert store.aliases.challenger is None
        assert store.aliases.champion == 1

    @pytest.mark.slow("serves for minutes of states")
    def test_an_equal_challenger_is_dropped_when_time_is_over(
        self, store, tmp_path, true_arm
    ) -> None:
        store.add(store.open(1).path, golden=self.golden(store), parent=1)
        store.challenge(3, "left over")
        run = self.judged(store, tmp_path, Arm(200.0), (true_arm, 130.0))
        assert "undecided after 120 s" in run.event("refused").text
        assert store.aliases.challenger is None

    @pytest.mark.slow("serves for minutes of states")
    def test_a_champion_that_is_worse_on_probation_goes_back(
        self, store, tmp_path, true_arm, worn_arm
    ) -> None:
        store.challenge(2, "left over")
        run = self.judged(store, tmp_path, Arm(300.0), (worn_arm, 58.0), (true_arm, 70.0))
        order = ["promoted", "rollback"]
        assert [kind for kind in run.kinds if kind in order] == order
        assert run.server.service.model.version == "1"
        assert store.aliases.champion == 1
        assert "probation" in run.event("rollback").text

    @staticmethod
    def golden(store: ModelStore) -> Recording:
        golden = store.open(1).golden()
        return Recording.from_arrays(golden.time, golden.position, golden.torque)


class TestAsking:
    def test_is_refused_while_another_training_goes_on(self, store, tmp_path, true_arm) -> None:
        arm = Arm(60.0)
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 2.0))
            assert run.server.retrain("to see")["stage"] == "idle"
            with pytest.raises(LimoError, match="cannot train now"):
                run.server.retrain("again")

    @pytest.mark.slow("trains a model in a process of its own")
    def test_is_refused_too_shortly_after_the_last(self, store, tmp_path, true_arm) -> None:
        arm = Arm(60.0)
        settings = RetrainingSettings(seconds=10.0, pause=30.0)
        with served(store, tmp_path, settings, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 5.0))
            run.server.retrain("to see")
            run.keeper.tick()
            run.wait_while("training")
            # Five seconds are too few to learn from.
            assert "of motion outside of contact" in run.event("refused").text
            run.keeper.tick()
            with pytest.raises(LimoError, match="too short ago"):
                run.server.retrain("again")
            assert store.numbers() == (1, 2)

    def test_is_refused_where_nothing_retrains(self, store, tmp_path, true_arm) -> None:
        with served(store, tmp_path, SETTINGS, Arm(5.0), true_arm) as run:
            run.server.keeper = None
            with pytest.raises(LimoError, match="does not retrain"):
                run.server.retrain("to see")


class FakeTraining:
    """A training that fails at once, in one of two ways."""

    error: Exception = LimoError("no logs")

    def __init__(self, *_: object) -> None:
        pass

    def result(self) -> None:
        raise self.error

    def end(self) -> None:
        pass


class TestOtherReasons:
    @pytest.mark.slow("streams half a minute of motion")
    def test_the_schedule_calls_for_training_now_and_then(
        self, store, tmp_path, true_arm, monkeypatch
    ) -> None:
        monkeypatch.setattr(
            "estimators.service.retraining.retraining.TrainingProcess", FakeTraining
        )
        arm, settings = Arm(30.0), RetrainingSettings(every=10.0, pause=1.0)
        with served(store, tmp_path, settings, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 25.0))
        assert run.kinds.count("training") == 2
        assert "h since the last" in run.event("training").text
        assert run.event("refused").text == "no logs"

    @pytest.mark.slow("streams half a minute of motion")
    def test_a_failure_of_the_program_is_told_and_life_goes_on(
        self, store, tmp_path, true_arm, monkeypatch
    ) -> None:
        monkeypatch.setattr(
            "estimators.service.retraining.retraining.TrainingProcess", FakeTraining
        )
        monkeypatch.setattr(FakeTraining, "error", ZeroDivisionError("of ours"))
        arm, settings = Arm(30.0), RetrainingSettings(every=10.0, pause=1.0)
        with served(store, tmp_path, settings, arm, true_arm) as run:
            run.feed(arm.states(true_arm, 25.0))
            assert run.stage == "idle"
        assert run.kinds.count("failure") == 2
        assert "of ours" in run.event("failure").text

    def test_without_river_the_service_says_so_and_serves(
        self, store, tmp_path, true_arm, monkeypatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "river", None)
        arm = Arm(30.0)
        with served(store, tmp_path, SETTINGS, arm, true_arm) as run:
            status = run.feed(arm.states(true_arm, 3.0))
        assert "pip install 'river" in run.event("drift").text
        assert run.kinds.count("drift") == 1
        assert status["answered"] == 100


@pytest.mark.parametrize(
    "given", [{"seconds": 0.0}, {"every": -1.0}, {"pause": np.inf}, {"shadow": np.nan}]
)
def test_settings_that_cannot_be_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="expected a number above 0"):
        RetrainingSettings(**given)
