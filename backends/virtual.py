"""VirtualRobot: an ideal arm in simulated time, which follows each command exactly.

Position set-points are met in the next cycle; impedance and torque commands move a rigid body
without friction. The torque is what the simulation says the motion needs. It is for testing
programs, not physics: `mujoco` is for physics.

Base class of simulated robots: their arm, their start, and restoring an earlier state.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from limo_driver.errors import BackendError, ConfigError, JointLimitError, ShapeError
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.physics import Simulation
from limo_driver.robot.realtime import LatencyHistogram
from limo_driver.robot.robot import Robot
from limo_driver.robot.safety import START_TOLERANCE
from limo_driver.runtime.parameters import seed_of
from limo_driver.types import (
    FloatArray,
    ImpedanceCommand,
    JointCommand,
    JointSample,
    JointState,
    PositionCommand,
    RobotSpec,
    TorqueCommand,
)

DEFAULT_PERIOD = 1e-3  # [s]


@dataclass(frozen=True)
class SavedState:
    """A moment of a simulated robot; only the robot it came from can read it."""

    session: object
    plant: object
    cycle: int
    losing: int


class SimulatedRobot(Robot):
    """A robot in simulated time, which starts at 0 and advances only by `receive`.

    With `keep_time`, `receive` waits for the cycle as a real robot does; a cycle that comes late is
    followed by the next at once, until the robot's time has caught up.

    Args:
        simulation: The arm and the physics of its joints.
        period: Control cycle [s].
        start_tolerance: How far the first position may be from the measured pose [rad].
    """

    simulated: ClassVar[bool] = True

    def __init__(
        self,
        simulation: Simulation,
        period: float = DEFAULT_PERIOD,
        start_tolerance: float = START_TOLERANCE,
    ) -> None:
        super().__init__(specification(simulation, period), start_tolerance)
        self.simulation = simulation
        self._cycle = 0
        self._losing = 0
        self._stood = 0  # cycles in which simulated time stood
        self._began: float | None = None  # [s], where time is kept: when cycle 0 was
        self._keeps_time = False
        self.lateness = LatencyHistogram()

    def keep_time(self) -> None:
        """Run no faster than real time from now on."""
        self._keeps_time, self._began = True, None

    def stand_by(self) -> JointState:
        """Wait for a cycle in which the arm and its time stand; return its last state again."""
        if self._state is None or not self._open:
            return self.receive()
        if self._began is None:
            self._began = time.monotonic() - self._passed
        if self._keeps_time:
            self._wait(self._began)
        self._stood += 1
        return self._state

    def place(self, position: Sequence[float] | FloatArray) -> None:
        """Put an arm that has not begun to move somewhere else, at rest.

        Args:
            position: (n,) [rad]; as if it had been the `initial_position`.

        Raises:
            BackendError: A cycle was simulated already.
            ShapeError: Another number of joints.
            JointLimitError: Outside the range.
        """
        if self._cycle:
            raise BackendError(
                f"the arm moves since {self._cycle} cycles; it can be placed before the first only"
            )
        self._place(start_position(self.simulation.model, position))

    def lose_measurements(self, count: int) -> None:
        """Lose the next `count` measurements, as a network might; the arm moves on meanwhile."""
        self._losing = count

    def save_state(self) -> SavedState:
        """Return this moment; what follows `restore_state` is equal to the last bit."""
        return SavedState(self._save_session(), self._save_plant(), self._cycle, self._losing)

    def restore_state(self, saved: SavedState) -> None:
        """Go back to a moment of this robot."""
        self._restore_session(saved.session)
        self._restore_plant(saved.plant)
        self._cycle, self._losing, self._began = saved.cycle, saved.losing, None

    def _receive(self, timeout: float | None) -> JointState | None:  # noqa: ARG002  # in time
        if self._keeps_time and self._began is not None:
            self._wait(self._began)
        measured = self._cycle_once()
        if self._began is None:  # time runs from here: the first cycle may compile for a second
            self._began = time.monotonic() - self._passed
        self._cycle += 1
        if self._losing:
            self._losing -= 1
            return None
        return measured

    @property
    def _passed(self) -> float:
        """Time from the first cycle to the next one, had it all been real [s]."""
        return (self._cycle + self._stood) * self.spec.period

    def _wait(self, began: float) -> None:
        """Sleep until this cycle is due."""
        now, due = time.monotonic(), began + self._passed
        if due > now:
            time.sleep(due - now)
        self.lateness.add(max(time.monotonic() - due, 0.0))

    def _close(self) -> None:
        """Nothing outside this process has to be told."""

    def _stand_at(self, position: FloatArray) -> None:
        if not self._cycle:
            self.place(position)

    @abstractmethod
    def _place(self, position: FloatArray) -> None:
        """Put the arm at rest at a position within its range, (n,) [rad]."""

    @abstractmethod
    def _cycle_once(self) -> JointState:
        """Simulate one control cycle."""

    @abstractmethod
    def _save_plant(self) -> object:
        """Return a copy of all that changes from cycle to cycle."""

    @abstractmethod
    def _restore_plant(self, saved: Any) -> None:  # noqa: ANN401  # what _save_plant returned
        """Go back to what `_save_plant` returned."""


def specification(simulation: Simulation, period: float) -> RobotSpec:
    """Return the specification of a simulated arm.

    Raises:
        ConfigError: The period is not above 0, or a joint has no limit of velocity or torque.
    """
    if not 0 < period < np.inf:
        raise ConfigError(f"period = {period} s has to be positive")
    model = simulation.model
    model.check_runnable()
    resolution = simulation.sensors.for_joints("torque_resolution", model.n)
    return RobotSpec(
        model.name,
        model.joint_names,
        model.limits,
        period,
        torque_resolution=resolution,
        jerk=model.jerk,
    )


def simulation_of(simulation: Simulation | Path | str | None, robot: str | None) -> Simulation:
    """Return the simulation given, read from its file, or the rigid body alone of `robot`.

    Raises:
        ConfigError: The file cannot be read, or both are given.
    """
    if simulation is None:
        return Simulation(robot=robot or BUILT_IN[0])
    if robot is not None:
        raise ConfigError("give a simulation or a robot; the simulation names its robot")
    return simulation if isinstance(simulation, Simulation) else Simulation.load(simulation)


def start_position(model: RobotModel, given: Sequence[float] | FloatArray | None) -> FloatArray:
    """Return where the arm starts, (n,) [rad]: the middle of its range if not given.

    Raises:
        ShapeError: Another number of joints.
        JointLimitError: Outside the range.
    """
    lower, upper = model.limits.position_min, model.limits.position_max
    if given is None:
        return 0.5 * (lower + upper)
    position = np.array(given, dtype=float)
    if position.shape != lower.shape:
        raise ShapeError("initial_position", position.shape, f"({model.n},)")
    for j in np.flatnonzero(~((lower <= position) & (position <= upper))):
        raise JointLimitError(
            int(j) + 1,
            "initial position",
            float(position[j]),
            (float(lower[j]), float(upper[j])),
            "rad",
        )
    return position


def check_gains(command: ImpedanceCommand, stiffness: FloatArray, damping: FloatArray) -> None:
    """Refuse gains above `stiffness` [N m/rad] or `damping` [N m s/rad], (n,) each.

    Raises:
        JointLimitError: Names the joint that is furthest above.
    """
    for name, most, unit in (
        ("stiffness", stiffness, "N m/rad"),
        ("damping", damping, "N m s/rad"),
    ):
        given: FloatArray = getattr(command, name)
        if (given > most).any():
            j = int(np.argmax(given / most))
            raise JointLimitError(j + 1, name, float(given[j]), (0.0, float(most[j])), unit)


LARGEST_GAIN = 1e6  # [N m/rad] and [N m s/rad], beyond any drive


class VirtualRobot(SimulatedRobot):
    """An arm that follows its commands perfectly, within their limits.

    Args:
        simulation: Arm and effects, or the path of a `sim.yaml`.
        robot: Built-in name or URDF of an arm without effects, instead of a simulation.
        initial_position: Position at time 0, (n,) [rad]; the middle of the range if not given.
        seed: Seed of the sensor noise.
        period: Control cycle [s].
        start_tolerance: How far the first position may be from the measured pose [rad].
    """

    def __init__(
        self,
        simulation: Simulation | Path | str | None = None,
        *,
        robot: str | None = None,
        initial_position: Sequence[float] | FloatArray | None = None,
        seed: int = 0,
        period: float = DEFAULT_PERIOD,
        start_tolerance: float = START_TOLERANCE,
    ) -> None:
        super().__init__(simulation_of(simulation, robot), period, start_tolerance)
        self._velocity = np.zeros(self.spec.n)
        self._place(start_position(self.simulation.model, initial_position))
        self._effects = self.simulation.init()
        self._random = np.random.default_rng(seed_of(seed))

    def _check(self, command: JointCommand) -> None:
        if isinstance(command, ImpedanceCommand):
            largest = np.full(self.spec.n, LARGEST_GAIN)
            check_gains(command, largest, largest)
        if not isinstance(command, (PositionCommand, ImpedanceCommand, TorqueCommand)):
            raise BackendError(f"the virtual backend knows no {type(command).__name__}")

    def _place(self, position: FloatArray) -> None:
        self._position = position
        self._command: JointCommand = PositionCommand(position=position)

    def _send(self, command: JointCommand) -> None:
        self._command = command

    def _cycle_once(self) -> JointState:
        before, h = self._velocity, self.spec.period
        if self._cycle:  # the first state is where the arm stands
            self._move()
        acceleration = (self._velocity - before) / h
        sample = JointSample(self._cycle * h, self._position, self._velocity, acceleration)
        torque, self._effects = self.simulation.step(self._effects, sample)
        sensors = self.simulation.sensors
        return JointState(
            time=sample.time,
            position=sensors.measure_position(self._position),
            velocity=self._velocity,
            torque=sensors.measure_torque(torque, self._random),
            sequence=self._cycle,
        )

    def _move(self) -> None:
        command, h = self._command, self.spec.period
        if isinstance(command, PositionCommand):
            self._velocity = (command.position - self._position) / h
            self._position = np.array(command.position)
            return
        self._velocity = self._velocity + self._free_change(command)
        self._position = self._position + h * self._velocity

    def _free_change(self, command: JointCommand) -> FloatArray:
        """Return the change of velocity [rad/s] in a cycle, with springs and dampers implicit."""
        h, q, v = self.spec.period, self._position, self._velocity
        model = self.simulation.body
        still = np.zeros((1, self.spec.n))
        coriolis = model.inverse_dynamics(q[None], v[None], still) - model.gravity_torque(q)
        inertia = model.mass_matrix(q)
        if isinstance(command, ImpedanceCommand):
            k, d = command.stiffness, command.damping
            inertia = inertia + np.diag(h * d + h * h * k)
            torque = command.torque + k * (command.position - q - h * v) - d * v
        elif isinstance(command, TorqueCommand):
            torque = command.torque
        else:
            torque = np.zeros(self.spec.n)
        limit = model.limits.torque
        change: FloatArray = np.linalg.solve(inertia, np.clip(torque, -limit, limit) - coriolis[0])
        return h * change

    def _save_plant(self) -> object:
        return (
            self._position.copy(),
            self._velocity.copy(),
            self._command,
            tuple(state.copy() for state in self._effects),
            self._random.bit_generator.state,
        )

    def _restore_plant(self, saved: Any) -> None:  # noqa: ANN401  # what _save_plant returned
        self._position, self._velocity, self._command, self._effects, random = saved
        self._random.bit_generator.state = random
