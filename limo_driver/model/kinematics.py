"""Batched forward kinematics, compiled by numba, and the wrench on the last frame.

Joint frames of many configurations at once; and the wrench at the end of an arm that explains
external torques best, with its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.display import Displayed
from limo_driver.types import BoolArray, FloatArray, IntArray, readonly

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.model.dynamics import JointLinkage
    from limo_driver.model.robot_model import RobotModel

_STILL: Final = 1e-6  # of a rotation by 1 rad: there is none


@dataclass(frozen=True)
class KinematicChain:
    """Geometry of m links: each moves along or turns about an axis in a frame fixed to its parent.

    Which of the n joints moves each is in `linkage`.
    """

    parent: IntArray  # (m,), 0-based link; -1 is the fixed base
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
    def slides(self) -> BoolArray:
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


def _relative(poses: FloatArray, parent: IntArray) -> FloatArray:
    """Return joint poses (n, 4, 4) in the frame of each joint's parent."""
    above = np.concatenate([poses, np.eye(4)[None]])[parent]  # -1 picks the base
    return np.asarray(np.linalg.solve(above, poses), dtype=np.float64)


@compiled(reads=("q",), nogil=True)
def forward(
    q: FloatArray,
    parent: IntArray,
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
    parent: IntArray,
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


_PRIOR: Final = 1e3  # [N, N m], standard deviation of any wrench


class Wrench(NamedTuple):
    """What the environment exerts on an arm, about the origin of a frame."""

    value: FloatArray  # (6,) force, then torque [N, N m]
    covariance: FloatArray  # (6, 6) of its error; NaN where that of the torques is unknown


class FlangeWrench:
    """Finds wrenches from external torques, which are -Jᵀ F.

    With torques of independent errors, and a normal prior of 1 kN and 1 kN m that says what no
    joint feels: in a singular pose, or on an arm with fewer than six joints, some direction has
    that deviation.

        covariance = (J S⁻¹ Jᵀ + P⁻¹)⁻¹        F = -covariance J S⁻¹ external

    Args:
        model: Of the arm.
        frame: Link or site that moves with its last link; the flange if empty.
        in_base: Tell wrenches in the axes of the base, not of the frame; about its origin anyhow.

    Raises:
        ConfigError: The last link has no such frame.
    """

    def __init__(self, model: RobotModel, frame: str = "", *, in_base: bool = False) -> None:
        frames = model.last_frames
        self.frame = frame or model.flange
        if self.frame not in frames:
            raise ConfigError(
                f"{model.name} has no frame {self.frame!r} that moves with its last link, expected "
                f"one of {', '.join(frames)}"
            )
        self._model = model
        place = np.linalg.solve(frames[model.flange], frames[self.frame])  # in the flange
        shift = np.cross(np.eye(3), place[:3, 3]).T  # of w, w x place
        self._moved = np.block([[np.eye(3), shift], [np.zeros((3, 3)), np.eye(3)]])
        self._turn = None if in_base else place[:3, :3].T

    def jacobian(self, position: FloatArray) -> FloatArray:
        """Return the Jacobian of the frame in its axes or the base's, (6, n), for one (n,)."""
        flange = self._model.flange_pose(position)[:3, :3]
        at_flange = flange.T @ self._model.flange_jacobian(position).reshape(2, 3, -1)
        at_frame = (self._moved @ at_flange.reshape(6, -1)).reshape(2, 3, -1)
        return ((flange if self._turn is None else self._turn) @ at_frame).reshape(6, -1)

    def of(self, position: FloatArray, external: FloatArray, deviation: FloatArray) -> Wrench:
        """Return the wrench on the arm.

        Args:
            position: Of the joints, (n,) [rad].
            external: Measured minus estimated torque, (n,) [N m].
            deviation: One standard deviation of it, (n,) [N m]; where one is unknown, all joints
                count alike.
        """
        J, known = self.jacobian(position), bool((deviation > 0).all())
        weighted = J / deviation**2 if known else J
        information = weighted @ J.T + np.eye(6) / _PRIOR**2
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        value = -covariance @ (weighted @ external)
        return Wrench(value, covariance * (1.0 if known else np.nan))


@dataclass(frozen=True, eq=False, repr=False)
class ExternalWrench(Displayed):
    """What the environment exerted on an arm, sample by sample: force, then torque [N, N m].

    About the origin of a frame, in its axes or, if `in_base`, in those of the robot's base.
    """

    frame: str
    in_base: bool
    time: FloatArray  # (T,) [s]
    value: FloatArray  # (T, 6)
    std: FloatArray  # (T, 6), one standard deviation; NaN where errors of torque are unknown
    external: FloatArray  # (T, n) [N m], measured less estimated torque
    bias: FloatArray  # (n,) [N m], taken off that

    @property
    def force(self) -> FloatArray:
        """Size of the force, (T,) [N]."""
        return np.linalg.norm(self.value[:, :3], axis=1)

    @property
    def certainty(self) -> FloatArray:
        """Size of the force over its standard deviation, (T,); NaN where that is unknown.

        A force is where this is large. In a singular pose a small torque is a large force, and its
        deviation is as large.
        """
        value, std = self.value[:, :3], self.std[:, :3]
        return self.force**2 / np.linalg.norm(value * std, axis=1)

    def headline(self) -> str:
        """Say how large the force is, and how sure."""
        half, most = np.quantile(self.force, (0.5, 0.95))
        sure = np.median(1.96 * np.linalg.norm(self.std[:, :3], axis=1))
        known = "" if np.isnan(sure) else f"; 95 % of its errors within {sure:.2f} N"
        return (
            f"force at {self.frame}: half of {len(self.time)} samples below {half:.2f} N, 95 % "
            f"below {most:.2f} N{known}"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the external torque of each joint, and what was taken off it."""
        rms = np.sqrt(np.mean(self.external**2, axis=0))
        return {
            "joint": range(1, len(rms) + 1),
            "external, RMS [N m]": rms.tolist(),
            "bias [N m]": self.bias.tolist(),
        }
