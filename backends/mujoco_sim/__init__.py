"""MuJoCo as a robot: rigid bodies by MuJoCo, joint physics from the catalogue, at 1 kHz."""

from backends.mujoco_sim.robot import MujocoRobot, SimulatedRun

__all__ = ["MujocoRobot", "SimulatedRun"]
