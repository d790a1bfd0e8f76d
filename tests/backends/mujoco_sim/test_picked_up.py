"""A load that the simulated arm picks up while it moves."""

import numpy as np
import pytest

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import Payload, PickedUpLoad, Simulation
from limo_driver.types import PositionCommand

LOAD = {"mass": 2.0, "com": (0.0, 0.02, 0.1), "inertia": (0.01, 0.0, 0.0, 0.01, 0.0, 0.005)}
START, CYCLES = 0.3, 1200  # [s], of 1 ms


def path():
    """Return a slow swing of all joints from rest, (T, 7) [rad]."""
    phase = 2 * np.pi * np.arange(CYCLES) / CYCLES
    return np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0]) + 0.05 * (1 - np.cos(phase))[:, None]


def torque(*effects):
    """Return the true torque of an arm on that way, (T, 7) [N m]."""
    targets = path()
    with MujocoRobot(Simulation("iiwa14", effects), initial_position=targets[0]) as robot:
        robot.receive()
        return robot.run(targets).true_torque


def test_is_none_before_and_a_payload_after():
    without, always, picked = (
        torque(), torque(Payload(**LOAD)), torque(PickedUpLoad(start=START, **LOAD))
    )  # fmt: skip
    before = int(1e3 * START) - 2
    np.testing.assert_array_equal(picked[:before], without[:before])
    np.testing.assert_allclose(picked[-100:], always[-100:], atol=1e-2)  # the drives have settled
    assert np.abs(picked - without)[-100:].max() > 5.0
    np.testing.assert_allclose(torque(PickedUpLoad(start=0.0, **LOAD)), always, atol=1e-9)


def test_goes_back_with_the_robot():
    targets = path()
    arm = Simulation("iiwa14", (PickedUpLoad(start=START, **LOAD),))
    with MujocoRobot(arm, initial_position=targets[0]) as robot:
        robot.receive()
        saved, runs = robot.save_state(), []
        for _ in range(2):
            robot.restore_state(saved)
            for position in targets[:500]:
                robot.send(PositionCommand(position=position))
                state = robot.receive()
            runs.append(state.torque)
    np.testing.assert_array_equal(*runs)


def test_is_predicted_as_it_is_simulated():
    arm = Simulation("iiwa14", (PickedUpLoad(start=START, **LOAD),))
    targets = path()
    with MujocoRobot(arm, initial_position=targets[0]) as robot:
        robot.receive()
        run = robot.run(targets)
    off = arm.predict(run.true_motion) - run.true_torque
    step = np.abs(run.true_motion.time - START) < 0.1  # in which the drives jerk
    assert np.abs(off[~step]).max() == pytest.approx(0.0, abs=0.05)
