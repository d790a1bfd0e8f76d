"""Arms that tell commands and positions, and no torque: run forward, identified, diagnosed.

The torque of a drive, a function of command, position and velocity, takes the place of the measured
one. Masses that are known, and the gravity on them, give the scale.
"""

from estimators.drives.forward import free_run

__all__ = ["free_run"]
