"""What the tests of the simulated arm share: an iiwa with effects, played along targets."""

import numpy as np

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import Simulation


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def play(simulation, targets, **options):
    with MujocoRobot(simulation, initial_position=targets[0], **options) as robot:
        robot.receive()
        return robot.run(targets)


def iiwa(*effects, **options):
    return Simulation(robot="iiwa14", effects=effects, **options)


def felt(simulation, targets):
    """Return the RMS by which torques miss the prediction, and the rigid body's, both (n,)."""
    run = play(simulation, targets)
    error = run.true_torque - simulation.predict(run.true_motion)
    missing = run.true_torque - simulation.without_effects().predict(run.true_motion)
    return rms(error), rms(missing)
