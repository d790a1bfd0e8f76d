"""The gate that every recording passes: which of its rows can be used."""

from limo_driver.recordings.gate.doubts import about_gaps
from limo_driver.recordings.gate.gaps import LONGEST_STEP, LONGEST_STEP_PERIODS, contiguous
from limo_driver.recordings.gate.held_values import held_reason
from limo_driver.recordings.gate.left_out import LeftOut, UsableRows
from limo_driver.recordings.gate.rows import (
    SYSTEMATIC,
    inspect,
    inspect_by_joint,
    inspect_commands,
)
from limo_driver.recordings.gate.silent_torques import without_silent_torques
from limo_driver.recordings.gate.velocities import velocity_factor

__all__ = [
    "LONGEST_STEP",
    "LONGEST_STEP_PERIODS",
    "SYSTEMATIC",
    "LeftOut",
    "UsableRows",
    "about_gaps",
    "contiguous",
    "held_reason",
    "inspect",
    "inspect_by_joint",
    "inspect_commands",
    "velocity_factor",
    "without_silent_torques",
]
