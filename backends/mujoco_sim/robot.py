"""MujocoRobot: the simulated arm behind the same interface as a real one."""

# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
# MuJoCo ships no stubs.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from backends.mujoco_sim import layout, realisation
from backends.mujoco_sim.engine import Engine
from backends.mujoco_sim.layout import DriveSideState
from backends.mujoco_sim.sampled import SampledEffects, SensorNoise, TorqueSensors
from backends.mujoco_sim.scene import PickedUpLoads, compile_model
from backends.virtual import DEFAULT_PERIOD, SimulatedRobot, simulation_of, start_position
from limo_driver.errors import (
    BackendError,
    ConfigError,
    ConnectionLostError,
    LimoError,
    ShapeError,
)
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.robot.safety import START_TOLERANCE
from limo_driver.runtime.installed_mujoco import mujoco
from limo_driver.runtime.parameters import seed_of
from limo_driver.types import (
    FloatArray,
    ImpedanceCommand,
    JointCommand,
    JointState,
    Motion,
    PositionCommand,
    StatesAhead,
    TorqueCommand,
)

MOTOR_INERTIA_PER_TORQUE = 0.01  # [kg m²/(N m)], harmonic drives of geared arms, order of size
_LIMIT_PER_LOAD = 2.0  # of drives as arms have them, where no limit is stated
SERVO_BANDWIDTH = 100.0  # [rad/s]
INTEGRAL_RATE = 10.0  # [1/s]
VELOCITY_BANDWIDTH = 50.0  # [Hz]
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_SETTLING = 20  # iterations that find the link's pose under a given encoder reading


@dataclass(frozen=True)
class SimulatedRun:
    """A whole run: what was measured, and what was true."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad], measured
    velocity: FloatArray  # (T, n) [rad/s], measured
    torque: FloatArray  # (T, n) [N m], measured
    target: FloatArray  # (T, n) [rad], set-points as sent after each of these states
    limited_by: tuple[str, ...]  # limits that changed the targets
    true_motion: Motion  # what encoders without error would see
    true_torque: FloatArray  # (T, n) [N m], at the torque sensor without noise


class MujocoRobot(SimulatedRobot):
    """An arm simulated by MuJoCo with the joint physics of a `Simulation`.

    Torque is sensed on the link's side of the gear: drive torque less the torque that accelerates
    the motor. The joint velocity is what the encoder gives: its differences, low-passed. The
    drives' own servo runs on the motor's encoder, which the gear makes finer than the joint's; it
    is taken as exact.

    Args:
        simulation: Arm and effects, or the path of a `sim.yaml`.
        robot: Built-in name or URDF of an arm without effects, instead of a simulation.
        initial_position: Encoder position at time 0, (n,) [rad]; the middle of the range if not
            given.
        seed: Seed of the sensor noise; the same seed gives the same bits.
        period: Control cycle and integration step [s].
        motor_inertia: Reflected inertia of the motors, (n,) [kg m²]; by default 0.01 kg m² for
            each N m of torque limit, which is the size seen on arms with harmonic drives. Where
            no limit is stated, twice what the joint holds and accelerates stands for it.
        velocity_bandwidth: Bandwidth of the encoder's velocity filter [Hz].
        start_tolerance: How far the first position may be from the measured pose [rad].

    Raises:
        ConfigError: The simulation cannot be integrated with this period, naming the joint; or the
            seed is no whole number.
    """

    def __init__(
        self,
        simulation: Simulation | Path | str | None = None,
        *,
        robot: str | None = None,
        initial_position: Sequence[float] | FloatArray | None = None,
        seed: int = 0,
        period: float = DEFAULT_PERIOD,
        motor_inertia: Sequence[float] | FloatArray | None = None,
        velocity_bandwidth: float = VELOCITY_BANDWIDTH,
        start_tolerance: float = START_TOLERANCE,
    ) -> None:
        super().__init__(simulation_of(simulation, robot), period, start_tolerance)
        arm, n = self.simulation.body, self.spec.n
        draft = realisation.draft_of(self.simulation.effects, n)
        self._plant = draft.plant(_motor_inertia(arm, motor_inertia))
        self._sampled = SampledEffects(draft, arm, period)
        self._model = compile_model(arm, self._plant, period, draft.shafts)
        self._loads = PickedUpLoads(draft, self._model, arm, self._plant, period)
        self._loads.carry(0.0)
        self._data = mujoco.MjData(self._model)
        self._inertia = realisation.effective_inertia(arm, self._plant.armature)
        realisation.check_elements(self._plant, self._inertia, period)
        realisation.check_late(draft, self._inertia, period)
        self._arm_state = DriveSideState(arm, self._model, self._data)
        self._arrays = self._arm_state.arrays
        sensors = self.simulation.sensors
        self._noise = SensorNoise(sensors.for_joints("torque_noise", n), seed_of(seed))
        self._log = np.empty((1, layout.LOG_ROWS, n))
        self._servo = layout.Servo(
            period=period,
            bandwidth=SERVO_BANDWIDTH,
            integral_rate=INTEGRAL_RATE,
            torque_limit=np.array(arm.limits.torque),
            velocity_gain=1.0 - float(np.exp(-2.0 * np.pi * velocity_bandwidth * period)),
            encoder_resolution=np.array(sensors.for_joints("encoder_resolution", n)),
            torque_resolution=np.array(sensors.for_joints("torque_resolution", n)),
        )
        self._sensors = TorqueSensors(draft.sensed, self._servo.torque_resolution)
        self._memory = np.zeros((layout.MEMORY_ROWS, n))
        self._command = np.zeros((layout.COMMAND_ROWS, n))
        self._engine = Engine(
            self._model,
            self._data,
            self._arrays,
            self._arm_state.links,
            self._plant,
            self._servo,
            self._memory,
            self._command,
            self._sampled.added,
        )
        self._mode = layout.POSITION
        self._fresh = False  # the next position starts a stream
        self._wanted: JointCommand | None = None  # in the next cycle, if another than in this one
        self._place(start_position(arm, initial_position))

    def run(self, targets: FloatArray) -> SimulatedRun:
        """Simulate T cycles in one call, each with the position commanded after the one before.

        The same, bit for bit, as T times `send(PositionCommand(...))` and `receive()`; faults are
        looked for once, at the end.

        Args:
            targets: Positions, (T, n) [rad]; the first starts from the measured pose.

        Raises:
            JointLimitError: As for `send`.
            HoldingError: As for `send`.
        """
        targets = np.ascontiguousarray(targets, dtype=float)
        if targets.ndim != 2 or targets.shape[1] != self.spec.n or not len(targets):  # noqa: PLR2004
            raise ShapeError("targets", targets.shape, f"(T, {self.spec.n})")
        if not self._open:
            raise ConnectionLostError("the robot is closed; open it again")
        path, limited_by, time, log = self._simulate(targets)
        self._close_run(log)
        return SimulatedRun(
            time=time,
            position=log[:, layout.MEASURED_POSITION],
            velocity=log[:, layout.MEASURED_VELOCITY],
            torque=log[:, layout.MEASURED_TORQUE],
            target=path,
            limited_by=limited_by,
            true_motion=Motion(
                time,
                log[:, layout.TRUE_POSITION],
                log[:, layout.TRUE_VELOCITY],
                log[:, layout.TRUE_ACCELERATION],
            ),
            true_torque=log[:, layout.TRUE_TORQUE],
        )

    def send_ahead(self, targets: FloatArray) -> StatesAhead | None:
        """Simulate T cycles in one call, and take them back where any was not ordinary."""
        if not self._open or self._keeps_time or self._losing or self._contract.at_rest:
            return None
        before = self.save_state()
        found = self._look_ahead(np.ascontiguousarray(targets, dtype=float))
        if found is None:
            self.restore_state(before)
        return found

    def _look_ahead(self, targets: FloatArray) -> StatesAhead | None:
        """Simulate T cycles; None where one is not ordinary, with the robot anywhere by then."""
        try:
            _, limited_by, time, log = self._simulate(targets)
        except LimoError:  # it comes up again in its own cycle
            return None
        position = np.ascontiguousarray(log[:, layout.MEASURED_POSITION])
        velocity = np.ascontiguousarray(log[:, layout.MEASURED_VELOCITY])
        torque = np.ascontiguousarray(log[:, layout.MEASURED_TORQUE])
        if limited_by or not self._contract.finds_nothing_in(position, velocity, torque):
            return None
        self._close_run(log)
        last = self._state
        if last is None or self._contract.holding:
            return None
        return StatesAhead(time, position, velocity, torque, last)

    def _simulate(
        self, targets: FloatArray
    ) -> tuple[FloatArray, tuple[str, ...], FloatArray, FloatArray]:
        """Simulate a cycle for each target (T, n); return set-points, limits, times and log."""
        starts = self._contract.at_rest
        path, limited_by = self._contract.admit_path(targets)
        if starts:
            self._begin()
        self._apply(PositionCommand(position=path[0]))
        first = self._cycle
        log = np.empty((len(path), layout.LOG_ROWS, self.spec.n))
        self._advance(path, log)
        self._cycle += len(path)
        time: FloatArray = (first + np.arange(len(path), dtype=float)) * self.spec.period
        return path, limited_by, time, log

    def _begin(self) -> None:
        self._fresh = True

    def _check(self, command: JointCommand) -> None:
        if type(command) not in _MODES:
            raise BackendError(f"the mujoco backend knows no {type(command).__name__}")
        if isinstance(command, ImpedanceCommand):
            realisation.check_impedance(command, self._inertia, self.spec.period)

    def _send(self, command: JointCommand) -> None:
        self._wanted = command

    def _apply(self, command: JointCommand) -> None:
        """Give the drives the last command of a cycle."""
        self._wanted = None
        mode = _MODES[type(command)]
        if isinstance(command, ImpedanceCommand):
            self._command[layout.STIFFNESS] = command.stiffness
            self._command[layout.DAMPING] = command.damping
        if isinstance(command, (ImpedanceCommand, TorqueCommand)):
            self._command[layout.FEED_FORWARD] = command.torque
        if isinstance(command, (PositionCommand, ImpedanceCommand)):
            self._command[layout.TARGET] = command.position
        if isinstance(command, PositionCommand) and (self._fresh or mode != self._mode):
            # The servo feeds forward the target's motion: that of the arm, unless it rests.
            rate = self._arrays.velocity * (mode != self._mode)
            self._memory[layout.LAST_TARGET] = command.position - rate * self.spec.period
            self._memory[layout.TARGET_VELOCITY] = rate
            self._memory[layout.INTEGRAL] *= mode == self._mode
        self._fresh, self._mode = False, mode

    def _cycle_once(self) -> JointState:
        if self._wanted is not None:
            self._apply(self._wanted)
        self._advance(self._command[layout.TARGET : layout.TARGET + 1], self._log)
        return self._measurement(self._cycle, self._log[0])

    def _advance(self, targets: FloatArray, log: FloatArray) -> None:
        """Simulate one cycle for each target and log it, (T, 7, n)."""
        noise = self._noise.take(len(targets))
        time = (self._cycle + np.arange(len(targets), dtype=float)) * self.spec.period
        if not (self._sampled or self._loads):
            self._run_engine(targets, noise, log)
        else:
            for row in range(len(targets)):
                here = slice(row, row + 1)
                self._loads.carry(time[row])
                self._sampled.sample(time[row], self._arrays, self._memory)
                self._run_engine(targets[here], noise[here], log[here])
                self._sampled.acceleration = log[row, layout.TRUE_ACCELERATION].copy()
        if self._sensors:
            self._sensors.sense(time, noise, log)

    def _run_engine(self, targets: FloatArray, noise: FloatArray, log: FloatArray) -> None:
        finite = self._engine.advance(self._mode, targets, noise, log)
        if not finite:
            raise BackendError("the simulation left the finite numbers; check effects and inertias")

    def _measurement(self, cycle: int, log: FloatArray) -> JointState:
        return JointState(
            time=cycle * self.spec.period,
            position=log[layout.MEASURED_POSITION],
            velocity=log[layout.MEASURED_VELOCITY],
            torque=log[layout.MEASURED_TORQUE],
            sequence=cycle,
        )

    def _close_run(self, log: FloatArray) -> None:
        """Leave all as if each cycle of a log (T, 7, n) had been received."""
        last = self._cycle - 1
        if len(log) > 1:
            self._contract.pass_by(self._measurement(last - 1, log[-2]))
        self._state = self._contract.observe(self._measurement(last, log[-1]))
        self._answered = False

    def _place(self, position: FloatArray) -> None:
        """Put the arm at rest in equilibrium where the encoders read `position`."""
        state, memory, plant = self._arm_state, self._memory, self._plant
        state.place(position)
        load, wind_up = state.arrays.bias, np.zeros(self.spec.n)
        for _ in range(_SETTLING):
            wind_up = load * (plant.compliance + plant.cubic * load**2)
            self._sampled.settle(position, load)
            wind_up = wind_up + self._sampled.added[layout.ADDED_WIND_UP]
            state.place(position - wind_up)
        memory[layout.LOAD] = load
        memory[layout.WIND_UP] = memory[layout.STATIC_WIND_UP] = wind_up
        memory[layout.LAST_TARGET] = self._command[layout.TARGET] = position
        memory[layout.ENCODER] = self.simulation.sensors.measure_position(position)

    def _save_plant(self) -> object:
        physics = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, physics, _STATE)
        return (
            physics,
            self._memory.copy(),
            self._command.copy(),
            self._mode,
            self._fresh,
            self._wanted,
            self._noise.save(),
            self._sampled.save(),
            self._sensors.save(),
        )

    def _restore_plant(self, saved: Any) -> None:  # noqa: ANN401  # what save returned
        physics, memory, command, self._mode, self._fresh, self._wanted = saved[:6]
        noise, sampled, sensors = saved[6:]
        mujoco.mj_setState(self._model, self._data, physics, _STATE)
        self._arm_state.refresh()
        self._memory[:], self._command[:] = memory, command
        self._noise.restore(noise)
        self._sampled.restore(sampled)
        self._sensors.restore(sensors)


_MODES: dict[type[JointCommand], int] = {
    PositionCommand: layout.POSITION,
    ImpedanceCommand: layout.IMPEDANCE,
    TorqueCommand: layout.TORQUE,
}


def _motor_inertia(arm: RobotModel, given: Sequence[float] | FloatArray | None) -> FloatArray:
    limit = arm.limits.torque
    if given is None:
        stated = np.isfinite(limit)
        if not stated.all():
            limit = np.where(stated, limit, _LIMIT_PER_LOAD * realisation.usual_load(arm))
        return MOTOR_INERTIA_PER_TORQUE * limit
    inertia = np.array(given, dtype=float)
    if inertia.shape != limit.shape:
        raise ShapeError("motor_inertia", inertia.shape, f"{limit.shape}")
    if not (np.isfinite(inertia) & (inertia >= 0)).all():
        raise ConfigError(f"motor_inertia = {inertia.tolist()} kg m² has to be 0 or more")
    return inertia
