"""`limo diagnose` on recordings of real arms, where those are at hand."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.diagnosis.headline import headline
from estimators.diagnosis.reading import verdict_in
from limo_driver.app.cli import main
from limo_driver.physics import Simulation
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
UR10E = DATA / "ur10e"
BANDWIDTH = 8.0  # [Hz], of the published baselines
LOAD = 2.805  # [kg], weighed
GAINS = 0.1  # to which the gains of its currents are good, relative
BY_GAINS = (2.7, 3.3)  # [kg] that such gains make of the load

pytestmark = [
    pytest.mark.slow("real recordings, minutes long, which few have"),
    pytest.mark.skipif(
        not UR10E.is_dir(),
        reason=f"no real recordings in {DATA}; name their folder in LIMO_DATA",
    ),
]


@dataclass(frozen=True)
class Diagnosed:
    """A verdict, and the simulations before and after it."""

    verdict: dict[str, Any]
    before: Simulation
    after: Simulation
    headline: str

    def finding(self, effect):
        """Return the one finding of that effect, or None."""
        return next((f for f in self.verdict["findings"] if f["effect"] == effect), None)

    def fall(self, run, joints=slice(None)):
        """Return by how much the error on another run falls, per joint."""
        recording = Recording.load(UR10E / f"{run}.parquet")
        return (1 - rmse(self.after, recording) / rmse(self.before, recording))[joints]


def rmse(simulation, recording):
    predicted = simulation.predict(recording, BANDWIDTH)
    predicted = smooth(recording.time, predicted, BANDWIDTH, recording.segments)
    error = recording.filtered_torque(BANDWIDTH) - predicted
    return np.sqrt(np.mean(error**2, axis=0))


def limo(*arguments):
    """Run a command as a user does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["limo", *map(str, arguments), "--bandwidth", str(BANDWIDTH)])
        with pytest.raises(SystemExit) as ended:
            main()
    assert not ended.value.code


@pytest.fixture(scope="module")
def unloaded(tmp_path_factory):
    """Identify the UR10e without its load."""
    sim = tmp_path_factory.mktemp("ur10e") / "sim.yaml"
    run = UR10E / "unloaded_14harm.parquet"
    limo("identify", run, "--robot", UR10E / "ur10e.urdf", "--moving-only", "--out", sim)
    return sim


def diagnosed(run, sim, out):
    limo("diagnose", UR10E / f"{run}.parquet", "--sim", sim, "--out", out)
    verdict = json.loads((out / "verdict.json").read_text())
    before, after = Simulation.load(sim), Simulation.load(out / "sim.yaml")
    return Diagnosed(verdict, before, after, headline(verdict_in(out)))


@pytest.fixture(scope="module")
def loaded(unloaded, tmp_path_factory):
    return diagnosed("loaded_14harm", unloaded, tmp_path_factory.mktemp("loaded"))


@pytest.fixture(scope="module")
def loaded_again(unloaded, tmp_path_factory):
    """Diagnose another run, in which friction by load makes a fit and its simulation differ."""
    return diagnosed("loaded_20_01_31", unloaded, tmp_path_factory.mktemp("loaded_again"))


@pytest.fixture(scope="module")
def unloaded_again(unloaded, tmp_path_factory):
    return diagnosed("unloaded_15harm", unloaded, tmp_path_factory.mktemp("again"))


def test_the_load_of_the_ur10e_is_in_the_headline(loaded):
    assert "payload" in loaded.headline
    assert loaded.finding("payload")["confidence"] > 0.9


def test_its_mass_is_what_the_current_gains_allow(loaded):
    holds_the_load(loaded.finding("payload")["parameters"]["mass"])


def holds_the_load(mass):
    """Assert that joints whose gains disagree widen the interval to the load, and no further."""
    low, high = mass["ci95"]
    assert low <= LOAD <= high
    assert low <= mass["value"] <= high
    assert BY_GAINS[0] < mass["value"] < BY_GAINS[1]
    assert high - low < 2 * 1.96 * GAINS * LOAD


def test_the_load_found_once_predicts_another_loaded_run(loaded):
    assert (loaded.fall("loaded_20_01_31", slice(1, None)) > 0.6).all()


def test_the_load_is_found_in_another_run_too(loaded_again):
    holds_the_load(loaded_again.finding("payload")["parameters"]["mass"])
    assert (loaded_again.fall("loaded_14harm", slice(1, None)) > 0.6).all()


def test_no_load_is_found_without_one(unloaded_again):
    assert unloaded_again.finding("payload") is None
    assert unloaded_again.finding("link_inertia") is None


def test_what_is_found_without_a_load_holds_on_other_unloaded_runs(unloaded_again):
    """Joints 2 and 3: friction that grows with the load; 5 and 6: presliding."""
    named = {j for f in unloaded_again.verdict["findings"] for j in f["joints"]}
    assert {2, 3, 5} <= named
    for run in ("unloaded_14harm", "unloaded_20_01_31", "unloaded_point_to_point"):
        fall = unloaded_again.fall(run)
        assert fall[[1, 2, 4]].min() > 0.03
        assert fall.mean() > 0.1
