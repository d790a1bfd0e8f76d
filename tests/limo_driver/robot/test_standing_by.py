"""Playback that waits: the arm stands, its states go on, and the motion is as if nobody waited."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from limo_driver.errors import ConfigError, HoldingError
from limo_driver.physics import ExternalContact
from limo_driver.recordings.files.recorder import partial_path
from limo_driver.robot.playback import NotBegunError, Playback
from limo_driver.robot.registry import open_for
from limo_driver.runtime.plugins import ROBOTS, find
from limo_driver.trajectory import Trajectory

START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
PUSH = ExternalContact(windows=((0.02, 0.05),), wrench=((0.0, 12.0, -12.0, 0.0, 0.0, 0.0),))
CYCLES = 101


@pytest.fixture
def motion():
    time = np.arange(CYCLES) * 1e-3
    phase = 2 * np.pi * time[:, None] / time[-1]
    spread = 1e-4 * np.ones(7)
    return Trajectory(
        time,
        START + spread * (1 - np.cos(phase)),
        spread * np.sin(phase),
        spread * np.cos(phase),
        robot="iiwa14",
    )


@pytest.fixture(params=["mujoco", "virtual"])
def play(request, motion, hysteretic, tmp_path):
    """Make a function that plays the motion on a pushed arm, and returns what it published."""
    pushed = replace(hysteretic, effects=(*hysteretic.effects, PUSH))

    def run(name, start_when=None, every=1):
        published = []
        with open_for(request.param, motion, simulation=pushed, robot=None, seed=5) as robot:
            playback = Playback(
                motion, tmp_path / name, every, publish=published.append, start_when=start_when
            )
            playback.run(robot, lambda *_: None)
        return published

    return run


class After:
    """Says yes after so many times."""

    def __init__(self, times):
        self.left = times

    def __call__(self):
        self.left -= 1
        return self.left < 0


def test_the_recording_is_the_same_to_the_bit_however_long_it_waited(play, tmp_path):
    play("at_once.parquet")
    play("later.parquet", After(300))
    at_once, later = (pq.read_table(tmp_path / f"{name}.parquet") for name in ("at_once", "later"))
    assert at_once.num_rows == CYCLES
    assert at_once.equals(later)
    torque = later["torque_2"].to_numpy()  # the push comes in the time of the motion, for both
    pushed, free = torque[25:45].mean(), np.r_[torque[:15], torque[60:]].mean()
    assert abs(pushed - free) > 1.0


def test_states_are_published_from_the_first_on_without_a_gap(play):
    published = play("later.parquet", After(40), every=4)
    assert [state.sequence for state in published] == list(range(len(published)))
    assert len(published) == (40 + 1 + CYCLES + 3) // 4
    steps = np.diff([state.time for state in published])
    np.testing.assert_allclose(steps, 4e-3, atol=1e-12)
    np.testing.assert_allclose(
        [state.position for state in published[:10]], [START] * 10, atol=1e-4
    )


def test_what_is_raised_while_it_waits_leaves_nothing(play, tmp_path):
    def give_up():
        raise ConfigError("no longer")

    with pytest.raises(ConfigError, match="no longer"):
        play("none.parquet", give_up)
    assert list(tmp_path.iterdir()) == []


def test_a_run_begins_once_a_measurement_that_was_lost_is_back(motion, tmp_path):
    with open_for("virtual", motion, simulation=None, robot=None, seed=5) as robot:
        first = robot.receive()
        robot.lose_measurements(3)
        played = Playback(motion, tmp_path / "run.parquet").run(robot, lambda *_: None)
    time = pq.read_table(tmp_path / "run.parquet")["time"].to_numpy()
    assert played.samples == CYCLES
    assert time[0] == pytest.approx(first.time + 4 * robot.spec.period)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_the_wait(play, tmp_path, number):
    def interrupt():
        os.kill(os.getpid(), number)
        return False

    with pytest.raises(NotBegunError):
        play("none.parquet", interrupt)
    assert list(tmp_path.iterdir()) == []
    assert not partial_path(tmp_path / "none.parquet").exists()


def test_a_recording_that_cannot_be_written_is_told_before_the_wait(play):
    with pytest.raises(ConfigError, match="there is no folder"):
        play(Path("nowhere") / "none.parquet", lambda: pytest.fail("it waited"))


@pytest.mark.parametrize("backend", ["mujoco", "virtual"])
def test_time_that_is_kept_goes_on_from_where_it_stood(backend):
    """In real time, cycles that stood are not caught up with."""
    with find(ROBOTS, backend)(robot="iiwa14", initial_position=START) as robot:
        robot.keep_time()
        first = robot.receive()
        for _ in range(20):
            assert robot.stand_by() is first
        assert robot.receive().sequence == first.sequence + 1
        assert robot._passed == pytest.approx(22e-3)


def test_an_arm_that_holds_waits_no_longer(motion, tmp_path):
    with find(ROBOTS, "virtual")(robot="iiwa14", initial_position=START) as robot:
        playback = Playback(motion, tmp_path / "none.parquet", start_when=lambda: False)
        robot.receive()
        robot.hold("somebody said so")
        with pytest.raises(HoldingError, match="somebody said so"):
            playback.run(robot, lambda *_: None)
