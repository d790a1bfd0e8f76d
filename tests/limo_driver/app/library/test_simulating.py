"""Many simulated runs side by side are the runs that each is by itself."""

import sys
import threading
import time
from concurrent.futures import CancelledError

import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.physics import CoulombFriction
from limo_driver.physics.effects.sensing import Sensors

ARM = limo.Simulation(
    "iiwa14", (CoulombFriction(joint=1, tau_c=1.0),), sensors=Sensors(torque_noise=(0.05,))
)


def motion(size: float) -> limo.Trajectory:
    t = np.arange(0.0, 1.0, 0.001)
    rest = np.zeros((t.size, 7))
    position = rest + 0.3 + size * (1.0 - np.cos(np.pi * t))[:, None]
    return limo.Trajectory(t, position, rest, rest, robot="iiwa14")


@sampled("workers", [1, 2, 3], "simulates four motions side by side and alone")
def test_side_by_side_they_are_what_each_is_alone(workers):
    motions, seeds = [motion(0.02), motion(0.04)], [1, 2]
    found = limo.simulate(ARM, motions, seeds, workers=workers)
    alone = [limo.run("mujoco", m, simulation=ARM, seed=s) for m in motions for s in seeds]
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one.torque, other.torque)
        np.testing.assert_array_equal(one.position, other.position)
    assert not np.array_equal(found[0].torque, found[1].torque)


def test_threads_switch_as_before_afterwards(monkeypatch):
    before, meanwhile = sys.getswitchinterval(), list[float]()

    def one_run(_backend, _motion, **_):
        meanwhile.append(sys.getswitchinterval())
        raise ConfigError("none")

    monkeypatch.setattr("limo_driver.app.library.moving.run", one_run)
    with pytest.raises(ConfigError, match="none"):
        limo.simulate(ARM, [motion(0.02)], [1, 2], workers=2)
    assert min(meanwhile) < before
    assert sys.getswitchinterval() == before


def test_what_goes_wrong_in_one_ends_the_others(monkeypatch):
    begun, ended = threading.Event(), threading.Event()

    def one_run(_backend, _motion, *, seed, progress, **_):
        if seed == 1:
            assert begun.wait(120.0)
            raise ConfigError("the first")
        begun.set()
        try:
            for _ in range(12_000):  # [10 ms]
                progress(1, 2)
                time.sleep(0.01)
        except CancelledError:
            ended.set()
            raise

    monkeypatch.setattr("limo_driver.app.library.moving.run", one_run)
    with pytest.raises(ConfigError, match="the first"):
        limo.simulate(ARM, [motion(0.02)], range(1, 9), workers=2)
    assert ended.is_set()
    assert not [t for t in threading.enumerate() if t.name.startswith("limo-simulate")]


def test_what_cannot_be_run_is_refused_before_anything_runs():
    with pytest.raises(ConfigError, match="workers is 0"):
        limo.simulate(ARM, [motion(0.02)], workers=0)
    with pytest.raises(ConfigError, match="seed"):
        limo.simulate(ARM, [motion(0.02)], ["one"])  # type: ignore[list-item]
    assert limo.simulate(ARM, []) == []
