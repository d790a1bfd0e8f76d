"""Batched forward kinematics: joint frames of many configurations at once, compiled by numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, readonly

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.model.dynamics import JointLinkage
    from limo_driver.model.robot_model import RobotModel


_STILL: Final = 1e-6  # of a rotation by 1 rad: there is none


@dataclass(frozen=True)
class KinematicChain:
    """Geometry of m links: each moves along or turns about an axis in a frame fixed to its parent.

    Which of the n joints moves each is in `linkage`.
    """

    parent: NDArray[np.int64]  # (m,), 0-based link; -1 is the fixed base
    rotation: FloatArray  # (m, 3, 3), of the link in its parent's frame at q = 0
    translation: FloatArray  # (m, 3) [m]
    axis: (
        FloatArray  # (m, 6), unit vector that it moves along, then one that it turns about; 0 else
    )
    flange: FloatArray  # (3,) [m], in the frame of the last link
    linkage: JointLinkage

    @classmethod
    def of(cls, model: RobotModel) -> KinematicChain:
        """Read the chain of a robot model."""
        links, at_zero = model.linkage.links, np.zeros(model.n)
        last = model.joint_poses(at_zero)[-1]
        flange = np.linalg.solve(last, model.flange_pose(at_zero))[:3, 3]
        parent = np.array([int(model.pin_tree.parents[k + 1]) - 1 for k in range(links)])
        fixed = _relative(model.link_poses(np.zeros(links)), parent)
        moved = _relative(model.link_poses(np.ones(links)), parent)
        turn = np.einsum("jki,jkl->jil", fixed[:, :3, :3], moved[:, :3, :3])  # exp(axis 1 rad)
        after, before = turn[:, [2, 0, 1], [1, 2, 0]], turn[:, [1, 2, 0], [2, 0, 1]]
        angular = after - before  # what is skew in a rotation, 2 sin(1 rad) axis
        linear = np.einsum("jki,jk->ji", fixed[:, :3, :3], moved[:, :3, 3] - fixed[:, :3, 3])
        slides = np.linalg.norm(angular, axis=1, keepdims=True) < _STILL
        axis = np.where(np.repeat([True, False], 3) == slides, np.hstack([linear, angular]), 0.0)
        return cls(
            parent=parent,
            rotation=readonly(np.ascontiguousarray(fixed[:, :3, :3])),
            translation=readonly(np.ascontiguousarray(fixed[:, :3, 3])),
            axis=readonly(axis / np.linalg.norm(axis, axis=1, keepdims=True)),
            flange=readonly(np.ascontiguousarray(flange)),
            linkage=model.linkage,
        )

    @property
    def direction(self) -> FloatArray:
        """The axis of each link, whether it turns or slides, unit vectors (m, 3)."""
        return self.axis[:, :3] + self.axis[:, 3:]  # one of both is zero

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Whether each link slides, (m,)."""
        return np.asarray((self.axis[:, :3] != 0).any(axis=1))

    def joint_poses(self, position: FloatArray) -> FloatArray:
        """Return the pose of every link's joint frame, (T, m, 4, 4), for positions (T, n)."""
        at = np.ascontiguousarray(self.linkage.positions(position))
        return _poses(at, self.parent, self.rotation, self.translation, self.axis)

    def flange_position(self, position: FloatArray) -> FloatArray:
        """Return the flange in the base frame [m], (T, 3), for joint positions (T, n) [rad]."""
        last = self.joint_poses(position)[:, -1]
        return last[:, :3, :3] @ self.flange + last[:, :3, 3]


def _relative(poses: FloatArray, parent: NDArray[np.int64]) -> FloatArray:
    """Return joint poses (n, 4, 4) in the frame of each joint's parent."""
    above = np.concatenate([poses, np.eye(4)[None]])[parent]  # -1 picks the base
    return np.asarray(np.linalg.solve(above, poses), dtype=np.float64)


@compiled(reads=("q",), nogil=True)
def forward(
    q: FloatArray,
    parent: NDArray[np.int64],
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    R: FloatArray,
    p: FloatArray,
) -> None:
    """Fill R, (n, 3, 3), and p, (n, 3) [m], with the joint frames in the base frame.

    Each joint adds its fixed placement, a slide by axis q, and the turn exp(axis q), written out by
    Rodrigues: exp(axis q) = I + sin(q) K + (1 - cos(q)) K², with K v = axis x v. One of both is 0.
    """
    local = np.empty((3, 3))
    turn = np.empty((3, 3))
    place = np.empty(3)
    for j in range(q.shape[0]):
        x, y, z = axis[j, 3], axis[j, 4], axis[j, 5]
        turns = x != 0.0 or y != 0.0 or z != 0.0
        s, c = (np.sin(q[j]), np.cos(q[j])) if turns else (0.0, 1.0)
        d = 1.0 - c
        turn[0, 0], turn[0, 1], turn[0, 2] = c + x * x * d, x * y * d - z * s, x * z * d + y * s
        turn[1, 0], turn[1, 1], turn[1, 2] = y * x * d + z * s, c + y * y * d, y * z * d - x * s
        turn[2, 0], turn[2, 1], turn[2, 2] = z * x * d - y * s, z * y * d + x * s, c + z * z * d
        for row in range(3):
            for col in range(3):
                total = 0.0
                for k in range(3):
                    total += rotation[j, row, k] * turn[k, col]
                local[row, col] = total
        for row in range(3):
            place[row] = translation[j, row]
            for k in range(3):
                place[row] += rotation[j, row, k] * axis[j, k] * q[j]
        above = parent[j]
        for row in range(3):
            if above < 0:
                p[j, row] = place[row]
                for col in range(3):
                    R[j, row, col] = local[row, col]
                continue
            shift = p[above, row]
            for k in range(3):
                shift += R[above, row, k] * place[k]
            p[j, row] = shift
            for col in range(3):
                total = 0.0
                for k in range(3):
                    total += R[above, row, k] * local[k, col]
                R[j, row, col] = total


@compiled(reads=("position",), nogil=True)
def _poses(
    position: FloatArray,
    parent: NDArray[np.int64],
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
) -> FloatArray:
    T, n = position.shape
    poses = np.zeros((T, n, 4, 4))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    for t in range(T):
        forward(position[t], parent, rotation, translation, axis, R, p)
        for j in range(n):  # loops: assigned slices take seconds to compile
            for row in range(3):
                for col in range(3):
                    poses[t, j, row, col] = R[j, row, col]
                poses[t, j, row, 3] = p[j, row]
            poses[t, j, 3, 3] = 1.0
    return poses
