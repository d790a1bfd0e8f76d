"""An arm some of whose joints follow others: MuJoCo steps every link, the drives see the joints.

With q = G q_r + b, the joints that move on their own have the inertia Gᵀ M G and the bias Gᵀ c. An
equality holds the others to them in MuJoCo.
"""

# MuJoCo ships no stubs.
# pyright: reportAttributeAccessIssue=false, reportUnknownParameterType=false
from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from backends.mujoco_sim.layout import Arrays, Links
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


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
        self.arrays = own = _arrays_of(model, data)
        self.links = _no_links()
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


def _arrays_of(model: mujoco.MjModel, data: mujoco.MjData) -> Arrays:
    return Arrays(
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


def _no_links() -> Links:
    none, short, long = np.zeros(0), np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int64)
    return Links(none, none, none, none, none, short, short, short, long, none, long)
