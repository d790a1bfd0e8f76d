"""The inner loop of the simulated robot, compiled: control cycles at the speed of MuJoCo itself.

MuJoCo is called through its C interface with the addresses of model and data, and its arrays are
seen as numpy arrays, so that no Python runs in between and no global callback is set.

One cycle is one step of symplectic Euler. With q_k at time k, MuJoCo's velocity v_k = (q_k −
q_k−1)/h belongs to time k − ½; position q_k, velocity (v_k + v_k+1)/2, acceleration
(v_k+1 − v_k)/h and the torque over that step therefore all belong to time k, to second order.
These four are what the sensors sample. They are known when the step is done: a measurement
reaches the controller one cycle after it was taken.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import llvmlite.binding as llvm
import mujoco
import numpy as np
from numba import njit, types

from backends.mujoco_sim.friction_laws import friction_damping
from backends.mujoco_sim.realisation import Plant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

# The compiled loop finds these symbols by name, also when it comes from the cache.
llvm.load_library_permanently(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))
_step1 = types.ExternalFunction("mj_step1", types.void(types.uintp, types.uintp))
_step2 = types.ExternalFunction("mj_step2", types.void(types.uintp, types.uintp))

POSITION, IMPEDANCE, TORQUE = 0, 1, 2  # control modes

# Rows of the command, (4, n).
TARGET, STIFFNESS, DAMPING, FEED_FORWARD = 0, 1, 2, 3

# Rows of the memory, (9, n): all that the robot remembers beside MuJoCo's own state.
LOAD = 0  # nominal rigid-body torque through the gear, last cycle [N m]
WIND_UP = 1  # encoder minus link under that load [rad]
STATIC_WIND_UP = 2  # the same under gravity and Coriolis torque alone [rad]
INTEGRAL = 3  # of the position servo [N m]
LAST_VELOCITY = 4  # [rad/s]
LAST_TARGET = 5  # [rad]
TARGET_VELOCITY = 6  # [rad/s]
ENCODER = 7  # last reading [rad]
ENCODER_VELOCITY = 8  # filtered [rad/s]
MEMORY_ROWS = 9

# Rows of what effects without a native form add in a cycle, (4, n).
ADDED_TORQUE, ADDED_DAMPING, ADDED_WIND_UP, ADDED_STATIC_WIND_UP = 0, 1, 2, 3

# Rows of the log of a cycle, (7, n).
MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_TORQUE = 0, 1, 2
TRUE_POSITION, TRUE_VELOCITY, TRUE_ACCELERATION, TRUE_TORQUE = 3, 4, 5, 6
LOG_ROWS = 7
_SMALLEST = 1e-30  # [rad/s]


class Arrays(NamedTuple):
    """MuJoCo's own arrays of an arm of n joints."""

    position: FloatArray  # (n,) of the links [rad]
    velocity: FloatArray  # (n,) [rad/s]
    control: FloatArray  # (n + E,) dampers, then slipping springs
    bias: FloatArray  # (n,) gravity and Coriolis torque [N m]
    applied: FloatArray  # (n,) torque of the drives [N m]
    inertia: FloatArray  # lower triangle of M(q), row by row [kg m²]
    row_size: NDArray[np.int32]  # (n,)
    row_start: NDArray[np.int32]  # (n,)
    column: NDArray[np.int32]


class Servo(NamedTuple):
    """The drives and sensors of the arm."""

    period: float  # [s]
    bandwidth: float  # of the position servo [rad/s]
    integral_rate: float  # [1/s]
    torque_limit: FloatArray  # (n,) at which a drive saturates [N m]
    velocity_gain: float  # of the encoder's velocity filter, 0 to 1
    encoder_resolution: FloatArray  # (n,) [rad]
    torque_resolution: FloatArray  # (n,) [N m]


def advance(
    model: int,
    data: int,
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    mode: int,
    targets: FloatArray,
    command: FloatArray,
    added: FloatArray,
    noise: FloatArray,
    log: FloatArray,
) -> bool:
    """Run one control cycle for each row of `targets`.

    Args:
        model: Address of MuJoCo's model.
        data: Address of MuJoCo's data.
        arrays: Its arrays.
        plant: Joint physics.
        servo: Drives and sensors.
        memory: What the robot remembers, (9, n); advanced in place.
        mode: Control mode in force in these cycles.
        targets: Position set-point of each cycle, (T, n) [rad].
        command: Other rows of the command, (4, n).
        added: What effects without a native form add, (4, n).
        noise: Noise of the torque sensor, (T, n) [N m].
        log: Written: what was measured and what was true in each cycle, (T, 7, n).

    Returns:
        Whether all joints are still in the finite numbers.
    """
    # Named tuples of arrays take 25 µs to pass to compiled code, their fields 5 µs.
    return _advance_fields(
        model, data, *arrays, *plant, *servo, memory, mode, targets, command, added, noise, log
    )


@njit(cache=True)
def _advance_fields(
    model: int,
    data: int,
    position: FloatArray,
    velocity: FloatArray,
    control: FloatArray,
    bias: FloatArray,
    applied: FloatArray,
    inertia: FloatArray,
    row_size: NDArray[np.int32],
    row_start: NDArray[np.int32],
    column: NDArray[np.int32],
    motor_inertia: FloatArray,
    armature: FloatArray,
    compliance: FloatArray,
    cubic: FloatArray,
    offset: FloatArray,
    friction_joint: NDArray[np.int64],
    friction_law: NDArray[np.int64],
    friction_parameters: FloatArray,
    element_joint: NDArray[np.int64],
    element_stiffness: FloatArray,
    element_width: FloatArray,
    period: float,
    bandwidth: float,
    integral_rate: float,
    torque_limit: FloatArray,
    velocity_gain: float,
    encoder_resolution: FloatArray,
    torque_resolution: FloatArray,
    memory: FloatArray,
    mode: int,
    targets: FloatArray,
    command: FloatArray,
    added: FloatArray,
    noise: FloatArray,
    log: FloatArray,
) -> bool:
    arrays = Arrays(
        position, velocity, control, bias, applied, inertia, row_size, row_start, column
    )
    plant = Plant(
        motor_inertia,
        armature,
        compliance,
        cubic,
        offset,
        friction_joint,
        friction_law,
        friction_parameters,
        element_joint,
        element_stiffness,
        element_width,
    )
    servo = Servo(
        period,
        bandwidth,
        integral_rate,
        torque_limit,
        velocity_gain,
        encoder_resolution,
        torque_resolution,
    )
    return _advance(
        model, data, arrays, plant, servo, memory, mode, targets, command, added, noise, log
    )


@njit(cache=True)
def _advance(
    model: int,
    data: int,
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    mode: int,
    targets: FloatArray,
    command: FloatArray,
    added: FloatArray,
    noise: FloatArray,
    log: FloatArray,
) -> bool:
    """Do what `advance` says."""
    n = targets.shape[1]
    position, velocity, rate = np.empty(n), np.empty(n), np.empty(n)
    torque, damping, friction = np.empty(n), np.empty(n), np.empty(n)
    inertial, acceleration = np.empty(n), np.empty(n)
    for t in range(targets.shape[0]):
        _step1(model, data)
        position[:] = arrays.position
        velocity[:] = arrays.velocity
        _wind_up(arrays, plant, servo, memory, added, rate)
        if mode == POSITION:
            _servo(arrays, plant, servo, memory, added, targets[t], rate, torque, damping, inertial)
        else:
            _compliant(arrays, memory, mode, targets[t], command, rate, torque, damping)
        _saturate(servo, velocity, torque, damping)
        _friction(plant, memory, added, velocity, rate, friction)
        for j in range(n):
            arrays.control[j] = friction[j] + damping[j]
            arrays.applied[j] = torque[j] - friction[j] * rate[j] - added[ADDED_TORQUE, j]
            memory[LAST_VELOCITY, j] = velocity[j]
        _step2(model, data)
        for j in range(n):
            acceleration[j] = (arrays.velocity[j] - velocity[j]) / servo.period
        _multiply(arrays, acceleration, inertial)
        _sense(
            arrays,
            plant,
            memory,
            added,
            position,
            acceleration,
            inertial,
            torque,
            damping,
            log[t],
        )
        _measure(servo, memory, noise[t], log[t])
        for j in range(n):
            log[t, TRUE_VELOCITY, j] = 0.5 * (velocity[j] + arrays.velocity[j]) + rate[j]
    return math.isfinite(arrays.velocity.sum() + arrays.position.sum())


@njit(cache=True)
def _wind_up(
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    added: FloatArray,
    rate: FloatArray,
) -> None:
    """Advance the wind-up of the gears and drive the slipping springs with the encoders' motion.

    `rate` becomes the velocity of the motor against the link that changing static load causes.
    """
    n = rate.size
    motor = np.empty(n)
    for j in range(n):
        static = (
            _deflection(plant.compliance[j], plant.cubic[j], arrays.bias[j])
            + added[ADDED_STATIC_WIND_UP, j]
        )
        rate[j] = (static - memory[STATIC_WIND_UP, j]) / servo.period
        memory[STATIC_WIND_UP, j] = static
        wind_up = (
            _deflection(plant.compliance[j], plant.cubic[j], memory[LOAD, j])
            + added[ADDED_WIND_UP, j]
        )
        motor[j] = arrays.velocity[j] + (wind_up - memory[WIND_UP, j]) / servo.period
        memory[WIND_UP, j] = wind_up
    for e in range(plant.element_joint.size):
        arrays.control[n + e] = motor[plant.element_joint[e]]


@njit(cache=True)
def _servo(
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    added: FloatArray,
    target: FloatArray,
    rate: FloatArray,
    torque: FloatArray,
    damping: FloatArray,
    inertial: FloatArray,
) -> None:
    """Position servo of the drives: feed-forward of the rigid body, and a PID on every joint.

    The target answers a measurement that is one cycle old by now, so it is carried forward by one
    cycle. Gains follow the inertia that a joint moves, for one bandwidth in all poses; the
    damping is left to the integrator, which takes it implicitly.
    """
    h, n = servo.period, target.size
    wanted, ahead, speed = np.empty(n), np.empty(n), np.empty(n)
    for j in range(n):
        v = (target[j] - memory[LAST_TARGET, j]) / h
        wanted[j] = (v - memory[TARGET_VELOCITY, j]) / h
        ahead[j] = target[j] + h * (v + h * wanted[j])
        speed[j] = v + 2.0 * h * wanted[j]
        memory[LAST_TARGET, j], memory[TARGET_VELOCITY, j] = target[j], v
    _multiply(arrays, wanted, inertial)
    for j in range(n):
        own = arrays.inertia[arrays.row_start[j] + arrays.row_size[j] - 1]
        nominal = inertial[j] - plant.armature[j] * wanted[j] + arrays.bias[j]
        wind_up = (
            _deflection(plant.compliance[j], plant.cubic[j], nominal)
            + added[ADDED_STATIC_WIND_UP, j]
        )
        error = ahead[j] - arrays.position[j] - wind_up
        stiffness = own * servo.bandwidth**2
        integral = memory[INTEGRAL, j] + stiffness * servo.integral_rate * h * error
        limit = servo.torque_limit[j]
        memory[INTEGRAL, j] = min(max(integral, -limit), limit)
        damping[j] = 2.0 * servo.bandwidth * own
        torque[j] = (
            arrays.bias[j]
            + inertial[j]
            + stiffness * error
            + memory[INTEGRAL, j]
            + damping[j] * (speed[j] - rate[j])
        )


@njit(cache=True)
def _compliant(
    arrays: Arrays,
    memory: FloatArray,
    mode: int,
    target: FloatArray,
    command: FloatArray,
    rate: FloatArray,
    torque: FloatArray,
    damping: FloatArray,
) -> None:
    """Impedance and torque control, on top of the compensated gravity."""
    for j in range(target.size):
        torque[j] = arrays.bias[j] + command[FEED_FORWARD, j]
        damping[j] = 0.0
        if mode == IMPEDANCE:
            encoder = arrays.position[j] + memory[STATIC_WIND_UP, j]
            damping[j] = command[DAMPING, j]
            torque[j] += command[STIFFNESS, j] * (target[j] - encoder) - damping[j] * rate[j]


@njit(cache=True)
def _saturate(servo: Servo, velocity: FloatArray, torque: FloatArray, damping: FloatArray) -> None:
    """Keep the drives within their torque; a saturated drive does not damp."""
    for j in range(torque.size):
        limit = servo.torque_limit[j]
        if abs(torque[j] - damping[j] * velocity[j]) > limit:
            torque[j] = math.copysign(limit, torque[j] - damping[j] * velocity[j])
            damping[j] = 0.0


@njit(cache=True)
def _friction(
    plant: Plant,
    memory: FloatArray,
    added: FloatArray,
    velocity: FloatArray,
    rate: FloatArray,
    friction: FloatArray,
) -> None:
    """Sum the secant damping of every joint's frictions, at the velocity expected next.

    A damping that is never negative dissipates at any step size, however stiff the law.
    """
    for j in range(velocity.size):
        friction[j] = added[ADDED_DAMPING, j]
    for f in range(plant.friction_joint.size):
        j = plant.friction_joint[f]
        expected = 2.0 * velocity[j] - memory[LAST_VELOCITY, j] + rate[j]
        friction[j] += friction_damping(
            plant.friction_law[f],
            plant.friction_parameters[f, 0],
            plant.friction_parameters[f, 1],
            plant.friction_parameters[f, 2],
            expected,
        )


@njit(cache=True)
def _sense(
    arrays: Arrays,
    plant: Plant,
    memory: FloatArray,
    added: FloatArray,
    position: FloatArray,
    acceleration: FloatArray,
    inertial: FloatArray,
    torque: FloatArray,
    damping: FloatArray,
    log: FloatArray,
) -> None:
    """Log what is true at the encoders and at the torque sensors, after the step."""
    for j in range(position.size):
        a, drive = acceleration[j], torque[j] - damping[j] * arrays.velocity[j]
        load = inertial[j] - plant.armature[j] * a + arrays.bias[j]
        wind_up = _deflection(plant.compliance[j], plant.cubic[j], load) + added[ADDED_WIND_UP, j]
        memory[LOAD, j] = load
        log[TRUE_POSITION, j] = position[j] + wind_up
        log[TRUE_ACCELERATION, j] = a
        log[TRUE_TORQUE, j] = drive - plant.motor_inertia[j] * a + plant.offset[j]


@njit(cache=True)
def _measure(servo: Servo, memory: FloatArray, noise: FloatArray, log: FloatArray) -> None:
    """Read encoder and torque sensor; the velocity is the encoder's, differenced and low-passed."""
    for j in range(noise.size):
        reading = _quantised(log[TRUE_POSITION, j], servo.encoder_resolution[j])
        difference = (reading - memory[ENCODER, j]) / servo.period
        filtered = memory[ENCODER_VELOCITY, j]
        filtered += servo.velocity_gain * (difference - filtered)
        # A decay into the denormal numbers would slow the whole loop down.
        memory[ENCODER_VELOCITY, j] = filtered if abs(filtered) > _SMALLEST else 0.0
        memory[ENCODER, j] = reading
        log[MEASURED_POSITION, j] = reading
        log[MEASURED_VELOCITY, j] = memory[ENCODER_VELOCITY, j]
        torque = log[TRUE_TORQUE, j] + noise[j]
        log[MEASURED_TORQUE, j] = _quantised(torque, servo.torque_resolution[j])


@njit(cache=True)
def _quantised(value: float, resolution: float) -> float:
    return round(value / resolution) * resolution if resolution > 0.0 else value


@njit(cache=True)
def _deflection(compliance: float, cubic: float, load: float) -> float:
    return load * (compliance + cubic * load * load)


@njit(cache=True)
def _multiply(arrays: Arrays, vector: FloatArray, product: FloatArray) -> None:
    """Write M(q) times `vector` into `product`."""
    product[:] = 0.0
    for i in range(vector.size):
        start, size = arrays.row_start[i], arrays.row_size[i]
        for k in range(start, start + size):
            j = arrays.column[k]
            product[i] += arrays.inertia[k] * vector[j]
            if j != i:
                product[j] += arrays.inertia[k] * vector[i]
