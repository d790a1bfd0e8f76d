"""The gate that every recording passes: which of its rows can be used."""

from limo_driver.recordings.gate.gaps import LONGEST_STEP, LONGEST_STEP_PERIODS, contiguous
from limo_driver.recordings.gate.left_out import LeftOut, UsableRows
from limo_driver.recordings.gate.rows import SYSTEMATIC, inspect, inspect_by_joint
from limo_driver.recordings.gate.velocities import velocity_factor

__all__ = [
    "LONGEST_STEP",
    "LONGEST_STEP_PERIODS",
    "SYSTEMATIC",
    "LeftOut",
    "UsableRows",
    "contiguous",
    "inspect",
    "inspect_by_joint",
    "velocity_factor",
]
