"""The simulated robot where joints follow others: it needs what the reduced rigid body needs."""

import numpy as np
import pytest
from linked_arms import gripper, parallelogram

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import Sensors, Simulation
from limo_driver.types import PositionCommand

ARMS = {
    "gripper.urdf#yaw,shoulder,elbow,finger_b": gripper,
    "linkage.xml": parallelogram,
    "gripper.urdf#shoulder,finger_b": gripper,
}


@pytest.fixture(params=ARMS)
def simulation(request, tmp_path):
    name = request.param.partition("#")[0]
    (tmp_path / name).write_text(ARMS[request.param](), encoding="utf-8")
    return Simulation(f"{tmp_path}/{request.param}", sensors=Sensors())


def targets_of(simulation, cycles):
    limits = simulation.model.limits
    rate = 2 * np.pi * np.array([0.4, 0.3, 0.5, 0.6])[: simulation.model.n]
    reach = 0.2 * (limits.position_max - limits.position_min)
    reach = np.minimum(reach, 0.3 * limits.velocity / rate)
    t = 1e-3 * np.arange(cycles)[:, None]
    x = np.minimum(t, 1.0)
    begun = x**3 * (10 - 15 * x + 6 * x**2)
    return limits.position_min + 2 * reach + begun * reach * np.sin(rate * t)


def test_it_needs_the_torque_of_the_reduced_rigid_body(simulation):
    targets = targets_of(simulation, 3000)
    with MujocoRobot(simulation, initial_position=targets[0]) as robot:
        robot.receive()
        run = robot.run(targets)
    assert not run.limited_by
    np.testing.assert_allclose(run.position[-1], targets[-1], atol=2e-3)
    motion = run.true_motion
    wanted = simulation.model.inverse_dynamics(
        motion.position, motion.velocity, motion.acceleration
    )
    error = np.sqrt(np.mean((run.true_torque - wanted)[200:] ** 2, axis=0))
    assert (error < 0.01 * np.sqrt(np.mean(wanted**2, axis=0))).all()


def test_a_state_that_is_restored_goes_on_alike(simulation):
    targets = targets_of(simulation, 60)
    with MujocoRobot(simulation, initial_position=targets[0]) as robot:
        robot.receive()
        robot.run(targets[:30])
        saved = robot.save_state()
        first = robot.run(targets[30:])
        robot.restore_state(saved)
        again = [robot.receive() for q in targets[30:] if robot.send(PositionCommand(q)) or True]
    np.testing.assert_array_equal(first.position, [state.position for state in again])
    np.testing.assert_array_equal(first.torque, [state.torque for state in again])
