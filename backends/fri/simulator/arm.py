"""The arm behind the simulated controller: MuJoCo's iiwa under the three kinds of control.

- position: the stiff servo of the simulated drives;
- joint impedance: spring and damper around the set-point, plus the client's joint torque;
- Cartesian impedance: Jᵀ (K (x_d − x) − D ẋ + wrench), x the flange in the axes of the base, with a
  spring and a damper for the elbow in the null space.

Interpolate the set-point of the arm, each millisecond, between the commands of a client.

A command comes once every receive interval. Between p₀, p₁ and the newest p₂ the set-point moves on
the mean over one interval of the polyline through them: at a fraction u of the interval

    q(u) = p₁ + ½ (p₂ − p₁) u² − ½ (p₁ − p₀) (1 − u)²

so that its velocity has no steps; it is half an interval behind. An interval of one millisecond is
followed as it is. One command that did not come is bridged by going on at the same velocity; when
more are missing, the arm comes to rest on the last one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from backends.fri.codec.messages import JOINTS, ControlMode
from backends.mujoco_sim import MujocoRobot, layout
from backends.mujoco_sim.realisation import largest_stiffness
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation
from limo_driver.types import FloatArray, ImpedanceCommand, PositionCommand

ACCELERATION_BANDWIDTH: Final = 20.0  # [Hz], of the acceleration in the robot's own model
DAMPING_RATIO: Final = 0.7
FRACTION_OF_STIFFEST: Final = 0.25  # that the step can follow
STEP: Final = 1e-3  # [s], of the arm's own control


@dataclass(frozen=True)
class Compliance:
    """Stiffness of the compliant kinds of control (limo's choice; an application sets its own)."""

    joint: tuple[float, ...] = (1000.0, 1000.0, 1000.0, 800.0, 300.0, 300.0, 150.0)  # [N m/rad]
    translation: float = 2000.0  # [N/m]
    rotation: float = 150.0  # [N m/rad]
    elbow: float = 200.0  # [N m/rad], of the null space
    joint_damping: float = 1.5  # [N m s/rad], beside the Cartesian one
    mass: float = 12.0  # [kg], and
    inertia: float = 1.0  # [kg m²], that the Cartesian damping is laid out for
    elbow_inertia: float = 3.0  # [kg m²], that the elbow's is


@dataclass(frozen=True)
class ArmState:
    """Last measurements of the arm; each array has shape (7,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    torque: FloatArray  # [N m], at the torque sensors
    model_torque: FloatArray  # [N m], of the robot's own model of itself
    external_torque: FloatArray  # [N m], measured minus that model


class ControlledArm(MujocoRobot):
    """A simulated arm that a controller moves itself, instead of by `receive` and `send`.

    Args:
        simulation: Arm and effects, or the path of a `sim.yaml`; the iiwa without effects if None.
        compliance: Stiffness of the compliant kinds of control.
        initial_position: Where it stands, (7,) [rad].
        seed: Of the sensors' noise.

    Raises:
        ConfigError: The arm has not seven joints.
    """

    def __init__(
        self,
        simulation: Simulation | None,
        compliance: Compliance,
        initial_position: Sequence[float],
        seed: int = 0,
    ) -> None:
        if simulation is not None and simulation.model.n != JOINTS:
            raise ConfigError(
                f"FRI is for arms with {JOINTS} joints; {simulation.model.name} has "
                f"{simulation.model.n}"
            )
        super().__init__(simulation, initial_position=initial_position, seed=seed, period=STEP)
        self.nominal = self.simulation.model  # the robot's own model of itself: no effects
        self._compliance = compliance
        self._stiffness, self._damping = self._joint_gains()
        self.control = ControlMode.POSITION
        self._row = np.zeros((1, layout.LOG_ROWS, JOINTS))
        self._acceleration = np.zeros(JOINTS)
        self._last_velocity = np.zeros(JOINTS)
        self._smoothing = 1.0 - float(np.exp(-2.0 * np.pi * ACCELERATION_BANDWIDTH * STEP))
        self._elbow_axis = np.zeros(JOINTS)
        self._goal_for: FloatArray | None = None
        self._goal = np.eye(4)
        self.take_control(ControlMode.POSITION, np.array(initial_position, dtype=float))

    def take_control(self, control: ControlMode, position: FloatArray) -> None:
        """Let another kind of control take over, around a set-point, (7,) [rad]."""
        if control is ControlMode.POSITION:
            self._apply(PositionCommand(position=position))
        else:
            joint = control is ControlMode.JOINT_IMPEDANCE
            self._apply(
                ImpedanceCommand(
                    position=position,
                    stiffness=self._stiffness if joint else np.zeros(JOINTS),
                    damping=self._damping if joint else self._cartesian_joint_damping(),
                    torque=np.zeros(JOINTS),
                )
            )
        self.control = control

    def push(self, torque: FloatArray) -> None:
        """Lean on the joints from outside, (7,) [N m]."""
        self._sampled.push(torque)

    def torque_of(self, force: FloatArray) -> FloatArray:
        """Return the torque on the joints, (7,) [N m], of a force on the flange, (3,) [N]."""
        return self._jacobian()[:3].T @ force

    def advance(
        self,
        targets: FloatArray,
        torque: FloatArray | None = None,
        wrench: FloatArray | None = None,
    ) -> ArmState:
        """Simulate T milliseconds.

        Args:
            targets: Set-points, (T, 7) [rad].
            torque: Added to joint impedance control, (7,) [N m].
            wrench: Added to Cartesian impedance control, (6,) [N, N m].
        """
        cartesian = self.control is ControlMode.CARTESIAN_IMPEDANCE
        self._command[layout.FEED_FORWARD] = 0.0 if torque is None or cartesian else torque
        if cartesian:
            self._elbow_axis = np.linalg.svd(self._jacobian())[2][-1]
        for row in range(len(targets)):
            here = targets[row : row + 1]
            if cartesian:
                self._command[layout.FEED_FORWARD] = self._cartesian(here[0], wrench)
            self._advance(here, self._row)
            self._cycle += 1
            velocity = self._row[0, layout.MEASURED_VELOCITY]
            change = (velocity - self._last_velocity) / STEP
            self._acceleration += self._smoothing * (change - self._acceleration)
            self._last_velocity = velocity.copy()
        return self._state_of_row()

    def _state_of_row(self) -> ArmState:
        log = self._row[0]
        position, velocity = log[layout.MEASURED_POSITION], log[layout.MEASURED_VELOCITY]
        torque = log[layout.MEASURED_TORQUE].copy()
        model = self.nominal.inverse_dynamics(
            position[None], velocity[None], self._acceleration[None]
        )[0]
        return ArmState(position.copy(), velocity.copy(), torque, model, torque - model)

    def _jacobian(self) -> FloatArray:
        return self.nominal.flange_jacobian(self._memory[layout.ENCODER])

    def _cartesian(self, target: FloatArray, wrench: FloatArray | None) -> FloatArray:
        """Return the joint torque of Cartesian impedance control, (7,) [N m]."""
        own, position = self._compliance, self._memory[layout.ENCODER]
        velocity = self._memory[layout.ENCODER_VELOCITY]
        if self._goal_for is None or (target != self._goal_for).any():
            self._goal_for, self._goal = target.copy(), self.nominal.flange_pose(target)
        pose, jacobian = self.nominal.flange_pose(position), self._jacobian()
        twist = jacobian @ velocity
        force = np.empty(6)
        force[:3] = own.translation * (self._goal[:3, 3] - pose[:3, 3])
        force[3:] = own.rotation * _rotation_between(pose[:3, :3], self._goal[:3, :3])
        force[:3] -= _damping(own.translation, own.mass) * twist[:3]
        force[3:] -= _damping(own.rotation, own.inertia) * twist[3:]
        if wrench is not None:
            force += wrench
        aside = own.elbow * float(self._elbow_axis @ (target - position))
        aside -= _damping(own.elbow, own.elbow_inertia) * float(self._elbow_axis @ velocity)
        return jacobian.T @ force + aside * self._elbow_axis

    def _joint_gains(self) -> tuple[FloatArray, FloatArray]:
        most = FRACTION_OF_STIFFEST * largest_stiffness(self._inertia, STEP)
        stiffness = np.minimum(np.array(self._compliance.joint), most)
        return stiffness, 2.0 * DAMPING_RATIO * np.sqrt(stiffness * self._inertia)

    def _cartesian_joint_damping(self) -> FloatArray:
        return np.full(JOINTS, self._compliance.joint_damping)


def _damping(stiffness: float, inertia: float) -> float:
    return 2.0 * DAMPING_RATIO * float(np.sqrt(stiffness * inertia))


def _rotation_between(now: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the rotation that is missing, (3,) [rad], exact for small ones."""
    return 0.5 * np.cross(now.T, goal.T).sum(axis=0)


class SetpointPath:
    """The set-point of the arm.

    Args:
        position: Where it stands, (n,) [rad].
        acceleration: With which it brakes, (n,) [rad/s²].
        steps: Milliseconds in one receive interval.
    """

    def __init__(self, position: FloatArray, acceleration: FloatArray, steps: int) -> None:
        self.steps = steps
        self._acceleration = acceleration
        self.rest_at(position, np.zeros_like(position))

    def rest_at(self, position: FloatArray, velocity: FloatArray) -> None:
        """Go on from a pose and its velocity, (n,) each [rad, rad/s], braking."""
        self.position, self.velocity = position.copy(), velocity.copy()
        self._base: FloatArray | None = None  # where the arm rests, less the program's motion
        self._standing = False  # there, with no motion to come
        self._begin_interval(self.position)

    def follow(self, command: FloatArray | None, count: int) -> FloatArray:
        """Return the next `count` set-points towards a client's command, (count, n) [rad].

        Args:
            command: The newest position commanded, (n,) [rad], if one came.
            count: Milliseconds.
        """
        self._base, self._standing = None, False
        if command is not None:
            self._command, self._missing = command, 0
        targets = np.empty((count, self.position.size))
        for row in range(count):
            if self._done == self.steps:
                self._points = (self._points[1], self._points[2], self._next_point())
                self._done = 0
            self._done += 1
            targets[row] = self._between(self._done / self.steps)
        return self._told(targets)

    def rest(self, program: FloatArray, count: int) -> FloatArray:
        """Return the next `count` set-points without a client: braking, then the program's motion.

        Args:
            program: How far the robot's program has moved the joints away from where they rest,
                at the end of these steps, (n,) [rad].
            count: Milliseconds.
        """
        if self._standing and not program.any():
            return np.repeat(self.position[None], count, axis=0)
        targets = np.empty((count, self.position.size))
        if self._base is None and self.velocity.any():
            position, velocity = self.position, self.velocity
            for row in range(count):
                position, velocity = slow_down(position, velocity, self._acceleration, STEP)
                targets[row] = position
            self.position, self.velocity = position, velocity
            self._begin_interval(position)
            return targets
        base = self.position - program if self._base is None else self._base
        self._base, goal = base, base + program
        steps = np.arange(1, count + 1)[:, None] / count
        targets[:] = self.position + (goal - self.position) * steps
        self._told(targets)
        self._standing = not program.any()
        self.velocity *= not self._standing  # of the last step to where it rests, otherwise
        self._begin_interval(self.position)
        return targets

    def guide(self, goal: FloatArray, count: int) -> FloatArray:
        """Return the next `count` set-points towards where a hand has the arm, (n,) [rad]."""
        self._base, self._standing = None, False
        steps = np.arange(1, count + 1)[:, None] / count
        targets = self._told(self.position + (goal - self.position) * steps)
        self.velocity *= 0.0  # it rests as soon as the hand does
        self._begin_interval(self.position)
        return targets

    def _next_point(self) -> FloatArray:
        """Return where the set-point goes in the interval that begins, (n,) [rad]."""
        self._missing += 1  # until a command comes
        if self._missing == 2:  # noqa: PLR2004  # of the interval before and of this one
            return 2.0 * self._points[2] - self._points[1]
        return self._command

    def _between(self, u: float) -> FloatArray:
        p0, p1, p2 = self._points
        if self.steps == 1:
            return p2
        return p1 + 0.5 * (p2 - p1) * u * u - 0.5 * (p1 - p0) * (1.0 - u) ** 2

    def _begin_interval(self, position: FloatArray) -> None:
        self._points = (position, position, position)
        self._command, self._missing = position, 0
        self._done = self.steps

    def _told(self, targets: FloatArray) -> FloatArray:
        before = targets[-2] if len(targets) > 1 else self.position
        self.velocity = (targets[-1] - before) / STEP
        self.position = targets[-1].copy()
        return targets


def slow_down(
    position: FloatArray, velocity: FloatArray, acceleration: FloatArray, period: float
) -> tuple[FloatArray, FloatArray]:
    """Return the next set-point of an arm that brakes to rest, and its velocity."""
    slower = np.sign(velocity) * np.maximum(np.abs(velocity) - acceleration * period, 0.0)
    return position + slower * period, slower
