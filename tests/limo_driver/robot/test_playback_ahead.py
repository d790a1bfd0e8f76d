"""A simulated arm that is played in long calls gives what it gives cycle by cycle, to the bit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import sampled

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import CoulombFriction, ExternalContact, PreslidingHysteresis, Simulation
from limo_driver.physics.effects.sensing import Sensors
from limo_driver.recordings.recording import Recording
from limo_driver.robot.playback import Playback
from limo_driver.trajectory import Trajectory
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.robot.playback import PlaybackSummary
    from limo_driver.types import FloatArray

ARM = Simulation(
    "iiwa14",
    (
        CoulombFriction(joint=1, tau_c=1.0),
        PreslidingHysteresis(joint=2, stiffness=(300.0,), width=(0.004,)),
    ),
    sensors=Sensors(torque_noise=(0.05,), encoder_resolution=(1e-5,)),
)
PUSHED = replace(
    ARM,
    effects=(
        *ARM.effects,
        ExternalContact(windows=((0.6, 0.9),), wrench=((0.0, 0.0, -60.0, 0.0, 0.0, 0.0),)),
    ),
)


class ByCycle(MujocoRobot):
    """The same arm, which never looks ahead."""

    def send_ahead(self, targets: FloatArray) -> None:
        del targets


class Ahead(MujocoRobot):
    """The same arm, which counts the cycles that it took in long calls."""

    taken = 0

    def send_ahead(self, targets):
        found = super().send_ahead(targets)
        self.taken += 0 if found is None else len(targets)
        return found


def motion(fast: float = 1.0) -> Trajectory:
    t = np.arange(0.0, 3.0, 0.001)
    swing = 0.2 * (1.0 - np.cos(2 * np.pi * fast * t / 3.0))
    rest = np.zeros((t.size, 7))
    position = rest + np.deg2rad([10, 40, -20, -70, 30, 50, -40]) + swing[:, None]
    return Trajectory(t, position, rest, rest, robot="iiwa14")


def play(
    kind: type[MujocoRobot], simulation: Simulation, path: Path, planned: Trajectory, every: int
) -> tuple[MujocoRobot, PlaybackSummary]:
    with kind(simulation, initial_position=planned.position[0], seed=3) as robot:
        summary = Playback(planned, path, every).run(robot, lambda _done, _all: None)
    return robot, summary


@sampled("every", [1, 3], "plays seconds of motion twice each")
@sampled(
    ("simulation", "fast", "looks_ahead"),
    [(ARM, 1.0, True), (ARM, 40.0, False), (PUSHED, 1.0, True)],
    "plays seconds of motion twice each",
    ids=["ordinary", "limited", "pushed"],
)
def test_the_recording_is_the_same_to_the_bit(
    simulation: Simulation, fast: float, looks_ahead: bool, every: int, tmp_path: Path
) -> None:
    by_cycle, ahead = tmp_path / "cycle.parquet", tmp_path / "ahead.parquet"
    _, expected = play(ByCycle, simulation, by_cycle, motion(fast), every)
    robot, found = play(Ahead, simulation, ahead, motion(fast), every)
    assert isinstance(robot, Ahead)
    assert (robot.taken > 1000) == looks_ahead
    assert by_cycle.read_bytes() == ahead.read_bytes()
    np.testing.assert_array_equal(found.tracking_rmse, expected.tracking_rmse)
    np.testing.assert_array_equal(found.tracking_max, expected.tracking_max)
    assert (found.samples, found.duration) == (expected.samples, expected.duration)
    assert found.limited == expected.limited
    assert len(Recording.load(ahead)) == found.samples


def test_a_fault_on_the_way_comes_in_its_own_cycle(tmp_path: Path) -> None:
    """The arm is thrown out of its velocity limit: it holds where it would have."""
    thrown = replace(
        ARM,
        effects=(
            *ARM.effects,
            ExternalContact(windows=((1.1, 1.3),), wrench=((9e4, 0.0, 9e4, 0.0, 0.0, 0.0),)),
        ),
    )
    said = []
    for kind in (ByCycle, Ahead):
        path = tmp_path / f"{kind.__name__}.parquet"
        with pytest.raises(Exception, match="joint") as raised:
            play(kind, thrown, path, motion(), 1)
        said.append((type(raised.value), str(raised.value), path.read_bytes()))
    assert said[0] == said[1]


def test_lost_measurements_are_not_looked_past() -> None:
    planned = motion()
    with Ahead(ARM, initial_position=planned.position[0]) as robot:
        robot.receive()
        assert robot.send_ahead(planned.position[:20]) is None  # a first command starts the stream
        robot.lose_measurements(2)
        assert robot.send_ahead(planned.position[:20]) is None


def test_what_later_cycles_follow_from_is_the_same() -> None:
    """Also what is believed of the arm's acceleration, which counts where a measurement is lost."""
    planned, believed = motion(), []
    for kind in (ByCycle, Ahead):
        with kind(ARM, initial_position=planned.position[0], seed=3) as robot:
            robot.receive()
            robot.send(PositionCommand(position=planned.position[0]))
            robot.receive()
            if (found := robot.send_ahead(planned.position[1:200])) is None:
                for target in planned.position[1:200]:
                    robot.send(PositionCommand(position=target))
                    robot.receive()
            assert (found is None) == (kind is ByCycle)
            robot.lose_measurements(1)
            robot.receive()
            believed.append(robot._contract._pose())
    assert believed[0].acceleration.any()
    for one, other in zip(*believed, strict=True):
        np.testing.assert_array_equal(one, other)
