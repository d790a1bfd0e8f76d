"""Settings of a simulated controller, under the name that programs import."""

from backends.fri.simulator.session import ControllerSettings

__all__ = ["ControllerSettings"]
