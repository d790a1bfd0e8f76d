"""How links follow joints, and the poses, mass matrix and torque of an arm."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError, ShapeError
from limo_driver.types import FloatArray, IntArray, as_numbers, readonly

# pinocchio has no stubs and is found through an import hook; this file is an adapter to it.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
_MOTION = ("position", "velocity", "acceleration")
_OWN = {"_data", "_pool"}
_MANY = 1000  # samples, from which on another thread is worth waking


class ArmDynamics(ABC):
    """What the rigid bodies of n joints do; a subclass says which bodies they are."""

    pin_model: Any  # of the n joints
    pin_tree: Any  # of the m links, each with a joint of its own
    linkage: JointLinkage  # which of the n joints moves each of the m links
    massless: tuple[str, ...]  # names of links without a mass, for which no torque is computed
    _flange: int  # frame

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return int(self.pin_model.nv)

    @abstractmethod
    def check_masses(self) -> None:
        """Refuse an arm whose torques cannot be computed, as links state no mass."""

    @abstractmethod
    def with_gravity(self, gravity: Sequence[float]) -> Self:
        """Return this robot under another gravity, (3,) [m/s²] in the frame of the base."""

    @cached_property
    def _data(self) -> Any:  # noqa: ANN401  # pinocchio's
        """Room in which pinocchio computes with `pin_model`."""
        return self.pin_model.createData()

    def __getstate__(self) -> dict[str, Any]:
        """Return what is sent to another process or copied: room to compute in is made anew there.

        pinocchio cannot always read what it has written of it, since some is not set.
        """
        return {name: value for name, value in vars(self).items() if name not in _OWN}

    def flange_position(self, position: FloatArray) -> FloatArray:
        """Return where the flange is in the base frame.

        Args:
            position: (T, n) or (n,) [rad].

        Returns:
            (T, 3) [m]; T is 1 for one position.

        Raises:
            ShapeError: Another number of joints.
        """
        several = self._several("position", np.atleast_2d(as_numbers("position", position)))
        return np.array([self.flange_pose(q)[:3, 3] for q in several]).reshape(-1, 3)

    def flange_pose(self, position: FloatArray) -> FloatArray:
        """Return the pose of the flange in the base frame.

        Args:
            position: One joint position, (n,) [rad].

        Returns:
            Homogeneous transform, (4, 4) [m].

        Raises:
            ShapeError: The position is not (n,).
        """
        pin.forwardKinematics(self.pin_model, self._data, self._one(position))
        pin.updateFramePlacement(self.pin_model, self._data, self._flange)
        return np.array(self._data.oMf[self._flange].homogeneous)

    def joint_poses(self, position: FloatArray) -> FloatArray:
        """Return the pose of every joint frame in the base frame, of those that follow as well.

        Args:
            position: One joint position, (n,) [rad].

        Returns:
            Homogeneous transforms of the m links that move, (m, 4, 4) [m].

        Raises:
            ShapeError: The position is not (n,).
        """
        pin.forwardKinematics(self.pin_model, self._data, self._one(position))
        return np.array([self._data.oMi[k + 1].homogeneous for k in range(self.linkage.links)])

    def link_poses(self, position: FloatArray) -> FloatArray:
        """Return the pose of every joint frame in the base frame, with no joint led by another.

        Args:
            position: Of the m links' own joints, (m,) [rad].

        Returns:
            Homogeneous transforms, (m, 4, 4) [m].

        Raises:
            ShapeError: The position is not (m,).
        """
        array, links = as_numbers("position", position), self.linkage.links
        if array.shape != (links,):
            raise ShapeError("position", array.shape, f"({links},)")
        data = self.pin_tree.createData()
        pin.forwardKinematics(self.pin_tree, data, array)
        return np.array([data.oMi[k + 1].homogeneous for k in range(links)])

    def flange_jacobian(self, position: FloatArray) -> FloatArray:
        """Return the Jacobian of the flange, in the axes of the base.

        Args:
            position: One joint position, (n,) [rad].

        Returns:
            (6, n): velocity [m/rad], then angular velocity [1], of each joint's.

        Raises:
            ShapeError: The position is not (n,).
        """
        jacobian = pin.computeFrameJacobian(
            self.pin_model,
            self._data,
            self._one(position),
            self._flange,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return np.array(jacobian).reshape(6, self.n)  # of one joint, pinocchio returns a row

    def mass_matrix(self, position: FloatArray) -> FloatArray:
        """Return the joint mass matrix.

        Args:
            position: One joint position, (n,) [rad].

        Returns:
            Symmetric, (n, n) [kg m²].

        Raises:
            ConfigError: A link has no mass.
            ShapeError: The position is not (n,).
        """
        self.check_masses()
        M = pin.crba(self.pin_model, self._data, self._one(position))
        return np.triu(M) + np.triu(M, 1).T

    def inertia_of(self, position: FloatArray, j: int) -> FloatArray:
        """Return one column of the mass matrices of T positions.

        Args:
            position: (T, n) [rad].
            j: Column, 0-based.

        Returns:
            (T, n) [kg m²].

        Raises:
            ConfigError: There is no such column.
            ShapeError: The positions are not (T, n).
        """
        position = self._several("position", as_numbers("position", position))
        if j not in range(self.n):
            raise ConfigError(f"column {j!r} does not exist, expected 0 to {self.n - 1}")
        still, unit = np.zeros_like(position), np.zeros_like(position)
        unit[:, j] = 1.0
        return self._weightless.inverse_dynamics(position, still, unit)

    @cached_property
    def _weightless(self) -> Self:
        return self.with_gravity((0.0, 0.0, 0.0))

    @cached_property
    def _pool(self) -> Any:  # noqa: ANN401  # pinocchio has no types
        return pin.ModelPool(self.pin_model, _threads())

    def gravity_torque(self, position: FloatArray) -> FloatArray:
        """Return the torque that holds the arm still.

        Args:
            position: (T, n) or (n,) [rad].

        Returns:
            Joint torques, (T, n) [N m]; T is 1 for one position.

        Raises:
            ShapeError: Another number of joints.
        """
        q = np.atleast_2d(as_numbers("position", position))
        return self.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))

    def inverse_dynamics(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Compute rigid-body torques, tau = M(q) ddq + C(q, dq) dq + g(q).

        Args:
            position: (T, n) [rad].
            velocity: (T, n) [rad/s].
            acceleration: (T, n) [rad/s²].

        Returns:
            Joint torques, (T, n) [N m].

        Raises:
            ConfigError: A link has no mass.
            ShapeError: The arrays are not all (T, n).
        """
        if self.massless:
            self.check_masses()
        if not type(position) is type(velocity) is type(acceleration) is np.ndarray:
            position, velocity, acceleration = (
                as_numbers(*item)
                for item in zip(_MOTION, (position, velocity, acceleration), strict=True)
            )
        shape = position.shape
        if not shape == velocity.shape == acceleration.shape == (*shape[:1], self.n):
            given = {"position": position, "velocity": velocity, "acceleration": acceleration}
            self._refuse_shapes(given)
        if shape[0] == 1:
            torque = pin.rnea(self.pin_model, self._data, position[0], velocity[0], acceleration[0])
            return np.array([torque])
        columns = [np.asfortranarray(value.T) for value in (position, velocity, acceleration)]
        # of one joint, pinocchio returns a row
        threads = self._pool.size() if shape[0] > _MANY else 1
        return np.array(pin.rneaInParallel(threads, self._pool, *columns).T).reshape(shape)

    def _one(self, position: FloatArray) -> FloatArray:
        """Return one position (n,), checked."""
        array = as_numbers("position", position)
        if array.shape != (self.n,):
            raise ShapeError("position", array.shape, f"({self.n},)")
        return array

    def _several(self, name: str, values: FloatArray) -> FloatArray:
        """Return values of T positions (T, n), checked."""
        self._refuse_shapes({name: values})
        return values

    def _refuse_shapes(self, given: Mapping[str, FloatArray]) -> None:
        shape = np.shape(next(iter(given.values())))
        for name, value in given.items():
            if np.shape(value) != shape or np.ndim(value) != 2 or shape[1] != self.n:  # noqa: PLR2004
                raise ShapeError(name, np.shape(value), f"(T, {self.n})")


def _threads() -> int:
    """Return how many threads a computation may use, as OpenMP decides it."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdigit() and int(asked) else len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class JointLinkage:
    """How n joints move m links, of which each stands where one joint puts it.

        q_link = ratio q[driver] + offset

    Links come in the order of the tree, those that follow after those that they follow; so the
    first link of a joint is its own, and the joints are in the order of their own links.
    """

    driver: IntArray  # (m,), 0-based joint
    ratio: FloatArray  # (m,), 1 for the own link of a joint
    offset: FloatArray  # (m,) [rad, m]

    @classmethod
    def plain(cls, n: int) -> JointLinkage:
        """Return the linkage of n joints that move a link each."""
        return cls(_indices(range(n)), readonly(np.ones(n)), readonly(np.zeros(n)))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.driver.max(initial=-1)) + 1

    @property
    def links(self) -> int:
        """Number of links that move."""
        return self.driver.size

    @property
    def is_plain(self) -> bool:
        """Whether each joint moves a link, and none follows another."""
        return self.n == self.links

    @property
    def own(self) -> IntArray:
        """The own link of each joint, (n,)."""
        return np.unique(self.driver, return_index=True)[1]

    def positions(self, position: FloatArray) -> FloatArray:
        """Return the position of each link's joint, (..., m) [rad, m], of those of joints."""
        return position if self.is_plain else self.ratio * position[..., self.driver] + self.offset

    def rates(self, rate: FloatArray) -> FloatArray:
        """Return velocities or accelerations of each link's joint, (..., m), of those of joints."""
        return rate if self.is_plain else self.ratio * rate[..., self.driver]

    def torques(self, torque: FloatArray) -> FloatArray:
        """Return the torque of each joint, (..., n) [N m], of those about each link's own axis."""
        if self.is_plain:
            return torque
        summed = np.zeros((*torque.shape[:-1], self.n))
        for link, joint in enumerate(self.driver.tolist()):
            summed[..., joint] += self.ratio[link] * torque[..., link]
        return summed

    def felt_by(self, link: int) -> int:
        """Return how many joints, from the first on, can feel what moves with a link."""
        return int(self.driver[: link + 1].max()) + 1


def linkage_of(
    names: Sequence[str], followed: Mapping[str, tuple[str, float, float]]
) -> JointLinkage:
    """Return the linkage of links that are named by the joints of their own.

    Args:
        names: Of the joints of m links, each after the one that it follows.
        followed: Of joints that follow others: which one, ratio and offset.
    """
    joints = [name for name in names if name not in followed]
    drives = [followed.get(name, (name, 1.0, 0.0)) for name in names]
    return JointLinkage(
        _indices(joints.index(leader) for leader, _, _ in drives),
        readonly(np.array([ratio for _, ratio, _ in drives])),
        readonly(np.array([offset for _, _, offset in drives])),
    )


def _indices(values: Iterable[int]) -> IntArray:
    array = np.array(list(values), dtype=np.int64)
    array.flags.writeable = False
    return array
