"""Dynamics of a chain of bodies: the regressor of its parameters, and inverse dynamics.

The torque regressor of an arm: joint torque is linear in the inertial parameters.

tau = Y(q, dq, ddq) pi,  pi = (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz) of each link

with the inertia at the origin of the joint frame, in pinocchio's order. Where joints follow others,
q = G q_r + b, the regressor of those that move on their own is Gᵀ Y.

Source: Atkeson, An and Hollerbach, "Estimation of inertial parameters of manipulator loads and
links", IJRR 1986.

Inverse dynamics of a serial arm by Newton and Euler's recursion, inside compiled loops.

Where a pose is evaluated at a time, a call of `RobotModel.inverse_dynamics` costs more than the
arithmetic of this one.

Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 5.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.dynamics import JointLinkage
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray, Motion

PER_LINK = 10


@dataclass(frozen=True)
class RegressorChain:
    """Kinematics of an arm of m links that n joints move, as the regressor needs it."""

    parent: IntArray  # (m,), link that carries each, before it; -1 is the base
    rotation: FloatArray  # (m, 3, 3), of each joint frame in the frame of the parent, at zero
    translation: FloatArray  # (m, 3) [m]
    axis: FloatArray  # (m, 6), in the joint's own frame: unit vector of a slide, then of a turn
    gravity: FloatArray  # (3,) [m/s²]
    linkage: JointLinkage

    @classmethod
    def of(cls, model: RobotModel) -> RegressorChain:
        """Read the chain of a robot."""
        tree = model.pin_tree
        placements = list(tree.jointPlacements)[1:]
        axes: list[FloatArray] = []
        for joint in list(tree.joints)[1:]:
            data = joint.createData()
            joint.calc(data, np.zeros(1))
            axes.append(np.array(data.S).ravel())
        return cls(
            np.array(list(tree.parents)[1:], dtype=np.int64) - 1,
            np.array([placement.rotation for placement in placements]),
            np.array([placement.translation for placement in placements]),
            np.array(axes),
            np.array(tree.gravity.linear),
            model.linkage,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.linkage.n

    @property
    def links(self) -> int:
        """Number of links that move, m."""
        return self.linkage.links

    @property
    def width(self) -> int:
        """Number of inertial parameters, 10 m."""
        return PER_LINK * self.links

    def first(self, joint: int) -> int:
        """Return the first parameter, and with it the first link, that a joint (0-based) feels."""
        return PER_LINK * int(self.linkage.own[joint])

    def regressor(self, motion: Motion) -> FloatArray:
        """Return Y, (n, T, 10 m): first the joint, then the sample, then the parameter."""
        Y = np.zeros((self.n, len(motion), self.width))
        self.fill(motion, Y)
        return Y

    def fill(self, motion: Motion, Y: FloatArray) -> None:
        """Write the regressor into Y, (n, at least T, at least 10 m), which holds zeros below."""
        T, linkage = len(motion), self.linkage
        own = Y if linkage.is_plain else np.zeros((self.links, T, self.width))
        fill_regressor(
            self.parent,
            self.rotation,
            self.translation,
            self.axis,
            self.gravity,
            np.ascontiguousarray(linkage.positions(motion.position)),
            np.ascontiguousarray(linkage.rates(motion.velocity)),
            np.ascontiguousarray(linkage.rates(motion.acceleration)),
            own,
        )
        if not linkage.is_plain:
            Y[:, :T, : self.width] = np.moveaxis(linkage.torques(np.moveaxis(own, 0, -1)), -1, 0)


def parameters_of(inertial: Inertial) -> FloatArray:
    """Return (m, m c, I at the joint frame) of a link, (10,)."""
    c = np.array(inertial.com)
    m = inertial.mass
    I = inertial.tensor() + m * (c @ c * np.eye(3) - np.outer(c, c))  # noqa: E741
    return np.array([m, *(m * c), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])


@compiled(
    reads=("rotation", "translation", "position", "velocity", "acceleration"),
    nogil=True,
    fastmath={"contract", "nsz"},
)
def fill_regressor(
    parent: IntArray,
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    Y: FloatArray,
) -> None:
    """Write the regressor of T samples into Y (m, T, 10 m); entries that are zero stay.

    Forward over the links, with everything in the frame of link i: its angular velocity w and
    acceleration dw, the acceleration a of its origin against free fall, and for each joint j that
    carries it its axis z_j and the vector r_j from its origin. The link's force f and moment m then
    give joint j the torque z_j · m + (z_j × r_j) · f, both linear in the parameters of link i. A
    joint that slides along y_j has no z_j, and needs the force y_j · f.
    """
    n = axis.shape[0]
    z, r, y = (
        np.zeros((n, n, 3)),
        np.zeros((n, n, 3)),
        np.zeros((n, n, 3)),
    )  # in the frame of i, of j
    moved = np.zeros((n, 3, 3))  # w, dw, a of each link
    R = np.zeros((3, 3))
    for t in range(position.shape[0]):
        for i in range(n):
            k = parent[i]
            if k < 0:
                w, dw = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
                a = (-gravity[0], -gravity[1], -gravity[2])
            else:
                w, dw, a = vector(moved[k, 0]), vector(moved[k, 1]), vector(moved[k, 2])
            u, along, v = vector(axis[i, 3:]), vector(axis[i, :3]), velocity[t, i]
            write_rotation(rotation[i], u, position[t, i], R)
            p = origin(rotation[i], translation[i], along, position[t, i])
            a = to_child(R, add(a, add(cross(dw, p), cross(w, cross(w, p)))))
            w, dw = to_child(R, w), to_child(R, dw)
            a = add(a, slide(along, w, v, acceleration[t, i]))
            dw = add(dw, add(times(u, acceleration[t, i]), times(cross(w, u), v)))
            w = add(w, times(u, v))
            store(moved[i, 0], w)
            store(moved[i, 1], dw)
            store(moved[i, 2], a)
            j = k
            while j >= 0:
                store(r[i, j], to_child(R, add(vector(r[k, j]), p)))
                store(z[i, j], to_child(R, vector(z[k, j])))
                store(y[i, j], to_child(R, vector(y[k, j])))
                j = parent[j]
            store(z[i, i], u)
            store(y[i, i], along)
            store(r[i, i], (0.0, 0.0, 0.0))  # r[i, i] = ... would compile the message of its error
            j = i
            while j >= 0:
                row = Y[j, t, PER_LINK * i : PER_LINK * (i + 1)]
                arm = add(cross(vector(z[i, j]), vector(r[i, j])), vector(y[i, j]))
                _fill_row(vector(z[i, j]), arm, w, dw, a, row)
                j = parent[j]


_Vector: TypeAlias = tuple[float, float, float]


@compiled(reads=("x",), nogil=True, fastmath={"contract", "nsz"})
def vector(x: FloatArray) -> _Vector:
    """Return the three numbers of x."""
    return x[0], x[1], x[2]


@compiled(nogil=True, fastmath={"contract", "nsz"})
def store(x: FloatArray, values: _Vector) -> None:
    """Write three numbers into x."""
    x[0], x[1], x[2] = values


@compiled(nogil=True, fastmath={"contract", "nsz"})
def add(x: _Vector, y: _Vector) -> _Vector:
    """Return x + y."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@compiled(nogil=True, fastmath={"contract", "nsz"})
def times(x: _Vector, factor: float) -> _Vector:
    """Return x times a factor."""
    return x[0] * factor, x[1] * factor, x[2] * factor


@compiled(nogil=True, fastmath={"contract", "nsz"})
def dot(x: _Vector, y: _Vector) -> float:
    """Return x · y."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@compiled(nogil=True, fastmath={"contract", "nsz"})
def cross(x: _Vector, y: _Vector) -> _Vector:
    """Return x × y."""
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@compiled(nogil=True, fastmath={"contract", "nsz"})
def to_child(R: FloatArray, x: _Vector) -> _Vector:
    """Express x in the child's frame."""
    return (
        R[0, 0] * x[0] + R[1, 0] * x[1] + R[2, 0] * x[2],
        R[0, 1] * x[0] + R[1, 1] * x[1] + R[2, 1] * x[2],
        R[0, 2] * x[0] + R[1, 2] * x[1] + R[2, 2] * x[2],
    )


@compiled(reads=("fixed", "translation"), nogil=True, fastmath={"contract", "nsz"})
def origin(fixed: FloatArray, translation: FloatArray, along: _Vector, position: float) -> _Vector:
    """Return where the frame of a joint is in that of the one before; `along` it slides."""
    x, y, z = times(along, position)
    return (
        translation[0] + (fixed[0, 0] * x + fixed[0, 1] * y + fixed[0, 2] * z),
        translation[1] + (fixed[1, 0] * x + fixed[1, 1] * y + fixed[1, 2] * z),
        translation[2] + (fixed[2, 0] * x + fixed[2, 1] * y + fixed[2, 2] * z),
    )


@compiled(nogil=True, fastmath={"contract", "nsz"})
def slide(along: _Vector, w: _Vector, velocity: float, acceleration: float) -> _Vector:
    """Return the acceleration of a frame that slides in one which turns at w, Coriolis' with it."""
    return add(times(along, acceleration), times(cross(w, along), 2.0 * velocity))


@compiled(reads=("fixed",), nogil=True, fastmath={"contract", "nsz"})
def write_rotation(fixed: FloatArray, axis: _Vector, angle: float, R: FloatArray) -> None:
    """Write fixed · Rot(axis, angle), child to parent, into R; fixed alone where the axis is 0."""
    x, y, z = axis
    turns = x != 0.0 or y != 0.0 or z != 0.0
    c, s = (np.cos(angle), np.sin(angle)) if turns else (1.0, 0.0)
    k = 1.0 - c
    for row in range(3):
        f0, f1, f2 = fixed[row, 0], fixed[row, 1], fixed[row, 2]
        R[row, 0] = f0 * (c + x * x * k) + f1 * (x * y * k + z * s) + f2 * (x * z * k - y * s)
        R[row, 1] = f0 * (x * y * k - z * s) + f1 * (c + y * y * k) + f2 * (y * z * k + x * s)
        R[row, 2] = f0 * (x * z * k + y * s) + f1 * (y * z * k - x * s) + f2 * (c + z * z * k)


@compiled(nogil=True, fastmath={"contract", "nsz"})
def _fill_row(z: _Vector, arm: _Vector, w: _Vector, dw: _Vector, a: _Vector, y: FloatArray) -> None:
    """Write what the ten parameters of a link add to the torque about axis z at distance r.

    Its mass at c accelerates by a + dw × c + w × (w × c); in z · (c × a) + (z × r) · (…) every
    factor of c is a triple product, and the inertia's moment is I dw + w × I w. The arm is z × r,
    or the direction in which a force counts.
    """
    turn = cross(z, w)
    swing = dot(arm, w)
    h = add(cross(a, z), add(cross(arm, dw), add(times(w, swing), times(arm, -dot(w, w)))))
    y[0] = dot(arm, a)
    y[1], y[2], y[3] = h
    y[4] = z[0] * dw[0] + turn[0] * w[0]
    y[5] = z[0] * dw[1] + z[1] * dw[0] + turn[0] * w[1] + turn[1] * w[0]
    y[6] = z[1] * dw[1] + turn[1] * w[1]
    y[7] = z[0] * dw[2] + z[2] * dw[0] + turn[0] * w[2] + turn[2] * w[0]
    y[8] = z[1] * dw[2] + z[2] * dw[1] + turn[1] * w[2] + turn[2] * w[1]
    y[9] = z[2] * dw[2] + turn[2] * w[2]


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
    reads=(
        "rotation",
        "translation",
        "axis",
        "gravity",
        "parameters",
        "position",
        "velocity",
        "acceleration",
    ),
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
