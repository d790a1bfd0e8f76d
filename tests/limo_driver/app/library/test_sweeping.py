"""A sweep trains each setting once, ranks them by motion not seen, and goes on after a kill."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from fleet_recordings import record_swing
from here import Here

import limo_driver as limo
from estimators.studies import SweepSpace, SweepTrial
from estimators.studies.sweep import Sweep
from estimators.studies.sweep_trial import SweptRange
from limo_driver.errors import ConfigError
from limo_driver.pages.markup import prose
from limo_driver.physics import CoulombFriction

DRIVER = """
import os, signal, sys
import limo_driver as limo

def tell(trial, done, total):
    if trial is not None:
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    limo.sweep(*sys.argv[1:], workers=1, progress=tell)
"""
SHORT = "model: mlp7\nfeatures: own-joint\nepochs: 1\nfolds: 1\nhidden: [2, 3]\nseed: [0, 1]\n"


@pytest.fixture(scope="module")
def data(tmp_path_factory, two_links_urdf):
    """A recording with friction that the simulation lacks, one to test on, and a space."""
    folder = tmp_path_factory.mktemp("sweep")
    simulation = limo.Simulation(str(two_links_urdf))
    simulation.save(folder / "sim.yaml")
    true = replace(simulation, effects=(CoulombFriction(joint=1, tau_c=0.5),))
    for seed, name in enumerate(("run", "test")):
        record_swing(true, seed, folder / f"{name}.parquet")
    (folder / "space.yaml").write_text(SHORT)
    return folder


@pytest.fixture
def here(monkeypatch):
    """Work in this process, and count from zero."""
    monkeypatch.setattr("limo_driver.app.library.sweeping.executor_of", Here)
    monkeypatch.setattr(Here, "done", 0)
    return Here


def read(tmp_path, text):
    path = tmp_path / "space.yaml"
    path.write_text(text)
    return SweepSpace.load(path)


def test_a_space_is_every_combination_with_every_draw(tmp_path):
    space = read(
        tmp_path,
        "model: [mlp7, lstm-2]\nhidden: 4\nseed: [0, 1]\ndraws: 3\n"
        "learning_rate: {from: 1e-4, to: 1e-2, scale: log}\nepochs: {from: 5, to: 50}\n",
    )
    settings = space.settings(7.0)
    assert len(settings) == len(set(settings)) == 2 * 2 * 3
    assert {item.bandwidth for item in settings} == {7.0}
    assert {item.hidden for item in settings} == {4}
    assert space.varied == ("model", "epochs", "learning_rate")
    rates = [item.learning_rate for item in settings]
    assert rates[:3] == rates[3:6]  # the same draws for each combination
    assert all(1e-4 <= rate <= 1e-2 for rate in rates)
    assert all(type(item.epochs) is int for item in settings)
    assert SweptRange(1e-4, 1e-2, "log").at(0.5) == pytest.approx(1e-3)
    drive = read(tmp_path, "features: [drive, own-joint]").settings(10.0)
    assert [item.epochs for item in drive] == [20, 100]  # the usual ones of each


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hiden: 3", r"has no 'hiden'; it has model"),
        ("model: [joint-physics]", "is 'joint-physics', expected one of mlp7"),
        ("hidden: []", "expected a whole number"),
        ("learning_rate: {from: 1, to: 0.1}", "from 1 to 0.1, expected a larger number last"),
        ("learning_rate: {from: 0, to: 1, scale: log}", "expected a number above 0 on a log scale"),
        ("hidden: [1, 2]\ndraws: 3", "draws is '3', expected 1 where there is no range"),
        ("model: transformer\nhidden: 7", "combination that cannot be: hidden = 7 has to be"),
        ("seed: {from: 0, to: 100}\ndraws: 20000", "has 20000 trials, expected 10000 at most"),
    ],
)
def test_a_space_that_cannot_be_is_named(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said):
        read(tmp_path, text).settings(10.0)


def trial(left, **changes):
    settings = replace(limo.TrainingSettings(), **changes)
    return SweepTrial(settings, f"{left}", left, rmse=(left,))


def test_settings_are_ranked_by_the_mean_over_seeds():
    lucky = [trial(0.1, hidden=2, seed=0), trial(0.9, hidden=2, seed=1)]
    steady = [trial(0.4, hidden=3, seed=0), trial(0.3, hidden=3, seed=1)]
    failed = replace(trial(0.0, hidden=4), error="diverged")
    found = Sweep((*lucky, *steady, failed), ("hidden",))
    assert [own.settings.hidden for own in found.ranked] == [3, 2]
    assert found.best.left == 0.3
    assert found.ranked[0].spread == pytest.approx(np.std([0.3, 0.4], ddof=1))
    assert found.failed == (failed,)
    assert "4 of 5 trials trained. Best: hidden 3, which leaves 35.0%" in found.headline()


@pytest.mark.slow("imports PyTorch and trains: ten seconds")
def test_each_setting_is_trained_once_and_the_best_is_a_model(data, here, tmp_path):
    sim, run, test = (data / name for name in ("sim.yaml", "run.parquet", "test.parquet"))
    found = limo.sweep(sim, run, data / "space.yaml", tmp_path, tests=test)
    assert here.done == 4
    assert not found.failed
    table = pq.read_table(tmp_path / "results.parquet").to_pylist()
    assert [(line["hidden"], line["seed"]) for line in table] == [
        (hidden, seed) for seed in (0, 1) for hidden in (2, 3)
    ]
    best = limo.load_model(tmp_path / "best")
    alone = limo.train(sim, run, "mlp7", settings=found.best.settings)
    own, same = (limo.predict(model, test).torque for model in (best, alone))
    np.testing.assert_array_equal(own, same)
    judged = limo.evaluate(best, test)
    ratio = judged.hybrid.rmse / judged.rigid_body.rmse
    assert found.best.test == pytest.approx(float(np.sqrt(np.mean(ratio**2))))
    assert prose(found.headline()) in (tmp_path / "sweep.html").read_text()

    larger = read(tmp_path, SHORT.replace("[2, 3]", "[2, 3, 4]"))
    assert len(limo.sweep(sim, run, larger, tmp_path, tests=test).trials) == 6
    assert here.done == 4 + 2


@pytest.mark.slow("imports PyTorch: five seconds")
@pytest.mark.usefixtures("here")
def test_a_sweep_in_which_nothing_can_be_trained_says_why(data, tmp_path):
    space = read(tmp_path, "model: lstm-2\nsequence_length: 100000\nepochs: 1")
    with pytest.raises(ConfigError, match=r"no trial could be trained: .*sequence"):
        limo.sweep(data / "sim.yaml", data / "run.parquet", space, tmp_path / "out")


@pytest.mark.slow("starts processes that import and compile: half a minute")
def test_a_kill_in_the_middle_of_a_sweep_loses_no_trial(data, tmp_path):
    program, out = tmp_path / "driver.py", tmp_path / "out"
    program.write_text(DRIVER)
    files = [data / name for name in ("sim.yaml", "run.parquet", "space.yaml")]
    given = [sys.executable, program, *files, out]
    killed = subprocess.run(given, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    before = {path: path.stat().st_mtime_ns for path in out.glob("trials/*/trial.json")}
    assert 0 < len(before) < 4
    found = limo.sweep(*files, out, workers=1)
    assert len(found.trials) == 4
    assert not found.failed
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())
