"""Inverse dynamics of a serial arm by Newton and Euler's recursion, inside compiled loops.

Where a pose is evaluated at a time, a call of `RobotModel.inverse_dynamics` costs more than the
arithmetic of this one.

Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 5.3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.dynamics.regressor import (
    PER_LINK,
    add,
    cross,
    dot,
    origin,
    slide,
    store,
    times,
    to_child,
    vector,
    write_rotation,
)
from limo_driver.errors import ConfigError
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


def link_parameters(model: RobotModel) -> FloatArray:
    """Return the inertial parameters of each moving link, (n, 10), in the order of `regressor`.

    Raises:
        ConfigError: The joints are not in series, each with a link of its own.
    """
    names = model.joint_names
    if not model.linkage.is_plain:
        raise ConfigError(
            "has joints that follow others, with which this cannot be computed: lock one of both, "
            f"as `#{','.join(names)},{next(iter(model.description.followers))}=0` does",
            path=model.urdf,
        )
    if list(model.pin_tree.parents)[1:] != list(range(model.n)):
        raise ConfigError(
            f"its joints {', '.join(names)} are not in series, as this needs: choose those of one "
            "arm, as `#arm_*` does",
            path=model.urdf,
        )
    inertias = list(model.pin_model.inertias)[1:]
    return np.array([inertia.toDynamicParameters() for inertia in inertias]).reshape(-1, PER_LINK)


@compiled(
    reads=("parameters", "position", "velocity", "acceleration"),
    nogil=True,
    fastmath={"contract", "nsz"},
)
def inverse_dynamics(
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    parameters: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
) -> None:
    """Write the torque (n,) [N m] of one sample; the arm is that of a `Chain`.

    Outward, the motion of each link in its own frame; inward, the force f and the moment m about
    its origin that move it and all links after it.
    """
    n = axis.shape[0]
    R = np.empty((n, 3, 3))
    p, f, m = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    w, dw = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    a = (-gravity[0], -gravity[1], -gravity[2])
    for i in range(n):
        u, along, v = vector(axis[i, 3:]), vector(axis[i, :3]), velocity[i]
        write_rotation(rotation[i], u, position[i], R[i])
        store(p[i], origin(rotation[i], translation[i], along, position[i]))
        swung = cross(w, cross(w, vector(p[i])))
        a = to_child(R[i], add(a, add(cross(dw, vector(p[i])), swung)))
        w, dw = to_child(R[i], w), to_child(R[i], dw)
        a = add(a, slide(along, w, v, acceleration[i]))
        dw = add(dw, add(times(u, acceleration[i]), times(cross(w, u), v)))
        w = add(w, times(u, v))
        first = vector(parameters[i, 1:4])  # mass times centre
        swing = add(cross(dw, first), cross(w, cross(w, first)))
        store(f[i], add(times(a, parameters[i, 0]), swing))
        spin = add(_inertia(parameters[i], dw), cross(w, _inertia(parameters[i], w)))
        store(m[i], add(spin, cross(first, a)))
    for i in range(n - 1, -1, -1):
        turning = dot(vector(axis[i, 3:]), vector(m[i]))
        torque[i] = turning + dot(vector(axis[i, :3]), vector(f[i]))
        if i > 0:
            force, moment = _to_parent(R[i], vector(f[i])), _to_parent(R[i], vector(m[i]))
            lever = cross(vector(p[i]), force)
            store(f[i - 1], add(vector(f[i - 1]), force))
            store(m[i - 1], add(vector(m[i - 1]), add(moment, lever)))


@compiled(nogil=True, fastmath={"contract", "nsz"})
def _inertia(parameters: FloatArray, x: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return I x with the inertia I about the origin of the link."""
    xx, xy, yy = parameters[4], parameters[5], parameters[6]
    xz, yz, zz = parameters[7], parameters[8], parameters[9]
    return (
        xx * x[0] + xy * x[1] + xz * x[2],
        xy * x[0] + yy * x[1] + yz * x[2],
        xz * x[0] + yz * x[1] + zz * x[2],
    )


@compiled(nogil=True, fastmath={"contract", "nsz"})
def _to_parent(R: FloatArray, x: tuple[float, float, float]) -> tuple[float, float, float]:
    """Express x in the parent's frame."""
    return (
        R[0, 0] * x[0] + R[0, 1] * x[1] + R[0, 2] * x[2],
        R[1, 0] * x[0] + R[1, 1] * x[1] + R[1, 2] * x[2],
        R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2],
    )
