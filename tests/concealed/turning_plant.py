"""The concealed arm behind servos that are told velocities; it shares no formula with limo.

Motor and link of each joint are two bodies with a stiff gear between them, as in `servo_plant`. The
servo counts its motor before the gear, which tells its speed finely, and looks at it every
millisecond. A program that wants the arm along a path sends velocities: that of the path, and a
part of what the arm is away from it by then.
"""

import arm as arm_
import numpy as np
from arm import Arm, Work
from servo_plant import DAMPING, LOOK, PERIOD, STIFFNESS, N, Played, _solve

from limo_driver.runtime.compiled import compiled

PULL = 1.5  # [1/s], of what the arm is away from its path, that the program adds
FIELDS = [
    ("gain", "f8"),  # [N m s/rad]
    ("reset", "f8"),  # [N m/rad] of the integral
    ("stall", "f8"),  # [N m]
    ("rotor", "f8"),  # [kg m^2] seen from the joint
    ("dry", "f8"),  # [N m]
    ("wet", "f8"),  # [N m s/rad]
    ("brake", "f8"),  # [N m s/rad], back-EMF
    ("by_load", "f8"),  # dry friction by N m in the gear
    ("late", "f8"),  # [s]
    ("hose", "f8"),  # [N m/rad] of a cable
    ("hose_rest", "f8"),  # [rad]
    ("tick", "f8"),  # [rad] of the encoders
]


def play(arm: Arm, servos: np.ndarray, path: np.ndarray, every: float, rate: float) -> Played:
    """Let an arm follow a path from rest, by velocities.

    Args:
        arm: Rigid bodies.
        servos: (n,) of `FIELDS`.
        path: (K, n) [rad].
        every: Seconds between two of its rows, and between two commands.
        rate: Of the recording [Hz].
    """
    steps = round(every / PERIOD)
    told = np.zeros((len(path) * steps, N))
    work = Work(
        np.zeros((N, 3, 3)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 3, 3)),
        np.zeros((N, 3)), np.zeros((N, 3)),
    )  # fmt: skip
    command = np.gradient(path, every, axis=0)
    _play(arm, servos, np.ascontiguousarray(path), command, steps, work, told)
    rows = np.arange(0, len(told), round(1 / rate / PERIOD))
    return Played(rows * PERIOD, command[rows // steps], told[rows])


@compiled(fastmath=True)
def _play(arm, servos, path, command, steps, w, told):
    q, v = path[0].copy(), np.zeros(N)  # of the links
    m, u = path[0].copy(), np.zeros(N)  # of the motors
    bias, torque, between, wrench = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(6)
    M, push, summed = np.zeros((N, N)), np.zeros(N), np.zeros(N)
    for t in range(told.shape[0]):
        arm_.place(arm, q, w)
        arm_.inverse_dynamics(arm, v, np.zeros(N), wrench, w, bias)
        arm_.mass_matrix(arm, w, M)
        for j in range(N):
            s = servos[j]
            if t % steps == 0:
                seen = s.tick * np.floor(q[j] / s.tick + 0.5)
                command[t // steps, j] += PULL * (path[t // steps, j] - seen)
            between[j] = STIFFNESS * (m[j] - q[j]) + DAMPING * (u[j] - v[j])
            if t % LOOK == 0:
                k = int(np.floor((t * PERIOD - s.late) / (steps * PERIOD)))
                error = (command[k, j] if k >= 0 else 0.0) - u[j]
                summed[j] += s.reset * error * LOOK * PERIOD
                torque[j] = min(max(s.gain * error + summed[j], -s.stall), s.stall)
            dry = s.dry + s.by_load * abs(between[j])
            wanted = s.rotor * u[j] + PERIOD * (torque[j] - between[j])
            free = abs(wanted) - PERIOD * dry
            u[j] = np.sign(wanted) * max(free, 0.0) / (s.rotor + PERIOD * (s.brake + s.wet))
            push[j] = between[j] - bias[j] - s.hose * (q[j] - s.hose_rest) - 2e-3 * v[j]
        _solve(M, push)
        for j in range(N):
            v[j] += PERIOD * push[j]
            q[j] += PERIOD * v[j]
            m[j] += PERIOD * u[j]
            told[t, j] = servos[j].tick * np.floor(q[j] / servos[j].tick + 0.5)
