"""Poses and inertias of bodies, as descriptions state them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin

    from limo_driver.types import FloatArray

# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
_ROUNDING = 1e-9  # of the largest second moment
_THIN = 1e-4  # of the largest second moment, that a body which was none gets at least
_GRAIN = 1e-3  # [m], root mean square extent of what stands for a point mass along each axis


def numbers(values: FloatArray | Sequence[float]) -> str:
    """Return numbers as they stand in XML."""
    return " ".join(repr(float(value)) for value in values)


def rotation_of(rpy: FloatArray) -> FloatArray:
    """Return the rotation matrix of roll, pitch and yaw [rad], (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def rpy_of(R: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw [rad] of a rotation matrix, (3,)."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at a pitch of 90 degrees any of the angles will do
        return np.asarray(Rotation.from_matrix(R).as_euler("xyz"))


def turned(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation about a unit axis by an angle [rad], (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(axis * angle).as_matrix())


@dataclass(frozen=True)
class Inertial:
    """Inertia of all that moves rigidly with one joint, in the frame of its link."""

    mass: float  # [kg]
    com: tuple[float, float, float]  # [m]
    inertia: tuple[float, float, float, float, float, float]  # at the com: xx xy xz yy yz zz

    @classmethod
    def of_pinocchio(cls, inertia: pin.Inertia) -> Inertial:
        """Return what pinocchio has for a link."""
        tensor = np.array(inertia.inertia)
        return cls(
            mass=float(inertia.mass),
            com=tuple(np.array(inertia.lever).tolist()),
            inertia=tuple(tensor[np.triu_indices(3)].tolist()),
        )

    def tensor(self) -> FloatArray:
        """Return the 3 × 3 inertia tensor at the centre of mass [kg m²]."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def is_consistent(self) -> bool:
        """Say whether mass and inertia are physically consistent, as those of some rigid body.

        True if the mass is positive and the density-weighted covariance is positive definite,
        which for the tensor means positive principal moments that satisfy the triangle inequality.
        """
        return bool(self.mass > 0 and self._second_moments().min() > 0)

    def is_possible(self) -> bool:
        """Say whether it can be fixed to a link: a rigid body, a rod, a point mass or nothing."""
        moments = self._second_moments()
        largest = float(np.abs(moments).max())
        massive = self.mass > 0 or (self.mass == 0 and largest == 0)
        return bool(massive and moments.min() >= -_ROUNDING * largest)

    def has_extent(self) -> bool:
        """Say whether it is a rigid body that resists turning about every axis."""
        return self.is_possible() and bool(np.linalg.eigvalsh(self.tensor()).min() > 0)

    def nearest_consistent(self) -> Inertial:
        """Return the rigid body of the same mass and centre whose inertia is nearest.

        A principal moment above the sum of the others asks for less than no extent along its axis;
        the body gets next to none there, as a thin plate has. A point mass becomes a grain.
        """
        moments, axes = np.linalg.eigh(self._covariance())
        least = _THIN * moments.max() if moments.max() > 0 else self.mass * _GRAIN**2
        moments = np.maximum(moments, least)
        covariance = (axes * moments) @ axes.T
        tensor = np.trace(covariance) * np.eye(3) - covariance
        xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
        return replace(self, inertia=(xx, xy, xz, yy, yz, zz))

    def joined(self, other: Inertial) -> Inertial:
        """Return both bodies as one; both in the frame of the same link."""
        mass = self.mass + other.mass
        com = (self.mass * np.array(self.com) + other.mass * np.array(other.com)) / mass
        tensor = self._tensor_at(com) + other._tensor_at(com)
        x, y, z = com.tolist()
        xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
        return Inertial(mass, (x, y, z), (xx, xy, xz, yy, yz, zz))

    def moved(self, pose: FloatArray) -> Inertial:
        """Return this body, given in the frame at a pose, as another frame has it.

        Args:
            pose: Of its own frame in the other, homogeneous, (4, 4) [m].
        """
        R = pose[:3, :3]
        x, y, z = (R @ np.array(self.com) + pose[:3, 3]).tolist()
        turned = R @ self.tensor() @ R.T
        xx, xy, xz, yy, yz, zz = turned[np.triu_indices(3)].tolist()
        return Inertial(self.mass, (x, y, z), (xx, xy, xz, yy, yz, zz))

    def _second_moments(self) -> FloatArray:
        """Return the principal values of ∫ρ x xᵀ about the centre of mass, (3,) [kg m²]."""
        return np.linalg.eigvalsh(self._covariance()).astype(np.float64)

    def _covariance(self) -> FloatArray:
        """Return ∫ρ x xᵀ about the centre of mass, (3, 3) [kg m²]."""
        tensor = self.tensor()
        return 0.5 * np.trace(tensor) * np.eye(3) - tensor

    def _tensor_at(self, point: FloatArray) -> FloatArray:
        """Return the inertia tensor about a point, by Steiner's theorem, (3, 3) [kg m²]."""
        d = np.array(self.com) - point
        return self.tensor() + self.mass * (d @ d * np.eye(3) - np.outer(d, d))
