"""VirtualRobot: an ideal arm in simulated time, which follows each command exactly.

Position set-points are met in the next cycle; impedance and torque commands move a rigid body
without friction. The torque is what the simulation says the motion needs. It is for testing
programs, not physics: `mujoco` is for physics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from backends.simulated import (
    DEFAULT_PERIOD,
    SimulatedRobot,
    check_gains,
    simulation_of,
    start_position,
)
from limo_driver.errors import BackendError
from limo_driver.robot.safety import START_TOLERANCE
from limo_driver.runtime.parameters import seed_of
from limo_driver.types import (
    ImpedanceCommand,
    JointSample,
    JointState,
    PositionCommand,
    TorqueCommand,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray, JointCommand

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
