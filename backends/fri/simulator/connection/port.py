"""Address of a simulated controller, under the name that programs import."""

from backends.fri.simulator.port import Address

__all__ = ["Address"]
