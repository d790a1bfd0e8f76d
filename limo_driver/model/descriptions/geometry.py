"""Rotations and numbers as descriptions write them."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray


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
