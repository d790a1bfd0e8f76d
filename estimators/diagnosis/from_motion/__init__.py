"""Arms that tell commands and positions, and no torque: run forward, identified, diagnosed.

The torque of a drive, a function of command, position and velocity, takes the place of the measured
one. Masses that are known, and the gravity on them, give the scale.
"""

from estimators.diagnosis.from_motion.pipeline import (
    DriveDiagnosis,
    diagnose_drives,
    identify_drives,
)
from estimators.diagnosis.from_motion.simulation.free_run import commanded_run, free_run

__all__ = ["DriveDiagnosis", "commanded_run", "diagnose_drives", "free_run", "identify_drives"]
