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
from typing import TYPE_CHECKING, Any

import llvmlite.binding as llvm
import mujoco
import numpy as np
from numba import carray, types  # pyright: ignore[reportPrivateImportUsage]
from numba.extending import intrinsic

from backends.mujoco_sim import layout as row
from backends.mujoco_sim.drives import (
    compliant,
    deflection,
    multiply,
    saturate,
    servo_torque,
    uncompensated,
)
from backends.mujoco_sim.friction_laws import friction_damping
from backends.mujoco_sim.layout import Arrays, Servo
from backends.mujoco_sim.realisation import Plant
from limo_driver.compiled import compiled, part
from limo_driver.physics.friction_laws import PARAMETERS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

# The compiled loop finds these symbols by name, also when it comes from the cache.
llvm.load_library_permanently(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))
_step1 = types.ExternalFunction("mj_step1", types.void(types.uintp, types.uintp))
_step2 = types.ExternalFunction("mj_step2", types.void(types.uintp, types.uintp))

_SMALLEST = 1e-30  # [rad/s]


class Engine:
    """The compiled loop, bound to one arm.

    The loop gets addresses: an array takes compiled code longer to receive than to use, and a
    cycle uses thirty. All arrays are changed in place, by either side, and never replaced.

    Args:
        model: MuJoCo's model, kept alive here, since only its address goes on.
        data: MuJoCo's data.
        arrays: Its arrays.
        plant: Joint physics.
        servo: Drives and sensors.
        memory: What the robot remembers, (9, n).
        command: Other rows of the command, (5, n).
        added: What effects without a native form add, (4, n).
    """

    def __init__(
        self,
        model: Any,  # noqa: ANN401  # MuJoCo has no stubs
        data: Any,  # noqa: ANN401
        arrays: Arrays,
        plant: Plant,
        servo: Servo,
        memory: FloatArray,
        command: FloatArray,
        added: FloatArray,
    ) -> None:
        sensors = (servo.torque_limit, servo.encoder_resolution, servo.torque_resolution)
        self._tables = (*arrays, *plant, *sensors, memory, command, added)
        if not all(table.flags.c_contiguous for table in self._tables):
            raise ValueError("the arrays of the simulated arm have to be contiguous")
        self._model, self._data = model, data
        self._addresses = np.array([table.ctypes.data for table in self._tables])
        self._sizes = (
            memory.shape[1],
            arrays.inertia.size,
            plant.friction_joint.size,
            plant.element_joint.size,
        )
        self._rates = (servo.period, servo.bandwidth, servo.integral_rate, servo.velocity_gain)

    def advance(self, mode: int, targets: FloatArray, noise: FloatArray, log: FloatArray) -> bool:
        """Run one control cycle for each row of `targets`.

        Args:
            mode: Control mode in force in these cycles.
            targets: Position set-point of each cycle, (T, n) [rad].
            noise: Noise of the torque sensor, (T, n) [N m].
            log: Written: what was measured and what was true in each cycle, (T, 7, n).

        Returns:
            Whether all joints are still in the finite numbers.
        """
        return _advance_at(
            self._model._address,  # MuJoCo's way to its C structures
            self._data._address,
            self._addresses,
            self._sizes,
            self._rates,
            mode,
            targets,
            noise,
            log,
        )


# The checker does not see that numba passes the context itself.
# pyright: reportCallIssue=false
@intrinsic
def _pointer(_context: Any, _address: Any) -> Any:  # noqa: ANN401  # numba's own types
    """Turn an address into a pointer, of which `carray` makes an array."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:  # noqa: ANN401
        return builder.inttoptr(values[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


@part()
def _floats(address: int, size: int) -> FloatArray:
    return carray(_pointer(address), size, np.float64)


@part()
def _table(address: int, rows: int, columns: int) -> FloatArray:
    return carray(_pointer(address), (rows, columns), np.float64)


@part()
def _integers(address: int, size: int) -> NDArray[np.int64]:
    return carray(_pointer(address), size, np.int64)


@part()
def _short_integers(address: int, size: int) -> NDArray[np.int32]:
    return carray(_pointer(address), size, np.int32)


@compiled()
def _advance_at(
    model: int,
    data: int,
    at: NDArray[np.int64],
    sizes: tuple[int, int, int, int],
    rates: tuple[float, float, float, float],
    mode: int,
    targets: FloatArray,
    noise: FloatArray,
    log: FloatArray,
) -> bool:
    """Find the tables at their addresses, in the order of `Engine`, and advance."""
    n, entries, frictions, elements = sizes
    period, bandwidth, integral_rate, velocity_gain = rates
    arrays = Arrays(
        _floats(at[0], n),
        _floats(at[1], n),
        _floats(at[2], n + elements),
        _floats(at[3], n),
        _floats(at[4], n),
        _floats(at[5], entries),
        _short_integers(at[6], n),
        _short_integers(at[7], n),
        _short_integers(at[8], entries),
    )
    plant = Plant(
        _floats(at[9], n),
        _floats(at[10], n),
        _floats(at[11], n),
        _floats(at[12], n),
        _floats(at[13], n),
        _integers(at[14], frictions),
        _integers(at[15], frictions),
        _table(at[16], frictions, PARAMETERS),
        _integers(at[17], elements),
        _floats(at[18], elements),
        _floats(at[19], elements),
    )
    servo = Servo(
        period,
        bandwidth,
        integral_rate,
        _floats(at[20], n),
        velocity_gain,
        _floats(at[21], n),
        _floats(at[22], n),
    )
    memory, command = _table(at[23], row.MEMORY_ROWS, n), _table(at[24], row.COMMAND_ROWS, n)
    added = _table(at[25], 4, n)
    return _advance(
        model, data, arrays, plant, servo, memory, mode, targets, command, added, noise, log
    )


@part()
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
    """Do what `Engine.advance` says."""
    n = targets.shape[1]
    position, velocity, rate = np.empty(n), np.empty(n), np.empty(n)
    torque, damping, friction = np.empty(n), np.empty(n), np.empty(n)
    inertial, acceleration = np.empty(n), np.empty(n)
    for t in range(targets.shape[0]):
        _step1(model, data)
        for j in range(n):  # an array assignment would compile its error messages for seconds
            position[j], velocity[j] = arrays.position[j], arrays.velocity[j]
        _wind_up(arrays, plant, servo, memory, added, rate)
        if mode in (row.POSITION, row.DRIVES):
            servo_torque(
                arrays, plant, servo, memory, added, targets[t], rate, torque, damping, inertial
            )
            if mode == row.DRIVES:
                uncompensated(arrays, memory, targets[t], command, rate, torque, damping)
        else:
            compliant(arrays, memory, mode, targets[t], command, rate, torque, damping)
        saturate(servo, velocity, torque, damping)
        _friction(plant, memory, added, velocity, rate, friction)
        for j in range(n):
            arrays.control[j] = friction[j] + damping[j]
            arrays.applied[j] = torque[j] - friction[j] * rate[j] - added[row.ADDED_TORQUE, j]
            memory[row.LAST_VELOCITY, j] = velocity[j]
        _step2(model, data)
        for j in range(n):
            acceleration[j] = (arrays.velocity[j] - velocity[j]) / servo.period
        multiply(arrays, acceleration, inertial)
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
            log[t, row.TRUE_VELOCITY, j] = 0.5 * (velocity[j] + arrays.velocity[j]) + rate[j]
    total = 0.0
    for j in range(n):
        total += arrays.position[j] + arrays.velocity[j]
    return math.isfinite(total)


@part()
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
            deflection(plant.compliance[j], plant.cubic[j], arrays.bias[j])
            + added[row.ADDED_STATIC_WIND_UP, j]
        )
        rate[j] = (static - memory[row.STATIC_WIND_UP, j]) / servo.period
        memory[row.STATIC_WIND_UP, j] = static
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], memory[row.LOAD, j])
            + added[row.ADDED_WIND_UP, j]
        )
        motor[j] = arrays.velocity[j] + (wind_up - memory[row.WIND_UP, j]) / servo.period
        memory[row.WIND_UP, j] = wind_up
    for e in range(plant.element_joint.size):
        arrays.control[n + e] = motor[plant.element_joint[e]]


@part()
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
        friction[j] = added[row.ADDED_DAMPING, j]
    for f in range(plant.friction_joint.size):
        j = plant.friction_joint[f]
        expected = 2.0 * velocity[j] - memory[row.LAST_VELOCITY, j] + rate[j]
        friction[j] += friction_damping(
            plant.friction_law[f],
            plant.friction_parameters[f, 0],
            plant.friction_parameters[f, 1],
            plant.friction_parameters[f, 2],
            plant.friction_parameters[f, 3],
            expected,
        )


@part()
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
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], load) + added[row.ADDED_WIND_UP, j]
        )
        memory[row.LOAD, j] = load
        log[row.TRUE_POSITION, j] = position[j] + wind_up
        log[row.TRUE_ACCELERATION, j] = a
        log[row.TRUE_TORQUE, j] = drive - plant.motor_inertia[j] * a + plant.offset[j]


@part()
def _measure(servo: Servo, memory: FloatArray, noise: FloatArray, log: FloatArray) -> None:
    """Read encoder and torque sensor; the velocity is the encoder's, differenced and low-passed."""
    for j in range(noise.size):
        reading = _quantised(log[row.TRUE_POSITION, j], servo.encoder_resolution[j])
        difference = (reading - memory[row.ENCODER, j]) / servo.period
        filtered = memory[row.ENCODER_VELOCITY, j]
        filtered += servo.velocity_gain * (difference - filtered)
        # A decay into the denormal numbers would slow the whole loop down.
        memory[row.ENCODER_VELOCITY, j] = filtered if abs(filtered) > _SMALLEST else 0.0
        memory[row.ENCODER, j] = reading
        log[row.MEASURED_POSITION, j] = reading
        log[row.MEASURED_VELOCITY, j] = memory[row.ENCODER_VELOCITY, j]
        torque = log[row.TRUE_TORQUE, j] + noise[j]
        log[row.MEASURED_TORQUE, j] = _quantised(torque, servo.torque_resolution[j])


@part()
def _quantised(value: float, resolution: float) -> float:
    return round(value / resolution) * resolution if resolution > 0.0 else value
