"""Simulated drives: real participants of a bus, in a process of their own, with one arm behind."""

from backends.can.simulator.session import SimulatedDrives

__all__ = ["SimulatedDrives"]
