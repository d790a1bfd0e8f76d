"""An arm behind hobby servos, which shares no formula with limo: motors, gears with play, links.

Each joint has two bodies: the motor as it is seen at the joint, and the link. The gear between them
is a spring that begins at the end of its play. The servo looks every millisecond at its own
encoder, which counts the motor or the link, and the motor brakes in proportion to its speed. All
motors hang on one supply, whose voltage its resistance lowers.
"""

from typing import NamedTuple

import arm as arm_
import numpy as np
from arm import Arm, Work

from limo_driver.runtime.compiled import compiled

N = 4
PERIOD = 0.25e-3  # [s] of a step
LOOK = 4  # steps between two looks of a servo
MOTOR, LINK = 0.0, 1.0  # where an encoder counts
STIFFNESS, DAMPING = 1000.0, 0.4  # [N m/rad], [N m s/rad] of gears whose teeth touch
UPPER, FORE, HAND = 0.116, 0.135, 0.07  # [m] lengths; of the hand to its centre of mass
REACH = 2.0  # [rad], range of every joint

FIELDS = [
    ("gain", "f8"),  # [N m/rad]
    ("brake", "f8"),  # [N m s/rad], derivative gain and back-EMF
    ("stall", "f8"),  # [N m]
    ("rotor", "f8"),  # [kg m^2] seen from the joint
    ("dry", "f8"),  # [N m]
    ("breakaway", "f8"),  # [N m] more of it at rest
    ("wet", "f8"),  # [N m s/rad]
    ("by_load", "f8"),  # dry friction by N m in the gear
    ("late", "f8"),  # [s]
    ("band", "f8"),  # [rad] of error that is taken for none
    ("gap", "f8"),  # [rad] of play, from flank to flank
    ("reset", "f8"),  # [N m/(rad s)] of the integral
    ("kick", "f8"),  # [N m] that any error outside the band asks for at least
    ("rate", "f8"),  # [N m s/rad] of the servo's own derivative, of what it asks for
    ("slew", "f8"),  # [rad/s] at most of the set-point, which leads the servo; 0: of no limit
    ("ramp", "f8"),  # [rad/s^2] likewise
    ("pace", "f8"),  # [rad/s] at which the volts leave no torque; 0: of no limit
    ("fade", "f8"),  # resistance that a winding stalled for long gains, over its own
    ("warm", "f8"),  # [s] in which it does
    ("by_drive", "f8"),  # dry friction by N m of the motor
    ("source", "f8"),  # resistance of the supply over that of this winding
    ("hose", "f8"),  # [N m/rad] of a cable
    ("hose_rest", "f8"),  # [rad]
    ("tick", "f8"),  # [rad] of the encoders
    ("looks_at", "f8"),  # MOTOR or LINK
    ("tells", "f8"),  # MOTOR or LINK, that is recorded
]


def hobby_arm() -> Arm:
    """Return an arm that turns, lifts, bends and nods."""
    flat, lying = np.eye(3), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z of it is -y
    return Arm(
        np.array([flat, lying, flat, flat]),
        np.array([[0, 0, 0.06], [0.03, 0, 0.06], [UPPER, 0, 0], [FORE, 0, 0]]),
        np.array([0.10, 0.16, 0.14, 0.20]),
        np.array([[0.01, 0, 0.03], [0.06, 0.01, 0], [0.07, -0.01, 0], [HAND, 0, 0.01]]),
        np.array([np.diag(x) for x in ([6, 6, 5], [4, 25, 25], [4, 25, 25], [8, 20, 20])]) * 1e-5,
        np.array([0.0, 0.0, -9.81]),
    )


def mjcf(arm: Arm) -> str:
    """Return a description of an arm's rigid body as it is handed to a diagnosis."""
    frames = ("1 0 0 0", "0.70710678118654752 0.70710678118654752 0 0", "1 0 0 0", "1 0 0 0")
    lines = [
        (
            f'<body name="link{j + 1}" pos="{_text(arm.offset[j])}" quat="{frames[j]}">'
            f'<inertial pos="{_text(arm.com[j])}" mass="{_text(arm.mass[j : j + 1])}" '
            f'diaginertia="{_text(np.diag(arm.inertia[j]))}"/>'
            f'<joint name="joint{j + 1}" axis="0 0 1" limited="true" range="-{REACH} {REACH}"/>'
        )
        for j in range(N)
    ]
    head = '<mujoco model="hobby"><compiler angle="radian"/><worldbody>'
    return "\n".join([head, *lines, "</body>" * N + "</worldbody></mujoco>"])


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)


class Played(NamedTuple):
    """What a recording tells."""

    time: np.ndarray  # (T,) [s]
    command: np.ndarray  # (T, n) [rad]
    position: np.ndarray  # (T, n) [rad]


def play(arm: Arm, servos: np.ndarray, command: np.ndarray, every: float, rate: float) -> Played:
    """Let an arm follow commands from rest.

    Args:
        arm: Rigid bodies.
        servos: (n,) of `FIELDS`.
        command: (K, n) [rad], each in force until the next.
        every: Seconds between two commands.
        rate: Of the recording [Hz].
    """
    steps = round(every / PERIOD)
    told = np.zeros((len(command) * steps, N))
    work = Work(
        np.zeros((N, 3, 3)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 3, 3)),
        np.zeros((N, 3)), np.zeros((N, 3)),
    )  # fmt: skip
    _play(arm, servos, np.ascontiguousarray(command), steps, work, told)
    rows = np.arange(0, len(told), round(1 / rate / PERIOD))
    return Played(rows * PERIOD, command[rows // steps], told[rows])


@compiled(fastmath=True)
def _play(arm, servos, command, steps, w, told):
    q, v = command[0].copy(), np.zeros(N)  # of the links
    m, u = command[0].copy(), np.zeros(N)  # of the motors
    bias, torque, between, wrench = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(6)
    M, push = np.zeros((N, N)), np.zeros(N)
    share, summed, volts = np.zeros(N), np.zeros(N), 1.0
    goal, glide, warmth = command[0].copy(), np.zeros(N), np.zeros(N)
    for t in range(told.shape[0]):
        arm_.place(arm, q, w)
        arm_.inverse_dynamics(arm, v, np.zeros(N), wrench, w, bias)
        arm_.mass_matrix(arm, w, M)
        volts = _volts(servos, share, u)
        for j in range(N):
            s = servos[j]
            torque[j] = s.stall * share[j] * volts
            if s.fade > 0.0:
                warmth[j] += PERIOD / s.warm * (share[j] * share[j] - warmth[j])
                torque[j] /= 1.0 + s.fade * warmth[j]
            if s.pace > 0.0:
                most = s.stall * (1.0 - u[j] / s.pace)
                least = -s.stall * (1.0 + u[j] / s.pace)
                torque[j] = min(max(torque[j], least), most)
            half, apart = 0.5 * s.gap, m[j] - q[j]
            wound = apart - half if apart > half else apart + half if apart < -half else 0.0
            touching = s.gap == 0.0 or wound != 0.0
            between[j] = STIFFNESS * wound + (DAMPING * (u[j] - v[j]) if touching else 0.0)
            if t % LOOK == 0:
                told_now = q[j] if s.looks_at == LINK else m[j]
                told_now = s.tick * np.floor(told_now / s.tick + 0.5)
                k = (t * PERIOD - s.late) / (steps * PERIOD)
                asked = command[max(0, int(np.floor(k))), j]
                if s.slew > 0.0 or s.ramp > 0.0:
                    asked = _led(s, asked, goal, glide, j)
                error = asked - told_now
                if s.band > 0.0:
                    error = np.sign(error) * max(abs(error) - s.band, 0.0)
                summed[j] += s.reset * error * LOOK * PERIOD
                wished = s.gain * error + summed[j] + s.kick * np.sign(error) - s.rate * u[j]
                share[j] = min(max(wished / s.stall, -1.0), 1.0)
            dry = s.dry + s.breakaway * np.exp(-((u[j] / 0.03) ** 2)) + s.by_load * abs(between[j])
            dry += s.by_drive * abs(torque[j])
            wanted = s.rotor * u[j] + PERIOD * (torque[j] - between[j])
            free = abs(wanted) - PERIOD * dry
            u[j] = np.sign(wanted) * max(free, 0.0) / (s.rotor + PERIOD * (s.brake + s.wet))
            push[j] = between[j] - bias[j] - s.hose * (q[j] - s.hose_rest) - 2e-3 * v[j]
        _solve(M, push)
        for j in range(N):
            v[j] += PERIOD * push[j]
            q[j] += PERIOD * v[j]
            m[j] += PERIOD * u[j]
            seen = q[j] if servos[j].tells == LINK else m[j]
            tick = servos[j].tick
            told[t, j] = tick * np.floor(seen / tick + 0.5)


@compiled(fastmath=True)
def _led(s, asked, goal, glide, j):
    """Return the set-point that glides to what is asked, as fast as it can still brake."""
    tick, left = LOOK * PERIOD, asked - goal[j]
    pace = abs(left) / tick
    if s.slew > 0.0:
        pace = min(pace, s.slew)
    wish = pace if left > 0.0 else -pace
    if s.ramp > 0.0:
        brakes = np.sqrt(2.0 * s.ramp * abs(left))
        wish = min(max(wish, -brakes), brakes)
        wish = min(max(wish, glide[j] - s.ramp * tick), glide[j] + s.ramp * tick)
    glide[j] = wish
    goal[j] += wish * tick
    return goal[j]


@compiled(fastmath=True)
def _volts(servos, share, u):
    """Return the voltage at the motors over that of a supply without load.

    v = 1 - r Σ share_j current_j, where the bridge of motor j passes its share of the voltage, and
    its current is what share_j v leaves over its back-EMF, in units of its stall current.
    """
    drawn, saved = 0.0, 0.0
    for j in range(N):
        s = servos[j]
        drawn += s.source * share[j] * share[j]
        saved += s.source * share[j] * s.brake * u[j] / s.stall
    return (1.0 + saved) / (1.0 + drawn)


@compiled(fastmath=True)
def _solve(A, b):
    """Solve A x = b in place by elimination; A is small, symmetric and positive."""
    n = b.size
    for k in range(n):
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
