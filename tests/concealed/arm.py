"""The rigid arm of the concealed plant: its numbers, and its dynamics in the world frame.

Everything here is written from the equations of Newton and Euler in world coordinates and shares
nothing with limo, which is measured against it, but where machine code is kept.

Source: Luh, Walker, Paul, "On-line computational scheme for mechanical manipulators", 1980; the
composite bodies are from Walker, Orin, "Efficient dynamic computer simulation", 1982.
"""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.runtime.compiled import compiled

N = 7
URDF = Path(__file__).parents[2] / "limo_driver" / "assets" / "iiwa14.urdf"
EFFORT = np.array([320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0])  # [N m] of its data sheet
FLANGE = 0.045  # [m] from the last link's frame along its axis


class Arm(NamedTuple):
    """A serial arm whose joints turn about the z axis of their link's frame."""

    rotation: np.ndarray  # (n, 3, 3) of each frame in the one before, at zero angle
    offset: np.ndarray  # (n, 3) [m] of each frame in the one before
    mass: np.ndarray  # (n,) [kg]
    com: np.ndarray  # (n, 3) [m] in the link's frame
    inertia: np.ndarray  # (n, 3, 3) [kg m^2] about the centre of mass, axes of the link
    gravity: np.ndarray  # (3,) [m/s^2]


class Limits(NamedTuple):
    position: np.ndarray  # (n,) [rad], symmetric
    velocity: np.ndarray  # (n,) [rad/s]


def load() -> tuple[Arm, Limits]:
    """Read the iiwa 14."""
    root = ET.parse(URDF).getroot()  # noqa: S314  # our own file
    links = [root.find(f"link[@name='link{i}']/inertial") for i in range(1, N + 1)]
    joints = [root.find(f"joint[@name='joint{i}']") for i in range(1, N + 1)]
    arm = Arm(
        np.array([_rotation(_vector(j.find("origin"), "rpy")) for j in joints]),
        np.array([_vector(j.find("origin"), "xyz") for j in joints]),
        np.array([float(link.find("mass").get("value")) for link in links]),
        np.array([_vector(link.find("origin"), "xyz") for link in links]),
        np.array([_inertia(link.find("inertia")) for link in links]),
        np.array([0.0, 0.0, -9.81]),
    )
    limits = [j.find("limit") for j in joints]
    return arm, Limits(
        np.array([float(limit.get("upper")) for limit in limits]),
        np.array([float(limit.get("velocity")) for limit in limits]),
    )


def add_body(arm: Arm, link: int, mass: float, com: np.ndarray, inertia: np.ndarray) -> Arm:
    """Fix a body to a link; `com` and `inertia` about it in the link's frame."""
    total = arm.mass[link] + mass
    centre = (arm.mass[link] * arm.com[link] + mass * com) / total
    about = arm.inertia[link] + inertia
    for m, c in ((arm.mass[link], arm.com[link]), (mass, com)):
        r = c - centre
        about = about + m * (r @ r * np.eye(3) - np.outer(r, r))
    masses, coms, inertias = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    masses[link], coms[link], inertias[link] = total, centre, about
    return arm._replace(mass=masses, com=coms, inertia=inertias)


def _vector(element: ET.Element, name: str) -> np.ndarray:
    return np.array([float(x) for x in element.get(name).split()])


def _inertia(element: ET.Element) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = (
        float(element.get(k)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _rotation(rpy: np.ndarray) -> np.ndarray:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


class Work(NamedTuple):
    """Arrays that the compiled functions write into, so that a step allocates nothing."""

    frame: np.ndarray  # (n, 3, 3) world axes of each link
    origin: np.ndarray  # (n, 3) [m]
    centre: np.ndarray  # (n, 3) [m] centre of mass in the world
    inertia: np.ndarray  # (n, 3, 3) in world axes
    force: np.ndarray  # (n, 3) [N]
    moment: np.ndarray  # (n, 3) [N m] about the link's origin


def work() -> Work:
    return Work(
        np.zeros((N, 3, 3)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 3, 3)),
        np.zeros((N, 3)), np.zeros((N, 3)),
    )  # fmt: skip


@compiled(fastmath=True)
def place(arm, q, w):
    """Write where every link is at `q`."""
    R, o = np.eye(3), np.zeros(3)
    half = np.empty((3, 3))
    for i in range(q.size):
        c, s = np.cos(q[i]), np.sin(q[i])
        for a in range(3):
            w.origin[i, a] = o[a]
            for b in range(3):
                w.origin[i, a] += R[a, b] * arm.offset[i, b]
                half[a, b] = 0.0
                for k in range(3):
                    half[a, b] += R[a, k] * arm.rotation[i, k, b]
        for a in range(3):
            R[a, 0] = c * half[a, 0] + s * half[a, 1]
            R[a, 1] = c * half[a, 1] - s * half[a, 0]
            R[a, 2] = half[a, 2]
            o[a] = w.origin[i, a]
        for a in range(3):
            w.centre[i, a] = o[a]
            for b in range(3):
                w.frame[i, a, b] = R[a, b]
                w.centre[i, a] += R[a, b] * arm.com[i, b]
        _turn(R, arm.inertia[i], half, w.inertia[i])


@compiled(fastmath=True)
def _turn(R, inertia, half, turned):
    """Write R I Rᵀ."""
    for a in range(3):
        for b in range(3):
            half[a, b] = 0.0
            for k in range(3):
                half[a, b] += R[a, k] * inertia[k, b]
    for a in range(3):
        for b in range(a, 3):
            value = 0.0
            for k in range(3):
                value += half[a, k] * R[b, k]
            turned[a, b] = value
            turned[b, a] = value


@compiled(fastmath=True)
def inverse_dynamics(arm, v, a, wrench, w, torque):
    """Write the torque of a motion; `place` comes first.

    Args:
        arm: The arm.
        v: Joint velocities, (n,) [rad/s].
        a: Joint accelerations, (n,) [rad/s^2].
        wrench: Force [N] and moment [N m] from outside at the flange, world axes, (6,).
        w: Placed links.
        torque: (n,) [N m], written.
    """
    _forces(arm, v, a, w)
    _transmit(wrench, w, torque)


@compiled(fastmath=True)
def _forces(arm, v, a, w):
    """Write the force at, and the moment about the origin of, each link; base to tip."""
    n = v.size
    ox, oy, oz = 0.0, 0.0, 0.0  # angular velocity
    dx, dy, dz = 0.0, 0.0, 0.0  # angular acceleration
    ax, ay, az = -arm.gravity[0], -arm.gravity[1], -arm.gravity[2]
    px, py, pz = 0.0, 0.0, 0.0
    for i in range(n):
        rx, ry, rz = w.origin[i, 0] - px, w.origin[i, 1] - py, w.origin[i, 2] - pz
        px, py, pz = w.origin[i, 0], w.origin[i, 1], w.origin[i, 2]
        kx, ky, kz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
        ax += dy * rz - dz * ry + oy * kz - oz * ky
        ay += dz * rx - dx * rz + oz * kx - ox * kz
        az += dx * ry - dy * rx + ox * ky - oy * kx
        zx, zy, zz = w.frame[i, 0, 2], w.frame[i, 1, 2], w.frame[i, 2, 2]
        dx += zx * a[i] + (oy * zz - oz * zy) * v[i]
        dy += zy * a[i] + (oz * zx - ox * zz) * v[i]
        dz += zz * a[i] + (ox * zy - oy * zx) * v[i]
        ox, oy, oz = ox + zx * v[i], oy + zy * v[i], oz + zz * v[i]
        rx, ry, rz = w.centre[i, 0] - px, w.centre[i, 1] - py, w.centre[i, 2] - pz
        kx, ky, kz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
        m, I = arm.mass[i], w.inertia[i]  # noqa: E741
        fx = m * (ax + dy * rz - dz * ry + oy * kz - oz * ky)
        fy = m * (ay + dz * rx - dx * rz + oz * kx - ox * kz)
        fz = m * (az + dx * ry - dy * rx + ox * ky - oy * kx)
        lx = I[0, 0] * ox + I[0, 1] * oy + I[0, 2] * oz
        ly = I[1, 0] * ox + I[1, 1] * oy + I[1, 2] * oz
        lz = I[2, 0] * ox + I[2, 1] * oy + I[2, 2] * oz
        w.force[i, 0], w.force[i, 1], w.force[i, 2] = fx, fy, fz
        w.moment[i, 0] = (
            I[0, 0] * dx + I[0, 1] * dy + I[0, 2] * dz + oy * lz - oz * ly + ry * fz - rz * fy
        )
        w.moment[i, 1] = (
            I[1, 0] * dx + I[1, 1] * dy + I[1, 2] * dz + oz * lx - ox * lz + rz * fx - rx * fz
        )
        w.moment[i, 2] = (
            I[2, 0] * dx + I[2, 1] * dy + I[2, 2] * dz + ox * ly - oy * lx + rx * fy - ry * fx
        )


@compiled(fastmath=True)
def _transmit(wrench, w, torque):
    """Write what each joint passes on, tip to base; a push at the flange carries its part."""
    n = torque.size
    ex, ey = FLANGE * w.frame[n - 1, 0, 2], FLANGE * w.frame[n - 1, 1, 2]
    ez = FLANGE * w.frame[n - 1, 2, 2]
    sx, sy, sz = -wrench[0], -wrench[1], -wrench[2]
    tx = -wrench[3] + ey * sz - ez * sy
    ty = -wrench[4] + ez * sx - ex * sz
    tz = -wrench[5] + ex * sy - ey * sx
    for i in range(n - 1, -1, -1):
        sx, sy, sz = sx + w.force[i, 0], sy + w.force[i, 1], sz + w.force[i, 2]
        tx, ty, tz = tx + w.moment[i, 0], ty + w.moment[i, 1], tz + w.moment[i, 2]
        torque[i] = w.frame[i, 0, 2] * tx + w.frame[i, 1, 2] * ty + w.frame[i, 2, 2] * tz
        if i > 0:
            rx = w.origin[i, 0] - w.origin[i - 1, 0]
            ry = w.origin[i, 1] - w.origin[i - 1, 1]
            rz = w.origin[i, 2] - w.origin[i - 1, 2]
            tx, ty, tz = tx + ry * sz - rz * sy, ty + rz * sx - rx * sz, tz + rx * sy - ry * sx


@compiled(fastmath=True)
def mass_matrix(arm, w, M):
    """Write the joint-space inertia of the placed links, (n, n): composite bodies from the tip."""
    n = M.shape[0]
    mass = 0.0
    c = np.zeros(3)
    body = np.zeros((3, 3))
    for k in range(n - 1, -1, -1):
        total = mass + arm.mass[k]
        for m, p in ((mass, c), (arm.mass[k], w.centre[k])):
            x = p[0] - (mass * c[0] + arm.mass[k] * w.centre[k, 0]) / total
            y = p[1] - (mass * c[1] + arm.mass[k] * w.centre[k, 1]) / total
            z = p[2] - (mass * c[2] + arm.mass[k] * w.centre[k, 2]) / total
            body[0, 0] += m * (y * y + z * z)
            body[1, 1] += m * (x * x + z * z)
            body[2, 2] += m * (x * x + y * y)
            body[0, 1] -= m * x * y
            body[0, 2] -= m * x * z
            body[1, 2] -= m * y * z
        for a in range(3):
            for b in range(a, 3):
                body[a, b] += w.inertia[k, a, b]
                body[b, a] = body[a, b]
            c[a] = (mass * c[a] + arm.mass[k] * w.centre[k, a]) / total
        mass = total
        zx, zy, zz = w.frame[k, 0, 2], w.frame[k, 1, 2], w.frame[k, 2, 2]
        rx, ry, rz = c[0] - w.origin[k, 0], c[1] - w.origin[k, 1], c[2] - w.origin[k, 2]
        px, py, pz = (
            mass * (zy * rz - zz * ry),
            mass * (zz * rx - zx * rz),
            mass * (zx * ry - zy * rx),
        )
        lx = body[0, 0] * zx + body[0, 1] * zy + body[0, 2] * zz
        ly = body[1, 0] * zx + body[1, 1] * zy + body[1, 2] * zz
        lz = body[2, 0] * zx + body[2, 1] * zy + body[2, 2] * zz
        for j in range(k + 1):
            rx, ry, rz = c[0] - w.origin[j, 0], c[1] - w.origin[j, 1], c[2] - w.origin[j, 2]
            M[j, k] = (
                w.frame[j, 0, 2] * (lx + ry * pz - rz * py)
                + w.frame[j, 1, 2] * (ly + rz * px - rx * pz)
                + w.frame[j, 2, 2] * (lz + rx * py - ry * px)
            )
            M[k, j] = M[j, k]


@compiled()
def along(arm, w, q, v, a):
    """Return the torque of a whole motion, (T, n) [N m], without contact."""
    torque, wrench = np.empty_like(q), np.zeros(6)
    for t in range(q.shape[0]):
        place(arm, q[t], w)
        inverse_dynamics(arm, v[t], a[t], wrench, w, torque[t])
    return torque
