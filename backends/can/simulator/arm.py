"""SimulatedArm: one MuJoCo simulation behind all drives of an arm.

Its time is counted in SYNCs while they come: each one moves the arm on by a communication period.
So a computer that is late disturbs the arm's time, not its motion, and a run on a loaded machine
moves exactly as on a quiet one. When SYNCs cease for a tenth of a second, and under a convention
that has none, the arm's own clock takes over: gravity, brakes and quick stops do not wait for
messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from backends.can.simulator.drive import AMBIENT, Actuation, JointPort
from backends.mujoco_sim import MujocoRobot, layout
from limo_driver.errors import BackendError
from limo_driver.physics import Simulation
from limo_driver.types import FloatArray

STEP: Final = 1e-3  # of the simulation [s]
LONGEST_GAP: Final = 0.05  # [s] simulated at once; a process that slept longer does not catch up
SYNC_PATIENCE: Final = 0.1  # [s] without SYNC after which the arm's own clock goes on
WARMING: Final = 30.0  # [°C] above the surroundings at the torque limit, in the long run
WARMING_TIME: Final = 300.0  # [s]


class DrivenArm(MujocoRobot):
    """A MuJoCo arm whose joints each have their own drive, without a contract of its own."""

    @property
    def encoders(self) -> FloatArray:
        """Positions that the encoders read, (n,) [rad]."""
        return self._memory[layout.ENCODER].copy()

    def pace(
        self,
        targets: FloatArray,
        servo: FloatArray,
        stiffness: FloatArray,
        damping: FloatArray,
        torque: FloatArray,
    ) -> FloatArray:
        """Simulate T steps.

        Args:
            targets: Position of each joint after each step, (T, n) [rad].
            servo: 1 where the drive's position servo runs, (n,).
            stiffness: Of the other joints, (n,) [N m/rad].
            damping: Of the other joints, (n,) [N m s/rad].
            torque: Made as such, (n,) [N m].

        Returns:
            Measured position, velocity and torque after the last step, (3, n).
        """
        begins = (servo != 0.0) & (self._command[layout.SERVO] == 0.0)
        memory = self._memory
        memory[layout.LAST_TARGET][begins] = memory[layout.ENCODER][begins]
        memory[layout.TARGET_VELOCITY][begins] = memory[layout.ENCODER_VELOCITY][begins]
        self._command[layout.SERVO] = servo
        self._command[layout.STIFFNESS] = stiffness
        self._command[layout.DAMPING] = damping
        self._command[layout.FEED_FORWARD] = torque
        self._mode = layout.DRIVES
        log = np.empty((len(targets), layout.LOG_ROWS, self.spec.n))
        self._advance(targets, log)
        self._cycle += len(targets)
        return log[-1, : layout.MEASURED_TORQUE + 1]


class SimulatedArm:
    """An arm of n joints with a `JointPort` each, moved on by SYNC or by the clock.

    Args:
        simulation: Arm and effects.
        position: Where it stands at first, (n,) [rad]; the middle of the range if not given.
        seed: Of the sensor noise.
    """

    def __init__(
        self,
        simulation: Simulation,
        position: Sequence[float] | FloatArray | None = None,
        seed: int = 0,
    ) -> None:
        self._arm = DrivenArm(simulation, initial_position=position, seed=seed, period=STEP)
        n = self._arm.spec.n
        self.joints = tuple(JointPort() for _ in range(n))
        self._torque_limit = self._arm.spec.limits.torque
        # Knots of the quadratic spline through the last three set-points, (3, n) [rad].
        self._knots = np.tile(self._arm.encoders, (3, 1))
        self._servo = np.ones(n)
        self.guided: FloatArray | None = None  # where a hand has the joints without power [rad]
        self._simulated = 0.0  # time simulated, in steps of STEP [s]
        self._due = 0.0  # time that has passed for the arm [s]
        self._clock: float | None = None  # when time was last accounted for [s]
        self._patient_until = 0.0  # by the clock [s]
        self._temperature = np.full(n, AMBIENT)
        for joint, at in zip(self.joints, self._knots[2], strict=True):
            joint.position = joint.measured_position = float(at)
        self._simulate(1)

    @property
    def encoders(self) -> FloatArray:
        """Positions that the encoders read, (n,) [rad]."""
        return self._arm.encoders

    @property
    def time(self) -> float:
        """Time of the arm [s]."""
        return self._simulated

    def synchronise(self, period: float, now: float) -> None:
        """Move on by one communication period [s], towards the set-points that are in force."""
        self.move_on(period)
        self._patient_until = now + SYNC_PATIENCE

    def periods_due(self, period: float, now: float) -> int:
        """Return how many communication periods [s] have passed that no SYNC moved the arm by."""
        if self._clock is None or now < self._patient_until:
            self._clock = now  # time that waited for a SYNC has not passed
            return 0
        self._clock = max(self._clock, now - LONGEST_GAP)
        due = int((now - self._clock) / period)
        self._clock += due * period
        return due

    def move_on(self, period: float) -> None:
        """Simulate one period as a whole number of steps; what is left over waits for the next."""
        self._due += period
        steps = round((self._due - self._simulated) / STEP)
        if steps > 0:
            self._simulate(steps)

    def _simulate(self, steps: int) -> None:
        acts = [joint.actuation for joint in self.joints]
        servo = np.array([float(act in {Actuation.POSITION, Actuation.BRAKE}) for act in acts])
        self._shift_knots(servo, acts, steps * STEP)
        stiff = np.array([float(act is Actuation.IMPEDANCE) for act in acts])
        driven = np.array([float(act not in {Actuation.FREE, Actuation.BRAKE}) for act in acts])
        columns = [
            (port.stiffness, port.damping, port.velocity, port.torque) for port in self.joints
        ]
        stiffness, damping, velocity, torque = np.array(columns).T
        # Positions along the spline, (T, n) [rad]; an impedance has its own at once
        s = (np.arange(1, steps + 1) / steps)[:, None]
        first, second, last = self._knots
        spline = 0.5 * (1 - s) ** 2 * first + (0.5 + s - s * s) * second + 0.5 * s * s * last
        targets = np.where(stiff != 0.0, last, spline)
        damping = damping * stiff
        made = np.clip(
            driven * (torque + damping * velocity), -self._torque_limit, self._torque_limit
        )
        measured = self._arm.pace(targets, servo, stiffness * stiff, damping, made)
        self._simulated += steps * STEP
        settled = AMBIENT + WARMING * (measured[2] / self._torque_limit) ** 2
        self._temperature += min((steps * STEP) / WARMING_TIME, 1.0) * (settled - self._temperature)
        self._write(measured)

    def _shift_knots(self, servo: FloatArray, acts: list[Actuation], duration: float) -> None:
        goal = np.array([port.position for port in self.joints])
        begins = (servo != 0.0) & (self._servo == 0.0)
        for j, (port, act) in enumerate(zip(self.joints, acts, strict=True)):
            if begins[j]:  # from where the joint is, with the velocity that it has
                half = 0.5 * duration * port.measured_velocity
                self._knots[1:, j] = port.measured_position + np.array((-half, half))
            if act is Actuation.BRAKE:  # keeps the last knot, or where the joint is
                goal[j] = self._knots[2, j] if self.guided is None else self.guided[j]
        self._knots = np.stack([self._knots[1], self._knots[2], goal])
        self._servo = servo

    def _write(self, measured: FloatArray) -> None:
        if not np.isfinite(measured).all():
            raise BackendError("the simulated arm left the finite numbers; check effects and gains")
        for j, port in enumerate(self.joints):
            port.measured_position = float(measured[0, j])
            port.measured_velocity = float(measured[1, j])
            port.measured_torque = float(measured[2, j])
            port.temperature = float(self._temperature[j])
