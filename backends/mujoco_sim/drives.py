"""The drives of the simulated arm: position servo, impedance and torque control, saturation.

The damping of a controller is left to the integrator, which takes it implicitly: it is stable
however strong. All functions are called from compiled code.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from backends.mujoco_sim import layout as row
from limo_driver.physics.effects.laws import friction_torque
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from backends.mujoco_sim.layout import Arrays, Scratch, Servo
    from backends.mujoco_sim.realisation import Plant
    from limo_driver.types import FloatArray

_SMALL_VELOCITY = 1e-9  # [rad/s]


@compiled(inline="always")
def servo_torque(
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    added: FloatArray,
    target: FloatArray,
    own: Scratch,
) -> None:
    """Position servo of the drives: feed-forward of the rigid body, and a PID on every joint.

    The target answers a measurement that is one cycle old by now, so it is carried forward by one
    cycle. Gains follow the inertia that a joint moves, for one bandwidth in all poses; the
    damping is left to the integrator, which takes it implicitly.
    """
    h, n = servo.period, target.size
    wanted, ahead, speed = own.wanted, own.ahead, own.speed
    inertial, torque, damping = own.inertial, own.torque, own.damping
    for j in range(n):
        v = (target[j] - memory[row.LAST_TARGET * n + j]) / h
        wanted[j] = (v - memory[row.TARGET_VELOCITY * n + j]) / h
        ahead[j] = target[j] + h * (v + h * wanted[j])
        speed[j] = v + 2.0 * h * wanted[j]
        memory[row.LAST_TARGET * n + j], memory[row.TARGET_VELOCITY * n + j] = target[j], v
    multiply(arrays, n, wanted, inertial)
    for j in range(n):
        mass = arrays.inertia[arrays.row_start[j] + arrays.row_size[j] - 1]
        nominal = inertial[j] - plant.armature[j] * wanted[j] + arrays.bias[j]
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], nominal)
            + added[row.ADDED_STATIC_WIND_UP * n + j]
        )
        error = ahead[j] - arrays.position[j] - wind_up
        stiffness = mass * servo.bandwidth**2
        integral = memory[row.INTEGRAL * n + j] + stiffness * servo.integral_rate * h * error
        limit = servo.torque_limit[j]
        memory[row.INTEGRAL * n + j] = min(max(integral, -limit), limit)
        damping[j] = 2.0 * servo.bandwidth * mass
        torque[j] = (
            arrays.bias[j]
            + inertial[j]
            + stiffness * error
            + memory[row.INTEGRAL * n + j]
            + damping[j] * (speed[j] - own.rate[j])
        )


@compiled(inline="always")
def compliant(
    arrays: Arrays,
    memory: FloatArray,
    mode: int,
    target: FloatArray,
    command: FloatArray,
    own: Scratch,
) -> None:
    """Impedance and torque control, on top of the compensated gravity."""
    rate, torque, damping = own.rate, own.torque, own.damping
    n = target.size
    for j in range(n):
        torque[j] = arrays.bias[j] + command[row.FEED_FORWARD * n + j]
        damping[j] = 0.0
        if mode == row.IMPEDANCE:
            encoder = arrays.position[j] + memory[row.STATIC_WIND_UP * n + j]
            damping[j] = command[row.DAMPING * n + j]
            torque[j] += (
                command[row.STIFFNESS * n + j] * (target[j] - encoder) - damping[j] * rate[j]
            )


@compiled(inline="always")
def uncompensated(
    arrays: Arrays,
    memory: FloatArray,
    target: FloatArray,
    command: FloatArray,
    own: Scratch,
) -> None:
    """Give each joint what its own drive makes, where the position servo does not run.

    A drive on a bus knows its motor and not the arm, so nothing is compensated.
    """
    rate, torque, damping = own.rate, own.torque, own.damping
    n = target.size
    for j in range(n):
        if command[row.SERVO * n + j] != 0.0:
            torque[j] += command[row.FEED_FORWARD * n + j]
            continue
        encoder = arrays.position[j] + memory[row.STATIC_WIND_UP * n + j]
        damping[j] = command[row.DAMPING * n + j]
        torque[j] = command[row.FEED_FORWARD * n + j] - damping[j] * rate[j]
        torque[j] += command[row.STIFFNESS * n + j] * (target[j] - encoder)
        memory[row.INTEGRAL * n + j] = 0.0


@compiled(inline="always")
def saturate(servo: Servo, n: int, own: Scratch) -> None:
    """Keep the drives within their torque; a saturated drive does not damp."""
    velocity, torque, damping = own.velocity, own.torque, own.damping
    for j in range(n):
        limit = servo.torque_limit[j]
        if abs(torque[j] - damping[j] * velocity[j]) > limit:
            torque[j] = math.copysign(limit, torque[j] - damping[j] * velocity[j])
            damping[j] = 0.0


@compiled(inline="always")
def deflection(compliance: float, cubic: float, load: float) -> float:
    """Return the wind-up of a gear [rad] under `load` [N m]."""
    return load * (compliance + cubic * load * load)


@compiled(inline="always")
def multiply(arrays: Arrays, n: int, vector: FloatArray, product: FloatArray) -> None:
    """Write M(q) times `vector` into `product`."""
    for i in range(n):
        product[i] = 0.0
        start, size = arrays.row_start[i], arrays.row_size[i]
        for k in range(start, start + size):
            j = arrays.column[k]
            product[i] += arrays.inertia[k] * vector[j]
            if j != i:
                product[j] += arrays.inertia[k] * vector[i]


@compiled(inline="always")
def friction_damping(
    law: int,
    p0: float,
    p1: float,
    p2: float,
    p3: float,
    fastest: float,
    up: float,
    down: float,
    velocity: float,
) -> float:
    """Return the secant torque / velocity [N m s/rad]; its limit at rest.

    An integrator that takes this damping implicitly dissipates at any step size, where the
    friction itself, taken explicitly, would reverse the motion.
    """
    v = away_from_rest(velocity)
    inside = min(max(v, -fastest), fastest)
    torque = friction_torque(law, p0, p1, p2, p3, inside)
    return (torque + (up if v > inside else down) * (v - inside)) / v


@compiled(inline="always")
def away_from_rest(velocity: float) -> float:
    """Return `velocity` [rad/s], of at least a size by which a torque can be divided."""
    return _SMALL_VELOCITY if abs(velocity) < _SMALL_VELOCITY else velocity
