"""The inner loop of the simulated robot, compiled: control cycles at the speed of MuJoCo itself.

MuJoCo is called through its C interface with the addresses of model and data, and its arrays are
read and written where they are, so that no Python runs in between and no global callback is set.

One cycle is one step of symplectic Euler. With q_k at time k, MuJoCo's velocity v_k = (q_k −
q_k−1)/h belongs to time k − ½; position q_k, velocity (v_k + v_k+1)/2, acceleration
(v_k+1 − v_k)/h and the torque over that step therefore all belong to time k, to second order.
Friction slows the arm by that of v_k+1, and is sensed as that of (v_k + v_k+1)/2.
These four are what the sensors sample. They are known when the step is done: a measurement
reaches the controller one cycle after it was taken.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba import config, types  # pyright: ignore[reportPrivateImportUsage]
from numba.extending import intrinsic

from backends.mujoco_sim import layout as row
from backends.mujoco_sim.layout import Arrays, Links, Scratch, Servo, gather, gather_state, spread
from backends.mujoco_sim.realisation import (
    Plant,
    compliant,
    deflection,
    friction_damping,
    multiply,
    saturate,
    servo_torque,
    uncompensated,
)
from limo_driver.errors import ConfigError
from limo_driver.physics.effects.laws import ROW
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.installed_mujoco import RELEASE, mujoco
from limo_driver.types import FloatArray, IntArray

# The compiled loop finds these symbols by name, also when it comes from the cache.
# Another release may have left its own in that folder.
_OWN = f"libmujoco.*{RELEASE[0]}.{RELEASE[1]}.*"
llvm.load_library_permanently(str(next(Path(mujoco.__file__).parent.glob(_OWN))))
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
        arrays: Its arrays, of the joints.
        links: Its arrays of the links, where they are others.
        plant: Joint physics.
        servo: Drives and sensors.
        memory: What the robot remembers, (9, n).
        command: Other rows of the command, (5, n).
        added: What effects without a native form add, (4, n).

    Raises:
        ConfigError: Compilation is switched off; the loop has no form in plain Python.
    """

    def __init__(
        self,
        model: Any,  # noqa: ANN401  # MuJoCo has no stubs
        data: Any,  # noqa: ANN401
        arrays: Arrays,
        links: Links,
        plant: Plant,
        servo: Servo,
        memory: FloatArray,
        command: FloatArray,
        added: FloatArray,
    ) -> None:
        if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
            raise ConfigError(
                "the simulated robot needs numba's compiler, which NUMBA_DISABLE_JIT switches off"
            )
        sensors = (servo.torque_limit, servo.encoder_resolution, servo.torque_resolution)
        scratch = np.empty((row.SCRATCH_ROWS, memory.shape[1]))
        self._tables = (*arrays, *plant, *sensors, memory, command, added, scratch, *links)
        if not all(table.flags.c_contiguous for table in self._tables):
            raise ValueError("the arrays of the simulated arm have to be contiguous")
        self._model, self._data = model, data
        self._addresses = np.array([table.ctypes.data for table in self._tables])
        self._sizes = (plant.friction_joint.size, plant.element_joint.size, links.driver.size)
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
        return _advance(
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
def _floats(_context: Any, _address: Any) -> Any:  # noqa: ANN401  # numba's own types
    """Turn an address into a pointer to doubles."""
    return _pointer_to(types.float64)


@intrinsic
def _integers(_context: Any, _address: Any) -> Any:  # noqa: ANN401
    """Turn an address into a pointer to integers of 64 bits."""
    return _pointer_to(types.int64)


@intrinsic
def _short_integers(_context: Any, _address: Any) -> Any:  # noqa: ANN401
    """Turn an address into a pointer to integers of 32 bits."""
    return _pointer_to(types.int32)


def _pointer_to(entry: Any) -> Any:  # noqa: ANN401
    pointer = types.CPointer(entry)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:  # noqa: ANN401
        return builder.inttoptr(values[0], context.get_value_type(pointer))

    return pointer(types.int64), generate


@compiled(nogil=True)
def _advance(
    model: int,
    data: int,
    at: IntArray,
    sizes: tuple[int, int, int],
    rates: tuple[float, float, float, float],
    mode: int,
    targets: FloatArray,
    noise: FloatArray,
    log: FloatArray,
) -> bool:
    """Do what `Engine.advance` says."""
    n = targets.shape[1]
    arrays, plant, servo = _tables(at, rates)
    memory, command, added = _floats(at[23]), _floats(at[24]), _floats(at[25])
    own = _scratch(at[26], n)
    links = _links(at)
    frictions, elements, followed = sizes
    position, velocity, rate = own.position, own.velocity, own.rate
    torque, damping, friction, motor = own.torque, own.damping, own.friction, own.motor
    for t in range(targets.shape[0]):
        _step1(model, data)
        gather(links, arrays, followed, n)
        for j in range(n):  # an array assignment would compile its error messages for seconds
            position[j], velocity[j] = arrays.position[j], arrays.velocity[j]
        _wind_up(arrays, plant, servo, memory, added, n, elements, own)
        if mode in (row.POSITION, row.DRIVES):
            servo_torque(arrays, plant, servo, memory, added, targets[t], own)
            if mode == row.DRIVES:
                uncompensated(arrays, memory, targets[t], command, own)
        else:
            compliant(arrays, memory, mode, targets[t], command, own)
        saturate(servo, n, own)
        for j in range(n):  # expected next
            motor[j] = 2.0 * velocity[j] - memory[row.LAST_VELOCITY * n + j] + rate[j]
        _friction(plant, n, frictions, own)
        for j in range(n):
            sliding = friction[j] + added[row.ADDED_DAMPING * n + j]
            arrays.control[j] = sliding + damping[j]
            arrays.applied[j] = torque[j] - sliding * rate[j] - added[row.ADDED_TORQUE * n + j]
            memory[row.LAST_VELOCITY * n + j] = velocity[j]
        spread(links, arrays, followed, n)
        _step2(model, data)
        gather_state(links, arrays, followed, n)
        for j in range(n):
            own.acceleration[j] = (arrays.velocity[j] - velocity[j]) / servo.period
            torque[j] -= friction[j] * (arrays.velocity[j] + rate[j])
            motor[j] = 0.5 * (velocity[j] + arrays.velocity[j]) + rate[j]
        _friction(plant, n, frictions, own)
        for j in range(n):
            torque[j] += friction[j] * motor[j]
        multiply(arrays, n, own.acceleration, own.inertial)
        _sense(arrays, plant, memory, added, n, own, log[t])
        _measure(servo, memory, noise[t], log[t])
        for j in range(n):
            log[t, row.TRUE_VELOCITY, j] = motor[j]
    total = 0.0
    for j in range(n):
        total += arrays.position[j] + arrays.velocity[j]
    return math.isfinite(total)


@compiled(inline="always")
def _tables(at: IntArray, rates: tuple[float, float, float, float]) -> tuple[Arrays, Plant, Servo]:
    """Return the tables at their addresses, in the order of `Engine`."""
    period, bandwidth, integral_rate, velocity_gain = rates
    arrays = Arrays(
        _floats(at[0]),
        _floats(at[1]),
        _floats(at[2]),
        _floats(at[3]),
        _floats(at[4]),
        _floats(at[5]),
        _short_integers(at[6]),
        _short_integers(at[7]),
        _short_integers(at[8]),
    )
    plant = Plant(
        _floats(at[9]),
        _floats(at[10]),
        _floats(at[11]),
        _floats(at[12]),
        _floats(at[13]),
        _integers(at[14]),
        _integers(at[15]),
        _floats(at[16]),
        _integers(at[17]),
        _floats(at[18]),
        _floats(at[19]),
    )
    servo = Servo(
        period,
        bandwidth,
        integral_rate,
        _floats(at[20]),
        velocity_gain,
        _floats(at[21]),
        _floats(at[22]),
    )
    return arrays, plant, servo


@compiled(inline="always")
def _links(at: IntArray) -> Links:
    """Return the arrays of the links at their addresses, in the order of `Engine`."""
    return Links(
        _floats(at[27]),
        _floats(at[28]),
        _floats(at[29]),
        _floats(at[30]),
        _floats(at[31]),
        _short_integers(at[32]),
        _short_integers(at[33]),
        _short_integers(at[34]),
        _integers(at[35]),
        _floats(at[36]),
        _integers(at[37]),
    )


@compiled(inline="always")
def _scratch(address: int, n: int) -> Scratch:
    """Return the rows of n doubles each that begin at an address."""
    row_bytes = 8 * n
    return Scratch(
        _floats(address),
        _floats(address + 1 * row_bytes),
        _floats(address + 2 * row_bytes),
        _floats(address + 3 * row_bytes),
        _floats(address + 4 * row_bytes),
        _floats(address + 5 * row_bytes),
        _floats(address + 6 * row_bytes),
        _floats(address + 7 * row_bytes),
        _floats(address + 8 * row_bytes),
        _floats(address + 9 * row_bytes),
        _floats(address + 10 * row_bytes),
        _floats(address + 11 * row_bytes),
    )


@compiled(inline="always")
def _wind_up(
    arrays: Arrays,
    plant: Plant,
    servo: Servo,
    memory: FloatArray,
    added: FloatArray,
    n: int,
    elements: int,
    own: Scratch,
) -> None:
    """Advance the wind-up of the gears and drive the slipping springs with the encoders' motion.

    `rate` becomes the velocity of the motor against the link that changing static load causes.
    """
    rate, motor = own.rate, own.motor
    for j in range(n):
        static = (
            deflection(plant.compliance[j], plant.cubic[j], arrays.bias[j])
            + added[row.ADDED_STATIC_WIND_UP * n + j]
        )
        rate[j] = (static - memory[row.STATIC_WIND_UP * n + j]) / servo.period
        memory[row.STATIC_WIND_UP * n + j] = static
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], memory[row.LOAD * n + j])
            + added[row.ADDED_WIND_UP * n + j]
        )
        motor[j] = arrays.velocity[j] + (wind_up - memory[row.WIND_UP * n + j]) / servo.period
        memory[row.WIND_UP * n + j] = wind_up
    for e in range(elements):
        arrays.control[n + e] = motor[plant.element_joint[e]]


@compiled(inline="always")
def _friction(plant: Plant, n: int, frictions: int, own: Scratch) -> None:
    """Sum the secant damping of every joint's frictions, at the velocities of the motors.

    A damping that is never negative dissipates at any step size, however stiff the law.
    """
    motor, friction = own.motor, own.friction
    for j in range(n):
        friction[j] = 0.0
    for f in range(frictions):
        j = int(plant.friction_joint[f])
        friction[j] += friction_damping(
            plant.friction_law[f],
            plant.friction_parameters[ROW * f + 0],
            plant.friction_parameters[ROW * f + 1],
            plant.friction_parameters[ROW * f + 2],
            plant.friction_parameters[ROW * f + 3],
            plant.friction_parameters[ROW * f + 4],
            plant.friction_parameters[ROW * f + 5],
            plant.friction_parameters[ROW * f + 6],
            motor[j],
        )


@compiled(inline="always")
def _sense(
    arrays: Arrays,
    plant: Plant,
    memory: FloatArray,
    added: FloatArray,
    n: int,
    own: Scratch,
    log: FloatArray,
) -> None:
    """Log what is true at the encoders and at the torque sensors, after the step."""
    position, inertial, torque, damping = own.position, own.inertial, own.torque, own.damping
    for j in range(n):
        a, drive = own.acceleration[j], torque[j] - damping[j] * arrays.velocity[j]
        load = inertial[j] - plant.armature[j] * a + arrays.bias[j]
        wind_up = (
            deflection(plant.compliance[j], plant.cubic[j], load) + added[row.ADDED_WIND_UP * n + j]
        )
        memory[row.LOAD * n + j] = load
        log[row.TRUE_POSITION, j] = position[j] + wind_up
        log[row.TRUE_ACCELERATION, j] = a
        log[row.TRUE_TORQUE, j] = drive - plant.motor_inertia[j] * a + plant.offset[j]


@compiled(inline="always")
def _measure(servo: Servo, memory: FloatArray, noise: FloatArray, log: FloatArray) -> None:
    """Read encoder and torque sensor; the velocity is the encoder's, differenced and low-passed."""
    n = noise.size
    for j in range(n):
        reading = _quantised(log[row.TRUE_POSITION, j], servo.encoder_resolution[j])
        difference = (reading - memory[row.ENCODER * n + j]) / servo.period
        filtered = memory[row.ENCODER_VELOCITY * n + j]
        filtered += servo.velocity_gain * (difference - filtered)
        # A decay into the denormal numbers would slow the whole loop down.
        memory[row.ENCODER_VELOCITY * n + j] = filtered if abs(filtered) > _SMALLEST else 0.0
        memory[row.ENCODER * n + j] = reading
        log[row.MEASURED_POSITION, j] = reading
        log[row.MEASURED_VELOCITY, j] = memory[row.ENCODER_VELOCITY * n + j]
        torque = log[row.TRUE_TORQUE, j] + noise[j]
        log[row.MEASURED_TORQUE, j] = _quantised(torque, servo.torque_resolution[j])


@compiled(inline="always")
def _quantised(value: float, resolution: float) -> float:
    return round(value / resolution) * resolution if resolution > 0.0 else value
