"""The gate that every recording passes: which of its rows can be used."""

from limo_driver.recordings.gate.clock import (
    SYSTEMATIC,
    OneClock,
    in_order,
    runs_backwards,
    with_one_clock,
)
from limo_driver.recordings.gate.doubts import (
    LeftOut,
    UsableRows,
    about_gaps,
    without_silent_torques,
)
from limo_driver.recordings.gate.held_values import (
    LONGEST_STEP,
    LONGEST_STEP_PERIODS,
    contiguous,
    held_reason,
    one_factor,
    velocity_factor,
)
from limo_driver.recordings.gate.rows import (
    inspect,
    inspect_by_joint,
    inspect_commands,
)

__all__ = [
    "LONGEST_STEP",
    "LONGEST_STEP_PERIODS",
    "SYSTEMATIC",
    "LeftOut",
    "OneClock",
    "UsableRows",
    "about_gaps",
    "contiguous",
    "held_reason",
    "in_order",
    "inspect",
    "inspect_by_joint",
    "inspect_commands",
    "one_factor",
    "runs_backwards",
    "velocity_factor",
    "with_one_clock",
    "without_silent_torques",
]
