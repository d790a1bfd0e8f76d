"""A data set holds what each run gives alone, survives kills, and says what cannot be simulated."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from here import Here

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.physics import CoulombFriction
from limo_driver.physics.effects.sensing import Sensors

pytestmark = pytest.mark.waits

DRIVER = """
import os, signal, sys
import limo_driver as limo

def tell(run, done, total):
    if run is not None:
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    limo.simulate_dataset(*sys.argv[1:], [1, 2, 3], workers=1, progress=tell)
"""


@pytest.fixture(scope="module")
def plans(tmp_path_factory, two_links_urdf):
    """Two short motions, a file that is none, and a simulation with noisy sensors."""
    folder = tmp_path_factory.mktemp("plans")
    t = np.arange(0.0, 0.6, 0.001)
    rest = np.zeros((t.size, 2))
    for name, size in (("one", 0.02), ("two", 0.04)):
        position = rest + 0.3 + size * (1.0 - np.cos(np.pi * t))[:, None]
        motion = limo.Trajectory(t, position, rest, rest, robot=str(two_links_urdf))
        motion.save(folder / f"{name}.traj.parquet")
    (folder / "zero.traj.parquet").write_text("none")
    sensors = Sensors(torque_noise=(0.05,))
    friction = CoulombFriction(joint=1, tau_c=0.1)
    limo.Simulation(str(two_links_urdf), (friction,), sensors=sensors).save(folder / "sim.yaml")
    return folder


@pytest.fixture
def here(monkeypatch):
    """Work in this process, and count from zero."""
    monkeypatch.setattr("limo_driver.app.library.simulating.executor_of", Here)
    monkeypatch.setattr(Here, "done", 0)
    return Here


def made(plans, out, **given):
    return limo.simulate_dataset(plans / "sim.yaml", f"{plans}/*.traj.parquet", out, **given)


def test_each_recording_is_the_run_alone_and_is_made_once(plans, here, tmp_path):
    found = made(plans, tmp_path, seeds=[1, 2])
    assert [file.name for file in found.files] == [
        f"{name}_seed{seed}.parquet" for name in ("one", "two") for seed in (1, 2)
    ]
    motion, sim = plans / "two.traj.parquet", plans / "sim.yaml"
    alone = limo.run("mujoco", motion, simulation=sim, seed=2)
    kept = limo.Recording.load(tmp_path / "two_seed2.parquet")
    np.testing.assert_array_equal(kept.torque, alone.torque)
    assert {run.seed for run in found.failed} == {1, 2}
    assert found.failed[0].error.startswith("cannot be read as a trajectory")
    assert here.done == 6

    made(plans, tmp_path, seeds=[1, 2, 3])
    assert here.done == 6 + 2 + 3  # the third seed, and what had failed
    made(plans, tmp_path, seeds=[1, 2], rate=500.0)
    assert here.done == 11 + 6  # anew, at another rate
    assert limo.Recording.load(tmp_path / "two_seed2.parquet").rate == pytest.approx(500.0)


@pytest.mark.usefixtures("here")
def test_what_cannot_be_a_data_set_is_said(plans, tmp_path):
    sim, one = plans / "sim.yaml", plans / "one.traj.parquet"
    with pytest.raises(ConfigError, match="none/\\*: matches no file, expected trajectories"):
        limo.simulate_dataset(sim, "none/*", tmp_path)
    with pytest.raises(ConfigError, match="no seeds given"):
        limo.simulate_dataset(sim, one, tmp_path, seeds=[])
    again = tmp_path / "one.traj.parquet"
    again.write_bytes(one.read_bytes())
    with pytest.raises(ConfigError, match="of one name would be one recording"):
        limo.simulate_dataset(sim, [one, again], tmp_path)
    with pytest.raises(ConfigError, match="none of 1 runs could be simulated"):
        limo.simulate_dataset(sim, plans / "zero.traj.parquet", tmp_path)
    with pytest.raises(ConfigError, match="workers is 0"):
        limo.simulate_dataset(sim, one, tmp_path, workers=0)


@pytest.mark.slow("starts processes that import: ten seconds")
def test_a_kill_of_the_driver_loses_no_recording(plans, tmp_path):
    program, out = tmp_path / "driver.py", tmp_path / "out"
    program.write_text(DRIVER)
    given = [sys.executable, program, plans / "sim.yaml", plans / "one.traj.parquet", out]
    killed = subprocess.run(given, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.parquet")}
    assert 0 < len(before) < 3
    found = limo.simulate_dataset(*given[2:], [1, 2, 3], workers=1)
    assert len(found.files) == 3
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())
