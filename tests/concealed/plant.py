"""The concealed plant: an arm and its drives under a tracking controller, at 1 kHz.

A step is linearly implicit in all that is stiff (the sign of dry friction, gears) and takes the
rest as it is. What a sensor sees is worked out afterwards, at the middle of each step, from the
motion that came about: inverse dynamics plus friction, exact whatever the step did.
"""

from typing import NamedTuple

import arm as arm_
import drive as drive_
import numpy as np
from arm import Arm, N

from limo_driver.runtime.compiled import compiled

PERIOD = 1e-3  # [s]
_ITERATIONS = 4


class Control(NamedTuple):
    """PD with integral action around a feed-forward torque; (n,) each."""

    proportional: np.ndarray  # [N m/rad]
    derivative: np.ndarray  # [N m s/rad]
    integral: np.ndarray  # [N m/(rad s)]


class Reference(NamedTuple):
    position: np.ndarray  # (T, n) [rad]
    velocity: np.ndarray  # (T, n) [rad/s]
    acceleration: np.ndarray  # (T, n) [rad/s^2]
    torque: np.ndarray  # (T, n) [N m] fed forward


class Response(NamedTuple):
    """What happened, at the middle of each step of 1 ms; (T, n) each."""

    position: np.ndarray  # [rad] of the motors
    velocity: np.ndarray  # [rad/s]
    acceleration: np.ndarray  # [rad/s^2]
    torque: np.ndarray  # [N m] in front of the friction
    link: np.ndarray  # [rad], position of the links
    heat: np.ndarray  # 0 cold to 1 warm


def simulate(
    arm: Arm, drive: np.ndarray, control: Control, reference: Reference, wrench: np.ndarray
) -> Response:
    """Follow a reference from rest.

    Args:
        arm: Rigid bodies.
        drive: Joints.
        control: Gains.
        reference: Motion asked for, every millisecond.
        wrench: Force and moment from outside at the flange, world axes, (T, 6) [N, N m].
    """
    shape = reference.position.shape
    response = Response(*(np.zeros(shape) for _ in Response._fields))
    _simulate(
        arm, drive, control, reference, wrench, drive_.rested(), arm_.work(), response
    )  # fmt: skip
    return response


@compiled(fastmath=True)
def _simulate(arm, d, control, reference, wrench, m, w, out):
    q = reference.position[0].copy()  # of the links
    v = np.zeros(N)
    motor, speed = q.copy(), v.copy()
    load, bias, summed = np.zeros(N), np.zeros(N), np.zeros(N)
    M = np.zeros((N, N))
    new_v, new_speed = v.copy(), v.copy()
    zero = np.zeros(N)
    middle, middle_v, a = np.zeros(N), np.zeros(N), np.zeros(N)
    arm_.place(arm, q, w)
    arm_.inverse_dynamics(arm, zero, zero, wrench[0], w, load)
    for j in range(N):  # begin with the gears loaded and in equilibrium
        if d[j].stiffness > 0:
            for _ in range(50):
                torque, slope = drive_.gear(d, j, motor[j] - q[j])
                step = (load[j] - torque) / max(slope, 0.02 * d[j].stiffness)
                motor[j] += min(max(step, -1e-3), 1e-3)
    for t in range(reference.position.shape[0]):
        arm_.place(arm, q, w)
        arm_.inverse_dynamics(arm, v, zero, wrench[t], w, bias)
        arm_.mass_matrix(arm, w, M)
        command = zero.copy()
        for j in range(N):
            error = reference.position[t, j] - motor[j]
            summed[j] += error * PERIOD
            command[j] = (
                reference.torque[t, j]
                + control.proportional[j] * error
                + control.derivative[j] * (reference.velocity[t, j] - speed[j])
                + control.integral[j] * summed[j]
            )
        _step(d, command, motor, speed, q, v, load, bias, M, m, new_speed, new_v)
        for j in range(N):
            a[j] = (new_v[j] - v[j]) / PERIOD
            middle[j] = q[j] + PERIOD * (3 * v[j] + new_v[j]) / 8
            middle_v[j] = 0.5 * (v[j] + new_v[j])
        arm_.place(arm, middle, w)
        arm_.inverse_dynamics(arm, middle_v, a, wrench[t], w, load)
        for j in range(N):
            out.link[t, j] = middle[j]
            at = motor[j] + PERIOD * (3 * speed[j] + new_speed[j]) / 8
            out.position[t, j] = at
            out.velocity[t, j] = 0.5 * (speed[j] + new_speed[j])
            out.acceleration[t, j] = (new_speed[j] - speed[j]) / PERIOD
            drive_.advance(d, j, at - motor[j], out.velocity[t, j], PERIOD / 2, m)
            out.heat[t, j] = m[j].heat
        for j in range(N):
            out.torque[t, j] = load[j] + _felt(d, j, out.position[t], out.velocity[t],
                                               out.acceleration[t], load, m)  # fmt: skip
        for j in range(N):
            end = motor[j] + PERIOD * 0.5 * (speed[j] + new_speed[j])
            drive_.advance(d, j, end - out.position[t, j], out.velocity[t, j], PERIOD / 2, m)
            motor[j], speed[j] = end, new_speed[j]
            q[j] += PERIOD * 0.5 * (v[j] + new_v[j])
            v[j] = new_v[j]


@compiled(fastmath=True)
def _felt(d, j, q, v, a, load, m):
    """Return what the sensor feels besides the load of the links [N m]."""
    s = v[j] * drive_.slope(v[j], d[j].sharpness)
    torque = d[j].armature * a[j] + drive_.rest(d, j, q, v[j], m)
    torque += s * drive_.level(d, j, q, v[j], load, m)
    k = int(d[j].other)
    if k >= 0:
        w = v[j] + d[j].ratio * v[k]
        torque += d[j].coupled_viscous * w + d[j].coupled_inertia * (a[j] + d[j].ratio * a[k])
        torque += d[j].coupled_coulomb * w * drive_.slope(w, d[j].sharpness)
    return torque


@compiled(fastmath=True)
def _step(d, command, motor, speed, q, v, load, bias, M, m, new_speed, new_v):
    """Write the velocities after one step.

    Every drive passes on `given - taken v` to its link, at link velocity v; a rigid one is its
    own link, an elastic one is solved for its motor first.
    """
    given, taken, follow, lead = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(N)
    A, b = np.zeros((N, N)), np.zeros(N)
    for j in range(N):
        new_v[j], new_speed[j] = v[j], speed[j]
    for _ in range(_ITERATIONS):
        for j in range(N):
            for k in range(N):
                A[j, k] = M[j, k] / PERIOD
        for j in range(N):
            s = drive_.slope(new_speed[j], d[j].sharpness)
            dry = drive_.level(d, j, motor, new_speed[j], load, m) * s
            inertia = (d[j].rotor + d[j].armature) / PERIOD
            push = command[j] + inertia * speed[j] - drive_.rest(d, j, motor, new_speed[j], m)
            push += d[j].viscous * new_speed[j]
            resist = max(dry, 0.0) + d[j].viscous + inertia
            if d[j].stiffness == 0.0:
                given[j], taken[j] = push, resist
            else:
                at = new_speed[j] - new_v[j]
                torque, slope = drive_.gear(d, j, motor[j] - q[j] + PERIOD * at)
                damping = slope * PERIOD + 2e-4 * d[j].stiffness
                torque += 2e-4 * d[j].stiffness * at - damping * at
                lead[j] = (push - torque) / (resist + damping)
                follow[j] = damping / (resist + damping)
                given[j] = torque + damping * lead[j]
                taken[j] = damping * (1 - follow[j])
            k = int(d[j].other)
            if k > j:  # a differential acts on both of its joints
                r = d[j].ratio
                w = new_v[j] + r * new_v[k]
                c = d[j].coupled_coulomb * drive_.slope(w, d[j].sharpness)
                c += d[j].coupled_viscous + d[j].coupled_inertia / PERIOD
                keep = d[j].coupled_inertia / PERIOD * (v[j] + r * v[k])
                A[j, j] += c
                A[k, k] += c
                A[j, k] += r * c
                A[k, j] += r * c
                given[j] += keep
                given[k] += r * keep
        for j in range(N):
            A[j, j] += taken[j]
            b[j] = given[j] - bias[j]
            for k in range(N):
                b[j] += M[j, k] / PERIOD * v[k]
        _solve(A, b)
        change = 0.0
        for j in range(N):
            before = new_speed[j]
            new_v[j] = b[j]
            new_speed[j] = b[j] if d[j].stiffness == 0.0 else lead[j] + follow[j] * b[j]
            change = max(change, abs(new_speed[j] - before))
        if change < 1e-7:
            break


@compiled(fastmath=True)
def _solve(A, b):
    """Solve A x = b in place, A symmetric and positive (Cholesky)."""
    n = b.size
    for j in range(n):
        for i in range(j, n):
            value = A[i, j]
            for k in range(j):
                value -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(value) if i == j else value / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
