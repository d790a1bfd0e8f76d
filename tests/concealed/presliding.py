"""Laws of presliding: torque that builds up over the distance since the last reversal.

Each law gives a number within about ±1, reached some `width` after a reversal; the drive scales it.

Source: Canudas de Wit et al., "A new model for control of systems with friction", 1995 (LuGre);
Wen, "Method for random vibration of hysteretic systems", 1976; Mayergoyz, "Mathematical Models of
Hysteresis", 1991 (Preisach).
"""

import numpy as np

from limo_driver.runtime.compiled import compiled

NONE, LUGRE, BOUC_WEN, PREISACH = range(4)
LAWS = {"lugre": LUGRE, "bouc_wen": BOUC_WEN, "preisach": PREISACH}
RELAYS = 300


FIELDS = [
    ("law", "i8"),
    ("sliding", "f8"),  # [N m] while sliding
    ("width", "f8"),  # [rad]
    ("rise", "f8"),  # LuGre: excess at rest
    ("rise_speed", "f8"),  # [rad/s] at which it is gone
    ("exponent", "f8"),  # Bouc-Wen
    ("share", "f8"),  # Bouc-Wen: how much less stiff on the way in than on the way out
    ("up", "f8", RELAYS),  # deflection at which a relay turns on, in widths
    ("down", "f8", RELAYS),  # and off
    ("weight", "f8", RELAYS),
]


def draw(law: str, sliding: float, width: float, random: np.random.Generator) -> dict:
    """Return the fields of a joint that has this law, its shape drawn."""
    fields = {"law": LAWS[law], "sliding": sliding, "width": width}
    if law == "lugre":
        fields |= {"rise": random.uniform(0.05, 0.3), "rise_speed": random.uniform(0.005, 0.02)}
    elif law == "bouc_wen":
        fields |= {"exponent": random.uniform(1.0, 2.0), "share": random.uniform(0.55, 0.95)}
    else:
        # Thresholds off the diagonal and denser at small loops: not a sum of symmetric stops.
        turn, middle = random.beta(1.2, 1.6, RELAYS), random.uniform(-1, 1, RELAYS)
        fields["up"] = turn + (1 - turn) * middle * 0.8
        fields["down"] = -turn + (1 - turn) * middle * 0.8
        fields["weight"] = random.dirichlet(np.full(RELAYS, 3.0))
    return fields


@compiled(fastmath=True)
def advance(p, dq, v, m):
    """Move a joint by `dq` [rad] at `v` [rad/s]; `m` is its memory."""
    u = dq / p.width
    if p.law == LUGRE:
        s = 1.0 if u > 0 else -1.0
        limit = 1.0 + p.rise * np.exp(-((v / p.rise_speed) ** 2))
        m.z = s * limit + (m.z - s * limit) * np.exp(-abs(u) / limit)
    elif p.law == BOUC_WEN:
        steps = int(abs(u) * 10) + 1
        for _ in range(steps):
            s = 1.0 if u * m.z > 0 else -1.0
            m.z += u / steps * (1 - (p.share * s + 1 - p.share) * abs(m.z) ** p.exponent)
    elif p.law == PREISACH:
        m.z = min(max(m.z + u / 2, -1.0), 1.0)  # deflection, full after two widths
        for r in range(RELAYS):
            if m.z >= p.up[r]:
                m.relay[r] = 1.0
            elif m.z <= p.down[r]:
                m.relay[r] = -1.0


@compiled(fastmath=True)
def torque(p, m):
    """Return the torque of a joint [N m]."""
    if p.law == NONE:
        return 0.0
    if p.law != PREISACH:
        return p.sliding * m.z
    value = 0.0
    for r in range(RELAYS):
        value += p.weight[r] * m.relay[r]
    return p.sliding * value
