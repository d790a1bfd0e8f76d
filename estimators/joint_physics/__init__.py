"""Torque linear in the physics of each joint, fitted in closed form, with a standard deviation."""

from estimators.joint_physics.model import FittedPhysics, JointPhysics, Learning

__all__ = ["FittedPhysics", "JointPhysics", "Learning"]
