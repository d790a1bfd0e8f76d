"""Frozen values that pass between the parts: limits, specifications, states and commands.

SI units; joints are counted from 1 in everything a user reads, from 0 in arrays.
Arrays are float64 and read-only, since they are shared.
"""

from limo_driver.types.motion import (
    ArrayFields,
    FloatArray,
    JointSample,
    Motion,
    as_numbers,
    readonly,
)
from limo_driver.types.states import (
    ImpedanceCommand,
    JointCommand,
    JointLimits,
    JointState,
    PositionCommand,
    RobotSpec,
    StatesAhead,
    TorqueCommand,
    WrenchCommand,
    WrenchLimits,
    same_robot,
)

__all__ = [
    "ArrayFields",
    "FloatArray",
    "ImpedanceCommand",
    "JointCommand",
    "JointLimits",
    "JointSample",
    "JointState",
    "Motion",
    "PositionCommand",
    "RobotSpec",
    "StatesAhead",
    "TorqueCommand",
    "WrenchCommand",
    "WrenchLimits",
    "as_numbers",
    "readonly",
    "same_robot",
]
