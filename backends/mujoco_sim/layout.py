"""Memory layout of the simulated robot's arrays, shared by Python and compiled code.

In compiled code the fields of these tuples are pointers, and tables are read row by row from one:
entry (row, j) of a table of n columns stands at row * n + j. Arrays there would carry their sizes,
strides and owners through every call, which takes numba three times as long to compile.

An arm some of whose joints follow others: MuJoCo steps every link, the drives see the joints.

With q = G q_r + b, the joints that move on their own have the inertia Gᵀ M G and the bias Gᵀ c. An
equality holds the others to them in MuJoCo.
"""

# MuJoCo ships no stubs.
# pyright: reportAttributeAccessIssue=false, reportUnknownParameterType=false
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limo_driver.model import RobotModel
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.installed_mujoco import mujoco
from limo_driver.types import FloatArray, IntArray

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
    driver: IntArray  # (m,), joint that moves each
    ratio: FloatArray  # (m,)
    own: IntArray  # (n,), link that each joint moves itself


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


class DriveSideState:
    """MuJoCo's state of an arm of n joints, as the drives see it.

    Where each joint moves a link of its own and MuJoCo has them in the robot's order, its arrays
    are MuJoCo's own; else they are of the joints, and filled from those.

    Args:
        robot: The arm.
        model: MuJoCo's, of m links.
        data: MuJoCo's.
    """

    def __init__(self, robot: RobotModel, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        order = [robot.link_joints.index(model.joint(k).name) for k in range(model.njnt)]
        self._order = np.array(order, dtype=np.int64)  # of MuJoCo's joints among the links
        self._linkage = robot.linkage
        self.arrays = own = Arrays(
            position=data.qpos,
            velocity=data.qvel,
            control=data.ctrl,
            bias=data.qfrc_bias,
            applied=data.qfrc_applied,
            inertia=data.M,
            row_size=model.M_rownnz,
            row_start=model.M_rowadr,
            column=model.M_colind,
        )
        none, short, long = np.zeros(0), np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int64)
        self.links = Links(none, none, none, none, none, short, short, short, long, none, long)
        if not robot.linkage.is_plain or order != sorted(order):
            self.arrays = _reduced(robot.n, data)
            self.links = Links(
                position=own.position,
                velocity=own.velocity,
                bias=own.bias,
                applied=own.applied,
                inertia=own.inertia,
                row_size=own.row_size,
                row_start=own.row_start,
                column=own.column,
                driver=np.ascontiguousarray(robot.linkage.driver[self._order]),
                ratio=np.ascontiguousarray(robot.linkage.ratio[self._order]),
                own=np.array([order.index(link) for link in robot.linkage.own], dtype=np.int64),
            )

    def place(self, position: FloatArray) -> None:
        """Put the joints at positions (n,) [rad], at rest, and what follows where it belongs."""
        self._data.qpos[:] = self._linkage.positions(position)[self._order]
        mujoco.mj_forward(self._model, self._data)
        self.refresh()

    def refresh(self) -> None:
        """Read MuJoCo's arrays anew, after a change from outside the loop."""
        gather(self.links, self.arrays, self.links.driver.size, self.arrays.position.size)


@compiled(inline="always")
def gather(links: Links, arrays: Arrays, m: int, n: int) -> None:
    """Write state, bias and inertia of the n joints, of those of m links; nothing if that is 0."""
    gather_state(links, arrays, m, n)
    for j in range(n if m else 0):
        arrays.bias[j] = 0.0
        for i in range(j + 1):
            arrays.inertia[j * (j + 1) // 2 + i] = 0.0
    for k in range(m):
        a = links.driver[k]
        arrays.bias[a] += links.ratio[k] * links.bias[k]
        start = links.row_start[k]
        for at in range(start, start + links.row_size[k]):
            other = links.column[at]
            b = links.driver[other]
            value = links.ratio[k] * links.ratio[other] * links.inertia[at]
            if k != other and a == b:  # stands for the entry on the other side as well
                value *= 2.0
            row, column = max(a, b), min(a, b)
            arrays.inertia[row * (row + 1) // 2 + column] += value


@compiled(inline="always")
def spread(links: Links, arrays: Arrays, m: int, n: int) -> None:
    """Write the torque of the drives of the n joints to the links that they move."""
    for j in range(n if m else 0):
        links.applied[links.own[j]] = arrays.applied[j]


@compiled(inline="always")
def gather_state(links: Links, arrays: Arrays, m: int, n: int) -> None:
    """Write position and velocity of the n joints; nothing if m is 0."""
    for j in range(n if m else 0):
        arrays.position[j] = links.position[links.own[j]]
        arrays.velocity[j] = links.velocity[links.own[j]]


def _reduced(n: int, data: mujoco.MjData) -> Arrays:
    """Return arrays of n joints, with the whole lower triangle of the inertia."""
    rows = np.arange(n)
    return Arrays(
        position=np.zeros(n),
        velocity=np.zeros(n),
        control=data.ctrl,
        bias=np.zeros(n),
        applied=np.zeros(n),
        inertia=np.zeros(n * (n + 1) // 2),
        row_size=(rows + 1).astype(np.int32),
        row_start=(rows * (rows + 1) // 2).astype(np.int32),
        column=np.concatenate([np.arange(j + 1) for j in range(n)]).astype(np.int32),
    )
