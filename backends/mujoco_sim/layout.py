"""Memory layout of the simulated robot's arrays, shared by Python and compiled code.

In compiled code the fields of these tuples are pointers, and tables are read row by row from one:
entry (row, j) of a table of n columns stands at row * n + j. Arrays there would carry their sizes,
strides and owners through every call, which takes numba three times as long to compile.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

POSITION, IMPEDANCE, TORQUE, DRIVES = 0, 1, 2, 3  # control modes; DRIVES: each joint its own

# Rows of the command, (5, n); a joint whose drive is not 0 runs its position servo under DRIVES.
TARGET, STIFFNESS, DAMPING, FEED_FORWARD, SERVO = 0, 1, 2, 3, 4
COMMAND_ROWS = 5

# Rows of the memory, (9, n): all that the robot remembers beside MuJoCo's own state.
LOAD = 0  # nominal rigid-body torque through the gear, last cycle [N m]
WIND_UP = 1  # encoder minus link under that load [rad]
STATIC_WIND_UP = 2  # the same under gravity and Coriolis torque alone [rad]
INTEGRAL = 3  # of the position servo [N m]
LAST_VELOCITY = 4  # [rad/s]
LAST_TARGET = 5  # [rad]
TARGET_VELOCITY = 6  # [rad/s]
ENCODER = 7  # last reading [rad]
ENCODER_VELOCITY = 8  # filtered [rad/s]
MEMORY_ROWS = 9

# Rows of what effects without a native form add in a cycle, (4, n).
ADDED_TORQUE, ADDED_DAMPING, ADDED_WIND_UP, ADDED_STATIC_WIND_UP = 0, 1, 2, 3

# Rows of the log of a cycle, (7, n).
MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_TORQUE = 0, 1, 2
TRUE_POSITION, TRUE_VELOCITY, TRUE_ACCELERATION, TRUE_TORQUE = 3, 4, 5, 6
LOG_ROWS = 7


class Arrays(NamedTuple):
    """MuJoCo's arrays of an arm of n joints."""

    position: FloatArray  # (n,) of the links [rad]
    velocity: FloatArray  # (n,) [rad/s]
    control: FloatArray  # (n + E,) dampers, then slipping springs
    bias: FloatArray  # (n,) gravity and Coriolis torque [N m]
    applied: FloatArray  # (n,) torque of the drives [N m]
    inertia: FloatArray  # lower triangle of M(q), row by row [kg m²]
    row_size: NDArray[np.int32]  # (n,)
    row_start: NDArray[np.int32]  # (n,)
    column: NDArray[np.int32]


class Links(NamedTuple):
    """MuJoCo's arrays of the m links of an arm in which joints follow others, and who moves them.

    Empty where `Arrays` are MuJoCo's own.
    """

    position: FloatArray  # (m,) [rad]
    velocity: FloatArray  # (m,) [rad/s]
    bias: FloatArray  # (m,) [N m]
    applied: FloatArray  # (m,) [N m]
    inertia: FloatArray  # lower triangle of M(q), row by row [kg m²]
    row_size: NDArray[np.int32]  # (m,)
    row_start: NDArray[np.int32]  # (m,)
    column: NDArray[np.int32]
    driver: NDArray[np.int64]  # (m,), joint that moves each
    ratio: FloatArray  # (m,)
    own: NDArray[np.int64]  # (n,), link that each joint moves itself


class Servo(NamedTuple):
    """The drives and sensors of the arm."""

    period: float  # [s]
    bandwidth: float  # of the position servo [rad/s]
    integral_rate: float  # [1/s]
    torque_limit: FloatArray  # (n,) at which a drive saturates [N m]
    velocity_gain: float  # of the encoder's velocity filter, 0 to 1
    encoder_resolution: FloatArray  # (n,) [rad]
    torque_resolution: FloatArray  # (n,) [N m]


class Scratch(NamedTuple):
    """Working arrays of a cycle, each of n joints; position and velocity are those of the links."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s²]
    inertial: FloatArray  # M(q) times an acceleration [N m]
    rate: FloatArray  # of the motor against the link, by static load [rad/s]
    torque: FloatArray  # of the drive [N m]
    damping: FloatArray  # of the drive [N m s/rad]
    friction: FloatArray  # as a damping [N m s/rad]
    motor: FloatArray  # [rad/s]
    wanted: FloatArray  # acceleration of the target [rad/s²]
    ahead: FloatArray  # target, carried forward [rad]
    speed: FloatArray  # of the target, carried forward [rad/s]


SCRATCH_ROWS = len(Scratch._fields)
