"""The concealed arm behind drives that are told torques; it shares no formula with limo.

Motor and link of each joint are two bodies with a stiff gear between them, as in `servo_plant`. A
program that wants the arm along a path sends torques, which pull it there and damp it; the drives
make currents of them, and look at nothing.
"""

import arm as arm_
import numpy as np
import turning_plant
from arm import Arm, Work
from servo_plant import DAMPING, LOOK, PERIOD, STIFFNESS, N, Played, _solve

from limo_driver.runtime.compiled import compiled

FIELDS = turning_plant.FIELDS
PULL, CALM = 4.0, 0.6  # [N m/rad], [N m s/rad] of the program
FRESH = 0.3  # of the speed that the program reckons with, which each look at the encoders renews


def play(arm: Arm, drives: np.ndarray, path: np.ndarray, every: float, rate: float) -> Played:
    """Let an arm follow a path from rest, by torques.

    Args:
        arm: Rigid bodies.
        drives: (n,) of `FIELDS`, of which `gain` has no unit, and `reset` is of no use.
        path: (K, n) [rad].
        every: Seconds between two of its rows, and between two commands.
        rate: Of the recording [Hz].
    """
    steps = round(every / PERIOD)
    told, command = np.zeros((len(path) * steps, N)), np.zeros(path.shape)
    work = Work(
        np.zeros((N, 3, 3)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 3, 3)),
        np.zeros((N, 3)), np.zeros((N, 3)),
    )  # fmt: skip
    _play(arm, drives, np.ascontiguousarray(path), command, steps, work, told)
    rows = np.arange(0, len(told), round(1 / rate / PERIOD))
    return Played(rows * PERIOD, command[rows // steps], told[rows])


@compiled(fastmath=True)
def _play(arm, drives, path, command, steps, w, told):
    q, v = path[0].copy(), np.zeros(N)  # of the links
    m, u = path[0].copy(), np.zeros(N)  # of the motors
    bias, torque, between, wrench = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(6)
    M, push, last, pace = np.zeros((N, N)), np.zeros(N), path[0].copy(), np.zeros(N)
    for t in range(told.shape[0]):
        arm_.place(arm, q, w)
        arm_.inverse_dynamics(arm, v, np.zeros(N), wrench, w, bias)
        arm_.mass_matrix(arm, w, M)
        for j in range(N):
            s = drives[j]
            if t % steps == 0:
                seen = s.tick * np.floor(q[j] / s.tick + 0.5)
                pace[j] += FRESH * ((seen - last[j]) / (steps * PERIOD) - pace[j])
                last[j] = seen
                command[t // steps, j] = PULL * (path[t // steps, j] - seen) - CALM * pace[j]
            between[j] = STIFFNESS * (m[j] - q[j]) + DAMPING * (u[j] - v[j])
            if t % LOOK == 0:
                k = int(np.floor((t * PERIOD - s.late) / (steps * PERIOD)))
                asked = s.gain * command[k, j] if k >= 0 else 0.0
                torque[j] = min(max(asked, -s.stall), s.stall)
            dry = s.dry + s.by_load * abs(between[j])
            wanted = s.rotor * u[j] + PERIOD * (torque[j] - between[j])
            free = abs(wanted) - PERIOD * dry
            u[j] = np.sign(wanted) * max(free, 0.0) / (s.rotor + PERIOD * (s.brake + s.wet))
            push[j] = between[j] - bias[j] - s.hose * (q[j] - s.hose_rest)
        _solve(M, push)
        for j in range(N):
            v[j] += PERIOD * push[j]
            q[j] += PERIOD * v[j]
            m[j] += PERIOD * u[j]
            told[t, j] = drives[j].tick * np.floor(q[j] / drives[j].tick + 0.5)
