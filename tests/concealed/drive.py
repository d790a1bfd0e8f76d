"""The drives of the concealed plant: gears, friction and what else acts between motor and link.

The sign of dry friction is s = v / (v⁴ + sharpness⁴)^¼: as smooth as any, with tails so short that
a joint that slides has the dry friction of its level and nothing else. A
joint's friction is `level` s + `rest`.
"""

import numpy as np
import presliding
from arm import N

from limo_driver.runtime.compiled import compiled

GAUSS, TUSTIN, LORENTZ = range(3)  # how the Stribeck excess falls with speed
NOWHERE = -1


# One record for each joint; zero where an effect is absent.
FIELDS = [
    ("rotor", "f8"),  # [kg m^2] seen from the joint; the torque sensor does not feel it
    ("armature", "f8"),  # [kg m^2] that it does feel
    ("coulomb", "f8"),  # [N m]
    ("sharpness", "f8"),  # [rad/s] of the sign
    ("one_sided", "f8"),  # [N m] of dry friction in one direction only
    ("side", "f8"),  # that direction, ±1
    ("viscous", "f8"),  # [N m s/rad]
    ("stribeck", "f8"),  # [N m] excess near rest
    ("stribeck_speed", "f8"),  # [rad/s]
    ("stribeck_law", "i8"),
    ("load", "f8"),  # dry friction for each N m of load
    ("load_side", "f8"),  # 0: any load; ±1: only load along the motion, or against it
    ("where", "f8", (3, 3)),  # amplitude [N m], cycles per revolution, phase
    ("bump", "f8", 3),  # amplitude [N m], place [rad], width [rad]
    ("cold", "f8"),  # [N m] of dry friction that goes as the joint warms
    ("warming", "f8"),  # [s]
    ("drag", "f8"),  # [N m (s/rad)^power]
    ("power", "f8"),
    ("ripple", "f8", (3, 3)),  # amplitude [N m], cycles per revolution, phase
    ("spring", "f8"),  # [N m/rad] to the link before
    ("spring_rest", "f8"),  # [rad]
    ("spring_width", "f8"),  # [rad] over which it stiffens, k w sinh(x / w)
    ("stiffness", "f8"),  # [N m/rad] of the gear; 0: rigid
    ("hardening", "f8"),  # [1/rad^2] of that stiffness
    ("gap", "f8"),  # [rad] of play in the gear
    ("other", "i8"),  # joint that this one is coupled with by a differential, or NOWHERE
    ("ratio", "f8"),  # ±1
    ("coupled_viscous", "f8"),  # [N m s/rad]
    ("coupled_coulomb", "f8"),  # [N m]
    ("coupled_inertia", "f8"),  # [kg m^2]
    ("neighbour", "i8"),  # joint whose load, heat or position acts here, or NOWHERE
    ("neighbour_load", "f8"),  # dry friction for each N m of its load
    ("neighbour_heat", "f8"),  # [N m] of dry friction when it is warm
    ("neighbour_hose", "f8"),  # [N m/rad^2] of a hose wound over both joints
    ("dwell", "f8"),  # [N m] of breakaway after a long rest
    ("dwell_time", "f8"),  # [s]
    ("dwell_distance", "f8"),  # [rad]
    ("slack", "f8"),  # [rad] within which the drive does not follow the joint
    ("slack_share", "f8"),  # of the joint's friction that the drive has
    *presliding.FIELDS,
]
MEMORY = [
    ("z", "f8"),  # of the law of presliding
    ("relay", "f8", presliding.RELAYS),
    ("heat", "f8"),  # 0 cold to 1 warm
    ("rested", "f8"),  # 0 just moved to 1 long at rest
    ("ahead", "f8"),  # [rad] of the joint before its drive
]
_DIVISORS = (
    "side", "stribeck_speed", "warming", "power", "spring_width", "dwell_time", "dwell_distance",
    "width", "rise_speed",
)  # fmt: skip


def plain(
    rotor: np.ndarray, coulomb: np.ndarray, viscous: np.ndarray, sharpness: float
) -> np.ndarray:
    """Make rigid drives with dry and viscous friction, (n,) of `FIELDS`."""
    drives = np.zeros(N, FIELDS)
    for name in _DIVISORS:
        drives[name] = 1.0
    drives["bump"][:, 2] = 1.0
    drives["other"] = drives["neighbour"] = NOWHERE
    drives["rotor"], drives["coulomb"], drives["viscous"] = rotor, coulomb, viscous
    drives["sharpness"] = sharpness
    return drives


def changed(drives: np.ndarray, joint: int, **values: object) -> np.ndarray:
    """Return the drives with other values at one joint."""
    made = drives.copy()
    for name, value in values.items():
        made[name][joint] = value
    return made


def rested() -> np.ndarray:
    """Return the memory of drives that have long been at rest, (n,) of `MEMORY`."""
    memory = np.zeros(N, MEMORY)
    memory["relay"] = np.where(np.arange(presliding.RELAYS) % 2, 1.0, -1.0)
    return memory


@compiled(fastmath=True)
def slope(v, sharpness):
    """Return the sign of `v` over `v` [s/rad]; an implicit step needs it so."""
    return 1 / np.sqrt(np.sqrt(v**4 + sharpness**4))


@compiled(fastmath=True)
def level(d, j, q, v, load, m):
    """Return the height of dry friction of joint `j` [N m].

    Args:
        d: Drives.
        j: Joint.
        q: Motor positions, (n,) [rad].
        v: Velocity of this joint [rad/s].
        load: Torques that the gears transmit, (n,) [N m].
        m: Memory.
    """
    p = d[j]
    s = v * slope(v, p.sharpness)
    height = p.coulomb + p.one_sided * 0.5 * (1 + p.side * s)
    if p.stribeck != 0.0:
        x = abs(v) / p.stribeck_speed
        if p.stribeck_law == GAUSS:
            height += p.stribeck * np.exp(-x * x)
        elif p.stribeck_law == TUSTIN:
            height += p.stribeck * np.exp(-x)
        else:
            height += p.stribeck / (1 + x * x)
    if p.load != 0.0:
        along = load[j] * s * p.load_side
        if p.load_side == 0.0:
            height += p.load * np.sqrt(load[j] ** 2 + 0.01)
        elif along > 0:
            height += p.load * along
    for k in range(3):
        if p.where[k, 0] != 0.0:
            height += p.where[k, 0] * np.sin(p.where[k, 1] * q[j] + p.where[k, 2])
    if p.bump[0] != 0.0:
        height += p.bump[0] * np.exp(-(((q[j] - p.bump[1]) / p.bump[2]) ** 2))
    height += p.cold * (1 - m[j].heat) + p.dwell * m[j].rested
    k = int(p.neighbour)
    if k >= 0:
        height += p.neighbour_load * abs(load[k]) + p.neighbour_heat * m[k].heat
    return height * taken_along(p, v, m[j])


@compiled(fastmath=True)
def rest(d, j, q, v, m):
    """Return what acts besides dry friction [N m]; arguments as in `level`."""
    p = d[j]
    value = p.viscous * v * taken_along(p, v, m[j])
    if p.drag != 0.0:
        value += p.drag * np.sign(v) * abs(v) ** p.power
    for k in range(3):
        if p.ripple[k, 0] != 0.0:
            value += p.ripple[k, 0] * np.sin(p.ripple[k, 1] * q[j] + p.ripple[k, 2])
    if p.spring != 0.0:
        w = p.spring_width
        value += p.spring * w * np.sinh((q[j] - p.spring_rest) / w)
    k = int(p.neighbour)
    if k >= 0:
        value += p.neighbour_hose * q[j] * q[k]
    return value + presliding.torque(p, m[j])


@compiled(fastmath=True)
def taken_along(p, v, memory):
    """Return the part of a joint's friction that is there: a drive within its slack has none."""
    if p.slack == 0.0:
        return 1.0
    beyond = memory.ahead * np.sign(v) / (0.5 * p.slack) - 0.98  # a flank gives way by a hundredth
    return 1.0 - p.slack_share * (1.0 - min(max(beyond / 0.02, 0.0), 1.0))


@compiled(fastmath=True)
def advance(d, j, dq, v, dt, m):
    """Let joint `j` remember that it moved by `dq` [rad] at `v` [rad/s] in `dt` [s]."""
    p = d[j]
    presliding.advance(p, dq, v, m[j])
    m[j].ahead = min(max(m[j].ahead + dq, -0.5 * p.slack), 0.5 * p.slack)
    m[j].heat += dt / p.warming * (1 - np.exp(-abs(v) / 0.01) - m[j].heat)
    if p.dwell != 0.0:
        if abs(v) < 1e-3:
            m[j].rested += dt / p.dwell_time * (1 - m[j].rested)
        else:
            m[j].rested *= np.exp(-abs(dq) / p.dwell_distance)


@compiled(fastmath=True)
def gear(d, j, deflection):
    """Return the torque of gear `j` [N m] and its slope [N m/rad]."""
    p = d[j]
    k, b = p.stiffness, 0.5 * p.gap
    if b == 0.0:
        x2 = p.hardening * deflection**2
        return k * deflection * (1 + x2), k * (1 + 3 * x2)
    w = 0.02 * b + 1e-6  # flanks that round off
    over, under = (deflection - b) / w, (-deflection - b) / w
    up = over if over > 30 else np.log1p(np.exp(over)) if over > -30 else 0.0
    down = under if under > 30 else np.log1p(np.exp(under)) if under > -30 else 0.0
    slope_up = 1.0 if over > 30 else 1 / (1 + np.exp(-over)) if over > -30 else 0.0
    slope_down = 1.0 if under > 30 else 1 / (1 + np.exp(-under)) if under > -30 else 0.0
    return k * w * (up - down), k * (slope_up + slope_down)
